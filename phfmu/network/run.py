"""The run loop: events, the time grid, result rows, and the audit while running."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phfmu.network.book import Book
from phfmu.network.march import AdaptiveSteps, FixedSteps, monolithic
from phfmu.network.scene import Event
from phfmu.network.stepper import Stepper

if TYPE_CHECKING:
    from phfmu.audit import Ledger
    from phfmu.discretise.start import Projection
    from phfmu.network.adaptive import Control

Array = NDArray[Any]


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
    #: steps taken with damping; adaptive runs: rejected trials, smallest and largest step (s)
    restarted: int = 0
    rejected: int = 0
    smallest: float = 0.0
    largest: float = 0.0
    #: whether a row lies within a step (rows), None for a run without such rows
    interpolated: Array | None = None
    #: what the run left out or did beside what was asked for, one line each
    notes: tuple[str, ...] = ()

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
        changed = np.ones(self.values.shape, bool)
        changed[1:] = self.values[1:] != self.values[:-1]
        times, values = self.time.tolist(), self.values.tolist()
        return [Event(times[i], self.names[j], values[i][j]) for i, j in np.argwhere(changed).tolist()]


def segments(
    t0: float, stop: float, events: Sequence[Event], close: float = 0.0
) -> Iterator[tuple[float, float, list[Event]]]:
    """(start, end, events at start) in order; the grid of steps starts anew at each event.

    Events before t0 have happened: they count at t0, in order of time.  Times within `close` of each other are one.
    """
    start, here = t0, []
    for e in sorted(events, key=lambda e: e.t):
        if e.t >= stop - close:
            break
        if e.t > start + close:
            yield start, e.t, here
            start, here = e.t, []
        here.append(e)
    yield start, stop, here


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
    restart: int = 0,
    rtol: float | None = None,
    atol: float | None = None,
    landing: float = np.inf,
    min_step: float = 0.0,
    max_step: float = np.inf,
    dense: int = 0,
) -> Result:
    """Run from t0 to stop; returns all rows (first row: the start).

    With `rtol` steps are as long as |error| <= rtol |x| + atol nominal allows in each of them (atol: as rtol), and within
    [min_step, max_step]; `step` is the first trial, and multiples of `landing` after t0 and each event are landed on.

    restart:  damping steps (Radau IIA) after each event
    dense:  rows within each step, interpolated (see `dense.py`)
    sink:  an audit sink (AuditWriter) that gets every ledger row as it is made
    keep:  receives (time, values) blocks instead of collecting them
    project:  move an inconsistent start onto its constraints (booked as the event `reprojection`) instead of refusing it
    kept:  states that the projection leaves as they are
    Errors: ValueError for a bad step or stop; InconsistentState; StepFailure (audit written so far stays readable);
    DeclarationError where restart or adaptive steps do not fit; ToleranceMissed
    """
    from phfmu.audit import Ledger

    _check_times(t0, stop, step)
    _check_events(stepper, [e for e in events if not e.t >= stop])
    ledger = Ledger(sink)
    book = Book(stepper, ledger)
    if rtol is None:
        march: Any = FixedSteps(stepper, book, step, restart)
    else:
        march = AdaptiveSteps(stepper, book, restart, landing, _control(rtol, atol, step, min_step, max_step))
    if dense:
        from phfmu.network.dense import Dense

        whole = monolithic(stepper, "--dense")
        whole.dense = Dense(whole.instance, dense)
    times: list[Array] = []
    rows: list[Array] = []
    inside: list[Array] = [np.zeros(1, bool)]

    def take(t: Array, v: Array) -> None:
        if keep is not None:
            keep(t, v)
        else:
            times.append(t)
            rows.append(v)

    first, projection = True, None
    for start, end, here in segments(t0, stop, events, close=1e-9 * step):
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
        for ends, values, interpolated in march.over(start, end, start > t0):
            take(ends, values)
            inside.append(interpolated)
            if progress is not None:
                progress(float(ends[-1]))
    ledger.flush()
    time = np.concatenate(times) if times else np.zeros(0)
    values = np.concatenate(rows) if rows else np.zeros((0, len(stepper.names)))
    worst, facts = book.worst(), march.facts()
    facts |= {"interpolated": np.concatenate(inside)} if dense else {}
    notes = (*_unreached(events, stop - 1e-9 * step, stop), *book.notes, *march.notes())
    return Result(
        stepper.names, time, values, ledger, book.steps, book.iterations, worst, projection, notes=notes, **facts
    )


def _unreached(events: Sequence[Event], last: float, stop: float) -> list[str]:
    """A line about the events that come too late."""
    late = sorted((e for e in events if e.t >= last), key=lambda e: e.t)
    if not late:
        return []
    e, more = late[0], f" and {len(late) - 1} more" if len(late) > 1 else ""
    return [f"not reached before the end at {stop:g} s: {e.name} = {e.value:g} at t = {e.t:g} s{more}"]


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


def _control(rtol: float, atol: float | None, step: float, smallest: float, largest: float) -> Control:
    from phfmu.network.adaptive import Control

    return Control(rtol, rtol if atol is None else atol, step, smallest, largest)
