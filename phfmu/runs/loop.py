"""The run loop: from event to event, result rows, and the audit while running."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from phfmu.declare.phdae import PHDAE
from phfmu.network.couplings.stepper import Stepper
from phfmu.network.members.inputs import with_bare
from phfmu.network.network import Network
from phfmu.network.scene import Event, Scene
from phfmu.outcome.status import EndRequested, StepFailure
from phfmu.runs.book import Book
from phfmu.runs.checkpoints import RunState, require_continued
from phfmu.runs.inputs.following import following
from phfmu.runs.march.event_steps import AdaptiveEventSteps, EventSteps
from phfmu.runs.march.march import AdaptiveSteps, FixedSteps, step_rows
from phfmu.runs.march.restart import monolithic
from phfmu.runs.march.stretches import Stretch, stretches
from phfmu.runs.options import Options
from phfmu.runs.result import Result
from phfmu.runs.rows import RowBlocks, RowCollector, RunColumns
from phfmu.words import counted

if TYPE_CHECKING:
    from phfmu.discretise.start import Projection
    from phfmu.engine.rest_changes import RestChange


def run(stepper: Stepper, options: Options, *, inputs: Any = None, interpolate: str = "held") -> Result:
    """Run from t0 to stop; returns all rows (first row: the start).

    inputs: values over time, a mapping or table of columns `time` and names that can be set, or a .csv or .parquet file;
    interpolate: "held", each row until the next one, "linear" or "cubic", free inputs at the nodes of each step between rows
    (see `docs/use/drive-inputs.md`); one composed model only.
    Errors: KeyError for events on names that cannot be set; ValueError for options that need one composed model;
    InconsistentState; StepFailure (audit written so far stays readable); DeclarationError where restart or adaptive steps do not
    fit; ToleranceMissed
    """
    _require_stepper(stepper)
    with following(stepper, options, inputs, interpolate) as (events, notes):
        return _run(stepper, options, events, notes)


def _run(stepper: Stepper, options: Options, events: Callable[..., Iterator[Event]], notes: Sequence[str]) -> Result:
    """With the inputs in place; `events`: in order, all or from a time on; `notes`: what there is to say about the inputs."""
    from phfmu.audit import Ledger
    from phfmu.audit.null_ledger import NullLedger

    _check_events(stepper, options)
    ledger = Ledger(options.sink, options.audit_rtol) if options.audited else NullLedger()
    told = RunColumns(stepper, options.signals, options.step)
    if options.columns is not None:
        options.columns(told.names, told.units, told.kinds, told.labels)
    book, rows = Book(stepper, ledger, options.happened), RowCollector(options)
    march = _march(stepper, book, options)
    if options.hash_states:
        _hash_states(stepper, book, march, options)
    state = RunState(stepper=stepper, book=book, ledger=ledger, rows=rows, columns=told, march=march)
    state.start = None, stepper.rest_changes()
    found = _kept(stepper, march, state, options)
    t0, stop, close = options.t0, options.stop, 1e-9 * options.step
    try:
        with dense_rows(stepper, options.dense):
            grid = stretches(lambda: segments(t0, stop, events(), close), options.step, march.takes_inputs)
            for state.stretch, stretch in enumerate(grid):
                if found is not None and state.stretch < found["stretch"]:
                    continue
                if found is not None and state.stretch == found["stretch"]:
                    march_rows = _resumed(state, found, told, march, stretch)
                elif stretch.start == t0:
                    state.start = _begin(stepper, book, options, stretch.events, stretch.end), state.start[1]
                    told.begin(stretch)
                    start = np.array([t0])
                    rows.take(start, told.rows(start, stepper.read()[None], after=True), np.zeros(1, bool))
                    march_rows = march.over(stretch, False)
                else:
                    for e in stretch.events:
                        book.set_value(e)
                    told.begin(stretch)
                    march_rows = march.over(stretch, True)
                for time, values, inside in march_rows:
                    rows.take(time, told.rows(time, values), inside)
    except EndRequested as end:
        book.notes.append(_ended(stepper, book, rows, told, end))
        stop = rows.last
    except KeyboardInterrupt:
        ledger.event(rows.last, "interrupted")
        raise
    finally:
        ledger.flush()
    rows.end()
    projection, before = state.start
    time, values, inside = rows.joined(len(told.names))
    facts = march.facts()
    if options.dense is not None:
        facts["interpolated"] = inside
    own = (*book.notes, *book.told(), *march.notes(), *stepper.notes(), *_rest_notes(before, stepper.rest_changes()))
    said = (*notes, *_unreached(events(stop - close), stop), *own)
    return Result(
        told.names, time, values, told.units, ledger, book.steps, book.iterations, book.worst(), projection, notes=said,
        least={c: (t, dict(zip(stepper.names, row.tolist(), strict=True))) for c, (t, row) in book.least.items()},
        kinds=told.kinds, labels=told.labels, **facts,
    )  # fmt: skip


def _hash_states(stepper: Stepper, book: Book, march: Any, options: Options) -> None:
    """Has hashes of states written to the audit; ValueError where there is no file for them."""
    if not hasattr(options.sink, "write_states"):
        raise ValueError(f"--hash-states {options.hash_states} writes to the audit; give --audit FILE, or leave it out")
    from phfmu.runs.state_hashes import StateHashes

    StateHashes(stepper, book, march, options)


def _kept(stepper: Stepper, march: Any, state: RunState, options: Options) -> Mapping[str, Any] | None:
    """Checkpoint of the run that this one goes on with, if any; the march is made to tell when it is between two blocks."""
    if options.checkpoints is None:
        return None
    require_continued(stepper)
    march.between_blocks = partial(options.checkpoints.between_blocks, state.now)
    return options.checkpoints.found


def _resumed(state: RunState, found: Mapping[str, Any], told: RunColumns, march: Any, stretch: Stretch) -> RowBlocks:
    """The rows of the stretch that the checkpoint `found` lies in, from there on."""
    state.start = found["start"]
    state.take(found, "stepper")
    told.begin(stretch)
    state.take(found, "book", "ledger", "rows", "columns", "march")
    return march.on(stretch)


def _ended(stepper: Stepper, book: Book, rows: RowCollector, told: RunColumns, end: EndRequested) -> str:
    """The last row of a run that a unit asks to end, up to where it asks; a line about it."""
    steps = end.last
    if steps is None and end.back and end.reached > end.time:
        try:
            steps = stepper.advance(end.time, end.reached - end.time, 1)
        except StepFailure as failure:
            steps = failure.recorded.get("steps")
    if steps is not None:
        begun, reached = np.array([end.time]), np.array([end.reached])
        book.add(begun, reached - begun, steps)
        time, values, inside = step_rows(begun, reached, steps)
        rows.take(time, told.rows(time, values), inside)
    return f"{end}; the run ends at {rows.last:.9g} s"


def _march(
    stepper: Stepper, book: Book, options: Options
) -> FixedSteps | AdaptiveSteps | EventSteps | AdaptiveEventSteps:
    """The steps that get the run from event to event."""
    if stepper.lands and options.adaptive:
        return AdaptiveEventSteps(monolithic(stepper, "--rtol"), book, options)
    if stepper.lands:
        return EventSteps(stepper, book, options)  # pyright: ignore[reportArgumentType]
    return AdaptiveSteps(stepper, book, options) if options.adaptive else FixedSteps(stepper, book, options)


def _begin(stepper: Stepper, book: Book, options: Options, events: Sequence[Event], end: float) -> Projection | None:
    """The start: its events, on its constraints; how it was projected. `end`: of the first stretch."""
    for e in events:
        stepper.set_value(e.name, e.value)
    projection = book.project(options.t0, options.kept) if options.project else None
    stepper.check_start()
    stepper.prepare(options.t0, min(options.step, end - options.t0))
    book.start()
    return projection


@contextmanager
def dense_rows(stepper: Stepper, rows: int | None) -> Iterator[None]:
    """The stepper makes `rows` rows within each step too, until the end of the block."""
    if rows is None:
        yield
        return
    from phfmu.runs.dense import DenseOutput

    whole = monolithic(stepper, "--dense")
    whole.between = DenseOutput(whole.instance, rows).between
    try:
        yield
    finally:
        whole.between = None


def segments(
    t0: float, stop: float, events: Iterable[Event], close: float = 0.0
) -> Iterator[tuple[float, float, list[Event]]]:
    """(start, end, events at start) of events in order; the grid of steps starts anew at each.

    Events before t0 have happened: they count at t0, in order of time.  Times within `close` of each other are one.
    """
    start, here = t0, []
    for e in events:
        if e.t >= stop - close:
            break
        if e.t > start + close:
            yield start, e.t, here
            start, here = e.t, []
        here.append(e)
    yield start, stop, here


def _require_stepper(item: object) -> None:
    """Raise TypeError, with the remedy, for an item that only leads to a stepper."""
    if isinstance(item, str | PathLike | PHDAE | Scene | Network):
        name = str(getattr(item, "name", item))[:60]
        remedy = "Monolithic(model, NativeInstance(model)) with model = build_model(declaration)"
        raise TypeError(f"run takes a stepper, got the {type(item).__name__} {name!r}; make one: {remedy}")


def _check_events(stepper: Stepper, options: Options) -> None:
    """Raise KeyError for unknown names, before the first step, of late events too."""
    known = with_bare(stepper.settable())
    for e in (e for e in options.events if e.name not in known):
        try:
            stepper.set_value(e.name, e.value)  # raises with what there is instead
        except ValueError:  # a parameter that is fixed here: no matter where it is not reached
            if e.t < options.stop:
                raise


def _unreached(late: Iterator[Event], stop: float) -> list[str]:
    """A line about the events that come too late."""
    if (e := next(late, None)) is None:
        return []
    others = sum(1 for _ in late)
    more = f" and {others} more" if others else ""
    return [f"not reached before the end at {stop:g} s: {e.name} = {e.value:g} at t = {e.t:g} s{more}"]


def _rest_notes(before: dict[str, list[RestChange]], now: dict[str, list[RestChange]]) -> list[str]:
    """Lines about redundant constraints that rested in a run or were needed again: their number, and the last changes."""
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
