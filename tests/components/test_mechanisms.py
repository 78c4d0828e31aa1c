"""Mechanisms of the library beside closed forms, published values and integrations in other coordinates."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mechanism_reference import ANDREWS, governor, parallel
from scipy.integrate import solve_ivp
from scipy.special import ellipk

from phfmu import (
    FMUInstance,
    Monolithic,
    NativeInstance,
    Options,
    PythonInstance,
    build_model,
    default_scheme,
    export,
    run,
)
from phfmu.audit.judge import DEFAULT_RTOL, EPS, REACH_ULPS
from phfmu.audit.kinds import LedgerVerdict
from phfmu.components.mechanical.four_bar import four_bar
from phfmu.components.mechanical.heavy_top import heavy_top
from phfmu.components.mechanical.mechanisms import andrews, bricard, flyball, pendulum, slider_crank
from phfmu.components.mechanical.multibody import Mechanism
from phfmu.components.mechanical.multibody.body import rotation_about
from phfmu.outcome.limits import LIMITS
from phfmu.schemes.named import named_scheme
from phfmu.studies.stress.mechanisms import bricard_reference
from tests.wide import slow, wide

G = 9.81


def ran(declaration: Any, order: int, step: float, steps: int, kernels: Any = "auto") -> Any:
    model = build_model(declaration, default_scheme(declaration, order))
    return run(Monolithic(model, NativeInstance(model, kernels=kernels)), Options(stop=steps * step, step=step))


def at(result: Any, name: str, n: int, row: Any = -1) -> np.ndarray:
    return np.array([result.column(f"{name}[{i + 1}]")[row] for i in range(n)])


def test_pendulum_has_the_period_of_the_elliptic_integral() -> None:
    quarter = float(ellipk(0.5)) * (1.0 / G) ** 0.5
    found = ran(pendulum(), 6, quarter / 100, 900)  # two periods and a quarter: through the lowest point, to the right
    late = at(found, "P", 2)[0] / (2 * G) ** 0.5  # seconds
    assert abs(late) / 9 * 4 <= 1e-10
    assert at(found, "P", 2)[1] == pytest.approx(-1.0, abs=1e-13)


@pytest.mark.parametrize("engine", ["native", "python"])
def test_a_pendulum_whose_energies_add_up_to_zero_closes_by_the_joint_gradient(engine: str) -> None:
    """It falls from the height of its zero: H = 0 all the time, and what moves is seen in the parts of H alone."""
    model = build_model(pendulum(), named_scheme(pendulum(), order=2, gradient="joint-gonzalez"))
    made = NativeInstance(model) if engine == "native" else PythonInstance(model)
    found = run(Monolithic(model, made), Options(stop=1.0, step=0.01))
    moved = np.ptp(found.column("q[2]"))
    assert moved > 0.5 and found.ledger.summary().closed and np.abs(found.column("energy.stored")).max() < 1e-13


@pytest.mark.parametrize(
    "n, order, step, most, kernels",
    wide(
        [(2, 6, 0.01, 1e-7, "auto"), (2, 2, 0.002, 1e-3, "auto"), (2, 6, 0.005, 1e-7, "auto"), (2, 6, 0.001, 1e-7, "auto"),
         (2, 2, 0.001, 1e-3, "auto"), (2, 2, 0.005, 1e-2, "auto"), (40, 6, 0.01, 1e-7, "interpreted"),
         (40, 6, 0.01, 1e-7, "compiled"), (40, 2, 0.005, 1e-2, "interpreted"), (40, 2, 0.01, 2e-2, "compiled"),
         (40, 2, 0.002, 1e-3, "compiled"), (40, 6, 0.005, 1e-7, "compiled"), (40, 6, 0.002, 1e-7, "compiled"),
         (40, 2, 0.001, 1e-3, "compiled"), (40, 6, 0.001, 1e-7, "compiled")],
        (2, 6, 0.01, 1e-7, "auto"),
    ),
)  # fmt: skip
def test_four_bar_windows_pass_their_flat_positions(n: int, order: int, step: float, most: float, kernels: str) -> None:
    """By the sparse Newton method of interpreted kernels and the Schur stepper of compiled ones; order 2 has its own error."""
    steps = round(20.0 / step)
    found = ran(four_bar(n), order, step, steps, kernels)
    rows = np.arange(0, steps + 1, steps // 400)
    exact = parallel(n, rows * step)
    assert np.abs(np.array([found.column(f"B0[{i}]")[rows] for i in (1, 2)]) - exact).max() <= most
    assert found.ledger.summary().components[0].verdict is LedgerVerdict.CLOSED


def windows(n: int, angle: float, rate: float) -> np.ndarray:
    """States of n windows whose cranks are at an angle [rad] from the upright and turn at a rate [rad/s]."""
    s, c, arm = np.sin(angle), np.cos(angle), 1 / np.sqrt(12)  # of inertia of a rod
    cranks = [(i + s / 2, c / 2, arm * s, arm * c) for i in range(n + 1)]
    couplers = [(i + 0.5 + s, c, arm, 0.0) for i in range(n)]
    turning = [(rate * c / 2, -rate * s / 2, arm * rate * c, -arm * rate * s)] * (n + 1)
    return np.concatenate(
        [np.ravel(cranks + couplers), np.ravel(turning), np.ravel([(rate * c, -rate * s, 0.0, 0.0)] * n)]
    )


def three_steps_before(n: int, step: float, miss: float) -> np.ndarray:
    """States three steps before the cranks, which have turned since they were upright, have the height `miss`."""
    gravity, end = G * (1.5 * n + 0.5) / (4 / 3 * n + 1 / 3), np.arccos(miss)
    start = solve_ivp(
        lambda _, y: [y[1], gravity * np.sin(y[0])], (3 * step, 0.0), [end, np.sqrt(1 + 2 * gravity * (1 - miss))], "DOP853",
        rtol=1e-13, atol=1e-13,
    ).y[:, -1]  # fmt: skip
    return windows(n, *start)


@pytest.mark.parametrize(
    "native, order, miss",
    [(True, k, miss) for k in (2, 6) for miss in (3e-3, 1e-3, -3e-4, -3.2e-5, 1e-5)] + [(False, 2, 1e-3), (False, 2, 1e-5)],
)  # fmt: skip
def test_a_step_that_ends_near_the_line_needs_no_other_one(native: bool, order: int, miss: float) -> None:
    """The last but one of four steps ends where the heights of the cranks are `miss`.

    Rows are independent by no more than that, and velocities across the lost directions are known to rounding over its
    square.  The step is found from the last one, in no more than two attempts, and the windows do not go apart.
    """
    n, step = 40, 0.01
    declaration = four_bar(n)
    model = build_model(declaration, default_scheme(declaration, order))
    instance = NativeInstance(model, kernels="interpreted") if native else PythonInstance(model)
    instance.set_x(0.0, three_steps_before(n, step, miss))
    for i in range(4):
        before = instance.counts["iterations"]
        instance.do_step(i * step, step)
        assert instance.counts["iterations"] - before <= 2 * LIMITS["NEWTON_ITERATIONS"]
        if i == 2:
            assert 2 * instance.x[1] == pytest.approx(miss, abs=1e-4 if order == 2 else 1e-8)
    assert instance.counts["substeps"] == instance.counts["restarts"] == 0
    q = instance.x[: 4 * (2 * n + 1)].reshape(-1, 4)
    assert np.ptp(q[: n + 1, 3]) <= 1e-12 and np.abs(q[n + 1 :, 3]).max() <= 1e-12


@pytest.mark.slow
def test_a_schur_step_that_the_ledger_would_not_let_pass_is_solved_to_rounding(compiler: None) -> None:
    """The second step ends after three sweeps whose updates shrink by luck: what is left does 1.04 times the work allowed.

    The third one would miss half as much as is allowed, which passes.
    """
    n, step = 40, 0.002
    declaration = four_bar(n)
    model = build_model(declaration, default_scheme(declaration, 6))
    instance, other = (NativeInstance(model, kernels="compiled") for _ in range(2))
    instance.set_x(0.0, three_steps_before(n, step, 1.6e-4))
    first = instance.run(0.0, step, 1, ("stored", "moved"))
    assert instance.counts["schur"] == 1
    other.set_state(instance.get_state())
    second = instance.run(step, step, 4, ("stored", "moved"))
    other.run(step, step, 4)
    assert instance.counts["schur"] == 3 and instance.get_state() == other.get_state()
    for found in (first, second):
        assert (np.abs(found["stored"]) <= (DEFAULT_RTOL + REACH_ULPS * EPS) * found["moved"]).all()


def test_andrews_has_the_published_angles_and_books_its_motor() -> None:
    found = ran(andrews(), 6, 5e-5, 600)
    for name, angle in ANDREWS.items():
        assert found.column(name)[-1] == pytest.approx(angle, abs=1e-8)
    total = found.ledger.summary()
    assert total.ports[0].port == "motor" and abs(total.network.unexplained) <= 1e-14
    work = 0.033 * (ANDREWS["beta"] + 0.0617138900142764496)
    assert total.ports[0].supplied == pytest.approx(work, abs=1e-9)
    assert total.components[0].stored == pytest.approx(work, abs=1e-9)


@pytest.mark.parametrize("order, step, most", [slow((2, 0.01, 1e-3)), slow((6, 0.025, 1e-6))])
def test_bricard_beside_index_reduction(order: int, step: float, most: float) -> None:
    """Thin rods here, masses at points there: the same mechanism."""
    found = ran(bricard(), order, step, round(10.0 / step))
    assert np.abs(at(found, "P3", 3) - bricard_reference(10.0)[6:9]).max() <= most
    assert np.ptp(found.column("energy.stored")) <= 1e-9


@pytest.mark.parametrize("stop, step", [slow((0.5, 0.01)), slow((10.0, 0.002))])
def test_flyball_governor_beside_three_coordinates(stop: float, step: float) -> None:
    found = ran(flyball(), 2, step, round(stop / step))
    height, lost = governor(stop)
    assert found.column("s")[-1] == pytest.approx(height, abs=1e-4)
    total = found.ledger.summary()
    assert total.network.dissipated == pytest.approx(lost, rel=0.02)
    assert abs(total.network.unexplained) <= 1e-9


def test_heavy_top_as_a_body_moves_like_its_directors() -> None:
    mass, radius, spin, tilt = 15.0, 0.5, 40.0, 1.0
    m = Mechanism("top")
    rotation = rotation_about((0, 1, 0), tilt)
    c, w = rotation[:, 2], spin * rotation[:, 2]
    moments = mass * radius**2 * np.array((0.25, 0.25, 0.5))
    top = m.body("top", mass, moments, position=c, rotation=rotation, velocity=np.cross(w, c), angular_velocity=w)
    m.joint("spherical", "tip", None, top, at=(0.0, 0.0, 0.0))
    found, other = (ran(d, 6, 1e-3, 200) for d in (m.build(), heavy_top(mass, radius, spin=spin, tilt=tilt)))
    assert np.abs(at(found, "q", 3) - at(other, "q", 3)).max() <= 1e-12
    assert np.ptp(found.column("energy.stored")) <= 1e-10
    rows = range(0, 201, 20)
    turn = [at(found, "top.rotation", 9, i).reshape(3, 3).T for i in rows]
    spins = [
        r @ np.diag(moments) @ r.T @ at(found, "top.angular_velocity", 3, i) for r, i in zip(turn, rows, strict=True)
    ]
    whole = [
        s + np.cross(at(found, "top.position", 3, i), at(found, "top.momentum", 3, i))
        for s, i in zip(spins, rows, strict=True)
    ]
    assert np.ptp([v[2] for v in whole]) <= 1e-10


@pytest.mark.parametrize("version", [slow("2.0"), slow("3.0")])
def test_a_unit_with_motors_is_both_engines(version: str, tmp_path: Path, compiler: None) -> None:
    declaration = slider_crank().with_starts({"main.torque": 1.5, "bore.force": -2.0})
    model = build_model(declaration, default_scheme(declaration, 2))
    (path,) = export(model, tmp_path, (version,), step=0.005)
    unit, native, python = FMUInstance(path), NativeInstance(model), PythonInstance(model)
    for i in range(50):
        for one in (unit, native, python):
            one.do_step(0.005 * i, 0.005)
        assert np.array_equal(unit.output(), native.output())
        assert unit.ledger()["supplied"] == native.ledger()["supplied"] != 0.0
        assert python.ledger()["supplied"] == pytest.approx(native.ledger()["supplied"], abs=1e-13)
