"""The run loop: events, the time grid, result rows, and the audit while running."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phfmu.network.couplings.stepper import Stepper
from phfmu.network.run.book import Book
from phfmu.network.run.march import AdaptiveSteps, FixedSteps, Row, monolithic
from phfmu.network.scene import Event
from phfmu.words import counted

if TYPE_CHECKING:
    from phfmu.audit import Ledger
    from phfmu.discretise.start import Projection
    from phfmu.engine.rest_changes import RestChange
    from phfmu.network.run.adaptive import Control

Array = NDArray[Any]
#: takes (times, values, whether each row lies within a step)
Keep = Callable[[Array, Array, Array], None]


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
    #: component -> time and signals at the end of the step in which it dissipated least, where that was negative
    least: dict[str, tuple[float, Array]] = field(default_factory=dict)

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
    keep: Keep | None = None,
    project: bool = False,
    kept: Sequence[str] = (),
    restart: int = 0,
    rtol: float | None = None,
    atol: float | None = None,
    landing: float = np.inf,
    min_step: float = 0.0,
    max_step: float = np.inf,
    dense: int = 0,
    audit_rtol: float = 1e-11,
) -> Result:
    """Run from t0 to stop; returns all rows (first row: the start).

    With `rtol` steps are as long as |error| <= rtol |x| + atol nominal allows in each of them (atol: as rtol), and within
    [min_step, max_step]; `step` is the first trial, and multiples of `landing` after t0 and each event are landed on.

    restart:  damping steps (Radau IIA) after each event
    dense:  rows within each step, interpolated (see `dense.py`)
    audit_rtol:  allowed residual of the ledger, relative to the energies in play
    sink:  an audit sink (AuditWriter) that gets every ledger row as it is made
    keep:  receives (time, values, whether a row lies within a step) blocks instead of collecting them; also those
        accepted before a failure
    progress:  called with the time after each block; a KeyboardInterrupt from it ends the run there
    project:  move an inconsistent start onto its constraints (booked as the event `reprojection`) instead of refusing it
    kept:  states that the projection leaves as they are
    Errors: ValueError for a bad step or stop; InconsistentState; StepFailure (audit written so far stays readable);
    DeclarationError where restart or adaptive steps do not fit; ToleranceMissed
    """
    from phfmu.audit import Ledger

    _check_times(t0, stop, step)
    _check_events(stepper, events, stop)
    ledger = Ledger(sink, audit_rtol)
    book = Book(stepper, ledger)
    if rtol is None:
        march: Any = FixedSteps(stepper, book, step, restart)
    else:
        march = AdaptiveSteps(stepper, book, restart, landing, _control(rtol, atol, step, min_step, max_step))
    if dense:
        from phfmu.network.run.dense import Dense

        whole = monolithic(stepper, "--dense")
        whole.between = Dense(whole.instance, dense).between
    rows = _Rows(keep, progress)
    first, projection, before = True, None, stepper.rest_changes()
    try:
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
                stepper.prepare(t0, min(step, end - t0))
                book.start()
                rows.take(np.array([t0]), stepper.read()[None], np.zeros(1, bool))
                first = False
            for row in march.over(start, end, start > t0):
                rows.take(*row)
    except KeyboardInterrupt:
        ledger.event(rows.last, "interrupted")
        raise
    finally:
        ledger.flush()
    time, values, inside = rows.joined(len(stepper.names))
    worst, facts = book.worst(), march.facts()
    facts |= {"interpolated": inside} if dense else {}
    rest_notes = _rest_notes(before, stepper.rest_changes())
    notes = (*_unreached(events, stop - 1e-9 * step, stop), *book.notes, *march.notes(), *rest_notes)
    return Result(
        stepper.names,
        time,
        values,
        ledger,
        book.steps,
        book.iterations,
        worst,
        projection,
        notes=notes,
        least=book.least,
        **facts,
    )


def _unreached(events: Sequence[Event], last: float, stop: float) -> list[str]:
    """A line about the events that come too late."""
    late = sorted((e for e in events if e.t >= last), key=lambda e: e.t)
    if not late:
        return []
    e, more = late[0], f" and {len(late) - 1} more" if len(late) > 1 else ""
    return [f"not reached before the end at {stop:g} s: {e.name} = {e.value:g} at t = {e.t:g} s{more}"]


class _Rows:
    """The rows of a run: handed on, or collected."""

    def __init__(self, keep: Keep | None, progress: Callable[[float], None] | None):
        self._keep, self._progress = keep, progress
        self._blocks: list[Row] = []
        self.last = np.nan

    def take(self, time: Array, values: Array, inside: Array) -> None:
        """One block: times (n), values (n x names), whether each row lies within a step (n)."""
        if self._keep is None:
            self._blocks.append((time, values, inside))
        else:
            self._keep(time, values, inside)
        self.last = float(time[-1])
        if self._progress is not None:
            self._progress(self.last)

    def joined(self, width: int) -> Row:
        """All rows that were not handed on."""
        if not self._blocks:
            return np.zeros(0), np.zeros((0, width)), np.zeros(0, bool)
        time, values, inside = (np.concatenate(parts) for parts in zip(*self._blocks, strict=True))
        return time, values, inside


def _check_times(t0: float, stop: float, step: float) -> None:
    if not (np.isfinite(step) and step > 0):
        raise ValueError(f"--step {step} s must be positive and finite")
    if not (np.isfinite(stop) and stop > t0):
        raise ValueError(f"--stop {stop} s must be finite and after the start {t0} s")
    if stop - step == stop:
        raise ValueError(f"--step {step} s is lost in the rounding of times near --stop {stop} s; take a longer one")


def _check_events(stepper: Stepper, events: Sequence[Event], stop: float) -> None:
    """ValueError for numbers that are not finite, KeyError for unknown names, before the first step, of late events too."""
    for e in events:
        if not np.isfinite(e.t) or not np.isfinite(e.value):
            raise ValueError(f"event {e.name} = {e.value} at t = {e.t} s: time and value must be finite")
    names = stepper.settable()
    known = {*names, *(n.partition("[")[0] for n in names)}
    for e in (e for e in events if e.name not in known):
        try:
            stepper.set_value(e.name, e.value)  # raises with what there is instead
        except ValueError:  # a parameter that is fixed here: no matter where it is not reached
            if e.t < stop:
                raise


def _control(rtol: float, atol: float | None, step: float, smallest: float, largest: float) -> Control:
    from phfmu.network.run.adaptive import Control

    return Control(rtol, rtol if atol is None else atol, step, smallest, largest)


def _rest_notes(before: dict[str, list[RestChange]], now: dict[str, list[RestChange]]) -> list[str]:
    """How often other redundant constraints rested in a run or were needed again, and the last of these changes."""
    lines = []
    for name, changes in now.items():
        old = before[name][-1].number if before[name] else 0
        new = [c for c in changes if c.number > old]
        if not new:
            continue
        where = f"{name}: " if name else ""
        many, dropped = new[-1].number - old, new[0].number - old - 1
        last = f", the last {len(new)} of them" if dropped else ""
        lines.append(
            f"{where}redundant constraints: {counted(many, 'change')}{last}; the motion does not depend on which rests"
        )
        lines += [f"{where}{c}" for c in new]
    return lines
