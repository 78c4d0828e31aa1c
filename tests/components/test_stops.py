"""Bumper, end stop, clutch and relay in their scenes, against closed forms."""

from __future__ import annotations

from functools import cache
from math import asin, cos, exp, pi, sin, sqrt

import casadi as ca
import numpy as np
import pytest
from event_reference import hard_stop, two_points
from scipy.optimize import brentq

from phfmu import (
    Collocated,
    Event,
    Monolithic,
    NativeInstance,
    Network,
    Options,
    build_model,
    check,
    run,
)
from phfmu.components.control.relay import relay
from phfmu.components.electrical.switches import chopper
from phfmu.components.library import build
from phfmu.components.mechanical.contacts import bumper, end_stop, impact_pair
from phfmu.components.mechanical.translational import mass, spring
from phfmu.engine.switched import stepped
from tests.wide import wide

W = 10.0  # rad/s, sqrt(200 N/m / 2 kg)


@cache
def model(name: str, k: int):
    return build_model(build(name).declaration(), Collocated(k))


def simulated(name: str, k: int = 3, step: float | None = None):
    scene = build(name)
    made = model(name, k)
    options = Options(stop=scene.stop, step=step or scene.step, events=scene.events)
    result = run(Monolithic(made, stepped(made, NativeInstance)), options)
    assert result.ledger.summary().closed
    return result


def told(result, word: str) -> list[float]:
    """Times of the events with a word."""
    return [float(n.split("t = ")[1].split(" s")[0]) for n in result.notes if word in n]


def lost(result) -> float:
    return -sum(c.jumps for c in result.ledger.summary().components if c.jumps is not None)


@pytest.mark.parametrize(
    "name", ["bumper", "impact_pair", "end_stop", "clutch", "relay", "buffer", "hard_stop", "two_point_control"]
)
def test_the_declarations_are_sound(name):
    found = build(name)
    assert check(found.declaration() if hasattr(found, "declaration") else found, strict=True) == []


def impacts(n: int, e: float = 0.5) -> list[float]:
    """Times of the first n impacts: between them q + 0.05 = A cos(w t + phi), after each v = -e v."""
    t, v, found = 0.0, 0.0, list[float]()
    x = 0.15
    for _ in range(n):

        def gap(s: float, x: float = x, v: float = v) -> float:
            return x * cos(W * s) + v / W * sin(W * s) - 0.05

        s = brentq(gap, 1e-9 if found else 0.0, 0.2 if not found else _before_back(v), xtol=1e-16, rtol=9e-16)
        x, v = 0.05, -e * (v * cos(W * s) - x * W * sin(W * s))
        t += s
        found.append(t)
    return found


def _before_back(v: float) -> float:
    """After an impact with v the body is back before this, and before it goes through the wall it was once at its top."""
    return 2 * (pi / 2 - asin(0.05 / sqrt(0.05**2 + (v / W) ** 2))) / W * 1.5


def test_a_bumper_bounces_rests_and_lets_go():
    """Each impact loses (1 - e^2) m v^2/2, all of them what the body had; it leaves where the spring's force is zero."""
    result = simulated("buffer")
    assert told(result, "hits")[:5] == pytest.approx(impacts(5), abs=1e-9)
    speed = W * sqrt(0.15**2 - 0.05**2)
    first = next(n for n in result.notes if "hits" in n)
    assert float(first.split("lost ")[1].split()[0]) == pytest.approx(0.75 * speed**2, rel=1e-6)
    assert lost(result) == pytest.approx(speed**2, rel=1e-12)  # m = 2 kg
    free = result.column("body.free")
    at_rest = (result.time > 0.6) & (result.time < 1.4999)
    assert (free[at_rest] == 0.0).all() and np.abs(result.column("body.v")[at_rest]).max() < 1e-30
    released = result.time[np.flatnonzero(np.diff(free) > 0)[0]]
    assert released == pytest.approx(1.5, abs=1e-12)
    q = 0.1 * (0.5 - sin(W * 0.5) / W)
    assert result.column("body.q")[-1] == pytest.approx(q, abs=1e-9)


def test_a_bumper_under_a_held_force_rests_until_it_changes():
    """Alone, in parts of a step: falls under -2 N, rests, and goes with 2 N from when that is set."""
    instance = NativeInstance(build_model(bumper(2.0, e=0.0, gap=0.5), Collocated(1)))
    instance.set_input([-2.0])
    for i in range(12):
        instance.do_step(0.1 * i, 0.1)
    assert instance.x == pytest.approx([0.0, 0.0], abs=1e-15)
    instance.set_input([2.0])
    for i in range(12, 22):
        instance.do_step(0.1 * i, 0.1)
    assert instance.x == pytest.approx([0.5, 1.0], abs=1e-12)


def test_two_bodies_hit_each_other_go_on_as_one_and_part():
    """2 kg pushed with 6 N against 1 kg: impacts of the relative motion, all its energy lost; N = 2 N until the force turns."""
    m_a, m_b, e, gap, force = 2.0, 1.0, 0.4, 0.3, 6.0
    instance = NativeInstance(build_model(impact_pair(m_a, m_b, e=e, gap=gap, v_a=1.0, v_b=1.0), Collocated(1)))
    reduced = m_a * m_b / (m_a + m_b)
    pull, first = force / m_a, (2 * gap / (force / m_a)) ** 0.5  # their relative motion is that of a ball on a floor
    rest = first * (1 + e) / (1 - e)
    instance.set_input([force, 0.0])
    happened = []
    for i in range(12):
        instance.do_step(0.15 * i, 0.15)
        happened += instance.happened
    assert rest < 12 * 0.15
    assert happened[0].t == pytest.approx(first, rel=1e-14)
    assert happened[0].lost.sum() == pytest.approx((1 - e**2) / 2 * reduced * (pull * first) ** 2, rel=1e-13)
    assert happened[-1].t == pytest.approx(rest, abs=1e-6) and happened[-1].rests == (0,)
    assert sum(h.lost.sum() for h in happened) == pytest.approx(reduced * pull * gap, rel=1e-12)
    assert all(h.energy.sum() == -h.lost.sum() for h in happened)
    v = 1.0 + force * 1.8 / (m_a + m_b)
    assert instance.x == pytest.approx([0.0, v, v], abs=1e-12)
    instance.set_input([-3.0, 1.5])  # their sum slows both down, N = -2 N: they part at once
    instance.do_step(1.8, 0.2)
    assert instance.x == pytest.approx([0.5 * 3.0 * 0.04, v - 0.3, v + 0.3], abs=1e-12)


def test_an_end_stop_pushes_and_lets_go():
    """Impact, motion of both on the spring until it is at rest, then each for itself."""
    result = simulated("hard_stop")
    exact = hard_stop()
    assert told(result, "closes") == pytest.approx([exact["hit"]], abs=1e-9)
    assert told(result, "opens") == pytest.approx([exact["apart"]], abs=1e-9)
    assert lost(result) == pytest.approx(2 * 1 / (2 * 3) * exact["before"] ** 2, rel=1e-9)
    assert result.column("wagon.v")[-1] == pytest.approx(exact["wagon"], abs=1e-7)
    assert result.column("other.v")[-1] == pytest.approx(exact["speed"], abs=1e-8)
    assert result.column("stop.gap")[-1] == pytest.approx(exact["gap"], abs=1e-8)
    assert result.column("stop.gap").min() >= -1e-15 and result.column("stop.F").min() >= -1e-9


def test_a_fixed_stop_holds_a_body_and_its_ledger_is_closed():
    """Nothing passes through it but a force and the rounding of a velocity."""
    net = Network("held")
    net.add("body", mass(2.0))
    net.add("spring", spring(200.0, elongation=0.15))
    net.add("stop", end_stop(0.1, nominal=0.1, f=10.0))
    net.junction("joint", ["body.flange", "spring.b", "stop.b"])
    made = build_model(net.compose(), Collocated(1))
    result = run(Monolithic(made, stepped(made, NativeInstance)), Options(stop=0.2, step=0.01))
    assert result.ledger.summary().closed
    assert lost(result) == pytest.approx(2.0, rel=1e-12) and result.column("stop.F")[-1] == pytest.approx(
        10.0, rel=1e-12
    )


@pytest.mark.parametrize("k", wide([1, 2, 3], 2))
def test_the_scenes_are_of_order_2k(k):
    """Through impact and release; when the wagon is let go, and how far it has come."""
    exact, h, errors = hard_stop(), 0.02, []
    for step in (h, h / 2):
        result = simulated("hard_stop", k, step)
        errors.append(
            (abs(told(result, "opens")[0] - exact["apart"]), abs(result.column("stop.gap")[-1] - exact["gap"]))
        )
    slopes = np.log2(np.divide(*errors))
    assert slopes[1] == pytest.approx(2 * k, abs=0.2) and (k == 3 or slopes[0] == pytest.approx(2 * k, abs=0.2))


def test_a_clutch_loses_its_formula_and_keeps_the_momentum():
    result = simulated("clutch_engagement")
    J1, J2, slip = 2.0, 0.7, 40 * exp(-0.1 / 2.0)
    assert lost(result) == pytest.approx(J1 * J2 / (2 * (J1 + J2)) * slip**2, rel=1e-12)
    joined = J1 * slip / (J1 + J2)
    together = joined * exp(-1.5 * 0.2 / (J1 + J2))
    driver, load = result.column("driver.w"), result.column("load.w")
    at = np.flatnonzero(np.diff(result.time) == 0)[0]
    assert J1 * driver[at + 1] + J2 * load[at + 1] == pytest.approx(J1 * driver[at], rel=1e-14)
    assert driver[-1] == pytest.approx(together * exp(-0.2 / J1), rel=1e-11)
    assert load[-1] == pytest.approx(together * exp(-0.5 * 0.2 / J2), rel=1e-11)
    phi = result.column("driver.phi")
    assert phi[at + 1] == phi[at]  # a jump turns nothing


def test_a_relay_switches_at_its_marks():
    result = simulated("two_point_control")
    wanted, last = two_points(6)
    assert told(result, "relay.turns") == pytest.approx(wanted, abs=1e-11)
    assert result.column("rotor.w")[-1] == pytest.approx(last, rel=1e-10)
    w, driven = result.column("rotor.w"), result.column("relay.command")
    assert set(driven) == {0.0, 4.0} and w[result.time > wanted[0]].min() >= 95 - 1e-9 and w.max() <= 105 + 1e-9


def test_a_relay_needs_a_hysteresis():
    with pytest.raises(ValueError, match=r"lower = 2 must be below upper = 2 V"):
        relay(2.0, 2.0, unit="V")


def test_guards_follow_the_signals_that_are_wired_to_them():
    """A duty that comes from another member is in the guards of the chopper, too."""
    net = Network("wired")
    net.add("relay", relay(low=0.25, high=0.75))
    net.add("chopper", chopper(10.0))
    net.signal("relay.command", "chopper.duty")
    declaration = net.compose()
    assert check(declaration, strict=True) == []
    (low,) = (p for p in declaration.parameters if p.name == "relay.low")
    guards = {e.guard.name: e.guard.expr for e in declaration.state_events}
    assert [ca.depends_on(guards[f"chopper.{n}"], low.sx) for n in ("begins", "ends")] == [True, True]


def test_a_bumper_is_pulled_off_by_an_event():
    """A force at its free flange, -1 N and from 2 s on 1 N."""
    made = build_model(bumper(1.0, e=0.0, gap=0.5).with_starts({"flange.force": -1.0}), Collocated(2))
    result = run(
        Monolithic(made, NativeInstance(made)), Options(stop=3.0, step=0.25, events=(Event(2.0, "flange.force", 1.0),))
    )
    assert result.column("q")[-1] == pytest.approx(0.5, abs=1e-12) and result.ledger.summary().closed
