"""Limits of joints and contacts of bodies beside minimal coordinates and Euler's equations with Newton's impacts."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from phfmu import Monolithic, NativeInstance, Options, StepFailure, build_model, check, default_scheme, run
from phfmu.components.mechanical.multibody import Compliance, Limits, Mechanism
from tests.wide import wide

G = 9.81
Impact = Callable[[np.ndarray], np.ndarray]


def ran(declaration: Any, order: int, step: float, stop: float) -> Any:
    assert not check(declaration)
    model = build_model(declaration, default_scheme(declaration, order))
    found = run(Monolithic(model, NativeInstance(model)), Options(stop=stop, step=step))
    assert found.ledger.summary().closed
    return found


def bounced(
    f: Any, x: np.ndarray, stop: float, gaps: Callable[[np.ndarray], np.ndarray], impact: Any
) -> tuple[np.ndarray, int]:
    """x' = f from impact to impact: where gap i falls to zero, x becomes impact(x, i); how many there were."""
    t, n = 0.0, 0
    while True:
        marks: list[Any] = [lambda t, x, i=i: gaps(x)[i] for i in range(len(gaps(x)))]
        for mark in marks:
            mark.terminal, mark.direction = True, -1
        part = solve_ivp(f, (t, stop), x, "DOP853", rtol=1e-12, atol=1e-13, events=marks)
        t, x = float(part.t[-1]), part.y[:, -1]
        if part.status != 1:
            return x, n
        x, n = impact(x, next(i for i, e in enumerate(part.t_events) if len(e))), n + 1


def arm(limits: Any, **more: Any) -> Mechanism:
    """A rod of 1 m and 1 kg that swings on a hinge, from 0.3 rad."""
    m = Mechanism("arm", planar=True)
    rod = m.rod("rod", 1.0, 1.0)
    m.joint("revolute", "hinge", None, rod, at_b=(-0.5, 0), limits=limits, **more)
    m.assemble({"hinge": 0.3})
    return m


def swung(x: np.ndarray) -> list[float]:
    return [x[1], -1.5 * G * np.cos(x[0])]


@pytest.mark.parametrize("order, step, most", [(2, 1e-3, 1e-4), (6, 0.01, 1e-9)])
@pytest.mark.parametrize("turns", wide([False, True], True))
def test_an_arm_that_is_thrown_back(order: int, step: float, most: float, turns: bool) -> None:
    found = ran(arm((-1.2, 1.0), restitution=0.5, turns=turns).build(), order, step, 1.4)
    exact, n = bounced(
        lambda t, x: swung(x), np.array([0.3, 0.0]), 1.4, lambda x: x[:1] + 1.2, lambda x, i: x * (1, -0.5)
    )
    assert n == 2 == found.ledger.summary().events["state"]
    assert abs(found.column("hinge.angle")[-1] - exact[0]) <= most
    assert abs(found.column("hinge.rate")[-1] - exact[1]) <= 10 * most


@pytest.mark.parametrize("skin", wide([0.0, 0.03], 0.03))
def test_an_arm_comes_to_rest_on_ends_that_give_way(skin: float) -> None:
    """Ten times as long as it moves; it rests where its weight is held."""
    law = Compliance(300.0, damping=0.5, skin=skin)
    found = ran(arm(Limits(-1.2, 1.0, 0.5, law)).build(), 6, 0.005, 20.0)
    angle = found.column("hinge.angle")
    assert 300.0 * (-1.2 + skin - angle[-1]) == pytest.approx(0.5 * G * np.cos(angle[-1]), rel=1e-6)
    assert (found.ledger.summary().events.get("state", 0) > 0) == (skin > 0)
    assert angle.min() >= -1.2 - 1e-9 or skin == 0.0


def test_a_slider_between_two_ends() -> None:
    """Without a force it goes to and fro at 1, 0.8, 0.64 m/s: from 0 to 1 m in 1 s, to -0.5 m in 1.875 s."""
    m = Mechanism("slider", planar=True, gravity=(0, 0))
    block = m.body("block", 2.0, 0.1)
    m.joint("prismatic", "rail", None, block, axis=(1, 0), limits=(-0.5, 1.0), restitution=0.8)
    m.assemble({"rail": 0.0}, speeds={"rail": 1.0})
    found = ran(m.build(), 2, 0.05, 3.0)
    assert found.column("rail.rate")[-1] == pytest.approx(0.64, abs=1e-13)
    assert found.column("rail.length")[-1] == pytest.approx(-0.5 + 0.64 * 0.125, abs=1e-12)
    assert found.ledger.summary().network.unexplained == pytest.approx(0.0, abs=1e-14)


SIZE, MASS, E = np.array((0.4, 0.3, 0.2)), 1.0, 0.6


def box(**more: Any) -> Mechanism:
    """A box that falls turned onto the floor."""
    m = Mechanism("box")
    inertia = MASS / 12 * (np.sum(SIZE**2) - SIZE**2)
    b = m.body("box", MASS, inertia, position=(0, 0, 0.6), rotation=Rotation.from_rotvec([0.5 / 1.0632, 0.15, 0.1]).as_matrix(),
               angular_velocity=(1.0, 2.0, 0.5))  # fmt: skip
    m.box_contact("corner", None, b, SIZE, **more)
    return m


def thrown(stop: float) -> tuple[np.ndarray, int]:
    """Centre, quaternion, velocity and angular velocity of the box in its own axes, by Euler's equations."""
    inertia = MASS / 12 * (np.sum(SIZE**2) - SIZE**2)
    corners = 0.5 * SIZE * np.array(list(product((-1, 1), repeat=3)))
    b = box().bodies[0]
    start = np.concatenate(
        [b.position, Rotation.from_matrix(b.rotation).as_quat(), b.velocity, b.rotation.T @ b.angular_velocity]
    )

    def f(t: float, x: np.ndarray) -> np.ndarray:
        (a, b_, c), d, w = x[3:6], x[6], x[10:]
        turn = 0.5 * np.array([[d, -c, b_], [c, d, -a], [-b_, a, d], [-a, -b_, -c]]) @ w
        return np.concatenate([x[7:10], turn, [0, 0, -G], np.cross(inertia * w, w) / inertia])

    def gaps(x: np.ndarray) -> np.ndarray:
        return x[2] + Rotation.from_quat(x[3:7]).apply(corners)[:, 2]

    def impact(x: np.ndarray, i: int) -> np.ndarray:
        r, n = corners[i], Rotation.from_quat(x[3:7]).inv().apply([0, 0, 1.0])
        arm = np.cross(r, n)
        rate = x[9] + arm @ x[10:]
        push = -(1 + E) * rate / (1 / MASS + arm @ (arm / inertia))
        return x + np.concatenate([np.zeros(9), [push / MASS], push * arm / inertia])

    return bounced(f, start, stop, gaps, impact)


@pytest.mark.parametrize("order, step, most", wide([(2, 2.5e-4, 2e-4), (6, 5e-3, 1e-8)], (6, 5e-3, 1e-8)))
def test_a_box_on_the_floor(order: int, step: float, most: float) -> None:
    declaration = box(restitution=E).build()
    found = ran(declaration, order, step, 0.8)
    exact, n = thrown(0.8)
    assert n >= 3 and found.ledger.summary().events["state"] == n
    at = [found.column(f"box.position[{i}]")[-1] for i in (1, 2, 3)]
    turn = np.array([found.column(f"box.rotation[{i}]")[-1] for i in range(1, 10)]).reshape(3, 3).T
    assert np.abs(at - exact[:3]).max() <= most
    assert np.abs(turn - Rotation.from_quat(exact[3:7]).as_matrix()).max() <= 10 * most
    gaps = [found.column(f"corner{i}.gap").min() for i in range(1, 9)]
    assert min(gaps) >= -1e-12
    lost = 0.5 * MASS * np.sum(exact[7:10] ** 2) + MASS * G * exact[2]
    lost += 0.5 * MASS / 12 * (np.sum(SIZE**2) - SIZE**2) @ exact[10:] ** 2
    assert found.column("energy.stored")[-1] == pytest.approx(lost, abs=10 * most)


@pytest.mark.slow
def test_a_box_comes_to_rest_on_a_skin() -> None:
    """Ten times as long as its fall: it lies on four corners, and all of its energy is booked."""
    found = ran(box(restitution=E, compliance=Compliance(2e3, damping=2.0, skin=0.02)).build(), 6, 2e-3, 8.0)
    sunk = MASS * G / (4 * 2e3)
    assert found.column("box.position[3]")[-1] == pytest.approx(0.5 * SIZE.min() + 0.02 - sunk, abs=1e-4)
    assert abs(found.ledger.summary().network.unexplained) <= 1e-10


def test_balls_in_line_exchange_their_momenta() -> None:
    m = Mechanism("balls", gravity=(0, 0, 0))
    a = m.body("a", 1.0, (0.1,) * 3, velocity=(2.0, 0, 0))
    b = m.body("b", 3.0, (0.1,) * 3, position=(1.0, 0, 0))
    m.contact("hit", a, b, radius=0.2, radius_a=0.1, restitution=0.5)
    found = ran(m.build(), 6, 0.01, 1.0)
    meet = (1.0 - 0.2 - 0.1) / 2.0  # s: radii of both
    assert found.column("hit.gap")[0] == pytest.approx(0.7, abs=1e-15) and found.column("hit.gap").min() >= -1e-13
    assert found.column("b.position[1]")[-1] == pytest.approx(1.0 + 0.75 * (1.0 - meet), abs=1e-13)
    common, beside = 0.5, 0.5 * 2.0
    speeds = [found.column(f"{n}.momentum[1]")[-1] / mass for n, mass in (("a", 1.0), ("b", 3.0))]
    assert speeds == pytest.approx([common - 0.75 * beside, common + 0.25 * beside], abs=1e-13)
    assert found.ledger.summary().network.unexplained == pytest.approx(0.0, abs=1e-14)


@pytest.mark.parametrize("order, most", [(2, 1e-4), (4, 2e-7)])
def test_a_ball_on_a_floor_that_gives_way(order: int, most: float) -> None:
    """Beside s'' = -g + F(s)/m by DOP853; the force has a kink where the contact begins."""
    m = Mechanism("ball")
    ball = m.point_mass("ball", 0.5, (0, 0, 0.3))
    m.contact(
        "floor", None, ball, normal=(0, 0, 2), radius=0.1, compliance=Compliance(1e4, 1.5, damping=0.4, depth=2e-3)
    )
    found = ran(m.build(), order, 1e-4, 0.6)

    def f(t: float, x: np.ndarray) -> list[float]:
        s = max(0.0, 0.1 - x[0])
        return [x[1], -G + 1e4 * 2e-3 * (s / 2e-3) ** 1.5 * (1 - 0.4 * x[1]) / 0.5]

    exact = solve_ivp(f, (0, 0.6), [0.3, 0.0], "DOP853", rtol=1e-12, atol=1e-13, max_step=1e-3).y[:, -1]
    assert abs(found.column("ball.position[3]")[-1] - exact[0]) <= most
    assert found.column("energy.dissipated")[-1] == pytest.approx(
        0.5 * G * (0.3 - exact[0]) - 0.25 * exact[1] ** 2, abs=20 * most
    )  # fmt: skip


def test_what_rests_on_hard_ground_is_refused_by_name() -> None:
    with pytest.raises(StepFailure, match=r"hinge\.lower"):
        ran(arm((-1.2, 1.0)).build(), 6, 0.01, 2.0)


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (lambda: arm((1.0, -1.0)), "lower < upper"),
        (lambda: arm((0.5, 1.0)).build(), "starts at 0.3, beyond its lower limit 0.5"),
        (lambda: arm((-1.0, 1.0), restitution=2.0), "restitution"),
        (lambda: arm(Limits(-1.0, 1.0, compliance=Compliance(-5.0))), "stiffness -5"),
        (lambda: box().contact("corner1", None, None), "two parts called 'corner1'"),  # type: ignore[arg-type]
        (lambda: (m := box()).contact("c", None, m.bodies[0]), "two points do not meet"),
        (lambda: (m := box()).contact("c", None, m.bodies[0], normal=(0, 0, 0)), "a normal that is not zero"),
        (lambda: (m := box()).contact("c", None, m.bodies[0], radius=-1.0, normal=(0, 0, 1)), "must not be negative"),
        (
            lambda: (m := box(), m.contact("c", None, m.bodies[0], at_a=(0, 0, 1), normal=(0, 0, 1)), m.build()),
            "overlaps by 0.4 m",
        ),
    ],
)
def test_what_is_refused(made: Any, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        made()
