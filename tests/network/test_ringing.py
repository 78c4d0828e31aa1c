"""Ringing after events is told with its remedy, in runs that ring and in no others; the run stays the same to the bit."""

from __future__ import annotations

import numpy as np
import pytest

from phfmu import (
    PHDAE,
    Collocated,
    Coupled,
    EngineMember,
    Event,
    Guard,
    Monolithic,
    NativeInstance,
    Network,
    Options,
    Radau,
    StateEvent,
    build_model,
    damping,
    energy,
    parameter,
    run,
    state,
    time,
)
from phfmu.components.library import LIBRARY, build
from phfmu.declare.error import DeclarationError
from phfmu.engine.switched import stepped
from phfmu.network.couplings.newton import Newton
from phfmu.runs.march import ringing
from tests.engines import ENGINES
from tests.events.stiff_fault import EVENTS, STEP, STOP, network
from tests.wide import turning, wide

SCENES = [n for n, row in LIBRARY.items() if row[0] == "scene"]


def decay(*events: StateEvent, t: float = 1e-6) -> PHDAE:
    """A capacitor whose conductance an event sets: time constant `t` once G = 1."""
    q, g = state("q", unit="C", start=1.0), parameter("G", 1e-9, unit="S")
    return PHDAE(
        "decay", states=(q,), parameters=(g,), energies=(energy(q**2 / (2 * t)),), dissipation=(damping(q, g),),
        state_events=events,
    )  # fmt: skip


def told(stepper, **options):
    return [
        n for n in run(stepper, Options(**options)).notes if n.startswith(("ringing", "and so after", "what rings"))
    ]


def composed(declaration, scheme, engine=NativeInstance):
    model = build_model(declaration, scheme)
    return Monolithic(model, engine(model))


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("k", wide([1, 2, 3], 1, 2))
def test_fast_decay_after_an_event_is_told(engine, k):
    """h/T = 1000: the factor of a step is -0.996, 0.988, -0.976."""
    options = {"stop": 0.03, "step": 1e-3, "events": [Event(0.005, "G", 1.0)]}
    first, remedy = told(composed(decay(), Collocated(k), engine), **options)
    assert first.startswith("ringing after G = 1 at t = 0.005 s: ") and "q by " in first
    assert ("stay beside" in first) == (k == 2)
    assert "a step of 0.001 s" in remedy
    for way in ("--restart 2", "--scheme radau", "--rtol", "smaller steps"):
        assert way in remedy
    assert told(composed(decay(), Collocated(k), engine), restart=2, **options) == []
    assert told(composed(decay(), Radau(2), engine), **options) == []


@pytest.mark.parametrize("k", [1, 2])
@pytest.mark.parametrize("ratio", [0.1, 1.0, 2.0])
def test_decay_that_the_steps_resolve_is_not(k, ratio):
    """A decay of h/T up to 2, and one that has died out in the steps before."""
    options = {"stop": 0.03, "step": 1e-3, "events": [Event(0.005, "G", 1.0)]}
    assert told(composed(decay(t=1e-3 / ratio), Collocated(k)), **options) == []


def test_a_state_event_is_an_event_too():
    g = parameter("G", 1e-9, unit="S")
    closes = StateEvent(Guard("closes", time - 0.0051, 1), when={"G": 1e-9}, sets={"G": 1.0})
    del g
    first, remedy = told(composed(decay(closes), Collocated(1)), stop=0.03, step=1e-3)
    assert first.startswith("ringing after closes at t = 0.0051 s") and "--restart 2" in remedy
    assert told(composed(decay(closes), Collocated(1)), stop=0.03, step=1e-3, restart=2) == []


def test_members_stepped_apart_ring_too_and_have_the_same_remedy():
    net = network()
    models = {n: build_model(d, Collocated(1)) for n, d in net.declared.items()}
    stepper = Coupled(net, [EngineMember(n, m, NativeInstance(m)) for n, m in models.items()])
    first, remedy = told(stepper, stop=STOP, step=STEP, events=EVENTS)
    assert "bus.q by" in first and "--scheme radau" in remedy and "--restart 2" in remedy
    models = {n: build_model(d, Collocated(1)) for n, d in net.declared.items()}
    stepper = Coupled(net, [EngineMember(n, m, NativeInstance(m)) for n, m in models.items()])
    assert told(stepper, stop=STOP, step=STEP, events=EVENTS, restart=2) == []


@pytest.mark.parametrize("k", [2, 3])
def test_a_state_event_is_one_for_node_values_too(k):
    """It comes within a block of steps, whose unknowns an even number of nodes needs."""
    closes = StateEvent(Guard("closes", time - 0.0051, 1), when={"G": 1e-9}, sets={"G": 1.0})
    first, remedy = told(composed(decay(closes), Collocated(k)), stop=0.03, step=1e-3)
    assert first.startswith("ringing after closes at t = 0.0051 s") and "--restart 2" in remedy
    assert ("stay beside" in first) == (k == 2)
    assert told(composed(decay(closes), Collocated(k)), stop=0.03, step=1e-3, restart=2) == []


@pytest.mark.parametrize("ratio", [0.1, 1.0, 2.0])
def test_a_decay_after_a_state_event_that_the_steps_resolve_is_not_told(ratio):
    closes = StateEvent(Guard("closes", time - 0.0051, 1), when={"G": 1e-9}, sets={"G": 1.0})
    assert told(composed(decay(closes, t=1e-3 / ratio), Collocated(2)), stop=0.03, step=1e-3) == []


def apart(net, k, **more):
    models = {n: build_model(d, Collocated(k)) for n, d in net.declared.items()}
    return Coupled(net, [EngineMember(n, m, NativeInstance(m)) for n, m in models.items()], **more)


@pytest.mark.parametrize("k", wide([1, 2, 3], 2))
def test_members_stepped_apart_ring_at_all_orders(k, monkeypatch):
    """Where a composed run is told of it, which at order 6 swings too little; rows are the same to the bit."""
    options = {"stop": 0.0115, "step": STEP, "events": EVENTS}
    watched = run(apart(network(), k), Options(**options))
    whole = run(composed(network().compose(), Collocated(k)), Options(**options))
    first, same = ([n for n in r.notes if n.startswith("ringing")] for r in (watched, whole))
    assert [n.partition(" by ")[0] for n in first] == [n.partition(" by ")[0] for n in same] and len(first) == (k < 3)
    for note in first:
        assert note.startswith("ringing after bus.G = 1 at t = 0.005 s") and "bus.q by" in note
        assert ("stay beside" in note) == (k == 2)
    monkeypatch.setattr(ringing, "WINDOWS", 0)
    blind = run(apart(network(), k), Options(**options))
    assert not any("ring" in n for n in blind.notes)
    assert np.array_equal(watched.values, blind.values)


@pytest.mark.parametrize("k", [1, 2])
def test_an_event_inside_the_step_of_a_member_is_one(k):
    """The member that decays meets another, so that it is stepped apart; what happens in its step is seen after
    it, with an even number of nodes in the steps of the next block."""
    closes = StateEvent(Guard("closes", time - 0.0051, 1), when={"G": 1e-9}, sets={"G": 1.0})
    net = Network("pair")
    net.add("a", decay(closes))
    net.add("b", network().declared["source"])
    member = net.declared
    models = {n: build_model(d, Collocated(k)) for n, d in member.items()}
    members = [EngineMember(n, m, NativeInstance(m)) for n, m in models.items()]
    stepper = Coupled(net, members, Newton())
    assert not stepper.lands
    first, _ = told(stepper, stop=0.2, step=1e-3)
    assert first.startswith("ringing after a.closes at t = 0.0051 s") and "a.q by" in first


def test_of_many_events_some_are_told_and_the_rest_counted():
    """Each time it is closed at another conductance it is another event."""
    events = [
        Event(0.01 * i + d, "G", g) for i in range(1, 7) for d, g in ((0.0, 1.0 + 0.1 * i), (0.0095, 1.0 + 0.05 * i))
    ]
    lines = told(composed(decay(), Collocated(1)), stop=0.07, step=1e-3, events=events)
    assert len(lines) == ringing.LINES + 2
    assert lines[-2] == "and so after 2 more events"


@pytest.mark.parametrize("k", [1, 2])
def test_watching_leaves_the_run_as_it_is(k, monkeypatch):
    """To the bit, although steps after an event are taken in blocks of their own."""
    declaration, options = network().compose(), Options(stop=STOP, step=STEP, events=EVENTS)
    watched = run(composed(declaration, Collocated(k)), options)
    monkeypatch.setattr(ringing, "WINDOWS", 0)
    blind = run(composed(declaration, Collocated(k)), options)
    assert any(n.startswith("ringing") for n in watched.notes) and not any("ring" in n for n in blind.notes)
    assert np.array_equal(watched.values, blind.values)


@pytest.mark.parametrize(
    ("name", "order"), turning(SCENES, [2, 4, 6], ("rectifier", 2), ("two_machine", 2), ("buffer", 2))
)
def test_no_scene_of_the_library_is_told_of_ringing_with_its_own_steps(name, order):
    """two_machine without its damping steps is: at order 2 the fault's decay, T = 14 us, rings in steps of 100 us."""
    from phfmu.schemes.named import named_scheme

    scene = build(name)
    declaration = scene.declaration()
    try:
        scheme = named_scheme(declaration, "auto", order)
    except DeclarationError as error:  # constraints on positions have odd stages only
        pytest.skip(str(error))
    model = build_model(declaration, scheme)
    options = {"stop": min(scene.stop, 0.3), "step": scene.step, "events": scene.events}
    assert told(Monolithic(model, stepped(model, NativeInstance)), restart=scene.restart, **options) == []
    if name == "two_machine" and order == 2:
        (first, _) = told(Monolithic(model, stepped(model, NativeInstance)), restart=0, **options)
        assert first.startswith("ringing after fault.G = 20 at t = 0.1 s") and "load.charge[1]" in first
