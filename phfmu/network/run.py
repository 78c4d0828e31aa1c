"""The run loop: events, the time grid, result rows, and the audit while running."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.status import StepFailure
from phfmu.network.scene import Event
from phfmu.network.stepper import Booking, InconsistentState, Stepper, Steps

if TYPE_CHECKING:
    from phfmu.audit import Ledger, PortKey
    from phfmu.discretise.start import Projection

Array = NDArray[Any]

BLOCK = 4096  # steps between progress reports and audit flushes


@dataclass
class Result:
    """Rows of a run: `time` (rows), `values` (rows x names); the ledger; step counts; how the start was projected."""

    names: list[str]
    time: Array
    values: Array
    ledger: Ledger
    steps: int
    iterations: float
    worst: dict[str, float] = field(default_factory=dict)
    projection: Projection | None = None

    def column(self, name: str) -> Array:
        """One signal over time; KeyError lists close names."""
        try:
            return self.values[:, self.names.index(name)]
        except ValueError:
            from difflib import get_close_matches

            raise KeyError(f"no signal '{name}'; close: {', '.join(get_close_matches(name, self.names, 5))}") from None


@dataclass(frozen=True)
class HeldInputs:
    """Input rows over time; the last row at or before t holds."""

    names: list[str]
    time: Array
    values: Array

    def events(self) -> list[Event]:
        """One event per changed value; before the first row the start values hold."""
        out = []
        for i, t in enumerate(self.time):
            for j, name in enumerate(self.names):
                if i == 0 or self.values[i, j] != self.values[i - 1, j]:
                    out.append(Event(float(t), name, float(self.values[i, j])))
        return out


def segments(t0: float, stop: float, events: Sequence[Event]) -> Iterator[tuple[float, float, list[Event]]]:
    """(start, end, events at start) in order; the grid of steps starts anew at each event.

    Events before t0 have happened: they count at t0, in order of time.
    """
    times = sorted({t0, stop, *(e.t for e in events if t0 <= e.t < stop)})
    past = sorted((e for e in events if e.t < t0), key=lambda e: e.t)
    for start, end in zip(times[:-1], times[1:], strict=True):
        yield start, end, past + [e for e in events if e.t == start]
        past = []


def pieces(start: float, end: float, h: float) -> Iterator[tuple[float, float, int]]:
    """(t, h, n) runs of equal steps covering [start, end]; the last partial step is taken."""
    n = int(np.floor((end - start) / h * (1 + 1e-12) + 1e-9))
    if n:
        full = abs(start + n * h - end) <= 1e-9 * h
        step = (end - start) / n if full else h
        for first in range(0, n, BLOCK):
            yield start + first * step, step, min(BLOCK, n - first)
        if full:
            return
    yield start + n * h, end - (start + n * h), 1


def run(
    stepper: Stepper,
    *,
    stop: float,
    step: float,
    t0: float = 0.0,
    events: Sequence[Event] = (),
    sink: Any = None,
    progress: Callable[[float], None] | None = None,
    keep: Callable[[Array, Array], None] | None = None,
    project: bool = False,
    kept: Sequence[str] = (),
) -> Result:
    """Run from t0 to stop; returns all rows (first row: the start).

    sink:  an audit sink (AuditWriter) that gets every ledger row as it is made
    keep:  receives (time, values) blocks instead of collecting them
    project:  move an inconsistent start onto its constraints (booked as the event `reprojection`) instead of refusing it
    kept:  states that the projection leaves as they are
    Errors: ValueError for a bad step or stop; InconsistentState; StepFailure (audit written so far stays readable)
    """
    from phfmu.audit import Ledger

    _check_times(t0, stop, step)
    _check_events(stepper, [e for e in events if not e.t >= stop])
    ledger = Ledger(sink)
    book = _Book(stepper, ledger)
    times: list[Array] = []
    rows: list[Array] = []

    def take(t: Array, v: Array) -> None:
        if keep is not None:
            keep(t, v)
        else:
            times.append(t)
            rows.append(v)

    first, projection = True, None
    for start, end, here in segments(t0, stop, events):
        for e in here:
            if first:
                stepper.set_value(e.name, e.value)
            else:
                book.set_value(e)
        if first:
            if project:
                projection = book.project(t0, kept)
            stepper.check_start()
            prepare = getattr(stepper, "prepare", None)
            if prepare is not None:
                prepare(t0, min(step, end - t0))
            book.start()
            take(np.array([t0]), stepper.read()[None])
            first = False
        for t, h, n in pieces(start, end, step):
            steps = book.advance(t, h, n)
            take(t + h * np.arange(1, n + 1), steps.signals)
            if progress is not None:
                progress(t + n * h)
    ledger.flush()
    time = np.concatenate(times) if times else np.zeros(0)
    values = np.concatenate(rows) if rows else np.zeros((0, len(stepper.names)))
    return Result(stepper.names, time, values, ledger, book.steps, book.iterations, book.worst(), projection)


def _check_times(t0: float, stop: float, step: float) -> None:
    if not (np.isfinite(step) and step > 0):
        raise ValueError(f"--step {step} s must be positive and finite")
    if not (np.isfinite(stop) and stop > t0):
        raise ValueError(f"--stop {stop} s must be finite and after the start {t0} s")
    if stop - step == stop:
        raise ValueError(f"--step {step} s is lost in the rounding of times near --stop {stop} s; take a longer one")


def _check_events(stepper: Stepper, events: Sequence[Event]) -> None:
    """ValueError for numbers that are not finite, KeyError for unknown names, before the first step."""
    for e in events:
        if not np.isfinite(e.t) or not np.isfinite(e.value):
            raise ValueError(f"event {e.name} = {e.value} at t = {e.t} s: time and value must be finite")
    names = stepper.settable()
    known = {*names, *(n.partition("[")[0] for n in names)}
    for e in events:
        if e.name not in known:
            stepper.set_value(e.name, e.value)  # raises with what there is instead


class _Book:
    """Books the steps of a stepper in a ledger and watches the hidden constraints."""

    def __init__(self, stepper: Stepper, ledger: Ledger):
        from phfmu.audit import Layout

        self.stepper, self.ledger = stepper, ledger
        b = stepper.booking
        self.layout = Layout(b.components, tuple(self._key(*pair, b) for pair in b.pairs))
        self._owners = np.array([[float(c == name) for name in b.components] for c, *_ in b.pairs])
        self._owners = self._owners.reshape(len(b.pairs), len(b.components))
        self.steps, self.iterations = 0, 0.0
        self._watch = [(n, i) for i, n in enumerate(stepper.names) if n.startswith("constraint.")]
        self._worst = dict.fromkeys((n for n, _ in self._watch), 0.0)
        self._H = np.zeros(0)

    @staticmethod
    def _key(component: str, port: str, index: int | None, junction: str | None, b: Booking) -> PortKey:
        from phfmu.audit import PortKey

        quality = "estimated" if component in b.estimated else "exact"
        return PortKey(component, port, index, junction, quality=quality)

    def start(self) -> None:
        self._H = self.stepper.energies()

    def set_value(self, e: Event) -> None:
        """Set an event's value and book the energy that a changed parameter makes or takes."""
        self.stepper.set_value(e.name, e.value)
        message, now = f"{e.name} = {e.value:.9g}", self.stepper.energies()
        changed = [(c, float(d)) for c, d in zip(self.layout.components, now - self._H, strict=True) if d]
        for component, jump in changed:
            self.ledger.event(e.t, "parameter", component, jump, message)
        if not changed:
            self.ledger.event(e.t, "input", message=message)
        self._H = now
        if changed:
            self._keep_consistent(e.t)

    def _keep_consistent(self, t: float) -> None:
        """A parameter that enters a hidden constraint (an inductance at a node) makes the state jump as by an impulse."""
        try:
            self.stepper.check_start()
        except InconsistentState:
            self.project(t, ())
            self.stepper.check_start()
            self._H = self.stepper.energies()

    def project(self, t0: float, kept: Sequence[str]) -> Projection | None:
        """Move the start onto its constraints; the energy change is an event."""
        found = self.stepper.project_start(t0, kept)
        if found is not None and found.moved:
            moved = ", ".join(f"{n} {a:.6g} -> {b:.6g}" for n, a, b in found.moved)
            self.ledger.event(t0, "reprojection", None, found.energy, moved)
        return found

    def advance(self, t: float, h: float, n: int) -> Steps:
        try:
            steps = self.stepper.advance(t, h, n)
        except StepFailure as failure:
            if "steps" in failure.recorded:
                self._add(t, h, failure.recorded["steps"])
            self.ledger.event(failure.time, "nonconverged", failure.component, message=str(failure))
            self.ledger.flush()
            raise
        self._add(t, h, steps)
        return steps

    def _add(self, t: float, h: float, s: Steps) -> None:
        n = len(s.H)
        k = self.steps + np.arange(n)
        before = np.vstack([self._H[None], s.H[:-1]])
        self._H = s.H[-1]
        # a lossless junction of large powers has supplied = 0: its scale is what passes through its ports
        scale = np.maximum(np.abs(before), np.abs(s.H)) + np.abs(s.pairs) @ self._owners
        newton = np.repeat(s.iterations.astype(int)[:, None], len(self.layout.components), axis=1)
        self.ledger.add_block(
            self.layout, k, t + h * np.arange(n), h, s.H, s.stored, s.dissipated, s.supplied, s.pairs, H0=before,
            scale=scale, newton=newton,
        )  # fmt: skip
        self.steps += n
        self.iterations += float(s.iterations.sum())
        for name, i in self._watch:
            self._worst[name] = max(self._worst[name], float(np.max(np.abs(s.signals[:, i]))))

    def worst(self) -> dict[str, float]:
        return self._worst
