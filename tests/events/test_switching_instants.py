"""Switching at given instants, for hundreds of periods: no event lost, none twice, whatever the clock of the steps.

The guards of a chopper are functions of time alone, zero at instants of which many are grid points, or beside one by what a
sum of steps has rounded.  The reference solves each stretch between two instants exactly, by matrix exponentials.
"""

from __future__ import annotations

from math import ceil
from typing import Any

import numpy as np
import pytest

from phfmu import (
    PHDAE,
    Collocated,
    Event,
    Guard,
    Monolithic,
    NativeInstance,
    Options,
    StateEvent,
    SwitchedInstance,
    build_model,
    energy,
    parameter,
    run,
    skew,
    state,
    time,
)
from phfmu.components.scenes.electrical.buck import buck
from phfmu.components.scenes.electrical.rectifier import rectifier
from tests.events.exact_buck import F, exact


def stepped(model: Any, h: float) -> Any:
    made = SwitchedInstance(model, NativeInstance)
    made.prepare(h)
    made.initialise()
    return made


SLOW = pytest.mark.slow


@pytest.mark.parametrize(("stop", "k"), [(0.03, 1), (0.03, 3), pytest.param(0.03, 2, marks=SLOW)])
def test_a_converter_runs_on_for_hundreds_of_periods(stop: float, k: int) -> None:
    """Every period has both events; the state is that of the exact stretches, of the order of the scheme."""
    scene = buck()
    model = build_model(scene.declaration(), Collocated(k))
    whole, errors = exact(stop, lambda t: 0.6 if t > 1.5e-3 - 1e-9 else 0.4), []
    for h in (5e-6, 2.5e-6):
        made = stepped(model, h)
        result = run(Monolithic(model, made), Options(stop=stop, step=h, events=scene.events))
        begins = [n for n in result.notes if "chopper.begins" in n]
        ends = [n for n in result.notes if "chopper.ends" in n]
        assert len(begins) in (round(stop * F), round(stop * F) + 1) and len(ends) == round(stop * F)
        errors.append(abs(made.x / whole - 1).max())
    assert errors[1] < {1: 3e-4, 2: 2e-7, 3: 1e-10}[k]
    assert errors[0] / errors[1] > 0.8 * 4**k or errors[0] < 1e-12


@pytest.mark.parametrize("h", (1e-6, 3e-6, 5e-6, 1e-4))
def test_summed_clocks_come_beside_every_instant_and_lose_none(h: float) -> None:
    """t += h ends 1.6e-18 s before or behind an instant of switching: that instant is there once."""
    model = build_model(buck(later=None).declaration(), Collocated(2))
    made, parts, stop = stepped(model, 5e-6), ceil(h / 5e-6 - 1e-9), 6e-3 if h > 1e-6 else 3e-3
    t, found = 0.0, list[tuple[float, str]]()
    while t < stop - 0.3 / F:
        made.do_step(t, h, parts)
        t += h
        found += [(e.t, model.events.names[i]) for e in made.happened for i in e.events]
    for name, part in (("chopper.begins", 0.0), ("chopper.ends", 0.4)):
        at = [time for time, n in found if n == name]
        expected = (np.arange(ceil(t * F + 0.5)) + part) / F
        assert at == pytest.approx(expected[: len(at)], rel=1e-13, abs=1e-18)
        assert len(at) == np.sum(expected <= t * (1 + 1e-12))
    assert made.x == pytest.approx(exact(t, lambda _: 0.4), rel=1e-6, abs=1e-10)


def test_light_load_blocks_the_diode_at_the_zeros_of_its_current() -> None:
    """Discontinuous conduction: three events a period, at instants and at zeros of the state."""
    scene = buck(R=100.0, later=None)
    model = build_model(scene.declaration(), Collocated(3))
    made = stepped(model, 2.5e-6)
    result = run(Monolithic(model, made), Options(stop=0.03, step=2.5e-6))
    assert made.x == pytest.approx(exact(0.03, lambda _: 0.4, 100.0), rel=1e-9, abs=1e-13)
    opened = [n for n in result.notes if "diode.opens" in n]
    assert len(opened) > 300


def pendulum_with_gate(late: float) -> PHDAE:
    """An oscillator; at each zero of cos(2 pi 50 (t - late)) a mode changes, back and forth, which changes nothing else."""
    import casadi as ca

    q, p, up = state("q", start=1.0), state("p"), parameter("up", 1.0)
    g = ca.cos(2 * np.pi * 50.0 * (time - late))
    events = (
        StateEvent(Guard("down", g, -1), when={"up": 1.0}, sets={"up": 0.0}),
        StateEvent(Guard("up", g, 1), when={"up": 0.0}, sets={"up": 1.0}),
    )
    return PHDAE(
        "gated",
        states=(q, p),
        parameters=(up,),
        energies=(energy(p**2 / 2 + 50 * q**2),),
        structure=(skew(q, p, 1.0 + 0 * up.sx),),
        state_events=events,
    )


@pytest.mark.parametrize("after", [0.0, 1000.0])
def test_opposite_guards_of_one_function_take_turns(after: float) -> None:
    """They are zero together; which side they are on there is rounding, that of the time at t = 1000 s too."""
    model = build_model(pendulum_with_gate(after), Collocated(1))
    made = NativeInstance(model)
    made.set_x(after, [1.0, 0.0])
    h, n = 1e-3, 400
    t, found = after, list[float]()
    for _ in range(n):
        made.do_step(t, h)
        t += h
        found += [e.t for e in made.happened]
    at = after + (np.arange(len(found)) + 0.5) / 100.0
    assert found == pytest.approx(at, rel=1e-14, abs=1e-12)
    assert len(found) == 40


def test_steps_from_a_state_know_nothing_of_steps_before_it() -> None:
    """From 40 units of rounding before an instant on: the same parts, whatever was landed on before."""
    model = build_model(pendulum_with_gate(1000.0), Collocated(1))
    t, found = 1000.005 - 40 * np.spacing(1000.0), list[Any]()
    for before in (0, 3, 7):
        made = NativeInstance(model)
        made.set_x(1000.0, [1.0, 0.0])
        start = made.get_state()
        if before:
            list(made.land(1000.0, 1e-3, before))
        made.set_state(start)
        made.set_x(t, [1.0, 0.0])
        parts = list(made.land(t, 1e-3, 2, ("x",), 0, False))
        told = [p.happened.t for p in parts if p.happened is not None]
        found.append(([p.h.tolist() for p in parts], told, made.x.tobytes()))
    assert found[0] == found[1] == found[2]
    assert found[0][1] == pytest.approx([1000.005], rel=1e-15)


@pytest.mark.parametrize(("scene", "h", "ends"), [("buck", 1e-5, 2), ("rectifier", 1e-3, 0)])
def test_a_state_saved_at_an_instant_gives_the_same_bits(scene: str, h: float, ends: int) -> None:
    """Communication steps, `ends` of which end at an instant of switching; on to the next events, back, and on again.

    Saved at each end, taken back to in the same instance and put into another one that has been elsewhere.
    """
    declaration = (buck(later=None) if scene == "buck" else rectifier()).declaration()
    model = build_model(declaration, Collocated(2))
    made, other = stepped(model, h / 2), stepped(model, h / 2)
    parts, events, at_end = 2, 0, 0
    for i in range(3):
        other.do_step(i * h, h, parts)
    for i in range(24):
        state, mode = made.get_state(), made.mode
        made.do_step(i * h, h, parts)
        told = [(e.t, e.events, e.switched) for e in made.happened]
        x, end = made.x.tobytes(), made.get_state()
        events, at_end = events + len(told), at_end + any(abs(e[0] - (i + 1) * h) < 1e-15 for e in told)
        made.do_step((i + 1) * h, h, parts)  # over what follows the end, which is an instant or not
        beyond = made.x.tobytes(), [(e.t, e.events) for e in made.happened]
        for instance in (made, other):
            instance.set_state(state)
            assert instance.mode == mode
            instance.do_step(i * h, h, parts)
            assert [(e.t, e.events, e.switched) for e in instance.happened] == told
            assert instance.x.tobytes() == x
            instance.set_state(end)
            instance.do_step((i + 1) * h, h, parts)
            assert (instance.x.tobytes(), [(e.t, e.events) for e in instance.happened]) == beyond
        made.set_state(end)
    assert events > 4 and at_end >= ends


def test_what_is_set_beyond_zero_happens_at_once_all_the_same() -> None:
    """A mode that is set while its guard is far beyond zero: the event happens at the start of the step, once."""
    model = build_model(buck(later=None).declaration(), Collocated(1))
    made = stepped(model, 5e-6)
    for k in range(6):
        made.do_step(k * 5e-6, 5e-6)
    p = made.parameters
    names = [n for v in model.declaration.parameters for n in v.names()]
    p[names.index("chopper.conducts")] = 1.0
    made.set_parameters(p)
    made.do_step(3e-5, 5e-6)
    told = [model.events.names[i] for e in made.happened for i in e.events]
    assert told == ["chopper.ends"] and made.mode[0] == 0


def test_an_event_of_the_scene_at_an_instant_of_switching() -> None:
    """Duty and frequency change exactly where a period begins: one event of each kind, the run goes on."""
    scene = buck(later=None)
    model = build_model(scene.declaration(), Collocated(2))
    made = stepped(model, 5e-6)
    events = tuple(Event(n * 1e-3, "chopper.duty", d) for n, d in enumerate((0.3, 0.7, 0.5, 0.6), 1))
    run(Monolithic(model, made), Options(stop=6e-3, step=5e-6, events=events))
    duties = {0: 0.4, 1: 0.3, 2: 0.7, 3: 0.5, 4: 0.6, 5: 0.6}
    assert made.x == pytest.approx(exact(6e-3, lambda t: duties[int(t * 1e3 + 1e-9)]), rel=2e-7)
