"""Impacts of mechanisms whose bodies have directions without mass, beside impulses in minimal coordinates."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from phfmu import (
    FMUInstance,
    Monolithic,
    NativeInstance,
    Options,
    build_model,
    check,
    default_scheme,
    export,
    run,
)
from phfmu.components.mechanical.multibody import Mechanism
from phfmu.network.couplings.unit import FMUStepper
from tests.wide import longer

G, E = 9.81, 0.6
THIN, LINKS = 1.0 / 12.0, (1.0, 2.0, 1.5)


def ran(declaration: Any, order: int, step: float, stop: float) -> Any:
    assert not check(declaration)
    model = build_model(declaration, default_scheme(declaration, order))
    found = run(Monolithic(model, NativeInstance(model)), Options(stop=stop, step=step))
    assert found.ledger.summary().closed
    return found


def falling_rod() -> Any:
    """A thin rod of 1 m and 1 kg, at 0.5 rad, that keeps in the plane y = 0 and falls with its end on the floor.

    It has no moment about itself: two of its directors have no mass.
    """
    m = Mechanism("stick")
    turn = np.array([[np.cos(0.5), 0, np.sin(0.5)], [0, 1, 0], [-np.sin(0.5), 0, np.cos(0.5)]])
    rod = m.body("stick", 1.0, (0.0, THIN, THIN), position=(0, 0, 1.0), rotation=turn)
    m.joint("planar", "guide", None, rod, axis=(0, 1, 0), x_axis=(1, 0, 0))
    m.contact("floor", None, rod, at_b=(0.5, 0, 0), normal=(0, 0, 1), restitution=E)
    return m.build()


@pytest.mark.parametrize("order", [2, 6])
def test_a_rod_on_a_plane_takes_the_impulse_of_its_end(order: int) -> None:
    """It falls by 1 m - sin(0.5)/2 and turns: (1 + e) c / (1/m + r^2/J) at the end, r its distance beside the centre."""
    found = ran(falling_rod(), order, 0.01, 0.5)
    drop, beside = 1.0 - 0.5 * np.sin(0.5), 0.5 * np.cos(0.5)
    rate = np.sqrt(2 * G * drop)
    weight = 1 / (1.0 + beside**2 / THIN)
    lost = 0.5 * (1 - E**2) * rate**2 * weight
    total = found.ledger.summary()
    assert total.events["state"] == 1
    end = found.column("energy.stored")
    assert end[-1] - end[0] == pytest.approx(-lost, rel=1e-9)
    spin = np.array([found.column(f"stick.angular_velocity[{i}]")[-1] for i in (1, 2, 3)])
    assert spin == pytest.approx((0, -beside / THIN * (1 + E) * rate * weight, 0), abs=1e-9)
    fall = (1 + E) * rate * weight - G * 0.5
    assert found.column("stick.momentum[3]")[-1] == pytest.approx(fall, abs=1e-9)


def loop(section: float = 0.0, planar: bool = False) -> Any:
    """Three links and the ground in a loop whose crank swings on a stop; of no section, their directors have no mass."""
    m = Mechanism("loop", planar=planar, gravity=(0, -G) if planar else (0, -G, 0))
    across = [l**2 / 12 + section for l in LINKS]
    links = [m.body(f"link{i}", 1.0, j if planar else (2 * section, j, j)) for i, j in enumerate(across)]

    def x(value: float) -> tuple[float, ...]:
        return (value, 0.0) if planar else (value, 0.0, 0.0)

    along: dict[str, Any] = {} if planar else {"axis": (0, 0, 1), "x_axis": (1, 0, 0)}
    m.joint("revolute", "A", None, links[0], at_b=x(-0.5), limits=(-0.5, 1.3), restitution=E, **along)
    m.joint("revolute", "B", links[0], links[1], at_a=x(0.5), at_b=x(-1), **along)
    m.joint("revolute", "C", links[1], links[2], at_a=x(1), at_b=x(-0.75), **along)
    m.joint("revolute", "D", links[2], None, at_a=x(0.75), at_b=x(2), **along)
    m.assemble({"A": 1.2}, near={"B": -1.0, "C": -1.0}, speeds={"A": 3.0})
    return m.build()


def in_the_crank(stop: float) -> tuple[float, float, float, int]:
    """Angle and rate of the crank and the energy lost by Lagrange's equation in it, thrown back at its stop."""
    a, w = ca.SX.sym("a"), ca.SX.sym("w")
    one, two, three = LINKS
    pin = one * ca.vertcat(ca.cos(a), ca.sin(a))
    between = ca.vertcat(2.0, 0.0) - pin  # from B to D
    d = ca.norm_2(between)
    along, height = (two**2 - three**2 + d**2) / (2 * d), ca.vertcat(-between[1], between[0]) / d
    elbow = pin + along * between / d + SIDE * ca.sqrt(two**2 - along**2) * height
    points = [pin / 2, (pin + elbow) / 2, (elbow + ca.vertcat(2.0, 0.0)) / 2]
    arms = [pin, elbow - pin, ca.vertcat(2.0, 0.0) - elbow]
    kinetic = sum(
        0.5 * ca.sumsqr(ca.jtimes(p, a, w)) + 0.5 / 12 * ca.sumsqr(ca.jtimes(r, a, w))
        for p, r in zip(points, arms, strict=True)
    )
    inertia = ca.hessian(kinetic, w)[0]
    potential = G * sum(p[1] for p in points)
    force = -ca.gradient(potential, a) - 0.5 * ca.jacobian(inertia, a) * w**2
    f = ca.Function("f", [a, w], [inertia, force])

    def slope(_: float, x: np.ndarray) -> list[float]:
        j, push = (float(v) for v in f(*x))
        return [x[1], push / j]

    t, x, lost, n = 0.0, np.array([1.2, 3.0]), 0.0, 0
    while True:
        marks: list[Any] = [lambda t, x: 1.3 - x[0], lambda t, x: x[0] + 0.5]
        for mark in marks:
            mark.terminal, mark.direction = True, -1
        part = solve_ivp(slope, (t, stop), x, "DOP853", rtol=1e-12, atol=1e-13, events=marks)
        t, x = float(part.t[-1]), part.y[:, -1]
        if part.status != 1:
            return x[0], x[1], lost, n
        lost += 0.5 * (1 - E**2) * float(f(*x)[0]) * x[1] ** 2
        x, n = np.array([x[0], -E * x[1]]), n + 1


#: side of the elbow at the start
SIDE = 1.0


@pytest.mark.parametrize("order, step, most", [(2, 1e-3, 1e-4), (6, 0.01, 1e-8)])
def test_a_loop_of_thin_links_on_its_stop_is_that_of_one_angle(order: int, step: float, most: float) -> None:
    """Twelve of its velocities have no mass, and three of its rows are too many."""
    found = ran(loop(), order, step, 1.0)
    angle, rate, lost, n = in_the_crank(1.0)
    assert n > 0 and found.ledger.summary().events["state"] == n
    assert abs(found.column("A.angle")[-1] - angle) <= most and abs(found.column("A.rate")[-1] - rate) <= 10 * most
    energy = found.column("energy.stored")
    assert energy[-1] - energy[0] == pytest.approx(-lost, abs=most)


@pytest.mark.parametrize("version", longer(("2.0", "3.0"), "3.0"))
def test_a_unit_of_a_thin_loop_is_thrown_back_as_in_the_engine(version: str, tmp_path: Path, compiler: None) -> None:
    declaration = loop()
    model = build_model(declaration, default_scheme(declaration, 2))
    (path,) = export(model, tmp_path, (version,), step=0.01)
    native = ran(declaration, 2, 0.01, 0.5)
    unit = run(FMUStepper(FMUInstance(path)), Options(stop=0.5, step=0.01))
    assert native.ledger.summary().events["state"] > 0
    # the clock of a host rounds the rest of a step after an event
    assert unit.column("A.angle")[-1] == pytest.approx(native.column("A.angle")[-1], abs=1e-11)
