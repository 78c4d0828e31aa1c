"""Events at the edges: in the first step, a hundred thousand of them, touches, groups."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from math import pi, sqrt

import numpy as np
import pytest

from phfmu import (
    PHDAE,
    Collocated,
    Guard,
    Jump,
    NativeInstance,
    StateEvent,
    build_model,
    energy,
    parameter,
    skew,
    state,
)
from phfmu.components.mechanical.multibody import Multibody

G = 9.81


@cache
def ball(e: float):
    """A ball above a hard floor, without rest."""
    q, p = state("q", unit="m", start=1.0), state("p", unit="kg.m/s")
    floor = StateEvent(Guard("floor", q, -1, unit="m"), jump=Jump({p: 1.0}, e))
    declaration = PHDAE("ball", states=(q, p), energies=(energy(p**2 / 2), energy(G * q)), structure=(skew(q, p, 1.0),),
                        state_events=(floor,))  # fmt: skip
    return build_model(declaration, Collocated(1))


@pytest.mark.parametrize("n", [3_000, pytest.param(100_000, marks=pytest.mark.slow)])
def test_many_events_are_neither_lost_nor_doubled(n):
    """An elastic ball, one bounce a step or two, at all places of a step; constant gravity, so that all times are exact."""
    instance, fall = NativeInstance(ball(1.0)), sqrt(2 / G)
    start = instance.signal("H").sum()
    h = 2 * fall * 0.99
    count = round((2 * n * fall) / h) + 1
    times = np.array([part.happened.t for part in instance.land(0.0, h, count) if part.happened])
    expected = fall * (2 * np.arange(len(times)) + 1)
    assert n <= len(times) <= n + 1
    assert times == pytest.approx(expected, abs=0, rel=1e-11)
    assert np.diff(times) == pytest.approx(2 * fall, rel=1e-8)
    assert instance.signal("H").sum() == pytest.approx(start, rel=1e-9)


@pytest.mark.parametrize("part", [1e-9, 1e-4, 0.3, 1.0])
def test_an_event_in_the_first_step(part):
    """The floor is reached at the given part of the first step, also right after its start and at its end."""
    instance, fall = NativeInstance(ball(0.5)), sqrt(2 / G)
    first = next(p for p in instance.land(0.0, fall / part, 1) if p.happened)
    assert first.happened.t == pytest.approx(fall, rel=1e-14)
    assert first.happened.lost.sum() == pytest.approx(0.75 * G, rel=1e-13)


@cache
def turning(depth: float, k: int, place: float = 10.4):
    """q = cos t against a guard that its turning point passes by `depth`, after `place` steps."""
    h = 2 * pi / 48
    q, p = state("q", unit="m", start=np.cos(-place * h)), state("p", unit="kg.m/s", start=-np.sin(-place * h))
    dip = StateEvent(Guard("dip", 1 - depth - q, 0, unit="m"))
    energies, structure = (energy(q**2 / 2), energy(p**2 / 2)), (skew(q, p, 1.0),)
    declaration = PHDAE("turning", states=(q, p), energies=energies, structure=structure, state_events=(dip,))
    return build_model(declaration, Collocated(k))


@pytest.mark.parametrize(
    ("k", "depth", "place", "seen"),
    [(1, 3e-3, 10.4, 2), (2, 1e-6, 10.4, 2), (3, 1e-6, 10.4, 2), (1, 1e-3, 10.2, 2), (3, 1e-8, 10.2, 2), (2, -1e-6, 10.4, 0),
     (3, -1e-8, 10.4, 0)],
)  # fmt: skip
def test_touches(k, depth, place, seen):
    """What passes the guard is seen, shallower ones near step ends; what does not reach it is none, and the full step counts."""
    instance = NativeInstance(turning(depth, k, place))
    parts = list(instance.land(0.0, 2 * pi / 48, 20))
    assert sum(part.happened is not None for part in parts) == seen
    assert instance.time == pytest.approx(20 * 2 * pi / 48, abs=1e-14)
    assert instance.signal("H").sum() == pytest.approx(0.5, abs=1e-15)


def above(k: int, place: float) -> float:
    """How far the least value of the collocation polynomial is above that of -cos t, which turns at `place` of a step."""
    h, x = 2 * pi / 48, np.array([-np.cos(place * 2 * pi / 48), -np.sin(place * 2 * pi / 48)])
    c = (np.polynomial.legendre.leggauss(k)[0] + 1) / 2
    basis = [np.poly1d(np.delete(c, i), r=True) / np.prod(c[i] - np.delete(c, i)) for i in range(k)]
    A = np.array([[np.polyint(b)(t) for b in basis] for t in c])
    rates = np.array([[0.0, 1.0], [-1.0, 0.0]])
    K = np.linalg.solve(np.eye(2 * k) - h * np.kron(A, rates), np.tile(rates @ x, k)).reshape(k, 2)
    t = np.linspace(0.0, 1.0, 2001)
    return float((x[0] + h * sum(np.polyint(b)(t) * r for b, r in zip(basis, K[:, 0], strict=True))).min() + 1)


@pytest.mark.parametrize(("k", "place", "most"), [(1, 0.5, 2.2e-3), (2, 0.2, 1.1e-6), (3, 0.5, 1.6e-7)])
def test_a_touch_is_seen_where_the_polynomial_does_not_see_it_too(k, place, most):
    """Its error inside a step is of order k + 1, here where it is largest: shallower touches are seen by the guard's rates."""
    error = above(k, place)
    assert 0.9 * most <= error <= most
    for depth in (1.3 * error, 0.7 * error, 1e-3 * error):
        parts = NativeInstance(turning(depth, k, 10 + place)).land(0.0, 2 * pi / 48, 12)
        assert sum(part.happened is not None for part in parts) == 2


@pytest.mark.parametrize("k", [2, 3])
def test_a_touch_to_rounding_ends(k):
    """The turning point is the guard's zero: found twice, once or not at all, but the run goes on from it."""
    instance = NativeInstance(turning(0.0, k))
    assert sum(part.happened is not None for part in instance.land(0.0, 2 * pi / 48, 20)) <= 2
    assert instance.signal("H").sum() == pytest.approx(0.5, abs=1e-15)


@cache
def bars():
    """Two masses with a rigid bar that fall flat on the floor, one heavier than the other."""
    body = Multibody("bar", 2)
    body.gravity([0.0, -G])
    points = [body.particle(m, [x, 1.0], [0.0, 0.0]) for m, x in ((1.0, 0.0), (3.0, 2.0))]
    body.bar(*points)
    declaration = body.build()
    q, v = declaration.states
    events = tuple(
        StateEvent(Guard(f"end{i + 1}", q.sx[2 * i + 1], -1, unit="m"), jump=Jump({v: np.eye(4)[:, 2 * i + 1].tolist()}, 0.5))
        for i in range(2)
    )  # fmt: skip
    return build_model(replace(declaration, state_events=events))


def test_a_bar_falls_on_both_ends_at_once():
    """One event of two jumps and the constraint of the bar; each end comes back with half of its speed."""
    instance = NativeInstance(bars())
    found = [part.happened for part in instance.land(0.0, 0.05, 12) if part.happened]
    assert [h.events for h in found] == [(0, 1)]
    assert found[0].t == pytest.approx(sqrt(2 / G), abs=1e-12)
    assert found[0].lost.sum() == pytest.approx(0.75 * 4.0 * G, rel=1e-12)


@cache
def relay():
    """A level that a valve fills and empties between two marks: 9 switchings in closed form."""
    x = state("x", unit="J", start=0.5)
    on = parameter("on", 1.0)
    upper = StateEvent(Guard("upper", x.sx - 0.8, 1, unit="J"), when={"on": 1.0}, sets={"on": 0.0})
    lower = StateEvent(Guard("lower", x.sx - 0.2, -1, unit="J"), when={"on": 0.0}, sets={"on": 1.0})
    p = state("p", start=1.0)
    rate = 2 * on.sx - 1
    return build_model(
        PHDAE("relay", states=(x, p), parameters=(on,), energies=(energy(0 * x.sx), energy(p**2 / 2)),
              structure=(skew(x, p, rate),), state_events=(upper, lower)),
        Collocated(2),
    )  # fmt: skip


@pytest.mark.parametrize("h", [0.05, 0.31, 5.5])
def test_a_relay_switches_where_it_should(h):
    """Also nine times within one step."""
    n = round(5.5 / h)
    times = [part.happened.t for part in NativeInstance(relay()).land(0.0, 5.5 / n, n) if part.happened]
    assert times == pytest.approx([0.3 + 0.6 * j for j in range(9)], abs=1e-12)
