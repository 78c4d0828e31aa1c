"""Steps that end on the zeros of guards too, where state events happen: equal ones, or within a tolerance."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.landing.locate import EPS
from phfmu.engine.record import Grid
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.network.couplings.stepper import Landing
from phfmu.outcome.limits import LIMITS
from phfmu.outcome.status import StepFailure
from phfmu.outcome.steps import StepEvent
from phfmu.runs.book import Book
from phfmu.runs.march import Pace, goals, pieces, step_rows
from phfmu.runs.options import Options
from phfmu.runs.restart import Restart
from phfmu.runs.ringing import Ringing
from phfmu.runs.rows import Row
from phfmu.runs.stretches import Stretch

if TYPE_CHECKING:
    from phfmu.network.couplings.coupled import Coupled

Array = NDArray[Any]
Rows = Iterator[Row]

CROWD = 3


class Booked:
    """Books landed steps and what happens at their end; their rows, with one before and one after each event."""

    def __init__(self, stepper: Monolithic | Coupled, book: Book, ringing: Ringing | None = None):
        self.stepper, self.book, self._ringing = stepper, book, ringing
        #: when the last event of the last rows happened, None without one
        self.event: float | None = None

    def rows(self, parts: Iterable[Landing], also: float = 0.0, *, damped: bool = False) -> Rows:
        """Rows of the parts that `land` of the stepper yields; `also`: iterations of trials, booked with the first step."""
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

    def _happened(self, e: StepEvent, row: Array) -> Row:
        """Books it; the row after it."""
        self.event = e.t
        self.book.happened(e)
        if self._ringing is not None:
            self._ringing.happened(e.t, e.names)
        self.stepper.check_start()
        return np.array([e.t]), row[None], np.zeros(1, bool)


class EventSteps:
    """Grid steps of a model with state events, or of members that land together.

    With restart steps the rest of a step with an event and the `restart` steps after it are taken with damping.
    """

    def __init__(self, stepper: Monolithic | Coupled, book: Book, options: Options):
        _require_fit(options)
        self.stepper, self.step, self.restart = stepper, options.step, options.restart
        self._ringing = Ringing(stepper, options.step, self.restart)
        self._booked, self._pace = Booked(stepper, book, self._ringing), Pace()
        self._damped = Restart(stepper) if self.restart else None

    def takes_inputs(self, name: str) -> bool:
        """Stretches end where an input changes."""
        return False

    def over(self, stretch: Stretch, event: bool) -> Rows:
        """The rows in (start, end]; `event`: something changed at the start."""
        changed, left = True, self.restart if event else 0
        self._ringing.changed(stretch)
        for t, h, n in pieces(stretch.start, stretch.end, self.step):
            first = 0
            while first < n:
                grid = Grid(t, h, self._ringing.block(min(self._pace.steps, n - first)), first)
                if self._damped is None:
                    yield from self._booked.rows(self.stepper.land(t, h, grid.n, first, changed))
                    taken = grid.n
                else:
                    taken, left = yield from self._restarting(self._damped, grid, changed, left)
                first, changed = first + taken, False
                self._pace.handed_over(taken)

    def _restarting(
        self, damped: Restart, grid: Grid, changed: bool, left: int
    ) -> Generator[Row, None, tuple[int, int]]:
        """One damped step if some are `left` to take, else exact ones up to an event and a damped rest of the step with it.

        Grid steps that were taken, and damped ones that are left after them.
        """
        if left:
            yield from self._booked.rows(damped.land(grid.start(0), grid.h, changed), damped=True)
            return 1, left - 1 if self._booked.event is None else self.restart
        own = damped.stepper
        yield from self._booked.rows(own.landed(own.instance, replace(grid, pause=True), changed))
        if (t := self._booked.event) is None:
            return grid.n, 0
        over, rest = _place(grid, t)
        if rest:
            yield from self._booked.rows(damped.land(t, rest), damped=True)
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
    step is landed whole, with all of its events, so that those that pile up come to rest.
    """

    def __init__(self, stepper: Monolithic, book: Book, options: Options):
        from phfmu.runs.adaptive import Adaptive

        _require_fit(options)
        assert options.rtol is not None
        self.stepper, self.book, self.landing, self.restart = stepper, book, options.landing, options.restart
        self._booked, self._adaptive = Booked(stepper, book), Adaptive(stepper, options, options.rtol)
        damps = self.restart > 0 and not stepper.model.loses_energy
        self._damped = Restart(stepper, companion=self._adaptive.other) if damps else None

    def takes_inputs(self, name: str) -> bool:
        """Steps of any length stop where an input changes."""
        return False

    def over(self, stretch: Stretch, event: bool) -> Rows:
        """The rows in (start, end]; `event`: something changed at the start."""
        t, crowd, left = stretch.start, 0, self.restart if event else 0
        yield from self._booked.rows(self.stepper.land(t, 0.0, 1))  # what happens at once
        left = left if self._booked.event is None else self.restart
        self._adaptive.after_event()
        for goal in goals(stretch.start, stretch.end, self.landing):
            while t < goal:
                before = self.stepper.instance.get_state()
                try:
                    end, spent = self._adaptive.sized(t, goal)
                except StepFailure as failure:
                    self.book.failed(failure)
                    raise
                self.stepper.instance.restore(before)
                first = self._first(t, end)
                self.stepper.instance.restore(before)
                end, crowd = (end, 0) if first is None or crowd == CROWD else (first, crowd + 1)
                if left and self._damped is not None:
                    parts = self._damped.land(t, end - t)
                else:
                    parts = self.stepper.land(t, end - t, 1, 0, False)
                yield from self._booked.rows(parts, spent)
                left = max(left - 1, 0) if self._booked.event is None else self.restart
                if first is not None:
                    self._adaptive.after_event()
                t = end

    def _first(self, t: float, end: float) -> float | None:
        """When something happens first in the step, None for nothing; as far as it does not fail."""
        try:
            parts = self.stepper.land(t, end - t, 1, 0, False)
            return next((p[3][0].t for p in parts if p[3] is not None and t < p[3][0].t < end), None)
        except StepFailure:
            return None

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
    """ValueError for options that state events do not go with."""
    if options.ecco is not None:
        raise ValueError("--ecco does not go with state events yet; leave it out")
