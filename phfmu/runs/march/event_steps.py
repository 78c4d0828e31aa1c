"""Steps that end on the zeros of guards too, where state events happen: equal ones, or within a tolerance."""

from __future__ import annotations

from collections.abc import Generator, Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.record import Grid
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.network.couplings.stepper import Landing
from phfmu.outcome.limits import LIMITS, defined
from phfmu.outcome.status import StepFailure
from phfmu.outcome.steps import StepEvent
from phfmu.runs.book import Book
from phfmu.runs.march.march import BlockSize, MarchPosition, blocks_of_goals, next_goal, nowhere, pieces, step_rows
from phfmu.runs.march.restart import Restart
from phfmu.runs.march.ringing import Ringing
from phfmu.runs.march.stretches import Stretch
from phfmu.runs.options import Options
from phfmu.runs.rows import RowBlock, RowBlocks

if TYPE_CHECKING:
    from phfmu.network.couplings.coupled import Coupled
    from phfmu.runs.march.native_march import NativeMarch

Array = NDArray[Any]

EPS = float(np.finfo(float).eps)
CROWD = int(defined(Path(__file__).parent / "runtime" / "march.h")["CROWD"])


class LandingBook:
    """Books landed steps and what happens at their end; their rows, with one before and one after each event."""

    def __init__(self, stepper: Monolithic | Coupled, book: Book, ringing: Ringing | None = None):
        self.stepper, self.book, self._ringing = stepper, book, ringing
        #: when the last event of the last rows happened, None without one
        self.event: float | None = None

    def rows(self, parts: Iterable[Landing], also: float = 0.0, *, damped: bool = False) -> RowBlocks:
        """RowBlocks of the parts that `land` of the stepper yields; `also`: iterations of trials, booked with the first step."""
        self.event = None
        try:
            for begun, size, steps, happened in parts:
                if steps is not None:
                    if also and steps.iterations is not None:
                        steps = replace(steps, iterations=steps.iterations + np.eye(1, len(size))[0] * also)
                    also = 0.0
                    self.book.add(begun, size, steps)
                    if self._ringing is not None:
                        self._ringing.add(steps, damped)
                    yield step_rows(begun, begun + size, steps)
                if happened is not None:
                    yield self._happened(*happened)
        except StepFailure as failure:
            self.book.failed(failure)
            raise

    def _happened(self, e: StepEvent, row: Array) -> RowBlock:
        """Books it; the row after it."""
        self.event = e.t
        self.book.happened(e)
        if self._ringing is not None:
            self._ringing.happened(e.t, e.names)
        if not self.book.as_near(row):
            self.stepper.check_start()
        return np.array([e.t]), row[None], np.zeros(1, bool)


class EventSteps:
    """Grid steps of a model with state events, or of members that land together.

    With restart steps the rest of a step with an event and the `restart` steps after it are taken with damping.
    """

    CARRIED = ("place", "pace", "_ringing", "_damped")

    def __init__(self, stepper: Monolithic | Coupled, book: Book, options: Options):
        #: where it is, and what is called there between two blocks
        self.place, self.between_blocks = MarchPosition(), nowhere
        _require_fit(options)
        self.stepper, self.step, self.restart = stepper, options.step, options.restart
        self._ringing = Ringing(stepper, options.step, self.restart)
        self._landing_book, self.pace = LandingBook(stepper, book, self._ringing), BlockSize()
        self._damped = Restart(stepper) if self.restart else None

    def takes_inputs(self, name: str) -> bool:
        """Stretches end where an input changes."""
        return False

    def over(self, stretch: Stretch, event: bool) -> RowBlocks:
        """The rows in (start, end]; `event`: something changed at the start."""
        self._ringing.changed(stretch)
        self.place = MarchPosition(left=self.restart if event else 0, changed=True)
        return self.on(stretch)

    def on(self, stretch: Stretch) -> RowBlocks:
        """The rows from its place on."""
        begun = self.place
        changed, left = begun.changed, begun.left
        for piece, (t, h, n) in enumerate(pieces(stretch.start, stretch.end, self.step)):
            if piece < begun.piece:
                continue
            first = begun.first if piece == begun.piece else 0
            while first < n:
                self.place = MarchPosition(piece, first, left, changed)
                self.between_blocks()
                grid = Grid(t, h, self._ringing.block(min(self.pace.steps, n - first)), first)
                if self._damped is None:
                    yield from self._landing_book.rows(self.stepper.land(t, h, grid.n, first, changed))
                    taken = grid.n
                else:
                    taken, left = yield from self._restarting(self._damped, grid, changed, left)
                first, changed = first + taken, False
                self.pace.handed_over(taken)

    def _restarting(
        self, damped: Restart, grid: Grid, changed: bool, left: int
    ) -> Generator[RowBlock, None, tuple[int, int]]:
        """One damped step if some are `left` to take, else exact ones up to an event and a damped rest of the step with it.

        Grid steps that were taken, and damped ones that are left after them.
        """
        if left:
            yield from self._landing_book.rows(damped.land(grid.start(0), grid.h, changed), damped=True)
            return 1, left - 1 if self._landing_book.event is None else self.restart
        own = damped.stepper
        yield from self._landing_book.rows(own.landed(own.instance, replace(grid, pause=True), changed))
        if (t := self._landing_book.event) is None:
            return grid.n, 0
        over, rest = _place(grid, t)
        if rest:
            yield from self._landing_book.rows(damped.land(t, rest), damped=True)
            over += 1
        return over, self.restart

    def facts(self) -> dict[str, Any]:
        """Facts about the steps for the result."""
        return {"restarted": self._damped.taken} if self._damped else {}

    def notes(self) -> list[str]:
        """Notes of what was not as asked for, one line each."""
        return (self._damped.notes() if self._damped else []) + self._ringing.notes()


class AdaptiveEventSteps:
    """Steps within a tolerance that end on events too.

    A step is sized as without events.  Where one happens in it the step ends there: it is shorter than what was accepted and
    needs no estimate, and the next one starts from there with the same size.  After `CROWD` steps in a row with events a
    step is landed whole, with all of its events, so that those that pile up come to rest.  Compiled code marches where it can.
    """

    CARRIED = ("place", "pace", "_adaptive", "_march", "_damped", "_crowd")

    def __init__(self, stepper: Monolithic, book: Book, options: Options):
        from phfmu.runs.march.adaptive import Adaptive

        _require_fit(options)
        #: where it is, and what is called there between two blocks
        self.place, self.between_blocks = MarchPosition(), nowhere
        assert options.rtol is not None
        self.stepper, self.book, self.landing, self.restart = stepper, book, options.landing, options.restart
        self._landing_book, self._adaptive = LandingBook(stepper, book), Adaptive(stepper, options, options.rtol)
        damps = self.restart > 0 and not stepper.model.loses_energy
        self._damped = Restart(stepper, companion=self._adaptive.other) if damps else None
        self._march, self.pace, self._crowd = self._adaptive.march(pauses=damps), BlockSize(), 0

    def takes_inputs(self, name: str) -> bool:
        """Steps of any length stop where an input changes."""
        return False

    def over(self, stretch: Stretch, event: bool) -> RowBlocks:
        """The rows in (start, end]; `event`: something changed at the start."""
        t, left, self._crowd = stretch.start, self.restart if event else 0, 0
        if self._march is not None:
            self._march.crowd = 0
        yield from self._landing_book.rows(self.stepper.land(t, 0.0, 1))  # what happens at once
        left = left if self._landing_book.event is None else self.restart
        self._adaptive.after_event()
        self.place = MarchPosition(t=t, left=left)
        yield from self.on(stretch)

    def on(self, stretch: Stretch) -> RowBlocks:
        """The rows from its place on."""
        t, left = self.place.t, self.place.left
        for ahead in blocks_of_goals(stretch.start, stretch.end, self.landing):
            while t < ahead[-1]:
                if self._march is None or not self._march.unfinished:
                    self.place = MarchPosition(t=t, left=left)
                    self.between_blocks()
                if self._march is None or (left and self._damped is not None):
                    t = yield from self._one(t, next_goal(ahead, t), left > 0)
                    left = max(left - 1, 0)
                else:
                    t = yield from self._many(self._march, t, ahead)
                left = left if self._landing_book.event is None else self.restart

    def _many(self, march: NativeMarch, t: float, ahead: Array) -> Generator[RowBlock, None, float]:
        """Steps of compiled code; where they end."""
        own, room, taken = self.stepper.instance, 1 if self.pace.counts else self.pace.steps, 0
        before = self.stepper.row_before(own)
        parts = self.stepper.landings(own, before, march.land(t, ahead, room))
        for row in self._landing_book.rows(parts):
            taken += len(row[0])
            yield row
        self.pace.handed_over(max(taken, 1), 0 if march.unfinished else 1)
        return march.t

    def _one(self, t: float, goal: float, damped: bool) -> Generator[RowBlock, None, float]:
        """One step, sized and landed; where it ends."""
        try:
            h, end, spent = self._adaptive.sized(t, goal)
        except StepFailure as failure:
            self.book.failed(failure)
            raise
        pause, n = self._crowd < CROWD, self._adaptive.parts
        if damped and self._damped is not None:
            parts = self._damped.land(t, h, pause=pause)
        else:
            parts = self.stepper.landed(self.stepper.instance, Grid(t, h / n, n, pause=pause), False)
        yield from self._landing_book.rows(parts, spent)
        self.pace.count(1)
        found = self._landing_book.event
        if not pause or found is None or found >= end:
            self._crowd = 0
            return end
        self._crowd += 1
        self._adaptive.after_event()
        return found

    def facts(self) -> dict[str, Any]:
        """Facts about the steps for the result."""
        return self._adaptive.facts() | ({"restarted": self._damped.taken} if self._damped else {})

    def notes(self) -> list[str]:
        """Notes of what was not as asked for, one line each."""
        return self._damped.notes() if self._damped else []


def _place(grid: Grid, t: float) -> tuple[int, float]:
    """Grid steps that are over at the time t, and what is left of the one under way, 0 for nothing."""
    over = int((t - grid.start(0)) // grid.h)
    for k in (over, over + 1):
        if abs(grid.start(k) - t) <= LIMITS["REST_OF_STEP"] * EPS * max(abs(t), abs(grid.start(k))):
            return k, 0.0
    return over, grid.start(over + 1) - t


def _require_fit(options: Options) -> None:
    """Raise ValueError for options that state events do not go with."""
    if options.by_energy:
        which = "--energy-rtol" if options.ecco is None else "--ecco"
        raise ValueError(f"{which} does not go with state events yet; leave it out")
