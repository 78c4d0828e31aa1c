"""Tables of docs/results/events.md: orders through events, losses beside formulas."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from pages import Array, PageBlock, independent, slopes, table

from phfmu import Collocated, Coupled, EngineMember, Event, NativeInstance, Options, build_model
from phfmu.components.library import build, builder
from phfmu.engine.switched import stepped
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.runs.loop import run


@dataclass(frozen=True)
class EventRun:
    """A run: times of its events, states at its end, closure over the energy at the start, solves an event beyond its steps."""

    times: list[float]
    x: Array
    closure: float
    solves: float


def landed(instance: Any, stop: float, n: int) -> EventRun:
    """n grid steps from the start."""
    instance.reset()
    before, counted = instance.signal("H").sum(), instance.counts["solves"]
    booked, times, steps = 0.0, [], 0
    for part in instance.land(0.0, stop / n, n, record=("dissipated", "supplied")):
        steps += len(part.t)
        if part.rows:
            booked += part.rows["dissipated"].sum() - part.rows["supplied"].sum()
        if part.happened:
            booked += part.happened.lost.sum()
            times.append(part.happened.t)
    missing = instance.signal("H").sum() - before + booked
    solves = (instance.counts["solves"] - counted - steps) / max(1, len(times))
    return EventRun(times, instance.x, float(abs(missing) / before), solves)


def instance(name: str, k: int) -> Any:
    """The scene `name` at its start, order 2k."""
    return stepped(build_model(build(name).declaration(), Collocated(k)), NativeInstance)


@dataclass(frozen=True)
class ClosedFormScene:
    """A scene with a closed form: its events, what of the states is compared at the stop, and their names."""

    times: list[float]
    values: Array
    names: tuple[str, ...]
    steps: dict[int, tuple[int, ...]]
    stop: float


def known() -> dict[str, ClosedFormScene]:
    """Scenes that tests/reference/event_reference.py solves by hand."""
    by_hand = independent("event_reference")
    times, ia, idc = by_hand.bridge(0.05)
    apart = by_hand.hard_stop()
    levels, speed = by_hand.two_points(6)
    flux = np.array([by_hand.LA * ia, by_hand.LD * idc])
    return {
        "rectifier": ClosedFormScene(times, flux, ("grid.flux", "load.flux"),
                           {1: (100, 200, 400), 2: (100, 200, 400), 3: (25, 50, 100)}, 0.05),
        "hard_stop": ClosedFormScene([apart["hit"], apart["apart"]], np.array([apart["gap"]]), ("stop.gap",),
                           {1: (50, 100, 200), 2: (25, 50, 100), 3: (10, 20, 40)}, 0.5),
        "two_point_control": ClosedFormScene(levels, np.array([speed]), ("rotor.w",),
                                   {1: (50, 100, 200), 2: (20, 40, 80), 3: (4, 8, 16)}, 2.0),
    }  # fmt: skip


def places(inst: Any, names: tuple[str, ...]) -> list[int]:
    """Places of scalar states."""
    every = [n for v in inst.model.declaration.states for n in v.names()]
    return [every.index(n) for n in names]


def event_orders() -> PageBlock:
    """Errors of event times and of states after the last event against closed forms; closure and cost of landing."""
    rows = []
    for name, exact in known().items():
        for k in (1, 2, 3):
            inst = instance(name, k)
            where = places(inst, exact.names)
            found = [landed(inst, exact.stop, n) for n in exact.steps[k]]
            late = [float(np.max(np.abs(np.array(r.times[-len(exact.times) :]) - exact.times))) for r in found]
            off = [float(np.linalg.norm((r.x[where] - exact.values) / exact.values)) for r in found]
            steps = [exact.stop / n for n in exact.steps[k]]
            shown = zip(exact.steps[k], found, late, slopes(late, steps), off, slopes(off, steps), strict=True)
            rows += [
                [f"{name}, {len(exact.times)} events", 2 * k, n, t, p, e, q, r.closure, f"{r.solves:.1f}"]
                for n, r, t, p, e, q in shown
            ]
    head = ["scene", "order", "steps", "event times, s", "slope", "states", "slope", "closure / H", "solves an event"]
    return table(head, rows)


def apart_orders() -> PageBlock:
    """The rectifier as three members stepped apart: errors against the closed form, and how far from the composed run."""
    exact, rows = known()["rectifier"], []
    for k in (1, 2, 3):
        found = [_apart(k, exact.stop / n) for n in exact.steps[k]]
        steps = [exact.stop / n for n in exact.steps[k]]
        late = [float(np.max(np.abs(_times(one) - exact.times))) for one, _ in found]
        ends = [np.array([one.column(n)[-1] for n in exact.names]) for one, _ in found]
        off = [float(np.linalg.norm((x - exact.values) / exact.values)) for x in ends]
        shown = zip(exact.steps[k], found, late, slopes(late, steps), off, slopes(off, steps), strict=True)
        for n, (one, whole), t, p, e, q in shown:
            beside = max(float(np.max(np.abs(one.column(s) / whole.column(s).max() - whole.column(s) / whole.column(s).max())))
                         for s in exact.names)  # fmt: skip
            apart = float(np.max(np.abs(_times(one) - _times(whole))))
            rows.append([2 * k, n, t, p, e, q, apart, beside])
    head = [
        "order",
        "steps",
        "event times, s",
        "slope",
        "states",
        "slope",
        "times, to the composed run, s",
        "states, to it",
    ]
    return table(head, rows)


def _apart(k: int, step: float) -> tuple[Any, Any]:
    """The rectifier apart, and composed."""
    scene = build("rectifier")
    models = {n: build_model(d, Collocated(k)) for n, d in scene.system.declared.items()}
    members: list[Any] = [EngineMember(n, m, stepped(m, NativeInstance)) for n, m in models.items()]
    return run(Coupled(scene.system, members), Options(stop=scene.stop, step=step)), ran(scene, k, step)


def _times(result: Any) -> Array:
    """Times of the events, each of which has a row before and one after it."""
    return result.time[np.flatnonzero(np.diff(result.time) == 0)]


def ran(scene: Any, k: int, step: float, stop: float | None = None) -> Any:
    """Result of a scene in the native engine."""
    model = build_model(scene.declaration(), Collocated(k))
    options = Options(stop=scene.stop if stop is None else stop, step=step, events=scene.events)
    return run(Monolithic(model, stepped(model, NativeInstance)), options)


def lost(result: Any, *members: str) -> float:
    """Energy that jumps took from these members, or from all [J]."""
    found = {c.component: c.jumps or 0.0 for c in result.ledger.summary().components}
    return -sum(found[m] for m in members or found)


def before(result: Any, name: str) -> float:
    """The value at the first state event, before it."""
    return float(result.column(name)[np.flatnonzero(np.diff(result.time) == 0)[0]])


def _bumper() -> tuple[float, float]:
    result = ran(build("buffer"), 3, 0.01, stop=0.2)
    return lost(result), 0.75 * 2.0 * before(result, "body.v") ** 2 / 2


def _pair() -> tuple[float, float]:
    from phfmu import Scene

    pair = builder("impact_pair")(2.0, 1.0, e=0.4, gap=0.3, v_a=3.0)
    return lost(ran(Scene("pair", pair, 0.2, 0.01), 3, 0.01)), (1 - 0.4**2) * 2.0 * 1.0 / (2 * 3.0) * 3.0**2


def _stop() -> tuple[float, float]:
    result = ran(build("hard_stop"), 3, 0.01, stop=0.3)
    return lost(result), 2.0 * 1.0 / (2 * 3.0) * before(result, "wagon.v") ** 2


def _clutch() -> tuple[float, float]:
    result = ran(build("clutch_engagement"), 3, 5e-3, stop=0.2)
    return lost(result), 2.0 * 0.7 / (2 * 2.7) * (before(result, "driver.w") - before(result, "load.w")) ** 2


def _chop() -> tuple[float, float]:
    return lost(ran(builder("breaker_opening")(chop=0.8), 3, 2.5e-4)), 3 * 0.01 * 0.8**2 / 2


def _forced() -> tuple[float, float]:
    result = ran(builder("breaker_opening")(forced=True), 3, 2.5e-4, stop=0.021)
    return lost(result), sum(0.01 * before(result, f"line.i[{j}]") ** 2 / 2 for j in (1, 2, 3))


def _capacitors() -> tuple[float, float]:
    from phfmu import Network, Scene
    from phfmu.components.electrical.branches import rc_node
    from phfmu.components.electrical.switches import ideal_switch

    net = Network("joined")
    net.add("one", rc_node(1e3, 2e-6, v0=100.0, v=100.0))
    net.add("two", rc_node(1e3, 5e-6, v0=20.0, v=100.0))
    net.add("switch", ideal_switch(conducts=False, v=100.0))
    net.connect("one.terminal", "switch.a", name="left")
    net.connect("switch.b", "two.terminal", name="right")
    scene = Scene("joined", net, 2e-5, 1e-5, (Event(0.0, "switch.conducts", 1.0),))
    return lost(ran(scene, 2, 1e-5)), 2e-6 * 5e-6 / (2 * 7e-6) * 80.0**2


#: what jumps -> formula, (booked, formula)
LOSSES: dict[str, tuple[str, Callable[[], tuple[float, float]]]] = {
    "capacitors of 2 and 5 uF joined at 100 and 20 V": ("C1 C2/(2 (C1 + C2)) dv^2", _capacitors),
    "clutch, 2 and 0.7 kg.m2": ("J1 J2/(2 (J1 + J2)) dw^2", _clutch),
    "wagon of 2 kg runs onto one of 1 kg": ("m1 m2/(2 (m1 + m2)) v^2", _stop),
    "bodies of 2 and 1 kg meet at 3 m/s, e = 0.4": ("(1 - e^2) m1 m2/(2 (m1 + m2)) v^2", _pair),
    "bumper, first impact, e = 0.5": ("(1 - e^2) m v^2/2", _bumper),
    "three poles chop 0.8 A of 10 mH": ("3 L i^2/2", _chop),
    "three poles of 10 mH forced open": ("sum of L i^2/2", _forced),
}


def event_losses() -> PageBlock:
    """Energy booked at a jump, and the formula with the values before it."""
    rows = []
    for what, (formula, measure) in LOSSES.items():
        booked, wanted = measure()
        rows.append([what, formula, f"{booked:.15g}", f"{wanted:.15g}", f"{abs(booked - wanted) / wanted:.1e}"])
    return table(["jump", "lost", "booked, J", "formula, J", "difference"], rows)
