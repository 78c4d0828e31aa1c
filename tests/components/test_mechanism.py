"""Rigid bodies and joints beside minimal coordinates and Euler's equations; consistent starts; what is refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from phfmu import (
    Monolithic,
    NativeInstance,
    Options,
    PythonInstance,
    build_model,
    check,
    constraint_rank,
    default_scheme,
    run,
)
from phfmu.components.mechanical.multibody import Mechanism
from tests.wide import wide

R, L, M1, M2, M3, FRICTION, SPEED = 0.3, 0.8, 1.0, 0.5, 0.8, 0.01, 10.0


def slider_crank(**main: Any) -> Mechanism:
    """A crank of 0.3 m, a rod of 0.8 m, a piston."""
    m = Mechanism("slider_crank", planar=True)
    crank, rod, piston = m.rod("crank", M1, R), m.rod("rod", M2, L), m.body("piston", M3, 1e-3)
    given: dict[str, Any] = {"damping": FRICTION} | main
    m.joint("revolute", "main", None, crank, at_b=(-R / 2, 0), **given)
    m.joint("revolute", "big_end", crank, rod, at_a=(R / 2, 0), at_b=(-L / 2, 0))
    m.joint("revolute", "small_end", rod, piston, at_a=(L / 2, 0))
    m.joint("prismatic", "bore", None, piston, axis=(1, 0))
    m.assemble({"main": 0.5}, speeds={"main": SPEED})
    return m


def in_the_angle(
    torque: Callable[[float], float], stop: float, spring: Callable[[float], float] = lambda q: 0.0
) -> np.ndarray:
    """Angle, speed and work of the motor of the slider-crank by Lagrange's equation in the angle of its crank."""
    q, w = ca.SX.sym("q"), ca.SX.sym("w")
    end = R * ca.vertcat(ca.cos(q), ca.sin(q))
    pin = ca.vertcat(end[0] + ca.sqrt(L**2 - end[1] ** 2), 0)
    turn = ca.asin(-end[1] / L)
    points = [(M1, end / 2), (M2, (end + pin) / 2), (M3, pin)]
    kinetic = 0.5 * (M1 * R**2 / 12) * w**2 + 0.5 * (M2 * L**2 / 12) * (ca.jacobian(turn, q) * w) ** 2
    kinetic += sum(0.5 * m * ca.sumsqr(ca.jacobian(p, q) * w) for m, p in points)
    potential = sum(9.81 * m * p[1] for m, p in points)
    inertia = ca.hessian(kinetic, w)[0]
    force = -ca.jacobian(potential, q) - 0.5 * ca.jacobian(inertia, q) * w**2 - FRICTION * w
    f = ca.Function("f", [q, w], [inertia, force])

    def slope(t: float, x: np.ndarray) -> list[float]:
        j, force = (float(a) for a in f(x[0], x[1]))
        return [x[1], (force + torque(t) + spring(x[0])) / j, torque(t) * x[1]]

    return solve_ivp(slope, (0.0, stop), [0.5, SPEED, 0.0], "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]


def ran(declaration: Any, order: int, step: float, stop: float, engine: Any = NativeInstance) -> Any:
    model = build_model(declaration, default_scheme(declaration, order))
    return run(Monolithic(model, engine(model)), Options(stop=stop, step=step))


@pytest.mark.parametrize("order, step, most", [(2, 1e-3, 2e-4), (6, 2.5e-3, 2e-9)])
@pytest.mark.parametrize("engine", wide([NativeInstance, PythonInstance], NativeInstance))
def test_slider_crank_beside_its_angle(engine: Any, order: int, step: float, most: float) -> None:
    declaration = slider_crank(motor=True).build().with_starts({"main.torque": 1.5})
    assert not check(declaration)
    found = ran(declaration, order, step, 0.5, engine)
    angle, speed, work = in_the_angle(lambda t: 1.5, 0.5)
    assert abs(np.angle(np.exp(1j * (found.column("main.angle")[-1] - angle)))) <= most
    assert abs(found.column("main.rate")[-1] - speed) <= 30 * most
    total = found.ledger.summary()
    assert abs(total.ports[0].supplied - work) <= 30 * most
    assert abs(total.network.unexplained) <= 1e-12


def test_slopes_in_positions_velocities_and_joint_forces() -> None:
    declaration = slider_crank().build()
    names = ["main.angle", "main.rate", "big_end.force[1]", "bore.force[2]"]
    exact = np.array([ran(declaration, 6, 1e-3, 0.2).column(n)[-1] for n in names])
    for order, steps in ((2, (2e-3, 1e-3)), (6, (2e-2, 1e-2))):
        errors = [
            np.abs(np.array([ran(declaration, order, h, 0.2).column(n)[-1] for n in names]) - exact) for h in steps
        ]
        assert np.all(np.log2(errors[0] / errors[1]) > order - 0.3), errors


def test_turns_are_counted_and_springs_wind_up() -> None:
    angle = in_the_angle(lambda t: 0.0, 1.0)[0]
    counted = ran(slider_crank(turns=True).build(), 6, 2.5e-3, 1.0)
    assert angle > 2 * np.pi
    assert counted.column("main.angle")[-1] == pytest.approx(angle, abs=1e-8)
    wound = ran(slider_crank(stiffness=3.0, neutral=0.2).build(), 6, 2.5e-3, 0.5)
    assert abs(wound.ledger.summary().network.unexplained) <= 1e-12
    angle = in_the_angle(lambda t: 0.0, 0.5, lambda q: -3.0 * (q - 0.2))[0]
    assert wound.column("main.angle")[-1] == pytest.approx(angle, abs=1e-8)


@pytest.mark.parametrize("order", [2, 6])
def test_a_given_speed_books_its_work(order: int) -> None:
    """The crank turns at 10 rad/s; the torque is that of d'Alembert's principle."""
    found = ran(slider_crank(motor="flow").build().with_starts({"main.speed": SPEED}), order, 2e-3, 0.5)
    total = found.ledger.summary()
    assert found.column("main.angle")[-1] == pytest.approx(np.angle(np.exp(1j * 5.5)), abs=1e-6 if order == 6 else 2e-3)
    assert total.network.dissipated == pytest.approx(FRICTION * SPEED**2 * 0.5, rel=1e-9)
    assert abs(total.network.unexplained) <= 1e-13 and abs(total.ports[0].supplied) > 0.1


def test_a_free_body_turns_by_eulers_equations() -> None:
    """An asymmetric body with its tensor in turned axes, about a point that is not its centre of mass."""
    j, mass, off = np.array((0.3, 0.2, 0.15)), 2.0, np.array((0.1, -0.2, 0.05))
    turned = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    turned *= np.sign(np.linalg.det(turned))
    about = np.diag(j) + mass * turned.T @ (off @ off * np.eye(3) - np.outer(off, off)) @ turned
    m = Mechanism("top", gravity=(0, 0, 0))
    spin, com = np.array((1.0, 4.0, 0.3)), np.array((0.5, 0.0, 0.2))
    m.body(
        "top", mass, about, com=com.tolist(), axes=turned, about=(com + off).tolist(), velocity=(1, 0, 0),
        angular_velocity=spin.tolist(),
    )  # fmt: skip
    declaration = m.build()
    assert not check(declaration) and m.mobility().freedom == 6
    found = ran(declaration, 6, 0.01, 2.0)

    def slope(_: float, x: np.ndarray) -> np.ndarray:
        r, w = x[:9].reshape(3, 3), x[9:]  # rotation of the principal axes; rates in them
        cross = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
        return np.concatenate([(r @ cross).ravel(), -np.cross(w, j * w) / j])

    start = np.concatenate([turned.ravel(), turned.T @ spin])
    end = solve_ivp(slope, (0.0, 2.0), start, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    rotation = np.array([found.column(f"top.rotation[{i + 1}]")[-1] for i in range(9)]).reshape(3, 3).T
    omega = np.array([found.column(f"top.angular_velocity[{i + 1}]")[-1] for i in range(3)])
    assert np.abs(rotation @ turned - end[:9].reshape(3, 3)).max() <= 2e-8
    assert np.abs(omega - end[:9].reshape(3, 3) @ end[9:]).max() <= 2e-7
    assert found.column("top.position[1]")[-1] == pytest.approx(com[0] + 2.0, abs=1e-12)


def four_bar() -> Mechanism:
    """Three links in space: a loop of four parallel hinges."""
    m = Mechanism("four_bar")
    links = [
        m.body(f"link{i + 1}", 1.0, np.array((0.02, 0.01 + l**2, 0.01 + l**2)) / 12) for i, l in enumerate((1, 2, 1.5))
    ]
    m.joint("revolute", "A", None, links[0], at_b=(-0.5, 0, 0), motor=True)
    m.joint("revolute", "B", links[0], links[1], at_a=(0.5, 0, 0), at_b=(-1, 0, 0), damping=0.1)
    m.joint("revolute", "C", links[1], links[2], at_a=(1, 0, 0), at_b=(-0.75, 0, 0))
    m.joint("revolute", "D", links[2], None, at_a=(0.75, 0, 0), at_b=(2, 0, 0))
    return m


def test_a_loop_in_space_says_what_is_too_many() -> None:
    m = four_bar()
    m.assemble({"A": 1.2}, near={"B": -1.0, "C": -1.0}, speeds={"A": 3.0})
    found = m.mobility()
    assert (found.freedom, found.equations - found.rank, found.redundant) == (1, 3, ("A", "B", "C", "D"))
    assert "3 too many" in found.report()
    declaration = m.build()
    rank = constraint_rank(declaration)
    assert rank.rows - rank.rank == 3 and {r.label for r in rank.redundant} <= {"A", "B", "C", "D"}
    flat = Mechanism("flat", planar=True)
    links = [flat.body(f"link{i + 1}", 1.0, (0.01 + l**2) / 12) for i, l in enumerate((1, 2, 1.5))]
    flat.joint("revolute", "A", None, links[0], at_b=(-0.5, 0))
    flat.joint("revolute", "B", links[0], links[1], at_a=(0.5, 0), at_b=(-1, 0), damping=0.1)
    flat.joint("revolute", "C", links[1], links[2], at_a=(1, 0), at_b=(-0.75, 0))
    flat.joint("revolute", "D", links[2], None, at_a=(0.75, 0), at_b=(2, 0))
    flat.assemble({"A": 1.2}, near={"B": -1.0, "C": -1.0}, speeds={"A": 3.0})
    assert flat.mobility().redundant == () and flat.mobility().freedom == 1
    # gravity is along z in the one, along y in the other: without it they move alike
    m.parts.gravity[:] = flat.parts.gravity[:] = 0.0
    ends = [ran(x.build(), 6, 5e-3, 0.5).column("A.angle")[-1] for x in (m, flat)]
    assert ends[0] == pytest.approx(ends[1], abs=1e-9)


def test_what_does_not_assemble_is_named() -> None:
    m = four_bar()
    with pytest.raises(ValueError, match=r"with these coordinates held: joint 'D' .* the ground is open by 1\.3"):
        m.assemble({"A": 1.2, "B": -1.0, "C": -1.0})
    m.assemble({"A": 1.2}, near={"B": -1.0, "C": -1.0})
    with pytest.raises(ValueError, match="rates of joints do not suit each other: joint"):
        m.assemble({"A": 1.2}, near={"B": -1.0, "C": -1.0}, speeds={"A": 3.0, "B": 7.0})
    with pytest.raises(ValueError, match="no joint 'E'; there are: A, B, C, D"):
        m.assemble({"E": 1.0})
    m.bodies[0].velocity[:] = (1.0, 0.0, 0.0)
    with pytest.raises(ValueError, match="velocities at the start open joint '[AB]' at 1"):
        m.build()
    far = Mechanism("far", planar=True)
    links = far.rod("first", 1.0, 1.0), far.rod("second", 1.0, 1.0)
    far.joint("revolute", "A", None, links[0], at_b=(-0.5, 0))
    far.joint("revolute", "B", *links, at_a=(0.5, 0), at_b=(-0.5, 0))
    far.joint("revolute", "C", links[1], None, at_a=(0.5, 0), at_b=(3.0, 0))
    with pytest.raises(ValueError, match="does not assemble: joint 'C' between 'second' and the ground is open by 1 "):
        far.assemble()


@pytest.mark.parametrize(
    "wrong, message",
    [
        (lambda m, b: m.body("x", 1.0, (1, 1, 3)), r"1, 1, 3 kg.m2 break the triangle inequality: 3 > 1 \+ 1"),
        (lambda m, b: m.body("x", 1.0, [[1, 0.1, 0], [0, 1, 0], [0, 0, 1]]), "not symmetric, by 0.1"),
        (lambda m, b: m.body("x", -1.0, (1, 1, 1)), "mass -1.0 kg"),
        (lambda m, b: m.body("x", 1.0, 1.0), "neither 3 moments nor a 3 x 3 tensor"),
        (lambda m, b: m.body("x", 1.0, (1, 1, 1), rotation=2 * np.eye(3)), "no rotation matrix"),
        (lambda m, b: m.body("b", 1.0, (1, 1, 1)), "two bodies called 'b'"),
        (lambda m, b: m.joint("ball", "j", None, b), "no joint 'ball' in space; there are: fixed, revolute"),
        (lambda m, b: m.joint("revolute", "j", b, b), "joins 'b' with itself"),
        (lambda m, b: m.joint("fixed", "j", None, b, motor=True), "no coordinate for a damper, spring or motor"),
        (lambda m, b: m.joint("cylindrical", "j", None, b, motor=True), "has 2 coordinates"),
        (lambda m, b: m.joint("revolute", "j", None, b, axis=(0, 0, 0)), "its axis is zero"),
        (lambda m, b: m.joint("revolute", "j", None, m.rod("r", 1.0, 1.0)), "a rod, which has no directions"),
        (lambda m, b: m.joint("spherical", "j", None, b, at=(0, 0, 0), at_b=(0, 0, 0)), "not both"),
        (lambda m, b: m.joint("distance", "j", None, b), "a distance of 0 m"),
        (lambda m, b: Mechanism("empty").build(), "no bodies"),
    ],
)
def test_bad_parts_are_refused(wrong: Any, message: str) -> None:
    m = Mechanism("m")
    b = m.body("b", 1.0, (1, 1, 1))
    with pytest.raises(ValueError, match=message):
        wrong(m, b)


def test_parameters_have_one_kernel_per_kind() -> None:
    """Places and gyration lengths are parameters: joints of one kind share their functions."""

    def groups(n: int) -> int:
        m, last = Mechanism("chain"), None
        for i in range(n):
            link = m.body(f"link{i}", 1.0 + 0.1 * i, (0.02, 0.1 + 0.001 * i, 0.11), position=(i + 0.5, 0, 0))
            m.joint("revolute", f"hinge{i}", last, link, at=(i, 0, 0), axis=(0.1 * i, 1, 0), damping=0.1)
            last = link
        declaration = m.build(observe=False)
        return len(build_model(declaration, default_scheme(declaration, 2)).step.groups)

    assert groups(3) == groups(6)
