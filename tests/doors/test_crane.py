"""Least sum of squares of the force that moves a hanging load from rest to rest: IPOPT over steps."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from phfmu import Collocated, Event, NativeInstance, Options, StepFunction, build_model, run
from phfmu.network.couplings.monolithic import Monolithic
from tests.doors.crane import crane, moved

pytestmark = pytest.mark.usefixtures("compiler")

N, H = 40, 0.1


@pytest.fixture(scope="module")
def step() -> StepFunction:
    model = build_model(crane(), Collocated(2))
    return StepFunction(model, NativeInstance(model), H)


def test_few_iterations_and_the_run_arrives(step: StepFunction) -> None:
    way = 5.0
    u, states, opti = moved(step, way, N)
    facts = opti.stats()
    assert facts["success"] and facts["iter_count"] <= 60
    r = NativeInstance(step.model).run(0.0, H, N, record=("x", "supplied"), inputs=u.reshape(-1, 1))
    assert (np.abs(r["x"] - states[:, 1:].T) / np.abs(states).max(axis=1)).max() < 1e-9
    assert abs(r["x"][-1] - [way, 0, 0, 0]).max() < 1e-6
    assert abs(r["supplied"].sum()) < 1e-6 * np.abs(r["supplied"]).sum()  # nothing is lost, and it rests again
    assert np.abs(states[1]).max() > 0.2  # far from what is linear


def test_a_run_at_the_optimum_has_its_cost(step: StepFunction) -> None:
    """The forces as events of a run of its own, whose rows tell them and where the load is."""
    u, _, opti = moved(step, 5.0, N)
    stepper = Monolithic(step.model, NativeInstance(step.model))
    events = [Event(k * H, "trolley.force", float(force)) for k, force in enumerate(u)]
    result = run(stepper, Options(stop=N * H, step=H, events=events))
    forces = result.column("trolley.force")[1:] if len(result.time) == N + 1 else np.zeros(0)
    assert H * np.sum(forces**2) == pytest.approx(opti.value(opti.f) * N * H * (300.0 * 5.0) ** 2, rel=1e-8)
    end = [result.column(name)[-1] for name in ("x", "angle", "p", "L")]
    assert np.abs(np.array(end) - [5.0, 0.0, 0.0, 0.0]).max() < 1e-6


def test_the_matrix_is_sparse(step: StepFunction) -> None:
    import casadi as ca

    opti = moved(step, 5.0, N)[2]
    J = ca.jacobian(opti.g, opti.x).sparsity()
    assert J.nnz() <= N * (16 + 4 + 4) + 8


def test_a_small_way_is_that_of_the_linear_crane(step: StepFunction) -> None:
    """Held forces of least squares by the discrete linear system, in accelerations and angles, from its exponential."""
    way, (M, m, l, g) = 1e-3, step.start[2]
    # M a + m g angle = u,  l angle'' + a + g angle = 0
    A = np.zeros((4, 4))
    A[0, 2] = A[1, 3] = 1.0
    A[2, 1], A[3, 1] = m * g / M, -(M + m) * g / (M * l)
    B = np.array([0, 0, 1 / M, -1 / (M * l)])
    whole = expm(np.block([[A, B[:, None]], [np.zeros((1, 5))]]) * H)
    Ad, Bd = whole[:4, :4], whole[:4, 4]
    reach = np.column_stack([np.linalg.matrix_power(Ad, N - 1 - k) @ Bd for k in range(N)])
    expected = np.linalg.lstsq(reach, np.array([way, 0, 0, 0]), rcond=None)[0]
    u = moved(step, way, N)[0]
    np.testing.assert_allclose(u, expected, atol=2e-5 * np.abs(expected).max())
