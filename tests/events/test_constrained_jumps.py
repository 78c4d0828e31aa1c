"""Jumps of constrained systems: the impulses of joints and nodes act with them; against generalised coordinates and formulas."""

from __future__ import annotations

from dataclasses import replace
from math import sqrt

import numpy as np
import pytest

from phfmu import (
    PHDAE,
    Collocated,
    DeclarationError,
    Guard,
    Jump,
    Monolithic,
    NativeInstance,
    Options,
    StateEvent,
    algebraic,
    build_model,
    damping,
    energy,
    parameter,
    run,
    skew,
    state,
    time,
)
from phfmu.components.mechanical.chain import chain
from phfmu.components.mechanical.multibody import Multibody
from phfmu.outcome.steps import EventRecord
from tests.wide import wide

LINKS, E, WALL = 3, 0.6, 2.2


def hitting_chain(e: float = E) -> PHDAE:
    """A chain of rigid links in the plane that falls and whose last mass hits a wall at x = 2.2 m with restitution e."""
    links = chain(LINKS, dim=2, speed=0.0, last=3.0)
    q, v = links.states
    column = [0.0] * (2 * LINKS - 2) + [1.0, 0.0]
    hit = StateEvent(Guard("wall", q.sx[2 * LINKS - 2] - WALL, -1, unit="m"), jump=Jump({v: column}, e))
    return replace(links, state_events=(hit,))


def landed(declaration: PHDAE, h: float, n: int, k: int = 2):
    """The state before the first event, the event, and the instance at the end of its step."""
    model = build_model(declaration) if declaration.constraints else build_model(declaration, Collocated(k))
    instance = NativeInstance(model)
    for part in instance.land(0.0, h, n, record=("x",)):
        if part.happened is not None:
            return part.rows["x"][-1], part.happened, instance
    raise AssertionError("no event")


def after(instance, h: EventRecord) -> np.ndarray:
    """States right after an event, from its row of signals."""
    signals, at = instance.signals(), 0
    for block in instance.layout:
        if block == "x":
            return h.signals[at : at + len(signals[block])]
        at += len(signals[block])
    raise AssertionError("no states in the row")


def generalised(q: np.ndarray, v: np.ndarray, mass: np.ndarray, e: float) -> tuple[np.ndarray, float]:
    """Velocities after the impact and the loss, in the angles of the links: no constraint, no multiplier."""
    ends = np.vstack([[0.0, 0.0], q.reshape(-1, 2)])
    arms = np.diff(ends, axis=0)
    n = len(arms)
    turn = np.array([[-a[1], a[0]] for a in arms])  # d arm / d angle
    P = np.zeros((2 * n, n))  # v = P w
    for i in range(n):
        for j in range(i + 1):
            P[2 * i : 2 * i + 2, j] = turn[j]
    M = P.T @ np.diag(np.repeat(mass, 2)) @ P
    w = np.linalg.lstsq(P, v, rcond=None)[0]
    assert P @ w == pytest.approx(v, abs=1e-9)
    along = P[2 * n - 2]
    c = along @ w
    m = -(1 + e) * c / (along @ np.linalg.solve(M, along))
    new = w + np.linalg.solve(M, along) * m
    return P @ new, 0.5 * w @ M @ w - 0.5 * new @ M @ new


@pytest.mark.parametrize("e", wide([0.0, E, 1.0], E))
def test_the_impact_of_a_chain_is_that_in_its_angles(e):
    declaration = hitting_chain(e)
    before, happened, instance = landed(declaration, 1e-2, 100)
    mass = np.array(declaration.parameters[0].start)
    q, v = before[: 2 * LINKS], before[2 * LINKS :]
    expected, loss = generalised(q, v, mass, e)
    x = after(instance, happened)
    assert x[: 2 * LINKS] == pytest.approx(q, abs=0)  # no position moves
    assert x[2 * LINKS :] == pytest.approx(expected, rel=1e-11, abs=1e-11)
    rounding = (
        16 * np.finfo(float).eps * 0.5 * float(np.repeat(mass, 2) @ v**2)
    )  # the loss in angles is a difference of energies
    assert happened.lost.sum() == pytest.approx(loss, rel=1e-10, abs=rounding)
    assert happened.energy.sum() == -happened.lost.sum()
    assert x[2 * LINKS + 2 * LINKS - 2] == pytest.approx(-e * v[-2], rel=1e-13, abs=1e-14)


def test_links_keep_their_length_rate_through_an_impact():
    """The hidden constraints of the velocity level hold after it, so that the run goes on and its ledger closes."""
    model = build_model(hitting_chain())
    result = run(Monolithic(model, NativeInstance(model)), Options(stop=0.7, step=1e-2))
    assert result.ledger.summary().closed
    assert result.ledger.summary().events["state"] >= 1
    rates = [n for n in result.names if n.startswith("constraint") and "velocity" in n]
    assert rates and max(np.abs(result.column(n)).max() for n in rates) <= 1e-11


def drive_train(second: float = 0.0) -> PHDAE:
    """A clutch grips a disc that a rigid shaft ties to another one."""
    J = (2.0, 0.7, 0.4)
    phi = state("phi", unit="rad")
    p = [
        state(f"p{i + 1}", unit="kg.m2/s", start=j * w)
        for i, (j, w) in enumerate(zip(J, (30.0, -10.0, -10.0), strict=True))
    ]
    torque = algebraic("torque", unit="N.m")
    return PHDAE(
        "drive_train",
        states=(phi, *p),
        algebraics=(torque,),
        energies=(*(energy(q**2 / (2 * j)) for q, j in zip(p, J, strict=True)), energy(0 * phi.sx)),
        structure=(skew(phi, p[0], 1.0), skew(torque, p[1], 1.0), skew(torque, p[2], -1.0)),
        state_events=(StateEvent(Guard("grip", phi.sx - 1.0, 1, unit="rad"), jump=Jump({p[0]: 1.0, p[1]: -1.0}, second)),),
    )  # fmt: skip


def test_a_clutch_grips_both_discs_of_a_shaft():
    _, happened, instance = landed(drive_train(), 0.02, 5)
    assert happened.lost.sum() == pytest.approx(2.0 * 1.1 / (2 * 3.1) * 40.0**2, rel=1e-14)
    x = after(instance, happened)
    assert x[1:].sum() == pytest.approx(60.0 - 11.0, rel=1e-15)
    assert x[1:] / (2.0, 0.7, 0.4) == pytest.approx([49.0 / 3.1] * 3, rel=1e-15)
    assert x[0] == pytest.approx(1.0, abs=1e-14)


def test_capacitors_joined_lose_their_formula():
    """2 and 5 uF at 100 and 20 V, joined when a clock says so."""
    C, V = (2e-6, 5e-6), (100.0, 20.0)
    q = [state(f"q{i + 1}", unit="C", start=c * v, nominal=1e-4) for i, (c, v) in enumerate(zip(C, V, strict=True))]
    joined = StateEvent(Guard("join", time - 0.5, 1, unit="s"), jump=Jump({q[0]: 1.0, q[1]: -1.0}))
    model = PHDAE("pair", states=tuple(q), energies=tuple(energy(a**2 / (2 * c)) for a, c in zip(q, C, strict=True)),
                  dissipation=(damping(q[0], 0.0),), state_events=(joined,))  # fmt: skip
    _, happened, instance = landed(model, 0.3, 3)
    assert happened.lost.sum() == pytest.approx(C[0] * C[1] / (2 * sum(C)) * (V[0] - V[1]) ** 2, rel=1e-14)
    assert after(instance, happened).sum() == pytest.approx(3e-4, rel=1e-15)


def test_a_jump_that_pushes_a_moving_constraint_is_refused():
    body = Multibody("lifted", 2)
    top = body.particle(1.0, [0.0, -1.0], [0.0, 0.0])
    body.bar(body.moving_support("hand", lambda t: [0.1 * t, 0.0]), top)
    declaration = body.build()
    v = declaration.states[1]
    hit = StateEvent(Guard("clock", time - 0.1, 1, unit="s"), jump=Jump({v: [1.0, 0.0]}))
    with pytest.raises(DeclarationError, match="moves with time"):
        build_model(replace(declaration, state_events=(hit,)))


def square(redundant: bool) -> PHDAE:
    """Four masses and five bars, or six of which one depends on the others, that fall on the corner at the origin."""
    body = Multibody("square", 2)
    body.gravity([0.0, -9.81])
    corners = [body.particle(m, q, [0.0, 0.0]) for m, q in zip(WEIGHTS, CORNERS, strict=True)]
    for i, j in ((0, 1), (1, 2), (2, 3), (3, 0), (0, 2), *([(1, 3)] if redundant else [])):
        body.bar(corners[i], corners[j])
    declaration = body.build()
    q, v = declaration.states
    hit = StateEvent(Guard("floor", q.sx[1], -1, unit="m"), jump=Jump({v: [0.0, 1.0, *[0.0] * 6]}, 0.5))
    return replace(declaration, state_events=(hit,))


WEIGHTS = (1.0, 2.0, 1.5, 0.5)
CORNERS = ([0.0, 1.0], [1.0, 1.2], [1.0, 2.2], [0.0, 2.0])


@pytest.mark.parametrize("redundant", wide([False, True], True))
def test_a_rigid_body_is_hit_as_one(redundant):
    """lost = (1 - e^2)/2 v^2 / (1/M + r^2/I), r the distance of the centre of mass from the line of the impulse."""
    _, happened, instance = landed(square(redundant), 0.05, 20)
    m, q = np.array(WEIGHTS), np.array(CORNERS)
    centre = m @ q / m.sum()
    inertia = m @ ((q - centre) ** 2).sum(axis=1)
    weight = 1 / (1 / m.sum() + centre[0] ** 2 / inertia)
    assert happened.lost.sum() == pytest.approx(0.75 * 9.81 * weight, rel=1e-12)
    v = after(instance, happened)[8:].reshape(4, 2)
    spin = weight * 1.5 * sqrt(2 * 9.81) * -centre[0] / inertia
    fall = -sqrt(2 * 9.81) + weight * 1.5 * sqrt(2 * 9.81) / m.sum()
    arms = q - centre
    assert v == pytest.approx(np.array([0.0, fall]) + spin * np.array([[-y, x] for x, y in arms]), abs=1e-12)


def test_a_jump_with_a_full_mass_matrix():
    """Velocities with E = M: the impulse on the first one moves both."""
    M = np.array([[2.0, 0.7], [0.7, 1.0]])
    q, v = state("q", 2, unit="m", start=[1.0, 0.0]), state("v", 2, unit="m/s", start=[-3.0, 1.0])
    kinetic = sum(0.5 * M[i, j] * v.sx[i] * v.sx[j] for i in range(2) for j in range(2))
    hit = StateEvent(Guard("floor", q.sx[0], -1, unit="m"), jump=Jump({v: [1.0, 0.0]}, 0.5))
    model = PHDAE("pair", states=(q, v), E={v: M}, energies=(energy(kinetic), energy(0 * q.sx[0])),
                  structure=(skew(q, v, np.eye(2)),), state_events=(hit,))  # fmt: skip
    _, happened, instance = landed(model, 0.1, 10)
    column = np.linalg.solve(M, [1.0, 0.0])
    m = 1.5 * 3.0 / column[0]
    assert after(instance, happened)[2:] == pytest.approx([-3.0, 1.0] + column * m, rel=1e-14)
    assert happened.t == pytest.approx(1 / 3, abs=1e-15)
    assert happened.lost.sum() == pytest.approx(0.75 / 2 * 9.0 / column[0], rel=1e-14)


def test_a_jump_in_which_its_own_mode_stands_is_refused():
    s = parameter("s", 1.0)
    p = state("p", start=-1.0)
    hit = StateEvent(Guard("clock", time - 0.1, 1, unit="s"), when={"s": 1.0}, sets={"s": 0.0}, jump=Jump({p: s.sx}))
    model = PHDAE("body", states=(p,), parameters=(s,), energies=(energy(p**2 / 2),), dissipation=(damping(p, s.sx),),
                  state_events=(hit,))  # fmt: skip
    with pytest.raises(DeclarationError, match="jump 'clock': depends on 's', which its event sets"):
        build_model(model, Collocated(1))
