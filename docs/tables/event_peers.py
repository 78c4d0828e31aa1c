"""Tables of docs/results/events.md: bouncing ball and rectifier beside SciPy and SUNDIALS."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from statistics import median
from time import thread_time
from typing import Any

import numpy as np
from events import instance, known, landed
from pages import Array, PageBlock, independent, table

from phfmu.studies.bench.machine import machine_line, versions

TURNS = 9  # of which the median counts
#: grid steps of our own runs, tolerances of the others
STEPS = {
    "bouncing_ball": {1: (9, 35), 2: (9, 35), 3: (9, 35)},
    "rectifier": {1: (100, 1600), 2: (50, 400), 3: (25, 100, 200)},
}
TOLERANCES = (1e-5, 1e-8, 1e-11, 1e-13)
STOPS = {"bouncing_ball": 3.5, "rectifier": 0.05}
#: levels of the largest event time error (s) at which costs are compared
LEVELS = (1e-6, 1e-9, 1e-12)


@dataclass
class EventEntry:
    """A method with one setting: times of its events and energy error over H at the start; CPU times of its turns in s."""

    method: str
    setting: str
    solve: Callable[[], tuple[list[float], float]]
    spent: list[float] = field(default_factory=list)
    late: float = np.nan
    energy: float = np.nan

    def turn(self, wanted: list[float]) -> None:
        begin = thread_time()
        times, self.energy = self.solve()
        self.spent.append(thread_time() - begin)
        same = len(times) == len(wanted)
        self.late = float(np.max(np.abs(np.array(times) - wanted))) if same else np.inf


@dataclass(frozen=True)
class Segment:
    """x' = rate(t, x) until a guard falls to zero; `after`: guard, t, x -> the next one, and x there."""

    rate: Callable[[float, Array], tuple[float, ...]]
    guards: tuple[Callable[[float, Array], float], ...]
    after: Callable[[int, float, Array], tuple[Segment, Array]]


@dataclass(frozen=True)
class Piecewise:
    """A scene as users of solvers write it; the last entry of x is energy dissipated less energy supplied."""

    first: Segment
    x: Array
    stored: Callable[[Array], float]


def ball() -> Piecewise:
    """q, v, lost energy."""
    g, e = 9.81, 0.8

    def bounce(_: int, t: float, x: Array) -> tuple[Segment, Array]:
        return flight, np.array([0.0, -e * x[1], x[2] + (1 - e**2) / 2 * x[1] ** 2])

    flight = Segment(lambda t, x: (x[1], -g, 0.0), (lambda t, x: x[0],), bounce)
    return Piecewise(flight, np.array([1.0, 0.0, 0.0]), lambda x: x[1] ** 2 / 2 + g * x[0])


def rectifier() -> Piecewise:
    """Currents of the AC and the DC inductor, energy: all four diodes conduct, or one pair does and i_a = +-i_d."""
    by_hand = independent("event_reference")
    LA, RA, LD, RD, E, W, PHI = (getattr(by_hand, n) for n in ("LA", "RA", "LD", "RD", "E", "W", "PHI"))
    from math import cos

    def overlap_rate(t: float, x: Array) -> tuple[float, ...]:
        e = E * cos(W * t + PHI)
        return (e - RA * x[0]) / LA, -RD * x[1] / LD, RA * x[0] ** 2 + RD * x[1] ** 2 - e * x[0]

    def pair(q: int) -> Segment:
        def slope(t: float, x: Array) -> float:
            return (q * E * cos(W * t + PHI) - (RA + RD) * x[1]) / (LA + LD)

        def rate(t: float, x: Array) -> tuple[float, ...]:
            s = slope(t, x)
            return q * s, s, (RA + RD) * x[1] ** 2 - E * cos(W * t + PHI) * q * x[1]

        return Segment(rate, (lambda t, x: LD * slope(t, x) + RD * x[1],), lambda i, t, x: (overlap, x))

    def paired(i: int, t: float, x: Array) -> tuple[Segment, Array]:
        q = (1, -1)[i]
        return pair(q), np.array([q * x[1], x[1], x[2]])

    overlap = Segment(overlap_rate, (lambda t, x: x[1] - x[0], lambda t, x: x[1] + x[0]), paired)
    return Piecewise(overlap, np.array([0.0, by_hand.I0, 0.0]), lambda x: LA * x[0] ** 2 / 2 + LD * x[1] ** 2 / 2)


def driven(scene: Piecewise, stop: float, to_event: Callable[..., Any]) -> tuple[list[float], float]:
    """Solve a scene from event to event; `to_event`: segment, t, x -> (guard, None at the stop; t, x)."""
    segment, t, x, times = scene.first, 0.0, scene.x, list[float]()
    while True:
        guard, t, x = to_event(segment, t, x)
        if guard is None:
            missing = scene.stored(x) + x[-1] - scene.stored(scene.x)
            return times, float(abs(missing) / scene.stored(scene.x))
        times.append(t)
        if len(times) > 100:
            raise RuntimeError("more than 100 events")
        segment, x = segment.after(guard, t, x)


def scipy_entry(scene: Piecewise, stop: float, method: str, rtol: float) -> EventEntry:
    from scipy.integrate import solve_ivp

    def to_event(segment: Segment, t: float, x: Array) -> tuple[int | None, float, Array]:
        events = [lambda s, y, g=g: g(s, y) for g in segment.guards]
        for g in events:
            g.terminal, g.direction = True, -1
        found = solve_ivp(segment.rate, (t, stop), x, method=method, rtol=max(rtol, 3e-14), atol=rtol, events=events)
        if found.status == 0:
            return None, stop, found.y[:, -1]
        i = next(i for i, times in enumerate(found.t_events) if len(times))
        return i, float(found.t_events[i][0]), found.y_events[i][0]

    return EventEntry(f"SciPy {method}", f"rtol = {rtol:g}", lambda: driven(scene, stop, to_event))


def cvode_entry(scene: Piecewise, stop: float, method: str, rtol: float) -> EventEntry:
    CVODE: Any = import_module("sksundae.cvode").CVODE

    def to_event(segment: Segment, t: float, x: Array) -> tuple[int | None, float, Array]:
        def rate(s: float, y: Array, yp: Array) -> None:
            yp[:] = segment.rate(s, y)

        def guards(s: float, y: Array, out: Array) -> None:
            for i, g in enumerate(segment.guards):
                out[i] = g(s, y)

        n = len(segment.guards)
        guards.terminal, guards.direction = [True] * n, [-1] * n  # type: ignore[attr-defined]
        solver = CVODE(rate, rtol=rtol, atol=rtol, method=method, eventsfn=guards, num_events=n, max_num_steps=100_000)
        found = solver.solve(np.array([t, stop]), x)
        if found.i_events is None:
            return None, stop, np.array(found.y[-1])
        return int(np.flatnonzero(found.i_events[-1])[0]), float(found.t_events[-1]), np.array(found.y_events[-1])

    return EventEntry(f"SUNDIALS CVODE {method}", f"rtol = {rtol:g}", lambda: driven(scene, stop, to_event))


def own_entry(name: str, k: int, n: int) -> EventEntry:
    inst, stop = instance(name, k), STOPS[name]

    def solve() -> tuple[list[float], float]:
        found = landed(inst, stop, n)
        return found.times[-11:], found.closure

    return EventEntry(f"phfmu, order {2 * k}", f"{n} steps", solve)


def entries(name: str, scene: Piecewise) -> Iterator[EventEntry]:
    stop = STOPS[name]
    for k, counts in STEPS[name].items():
        yield from (own_entry(name, k, n) for n in counts)
    for rtol in TOLERANCES:
        for method in ("DOP853", "LSODA"):
            yield scipy_entry(scene, stop, method, rtol)
        if find_spec("sksundae") is not None:
            for method in ("Adams", "BDF"):
                yield cvode_entry(scene, stop, method, rtol)


@cache
def measured() -> dict[str, list[EventEntry]]:
    """Turn by turn, so that what else the machine does falls on all alike."""
    wanted = {"bouncing_ball": independent("event_reference").ball(STOPS["bouncing_ball"]),
              "rectifier": known()["rectifier"].times}  # fmt: skip
    out = {}
    for name, scene in (("bouncing_ball", ball()), ("rectifier", rectifier())):
        found = out[name] = list(entries(name, scene))
        for _ in range(TURNS + 1):  # the first one warms up
            for e in found:
                e.turn(wanted[name])
        for e in found:
            del e.spent[0]
    return out


def notes() -> tuple[str, ...]:
    about = f"{machine_line()}; one thread, CPU time, median of {TURNS} turns taken in rotation"
    return (about, versions(("phfmu", "numpy", "scipy", "scikit-sundae")))


def event_peers() -> PageBlock:
    """Largest error of an event time, energy error over H at the start, CPU time of a run with its books."""
    rows = []
    for name, found in measured().items():
        for e in sorted(found, key=lambda e: e.method.startswith("phfmu"), reverse=True):
            rows.append([name, e.method, e.setting, e.late, e.energy, f"{1e3 * median(e.spent):.2f}"])
    return table(["scene", "method", "setting", "event times, s", "energy / H", "CPU, ms"], rows, notes=notes())


def event_peers_equal() -> PageBlock:
    """Least CPU time (ms) at which all event times are within a level, and the energy error over H there."""
    rows = []
    for name, found in measured().items():
        kinds = {"phfmu": "phfmu", "SciPy": "SciPy", "SUNDIALS": "SUNDIALS CVODE"}
        for level in LEVELS:
            cells = []
            for kind in kinds:
                good = [e for e in found if e.method.startswith(kind) and e.late <= level]
                best = min(good, key=lambda e: median(e.spent), default=None)
                cells.append(f"{1e3 * median(best.spent):.2f} ({best.energy:.0e})" if best else "not reached")
            rows.append([name, f"{level:g}", *cells])
    return table(["scene", "event times within, s", "phfmu", "SciPy", "SUNDIALS CVODE"], rows)
