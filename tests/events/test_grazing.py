"""Guards that dip beyond zero and return within one step: q = cos(t - 1) against thresholds near its largest value."""

from __future__ import annotations

from dataclasses import replace
from math import acos, cos, pi, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phfmu import (
    PHDAE,
    TRANSLATIONAL,
    Collocated,
    Coupled,
    EngineMember,
    FMUInstance,
    FMUMember,
    Guard,
    Monolithic,
    NativeInstance,
    Network,
    Options,
    Port,
    StateEvent,
    build_model,
    energy,
    export,
    parameter,
    run,
    skew,
    state,
)
from phfmu.network.couplings.newton import newton

DEPTHS = (1e-2, 1e-4, 1e-6, 1e-8)
#: places of a step at which the guard turns
PLACES = np.linspace(0.01, 0.99, 50)
#: error of the time with steps of 0.1 s, by order: that of the phase of q after 1 s
ERROR = {1: 2e-3, 2: 3e-7, 3: 3e-11}


def oscillator(depth: float, direction: int = 1) -> PHDAE:
    """Counts when q first passes 1 - depth in the direction: at 1 -+ acos(1 - depth)."""
    q, v, seen = state("q", start=cos(1.0)), state("v", start=sin(1.0)), parameter("seen", 0.0)
    event = StateEvent(Guard("top", q - (1 - depth), direction), when={"seen": 0.0}, sets={"seen": 1.0})
    return PHDAE("oscillator", states=(q, v), parameters=(seen,), energies=(energy((q**2 + v**2) / 2),),
                 structure=(skew(q, v, 1),), state_events=(event,))  # fmt: skip


def times(declaration: PHDAE, k: int, h: float, stop: float = 2.0, changed: bool = True) -> list[float]:
    parts = NativeInstance(build_model(declaration, Collocated(k))).land(0.0, h, round(stop / h), changed=changed)
    return [part.happened.t for part in parts if part.happened]


@pytest.mark.parametrize("k", (1, 2, 3))
@pytest.mark.parametrize("direction", (1, -1))
def test_dips_of_any_depth_are_seen_and_none_is_made_up(k, direction):
    """In steps of 0.1 and 0.4 s both crossings are in one step or in two; -1: what counts is how the guard returns."""
    for depth in DEPTHS:
        for h, error in ((0.1, ERROR[k]), (0.4, far(k))):
            found = times(oscillator(depth, direction), k, h, changed=False)
            assert found == [pytest.approx(1 - direction * acos(1 - depth), abs=error)], (depth, h)
        assert times(oscillator(-depth, direction), k, 0.1, changed=False) == []
        assert times(oscillator(-depth, direction), k, 0.4, changed=False) == []


@pytest.mark.parametrize("k", (1, 2, 3))
def test_a_guard_of_both_directions_sees_both_crossings(k):
    q, v = state("q", start=cos(1.0)), state("v", start=sin(1.0))
    both = PHDAE("oscillator", states=(q, v), energies=(energy((q**2 + v**2) / 2),), structure=(skew(q, v, 1),),
                 state_events=(StateEvent(Guard("top", q - (1 - 1e-3), 0)),))  # fmt: skip
    found = times(both, k, 0.4)
    assert found == pytest.approx([1 - acos(1 - 1e-3), 1 + acos(1 - 1e-3)], abs=far(k))


@pytest.mark.parametrize("version", ("2.0", "3.0"))
@pytest.mark.parametrize("k", (1, 3))
def test_units_see_them(tmp_path, compiler, version, k):
    (path,) = export(build_model(oscillator(1e-6), Collocated(k)), tmp_path, (version,), step=0.4)
    member = FMUMember("oscillator", FMUInstance(path))
    net = Network("n")
    net.add("oscillator", path)
    result = run(Coupled(net, [member]), Options(stop=2.0, step=0.4))
    assert result.column("oscillator.events.count")[-1] == 1
    assert result.column("oscillator.events.last")[-1] == pytest.approx(1 - acos(1 - 1e-6), abs=far(k))


@pytest.mark.parametrize("k", (1, 2, 3))
def test_members_that_land_together_see_them(k):
    """The same oscillator, cut between its mass, which has the guard, and its spring.

    At order 2 the spring's force is held, so that the largest value of q in a step is of order 2 too, and the event lies within
    a row of the table.
    """
    depth = {1: 1e-2, 2: 1e-6, 3: 1e-6}[k]
    q, p, seen = state("q", start=cos(1.0)), state("p", start=sin(1.0)), parameter("seen", 0.0)
    event = StateEvent(Guard("top", q - (1 - depth), 1), when={"seen": 0.0}, sets={"seen": 1.0})
    mass = PHDAE("mass", states=(q, p), parameters=(seen,), energies=(energy(p**2 / 2), energy(0 * q.sx)),
                 structure=(skew(q, p, 1),), ports=(Port("end", TRANSLATIONAL, "effort", {p: 1.0}),),
                 state_events=(event,))  # fmt: skip
    s = state("s", start=cos(1.0))
    spring = PHDAE("spring", states=(s,), energies=(energy(s**2 / 2),),
                   ports=(Port("end", TRANSLATIONAL, "flow", {s: 1.0}),))  # fmt: skip
    net = Network("cut")
    net.add("mass", mass)
    net.add("spring", spring)
    net.connect("mass.end", "spring.end")
    made = {n: build_model(d, Collocated(k)) for n, d in net.separate().items()}
    apart = run(
        Coupled(net, [EngineMember(n, m, NativeInstance(m)) for n, m in made.items()], newton),
        Options(stop=2.0, step=0.4),
    )
    model = build_model(net.compose(), Collocated(k))
    composed = run(Monolithic(model, NativeInstance(model)), Options(stop=2.0, step=0.4))
    for result in (apart, composed):
        assert result.ledger.summary().events == {"state": 1}
        if k > 1 or result is composed:
            assert twice(result.time) == [pytest.approx(1 - acos(1 - depth), abs=far(k))]


@settings(max_examples=40, deadline=None)
@given(st.floats(0.2, 3.0), st.floats(0.1, 1.0), st.floats(0.0, 2 * pi), st.floats(0.0, 2 * pi), st.floats(-1.2, 1.2))
def test_all_crossings_of_two_tones_are_seen(w, share, first, second, level):
    """Order 6, steps of 0.2 s: the events are the sign changes of a dense table, where it dips by more than 1e-6."""
    q, v = state("q", start=cos(first)), state("v", start=-sin(first))
    r, u = state("r", start=cos(second)), state("u", start=-sin(second))
    tones = PHDAE(
        "tones", states=(q, v, r, u), structure=(skew(q, v, 1), skew(r, u, 1)),
        energies=(energy((q**2 + v**2) / 2), energy(w * (r**2 + u**2) / 2)),
        state_events=(StateEvent(Guard("level", q + share * r - level, 0)),),
    )  # fmt: skip
    t = np.linspace(0.0, 6.0, 60001)
    g = np.cos(t + first) + share * np.cos(w * t + second) - level
    crossed = t[:-1][g[:-1] * g[1:] < 0]
    extremes = np.abs(g[1:-1][(g[1:-1] - g[:-2]) * (g[2:] - g[1:-1]) <= 0])
    if min(extremes, default=1.0) < 1e-6 or abs(g[0]) < 1e-6 or abs(g[-1]) < 1e-6:
        return  # whether it touches is for rounding to say
    assert times(tones, 3, 0.2, stop=6.0) == pytest.approx(crossed.tolist(), abs=1e-3)


def far(k: int) -> float:
    """The error of a time with a step of 0.4 s."""
    return 2 * ERROR[k] * 4 ** (2 * k)


def twice(time: np.ndarray) -> list[float]:
    """Instants with a row before and a row after an event."""
    return time[1:][np.diff(time) == 0].tolist()


@pytest.mark.parametrize("k", (1, 2, 3))
@pytest.mark.parametrize("depth", (1e-7, 3e-8))
def test_a_crossing_whose_guard_is_coarser_than_the_clock_is_landed_on(k, depth):
    """Where g moves slowly, in roundings of q that pass zero by, only the change of its sign tells where that is."""
    plain = oscillator(depth)
    guard = replace(plain.state_events[0].guard, expr=plain.states[0] - 1 + depth)
    events = (replace(plain.state_events[0], guard=guard),)
    h, model = 2 * pi / 48, build_model(replace(plain, state_events=events), Collocated(k))
    error, missed = 2 * ERROR[k] * (h / 0.1) ** (2 * k), []
    for place in PLACES:
        instance, turn = NativeInstance(model), (10 + place) * h
        instance.set_x(0.0, np.array([cos(turn), sin(turn)]))
        found = [part.happened.t for part in instance.land(0.0, h, 12, changed=False) if part.happened]
        if found != [pytest.approx(turn - acos(1 - depth), abs=error)]:
            missed.append((place, found))
    assert missed == []
