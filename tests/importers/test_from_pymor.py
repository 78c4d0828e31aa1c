"""Models of pyMOR, full and reduced: the same matrices, the same outputs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.linalg import expm

from phfmu import Collocated, DeclarationError, PythonInstance, build_model, check
from phfmu.importers import from_pymor

pytest.importorskip("pymor", reason="pyMOR is not installed (pip install pymor)")
from pymor.algorithms.timestepping import ImplicitEulerTimeStepper  # noqa: E402
from pymor.core.logger import set_log_levels  # noqa: E402
from pymor.models.iosys import LTIModel, PHLTIModel  # noqa: E402
from pymor.reductors.ph.ph_irka import PHIRKAReductor  # noqa: E402
from pymor.vectorarrays.numpy import NumpyVectorSpace  # noqa: E402

set_log_levels({"pymor": "ERROR"})


def chain(k: int, **more: Any) -> PHLTIModel:
    """k masses between walls, pushed at the last one, as a pyMOR model in E, J, R (Q = I)."""
    K = sp.diags([2 * np.ones(k), -np.ones(k - 1), -np.ones(k - 1)], [0, 1, -1])
    one, zero = sp.eye(k), sp.csc_matrix((k, k))
    J, R = sp.bmat([[None, K], [-K, None]]), sp.block_diag([zero, 0.2 * one])
    G = np.zeros((2 * k, 1))
    G[-1] = 1.0
    return PHLTIModel.from_matrices(
        sp.csc_matrix(J), sp.csc_matrix(R), G, E=sp.csc_matrix(sp.block_diag([K, one])), **more
    )


def after(model: PHLTIModel, x: np.ndarray, u: float, t: float) -> tuple[np.ndarray, float]:
    """x(t) and y(t) by the exponential of pyMOR's A, B, C, D, E."""
    A, B, C, D, E = (None if m is None else m.toarray() if sp.issparse(m) else m for m in LTIModel.to_matrices(model))
    E = np.eye(len(A)) if E is None else E
    rate = np.block([[np.linalg.solve(E, A), np.linalg.solve(E, B) * u], [np.zeros((1, len(A) + 1))]])
    end = (expm(t * rate) @ np.append(x, 1.0))[:-1]
    return end, float((C @ end).item() + (0.0 if D is None else D.item() * u))


def test_a_reduced_model_follows_its_own_equations() -> None:
    reduced = PHIRKAReductor(chain(40)).reduce(8)
    declared = from_pymor(reduced, name="reduced")
    assert check(declared) == [] and declared.x.numel() == 8
    unit = PythonInstance(build_model(declared, Collocated(3)))
    rows = unit.run(0.0, 0.05, 100, ("stored", "dissipated", "supplied"), inputs=[[0.7]] * 100)
    assert abs(rows["stored"] + rows["dissipated"] - rows["supplied"]).max() < 1e-13
    _, own = after(reduced, np.zeros(8), 0.7, 5.0)
    assert unit.signals()["y_end"][0] == pytest.approx(own, abs=1e-9)


def test_a_full_model_keeps_its_states_and_starts() -> None:
    start = np.sin(np.arange(10.0))
    data = NumpyVectorSpace(10).from_numpy(start[:, None])
    full = chain(5, initial_data=data, T=1.0, time_stepper=ImplicitEulerTimeStepper(10))
    declared = from_pymor(full)
    assert [v.name for v in declared.states] == ["x"] and declared.states[0].start == tuple(start)
    unit = PythonInstance(build_model(declared, Collocated(3)))
    unit.run(0.0, 0.02, 50, (), inputs=[[0.3]] * 50)
    end, y = after(full, start, 0.3, 1.0)
    assert np.abs(unit.x - end).max() < 1e-9 and unit.signals()["y_end"][0] == pytest.approx(y, abs=1e-9)


def test_what_is_no_such_model_is_refused() -> None:
    A = -np.eye(2)
    with pytest.raises(DeclarationError, match="is a LTIModel, not a PHLTIModel; .*from_passive_LTIModel"):
        from_pymor(LTIModel.from_matrices(A, np.ones((2, 1)), np.ones((1, 2))))
    with pytest.raises(DeclarationError, match=r"sampling time 0.1 s"):
        from_pymor(chain(3, sampling_time=0.1))
