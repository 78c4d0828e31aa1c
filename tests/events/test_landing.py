"""State events are landed on: times, states and losses against exact solutions."""

from __future__ import annotations

from dataclasses import replace
from math import cos, pi, sin, sqrt

import numpy as np
import pytest

from phfmu import (
    PHDAE,
    TRANSLATIONAL,
    Collocated,
    Guard,
    Jump,
    Monolithic,
    NativeInstance,
    Options,
    Port,
    StateEvent,
    StepFailure,
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
from phfmu.components.library import build
from phfmu.outcome.status import EventRefused
from tests.events.scenes import MASS, REBOUND, WALL_STOP, exact, wall


@pytest.fixture(scope="module")
def models() -> dict:
    return {k: build_model(wall(), Collocated(k)) for k in (1, 2, 3)}


@pytest.mark.parametrize(("k", "n", "time_error"), [(1, 160, 5e-3), (2, 160, 1e-6), (3, 320, 1e-12)])
def test_order_2k_through_nine_impacts(models, k, n, time_error):
    times, q, p = exact()
    assert len(times) == 9
    errors = []
    for steps in (n // 2, n):
        instance = NativeInstance(models[k])
        start = instance.signal("H").sum()
        parts = list(instance.land(0.0, WALL_STOP / steps, steps, record=("stored",)))
        happened = [part.happened for part in parts if part.happened]
        assert len(happened) == 9
        errors.append(np.hypot(instance.x[0] - q, (instance.x[1] - p) / MASS))
        lost = sum(h.lost.sum() for h in happened)
        assert abs(instance.signal("H").sum() - start + lost) <= 1e-14 * start
        assert max(np.abs(part.rows["stored"]).max() for part in parts if part.rows) <= 1e-14 * start
        assert max(abs(h.energy.sum() + h.lost.sum()) for h in happened) == 0.0
    assert np.max(np.abs(np.array([h.t for h in happened]) - times)) <= time_error
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2 * k, abs=0.2)


def test_landing_takes_few_solves(models):
    """Most 6 an event beyond its trial and its landed step."""
    for k in (1, 2, 3):
        instance = NativeInstance(models[k])
        before = instance.counts["solves"]
        events = sum(part.happened is not None for part in instance.land(0.0, WALL_STOP / 160, 160))
        assert (instance.counts["solves"] - before - 160 - events) / events <= 6


@pytest.mark.parametrize("cut", [1, 7])
def test_blocks_of_steps_do_not_matter(models, cut):
    whole, parts = NativeInstance(models[1]), NativeInstance(models[1])
    list(whole.land(0.0, 0.05, 42))
    for first in range(0, 42, cut):
        list(parts.land(0.0, 0.05, cut, first=first, changed=first == 0))
    assert (whole.x == parts.x).all()


@pytest.mark.parametrize("k", (1, 2))
def test_a_ball_comes_to_rest(k):
    """The bounces end at t = sqrt(2 h/g) (1 + e)/(1 - e); gravity is constant, so that all times are exact."""
    scene = build("bouncing_ball")
    model = build_model(scene.declaration(), Collocated(k))
    result = run(Monolithic(model, NativeInstance(model)), Options(stop=scene.stop, step=scene.step))
    summary = result.ledger.summary()
    assert summary.closed
    end = sqrt(2 / 9.81) * 9
    flight = result.column("flight")
    rests = result.time[np.flatnonzero(flight == 0)[0]]
    assert 0 <= end - rests <= 3e-7  # what is left below 1e-6 of the step
    assert result.column("q")[-1] == pytest.approx(0, abs=1e-15) and result.column("p")[-1] == 0
    first = sqrt(2 / 9.81)
    jumps = np.flatnonzero(np.diff(result.time) == 0)
    v = np.array([result.column("v")[jumps], result.column("v")[jumps + 1]])
    assert result.time[jumps[0]] == pytest.approx(first, abs=1e-14)
    assert v[1, :-1] == pytest.approx(-REBOUND * v[0, :-1], rel=1e-14)
    (ball,) = summary.components
    assert ball.jumps == pytest.approx(-9.81, rel=1e-14)
    assert summary.events["state"] == len(jumps)


def test_start_on_the_guard():
    """A ball that starts on the floor and falls has its impact at once; one that is thrown up flies first."""
    scene = build("bouncing_ball")
    for p, first in ((0.0, 0.0), (-1.0, 0.0), (1.0, 2 / 9.81)):
        model = build_model(scene.declaration().with_starts({"q": 0.0, "p": p}), Collocated(2))
        part = next(iter(NativeInstance(model).land(0.0, 0.5, 1)))
        assert part.happened is not None and part.happened.t == pytest.approx(first, abs=1e-14)


def oscillator(*events: StateEvent, **more) -> tuple[PHDAE, dict]:
    q, p = state("q", unit="m", start=1.0), state("p", unit="kg.m/s")
    s, r = parameter("s", 1.0), parameter("r", 0.0)
    return PHDAE(
        "oscillator", states=(q, p), parameters=(s, r), energies=(energy(q**2 / 2), energy(p**2 / 2)),
        structure=(skew(q, p, 1.0),), **more,
    ), {"q": q, "p": p, "s": s}  # fmt: skip


def fired(declaration: PHDAE, k: int, h: float, n: int) -> list[float]:
    parts = NativeInstance(build_model(declaration, Collocated(k))).land(0.0, h, n)
    return [part.happened.t for part in parts if part.happened]


@pytest.mark.parametrize(("k", "depth"), [(2, 1e-5), (3, 1e-6)])
def test_short_dips_are_seen(k, depth):
    """q = cos t falls below 1 - .. only near its turning points: both crossings lie inside one step."""
    model, v = oscillator()
    h = 2 * pi / 48
    start = replace(v["q"], start=(cos(-10.4 * h),)), replace(v["p"], start=(-sin(-10.4 * h),))
    dip = Guard("dip", -v["q"] + 1 - depth, 0, unit="m")
    declaration = replace(model, states=start, state_events=(StateEvent(dip),))
    found = fired(declaration, k, h, 20)
    assert len(found) == 2 and found[1] - found[0] == pytest.approx(2 * np.arccos(1 - depth), rel=0.2)


def test_an_event_on_a_grid_point_happens_once():
    q = state("q", start=1.0)
    s = parameter("s", 1.0)
    e = StateEvent(Guard("zero", q, -1), when={"s": 1.0}, sets={"s": -1.0})
    p = state("p", start=1.0)
    declaration = PHDAE("line", states=(q, p), parameters=(s,), energies=(energy(p**2 / 2), energy(0 * q.sx)),
                        structure=(skew(q, p, -s.sx),), state_events=(e,))  # fmt: skip
    instance = NativeInstance(build_model(declaration, Collocated(2)))
    times = [part.happened.t for part in instance.land(0.0, 0.25, 8) if part.happened]
    assert times == [pytest.approx(1.0, abs=1e-15)]
    assert instance.x[0] == pytest.approx(1.0, abs=1e-14)  # there and back


def test_two_guards_at_one_instant_are_one_event():
    model, v = oscillator()
    guards = (Guard(n, c * v["q"], -1, unit="m") for n, c in (("a", 1), ("b", 3)))
    events = tuple(StateEvent(g, when={"s": 1.0}, sets={"s": 2.0}) for g in guards)
    parts = NativeInstance(build_model(replace(model, state_events=events), Collocated(2))).land(0.0, 0.3, 20)
    assert [part.happened.events for part in parts if part.happened] == [(0, 1)]


def test_chatter_and_crowds_are_refused_by_name():
    model, v = oscillator()
    g = v["q"] - 0.5
    off = StateEvent(Guard("off", g, -1), when={"s": 1.0}, sets={"s": 0.0})
    both = off, StateEvent(Guard("on", g, -1), when={"s": 0.0}, sets={"s": 1.0})
    beyond = off, StateEvent(Guard("on", g - 0.2, -1), when={"s": 0.0}, sets={"s": 1.0, "r": 1.0})
    beyond = *beyond, StateEvent(Guard("off again", g - 0.2, -1), when={"s": 1.0, "r": 1.0}, sets={"s": 0.0})
    for events, says in ((both, "100 events fall into one step"), (beyond, "happens again at the same instant")):
        with pytest.raises(EventRefused, match=says):
            list(NativeInstance(build_model(replace(model, state_events=events), Collocated(1))).land(0.0, 0.1, 40))
    scene = build("bouncing_ball").declaration()
    endless = replace(scene, state_events=tuple(replace(e, rest={}) for e in scene.state_events))
    instance = NativeInstance(build_model(endless, Collocated(2)))
    with pytest.raises(StepFailure, match="100 events fall into one step, the last 'floor'.*rest"):
        list(instance.land(0.0, 0.5, 10))
    assert instance.time < 4.07  # at its last accepted step


def clutch(most: float = np.inf) -> PHDAE:
    """Two discs that a clutch joins for an instant when the first has turned by 1 rad."""
    J = (2.0, 0.7)
    phi = state("phi", unit="rad")
    p = state("p1", unit="kg.m2/s", start=J[0] * 30.0), state("p2", unit="kg.m2/s", start=J[1] * -10.0)
    s = parameter("s", 0.0)
    return PHDAE(
        "clutch",
        states=(phi, *p),
        parameters=(s,),
        energies=tuple(energy(q**2 / (2 * j)) for q, j in zip(p, J, strict=True)) + (energy(0 * phi.sx),),
        structure=(skew(phi, p[0], 1.0),),
        dissipation=(damping(p[0], 0.0),),
        state_events=(
            StateEvent(Guard("grip", phi.sx - 1.0, 1, unit="rad"), when={"s": 0.0}, sets={"s": 1.0},
                       jump=Jump({p[0]: 1.0, p[1]: -1.0}, most=most)),
        ),
    )  # fmt: skip


def test_the_loss_of_a_clutch_is_its_formula():
    instance = NativeInstance(build_model(clutch(), Collocated(2)))
    before = instance.x[1:].sum()
    (happened,) = (part.happened for part in instance.land(0.0, 0.02, 5) if part.happened)
    assert happened.lost.sum() == pytest.approx(2.0 * 0.7 / (2 * 2.7) * 40.0**2, rel=1e-14)
    assert instance.x[1:].sum() == pytest.approx(before, rel=1e-15)
    assert instance.x[1] / 2.0 == pytest.approx(instance.x[2] / 0.7, rel=1e-15)
    assert instance.x[0] == pytest.approx(
        1.0 + (0.1 - happened.t) * instance.x[1] / 2.0, rel=1e-14
    )  # unmoved by the jump


def test_a_jump_beyond_its_limit_is_refused():
    instance = NativeInstance(build_model(clutch(most=39.0), Collocated(2)))
    with pytest.raises(EventRefused, match=r"'grip' would jump with \|c\| = 40, more than its most = 39"):
        list(instance.land(0.0, 0.02, 5))


def test_compiled_landing_goes_on_where_its_room_ended(monkeypatch):
    """Many impacts in few steps with room for one event and one row more than grid steps, and with much: the same bits."""
    from phfmu.engine.native import native_landing

    scene = build("bouncing_ball")
    model = build_model(scene.declaration(), Collocated(2))
    found = []
    for steps, events in ((1, 1), (500, 500)):
        monkeypatch.setattr(native_landing, "STEPS", steps)
        monkeypatch.setattr(native_landing, "EVENTS", events)
        parts = list(NativeInstance(model).land(0.0, 0.5, 10, record=("x",)))
        found.append([(p.t.tolist(), p.h.tolist(), p.rows["x"].tolist() if p.rows else []) for p in parts])
        assert sum(part.happened is not None for part in parts) > 60
    steps = [[x for part in run for x in zip(*part, strict=True)] for run in found]
    assert steps[0] == steps[1] and len(steps[0]) > 60


def test_guards_of_algebraic_variables():
    """The voltage over a resistor in series is an algebraic variable; it is solved for within the step too."""
    flux, v = state("flux", unit="Wb", start=1.0), algebraic("v", unit="V")
    s = parameter("s", 1.0)
    decay = PHDAE(
        "decay", states=(flux,), algebraics=(v,), parameters=(s,), energies=(energy(flux**2 / 2),),
        structure=(skew(flux, v, -1.0),), dissipation=(damping(v, 1.0),),
        state_events=(StateEvent(Guard("half", v.sx - 0.5, -1, unit="V"), when={"s": 1.0}, sets={"s": 0.0}),),
    )  # fmt: skip
    (happened,) = (
        p.happened for p in NativeInstance(build_model(decay, Collocated(3))).land(0.0, 0.02, 50) if p.happened
    )
    assert happened.t == pytest.approx(np.log(2), abs=1e-12)


def test_guards_of_time_and_of_inputs():
    q, p = state("q", start=0.0), state("p", start=0.0)
    force = Port("force", TRANSLATIONAL, "effort", {p: 1.0}, start=2.0)
    s = parameter("s", (1.0, 1.0), 2)
    events = (
        StateEvent(Guard("clock", time - 0.3137, 1, unit="s"), when={"s[1]": 1.0}, sets={"s[1]": 0.0}),
        StateEvent(Guard("work", force.u * q.sx - 0.32, 1), when={"s[2]": 1.0}, sets={"s[2]": 0.0}),
    )
    body = PHDAE("body", states=(q, p), parameters=(s,), energies=(energy(p**2 / 2), energy(0 * q.sx)),
                 structure=(skew(q, p, 1.0),), ports=(force,), state_events=events)  # fmt: skip
    found = [p.happened for p in NativeInstance(build_model(body, Collocated(2))).land(0.0, 0.125, 8) if p.happened]
    assert [h.events for h in found] == [(0,), (1,)]
    assert [h.t for h in found] == [pytest.approx(0.3137, abs=1e-15), pytest.approx(0.4, abs=1e-14)]  # q = t^2


def test_a_bounce_without_end_is_told_of_rest_first():
    """Zeno: the ball of the library, at whose floor nothing says what holds at rest."""
    scene = build("bouncing_ball").declaration()
    endless = replace(scene, state_events=tuple(replace(e, rest={}) for e in scene.state_events))
    with pytest.raises(EventRefused) as refused:
        list(NativeInstance(build_model(endless, Collocated(1))).land(0.0, 0.02, 250))
    assert "Next: declare what holds where a bounce comes to rest (StateEvent(rest=..)" in str(refused.value)
