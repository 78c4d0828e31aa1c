"""Adjoint derivatives of units over several internal steps: against differences, after a rollback, and in CasADi's import."""

from __future__ import annotations

import re
import zipfile
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from phfmu import Collocated, FMUInstance, build_model, export
from phfmu.components.library import build

pytestmark = pytest.mark.usefixtures("compiler")

STEP, PARTS = 1e-3, 5


@pytest.fixture(scope="module", params=[2, 4])
def unit_file(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    model = build_model(build("dc_motor"), Collocated(request.param // 2))
    return export(model, tmp_path_factory.mktemp("adjoint"), step=STEP)[1]


def adjoint(unit: FMUInstance, seed: list[float]) -> np.ndarray:
    """S^T seed of the last communication step."""
    means = [unit.variable(n).reference for p in unit.ports for n in p.step_outputs]
    return np.array(
        unit._slave.fmu.getAdjointDerivative(means, [unit.variable(n).reference for n in unit.inputs], seed)
    )


def test_it_is_that_of_differences_and_comes_back_with_the_state(unit_file: Path) -> None:
    with FMUInstance(unit_file) as unit:
        u, h, seed = np.array([12.0, 0.3]), PARTS * STEP, [0.7, -1.3]
        unit.set_input(u)
        unit.do_step(0.0, h)
        state = unit.get_state()

        def means(du: np.ndarray) -> np.ndarray:
            unit.set_state(state)
            unit.set_input(u + du)
            unit.do_step(h, h)
            return unit.output()

        S = np.column_stack([(means(e) - means(-e)) / 2 for e in np.eye(2)])  # the motor is linear
        means(np.zeros(2))
        after, found = unit.get_state(), adjoint(unit, seed)
        np.testing.assert_allclose(found, S.T @ seed, rtol=1e-10, atol=1e-12)
        means(np.array([5.0, 1.0]))
        unit.set_state(after)
        np.testing.assert_array_equal(adjoint(unit, seed), found)


def listed(description: str) -> str:
    """The description with all inputs as dependencies where it leaves them to the default, which CasADi does not know."""
    inputs = " ".join(re.findall(r'valueReference="(\d+)"[^>]*causality="input"', description))
    return re.sub(
        r'<(Output|InitialUnknown) valueReference="(\d+)"/>',
        rf'<\1 valueReference="\2" dependencies="{inputs}"/>',
        description,
    )


@pytest.mark.parametrize("version", [2, 3])
def test_casadi_imports_it(version: int, tmp_path: Path) -> None:
    """CasADi's import calls the directional derivative, and of FMI 3 the adjoint one for its reverse derivatives.

    Up to 3.8 it refuses whatever is not of Model Exchange, which is the state of a solver and no step: then that is the reason.
    """
    made = export(build_model(build("dc_motor")), tmp_path, step=STEP)[version - 2]
    with zipfile.ZipFile(made) as archive:
        archive.extractall(tmp_path / "unit")
    description = tmp_path / "unit" / "modelDescription.xml"
    description.write_text(listed(description.read_text("utf-8")), "utf-8")
    try:
        unit = ca.DaeBuilder("motor", str(tmp_path / "unit"), {})
    except RuntimeError as error:
        told = str(error).splitlines()[-1]
        assert "must be of ModelExchange type" in told
        pytest.skip(f"CasADi {ca.__version__} imports units of Model Exchange only, these are of Co-Simulation: {told}")
    f = unit.create("f", ["u"], ["y"])
    given = ca.DM.ones(f.size_in(0))
    J = np.array(f.jacobian()(given, f(given)))
    np.testing.assert_allclose(f.reverse(1)(given, f(given), ca.DM.ones(f.size_out(0))), J.T.sum(axis=1), rtol=1e-12)
