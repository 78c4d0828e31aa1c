"""Mechanisms of the library beside closed forms, published values and integrations in other coordinates."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
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
from phfmu.components.mechanical.four_bar import four_bar
from phfmu.components.mechanical.heavy_top import heavy_top
from phfmu.components.mechanical.mechanisms import andrews, bricard, flyball, pendulum, slider_crank
from phfmu.components.mechanical.multibody import Mechanism
from phfmu.components.mechanical.multibody.body import rotation_about
from phfmu.studies.stress.mechanisms import bricard_reference
from tests.wide import slow, wide

G = 9.81


def ran(declaration: Any, order: int, step: float, steps: int) -> Any:
    model = build_model(declaration, default_scheme(declaration, order))
    return run(Monolithic(model, NativeInstance(model)), Options(stop=steps * step, step=step))


def at(result: Any, name: str, n: int, row: Any = -1) -> np.ndarray:
    return np.array([result.column(f"{name}[{i + 1}]")[row] for i in range(n)])


def test_pendulum_has_the_period_of_the_elliptic_integral() -> None:
    quarter = float(ellipk(0.5)) * (1.0 / G) ** 0.5
    found = ran(pendulum(), 6, quarter / 100, 900)  # two periods and a quarter: through the lowest point, to the right
    late = at(found, "P", 2)[0] / (2 * G) ** 0.5  # seconds
    assert abs(late) / 9 * 4 <= 1e-10
    assert at(found, "P", 2)[1] == pytest.approx(-1.0, abs=1e-13)


def parallel(n: int, times: np.ndarray) -> np.ndarray:
    """B0 of n windows: all cranks turn like one pendulum."""
    rate = G * ((n + 1) / 2 + n) / ((n + 1) / 3 + n)
    s = solve_ivp(
        lambda _, y: [y[1], rate * np.sin(y[0])], (0, times[-1]), [0.0, 1.0], "DOP853", times, rtol=1e-13, atol=1e-13
    )
    return np.stack([np.sin(s.y[0]), np.cos(s.y[0])])


@pytest.mark.parametrize(
    "n, order, step, most",
    wide(
        [(2, 6, 0.01, 1e-7), (2, 2, 0.002, 1e-3), (2, 6, 0.005, 1e-7), (2, 6, 0.001, 1e-7), (2, 2, 0.001, 1e-3),
         (2, 2, 0.005, 1e-2), (40, 6, 0.005, 1e-7)],
        (2, 6, 0.01, 1e-7),
    ),
)  # fmt: skip
def test_four_bar_windows_pass_their_flat_positions(n: int, order: int, step: float, most: float) -> None:
    steps = round(20.0 / step)
    found = ran(four_bar(n), order, step, steps)
    rows = np.arange(0, steps + 1, steps // 400)
    exact = parallel(n, rows * step)
    assert np.abs(np.array([found.column(f"B0[{i}]")[rows] for i in (1, 2)]) - exact).max() <= most
    assert abs(found.ledger.summary().network.unexplained) <= 1e-10


#: at 0.03 s; E. Hairer, G. Wanner; Test Set for IVP Solvers, problem andrews
ANDREWS = {
    "beta": 15.81077119629904, "theta": -15.75637105984298, "gamma": 0.04082224013073101, "phi": -0.5347301163226948,
    "delta": 0.5244099658805304, "omega": 0.5347301163226948, "epsilon": 1.048080741042263,
}  # fmt: skip


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


def governor(stop: float) -> np.ndarray:
    """s and the dissipated energy of the flyball governor in shaft angle, arm angle and s, by a stiff method."""
    bar, cube, ball, k, c = 0.3, 3.0, 5.0, 8e5, 4e4
    q, w = (
        ca.SX.sym("q", 2),
        ca.SX.sym("w", 3),
    )  # angle of the arms from the downward vertical, s; rates with the shaft's
    thin, long = bar * 2e-4 / 12, bar * (1.0 + 1e-4) / 12
    arm = long + bar * 0.25 + ball
    r = 0.05 + ca.sin(q[0]) * 0.5
    across = long * ca.sin(q[0]) ** 2 + thin * ca.cos(q[0]) ** 2 + bar * r**2 + ball * (0.05 + ca.sin(q[0])) ** 2
    shaft = thin + cube * 0.01 / 6
    kinetic = 0.5 * shaft * w[2] ** 2 + across * w[2] ** 2 + arm * w[0] ** 2 + 0.5 * cube * w[1] ** 2
    d = ca.sqrt((0.5 * ca.sin(q[0])) ** 2 + (1.0 - 0.5 * ca.cos(q[0]) - q[1]) ** 2)
    potential = G * (cube * q[1] - 2 * (0.5 * bar + ball) * ca.cos(q[0])) + k * (d - 0.5) ** 2
    rate = ca.jacobian(d, q) @ w[:2]
    m = ca.hessian(kinetic, w)[0]
    force = ca.gradient(kinetic, q) - ca.gradient(potential, q) - 2 * c * rate * ca.gradient(d, q)
    force = ca.vertcat(force, 0) - ca.jacobian(m @ w, q) @ w[:2]
    f = ca.Function("f", [q, w], [ca.vertcat(w[:2], ca.solve(m, force), 2 * c * rate**2)])
    start = np.array([np.pi / 3, 0.5, 0, 0, 2 * np.pi, 0])
    jac = ca.Function("J", [q, w], [ca.jacobian(f(q, w), ca.vertcat(q, w))])
    s = solve_ivp(
        lambda _, x: np.array(f(x[:2], x[2:5])).ravel(), (0, stop), start, "Radau", rtol=1e-10, atol=1e-12,
        jac=lambda _, x: np.hstack([np.array(jac(x[:2], x[2:5])), np.zeros((6, 1))]),
    )  # fmt: skip
    return s.y[[1, 5], -1]


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
