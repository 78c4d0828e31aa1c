"""Native runtime on small plans made by hand, against numpy and scipy."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq, fsolve

from phfmu.engine.build.derived import factor_values
from phfmu.engine.native.native import NativeInstance
from phfmu.outcome.status import Status, StepFailure
from tests.engine.hand_made import (
    A2,
    C2,
    HandMade,
    bar,
    blow_up,
    gauss_two,
    heat,
    implicit_node,
    oscillator,
    oscillator_step,
    pendulum,
)


def test_oscillator_equals_numpy_and_the_ledger_closes() -> None:
    model, h, n = oscillator(), 0.05, 200
    inst = NativeInstance(model)
    u = np.sin(0.3 * np.arange(n))[:, None]
    record = ("x", "y_step", "pairs", "stored", "dissipated", "supplied", "energy", "counts")
    got = inst.run(0.0, h, n, record, inputs=u)
    x = model.x0
    for i in range(n):
        x, y = oscillator_step(x, u[i, 0], h, model.p0)
        assert np.allclose(got["x"][i], x, rtol=0, atol=1e-13)
        assert abs(got["y_step"][i, 0] - y) < 1e-13
    assert np.allclose(got["pairs"], h * u * got["y_step"], rtol=1e-15)
    closure = got["stored"] + got["dissipated"] - got["supplied"]
    assert np.abs(closure).max() < 5e-16 * np.abs(got["energy"]).max()
    assert np.allclose(got["energy"][:, 0], got["x"] ** 2 @ (model.p0[:2] / 2), rtol=1e-15)
    signals = inst.signals()
    assert signals["energy"][0] == pytest.approx(got["pairs"].sum(), rel=1e-14)
    assert signals["residual"][0] == pytest.approx(closure.sum(), abs=1e-18)
    assert signals["y_end"][0] == pytest.approx(model.p0[1] * x[1], rel=1e-13)
    assert signals["observables"][0] == pytest.approx(model.p0[0] * x[0], rel=1e-12)
    assert inst.time == 0.0 + (n - 1) * h + h
    assert inst.counts["steps"] == n and inst.counts["substeps"] == 0


def test_single_steps_equal_run_bitwise_and_parts_are_substeps() -> None:
    one, other, fine = (NativeInstance(oscillator()) for _ in range(3))
    u = np.linspace(-1, 1, 20)
    rows = one.run(1.0, 0.1, 20, ("x",), inputs=u[:, None])["x"]
    for i in range(20):
        other.set_input([u[i]])
        other.do_step(1.0 + i * 0.1, 0.1)
        assert other.x.tobytes() == rows[i].tobytes()
    fine.set_input([0.7])
    fine.do_step(0.0, 0.3, parts=3)
    x, y = fine.model.x0, []
    for _ in range(3):
        x, mean = oscillator_step(x, 0.7, 0.1, fine.model.p0)
        y.append(mean)
    assert np.allclose(fine.x, x, rtol=0, atol=1e-14)
    assert fine.output()[0] == pytest.approx(np.mean(y), rel=1e-14)
    assert fine.ledger()["pairs"][0] == pytest.approx(0.3 * 0.7 * fine.output()[0], rel=1e-14)
    change = []
    for u in (0.8, 0.6):
        other.reset()
        other.set_input([u])
        other.do_step(0.0, 0.3, parts=3)
        change.append(other.output()[0])
    assert fine.sensitivity()[0, 0] == pytest.approx((change[0] - change[1]) / 0.2, rel=1e-12)


def test_pendulum_conserves_energy_and_equals_scipy() -> None:
    inst, h = NativeInstance(pendulum()), 0.1

    def residual(d: np.ndarray, x: np.ndarray) -> np.ndarray:
        gradient = -(np.cos(x[0] + d[0]) - np.cos(x[0])) / d[0]
        return np.array([d[0] - h * (x[1] + d[1] / 2), d[1] + h * gradient])

    x = inst.x
    for i in range(50):
        inst.do_step(i * h, h)
        step: Any = fsolve(residual, [h * x[1] + 1e-3, -h * np.sin(x[0])], (x,), xtol=1e-13)
        x = x + step
        assert np.allclose(inst.x, x, rtol=0, atol=1e-10)
    energy = inst.run(5.0, h, 2000, ("energy", "stored"))
    assert np.abs(energy["stored"]).max() < 3e-16
    assert np.ptp(energy["energy"]) < 3e-15


def test_duplicate_constraints_share_the_multiplier() -> None:
    single, double = NativeInstance(bar(1)), NativeInstance(bar(2))
    one = single.run(0.0, 0.01, 100, ("x", "a"))
    two = double.run(0.0, 0.01, 100, ("x", "a"))
    assert np.allclose(one["x"], two["x"], rtol=0, atol=1e-12)
    assert np.allclose(two["a"], one["a"] / 2, rtol=1e-8, atol=1e-10)
    d = one["x"][:, :2] - one["x"][:, 2:4]
    assert np.allclose((d**2).sum(axis=1), 1.0, rtol=0, atol=1e-13)

    def residual(w: np.ndarray) -> np.ndarray:
        h, x = 0.01, single.model.x0
        m = x + w[:8] / 2
        arm = np.concatenate([m[:2] - m[2:4], m[2:4] - m[:2]])
        force = h * arm * w[8] + h * np.array([0, 9.81, 0, 0])
        return np.concatenate([w[:4] - h * m[4:], w[4:8] + force, [-arm @ m[4:] * 100]])

    w: Any = fsolve(residual, np.zeros(9), xtol=1e-12)
    assert np.allclose(one["x"][0], single.model.x0 + w[:8], rtol=0, atol=1e-12)
    assert one["a"][0, 0] == pytest.approx(w[8], rel=1e-9)


def test_a_step_that_does_not_solve_is_halved_then_refused() -> None:
    inst = NativeInstance(blow_up())
    inst.do_step(0.0, 0.6)
    assert inst.counts["substeps"] == 1
    x = 1.0
    for h in (0.3, 0.3):
        d = fsolve(lambda d, x=x, h=h: d - h * (x + d / 2) ** 2, h * x * x, xtol=1e-14)[0]
        x += d
    assert inst.x[0] == pytest.approx(x, rel=1e-12)
    before = inst.get_state()
    with pytest.raises(StepFailure, match="balance of x") as failure:
        inst.do_step(0.6, 5.0)
    assert failure.value.status is Status.NO_CONVERGENCE
    assert failure.value.h == 5.0 / 64 and failure.value.time >= 0.6
    assert inst.get_state() == before and inst.counts["failed"] == 1
    inst.do_step(0.6, 0.01)


def test_node_inputs_and_their_substeps() -> None:
    inst = NativeInstance(gauss_two())

    def step(x: float, u: np.ndarray, h: float) -> tuple[float, np.ndarray]:
        slopes = np.linalg.solve(np.eye(2) + h * A2, u - x)
        return x + h * slopes.mean(), x + h * A2 @ slopes

    u = np.array([0.4, -1.1])
    inst.set_node_inputs(u[:, None])
    inst.do_step(0.0, 0.3)
    x, stages = step(1.0, u, 0.3)
    assert inst.x[0] == pytest.approx(x, rel=1e-14)
    assert inst.output()[0] == pytest.approx(stages.mean(), rel=1e-14)
    ledger = inst.ledger()
    assert ledger["pairs"][0] == pytest.approx(0.3 * u @ stages / 2, rel=1e-14)
    assert abs(ledger["stored"] + ledger["dissipated"] - ledger["supplied"])[0] < 1e-16
    slope = (u[1] - u[0]) / (C2[1] - C2[0])
    line = lambda t: u[0] + slope * (t - C2[0])  # noqa: E731
    assert inst.signals()["observables"][0] == pytest.approx(line(1.0), rel=1e-13)
    inst.reset()
    inst.set_node_inputs(u[:, None])
    inst.do_step(0.0, 0.3, parts=2)
    x = 1.0
    for part in range(2):
        x, _ = step(x, line((part + C2) / 2), 0.15)
    assert inst.x[0] == pytest.approx(x, rel=1e-13)
    held = NativeInstance(gauss_two())
    held.set_input([0.25])
    held.do_step(0.0, 0.3)
    assert held.x[0] == pytest.approx(step(1.0, np.full(2, 0.25), 0.3)[0], rel=1e-14)


@pytest.mark.parametrize("make", [oscillator, gauss_two, implicit_node])
def test_sensitivity_equals_finite_differences(make: Callable[[], HandMade]) -> None:
    inst = NativeInstance(make())
    inst.set_input([0.2])
    inst.do_step(0.0, 0.1)
    state, outputs = inst.get_state(), []
    for du in (1e-4, -1e-4):
        inst.set_state(state)
        inst.set_input([0.3 + du])
        inst.do_step(0.1, 0.1)
        outputs.append(inst.output()[0])
    inst.set_state(state)
    inst.set_input([0.3])
    inst.do_step(0.1, 0.1)
    after = inst.get_state()
    assert inst.sensitivity()[0, 0] == pytest.approx((outputs[0] - outputs[1]) / 2e-4, rel=1e-7)
    assert inst.get_state() == after


def test_end_values_of_an_implicit_node() -> None:
    inst = NativeInstance(implicit_node())

    def root(x: float, u: float) -> float:
        return brentq(lambda a: a - x + a**3 - u, -5, 5, xtol=1e-15)  # pyright: ignore[reportReturnType]

    assert inst.signal("a")[0] == pytest.approx(root(0.3, 0.5), rel=1e-12)
    assert inst.output()[0] == inst.signal("a")[0] == inst.signal("y_end")[0]
    inst.set_input([0.9])
    inst.do_step(0.0, 0.2)
    solves = inst.counts["instants"]
    assert inst.signal("a_end")[0] == pytest.approx(root(inst.x[0], 0.9), rel=1e-12)
    inst.signals()
    assert inst.counts["instants"] == solves + 1
    slope = inst.sensitivity(end=True)[0, 0]
    assert slope == pytest.approx(1 / (1 + 3 * inst.signal("a_end")[0] ** 2), rel=1e-12)


@pytest.mark.parametrize("make", [oscillator, pendulum, lambda: bar(2), gauss_two, implicit_node])
def test_restored_state_gives_the_same_bits_elsewhere(make: Callable[[], HandMade]) -> None:
    one, other = NativeInstance(make()), NativeInstance(make())
    rng = np.random.default_rng(5)
    u = rng.normal(size=(12, one.model.step.nu))
    h = rng.uniform(0.01, 0.05, 12)
    other.run(0.0, 0.02, 3)
    t = np.concatenate([[0.0], np.cumsum(h)])
    for i in range(12):
        if i == 6:
            other.set_state(one.get_state())
        for inst in (one, other) if i >= 6 else (one,):
            inst.set_input(u[i])
            inst.do_step(t[i], h[i])
            inst.signals()
    assert one.get_state() == other.get_state()
    with pytest.raises(ValueError, match="bytes"):
        one.set_state(b"")


def test_a_matrix_that_stays_is_factored_once() -> None:
    """Linear model above the size where the factors get all the memory; a new step size is a new matrix."""
    n, h = 150, 0.05
    inst = NativeInstance(heat(n))
    assert 3 * n < factor_values(inst.model.step)["lucap"] < n * n
    x = inst.run(0.0, h, 10, ("x",))["x"]
    a = np.diag(np.full(n, -2.0)) + np.diag(np.ones(n - 1), 1) + np.diag(np.ones(n - 1), -1)
    exact = np.linalg.matrix_power(np.linalg.solve(np.eye(n) - h / 2 * a, np.eye(n) + h / 2 * a), 10)
    assert np.allclose(x[-1], exact @ inst.model.x0, rtol=0, atol=1e-13)
    assert inst.counts["factored"] == 1
    inst.do_step(0.5, 0.06)
    assert inst.counts["factored"] == 2


def test_values_that_are_not_finite_are_refused() -> None:
    inst = NativeInstance(oscillator())
    state = inst.get_state()
    for call in (lambda: inst.set_input([np.nan]), lambda: inst.set_x(0.0, [np.inf, 0.0])):
        with pytest.raises(StepFailure) as failure:
            call()
        assert failure.value.status is Status.VALUE
    for h in (np.nan, np.inf):
        with pytest.raises(StepFailure) as failure:
            inst.do_step(0.0, h)
        assert failure.value.status is Status.ARGUMENT
    assert inst.get_state() == state
    with pytest.raises(ValueError, match="shape"):
        inst.set_input([1.0, 2.0])


def test_parameters_and_reset() -> None:
    inst = NativeInstance(oscillator())
    start = inst.get_state()
    inst.set_parameters([1.0, 1.0, 0.0])
    inst.do_step(0.0, 0.1)
    x, _ = oscillator_step(inst.model.x0, 0.0, 0.1, np.array([1.0, 1.0, 0.0]))
    assert np.allclose(inst.x, x, rtol=0, atol=1e-15)
    assert inst.parameters.tolist() == [1.0, 1.0, 0.0]
    inst.reset()
    assert inst.get_state() == start
