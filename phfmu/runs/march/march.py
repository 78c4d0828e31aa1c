"""Steps from event to event of a run: equal ones, or steps that keep a tolerance; either with restart steps.

Rows are handed over in blocks: what is on its way to the audit and the result file is at most `BLOCK_SECONDS` old.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phfmu.interrupt import Interrupted
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.network.couplings.stepper import Stepper
from phfmu.network.scene import Event
from phfmu.outcome.status import StepFailure
from phfmu.outcome.steps import Steps
from phfmu.runs.book import Book
from phfmu.runs.march.restart import Restart, monolithic, not_damped, require_fit
from phfmu.runs.march.ringing import Ringing
from phfmu.runs.march.stretches import Stretch
from phfmu.runs.options import Options
from phfmu.runs.rows import RowBlock, RowBlocks

if TYPE_CHECKING:
    from phfmu.runs.march.adaptive import Adaptive
    from phfmu.runs.march.energy_steps import EnergySteps
    from phfmu.runs.march.native_march import NativeMarch

Array = NDArray[Any]

BLOCK = 4096  # most steps of a block
BLOCK_SECONDS = 0.25  # wall time that a block should take
GROWTH = 64  # most that a block may have more steps than the one before it


def pieces(start: float, end: float, h: float) -> Iterator[tuple[float, float, int]]:
    """(t, h, n) runs of equal steps covering [start, end]; the last partial step is taken."""
    n = int(np.floor((end - start) / h * (1 + 1e-12) + 1e-9))
    if n:
        full = abs(start + n * h - end) <= 1e-9 * h
        yield start, (end - start) / n if full else h, n
        if full:
            return
    yield start + n * h, end - (start + n * h), 1


def goals(start: float, end: float, landing: float) -> Iterator[float]:
    """Times in (start, end] that steps land on: multiples of `landing` after the start, and the end."""
    if not np.isfinite(landing):
        yield end
        return
    for t, h, n in pieces(start, end, landing):
        for i in range(1, n + 1):
            goal = t + i * h
            yield end if abs(goal - end) <= 1e-9 * h else goal


def blocks_of_goals(start: float, end: float, landing: float) -> Iterator[Array]:
    """The times of `goals` in arrays of at most `BLOCK`."""
    remaining = goals(start, end, landing)
    while block := list(islice(remaining, BLOCK)):
        yield np.array(block)


def next_goal(ahead: Array, t: float) -> float:
    """The first of the times `ahead` after t."""
    return float(ahead[np.searchsorted(ahead, t, side="right")])


@dataclass(frozen=True)
class MarchPosition:
    """Position of a march in a stretch, between two blocks of rows.

    piece, first: the next step is `first` of the grid number `piece`;  t: it starts then (s), where steps have any length
    left: damped steps that are still to be taken;  changed: something was set since the last step
    """

    piece: int = 0
    first: int = 0
    left: int = 0
    changed: bool = False
    t: float = 0.0


def nowhere() -> None:
    """Do nothing between two blocks, where nobody asks for a checkpoint."""


class BlockSize:
    """Number of steps of a block, after which rows are handed over, from the wall time that steps took.

    Where something is to be done each so many steps, whatever the time, blocks end there.
    """

    CARRIED = ("_count",)

    def __init__(self) -> None:
        self._steps, self._since = 1, perf_counter()
        self._each, self._do, self._count = 0, nowhere, 0

    def each(self, steps: int, do: Callable[[], None]) -> None:
        """Has `do` called each so many steps."""
        self._each, self._do = steps, do

    @property
    def counts(self) -> bool:
        """Whether something is done each so many steps."""
        return self._each > 0

    @property
    def steps(self) -> int:
        """Steps of the next block."""
        return min(self._steps, self._each - self._count) if self._each else self._steps

    def full(self, taken: int) -> bool:
        """Whether the steps since the last rows fill a block."""
        return taken >= BLOCK or perf_counter() - self._since >= BLOCK_SECONDS

    def handed_over(self, taken: int, counted: int | None = None) -> None:
        """After `taken` steps with all that was done with their rows; `counted`: where other than these count."""
        now = perf_counter()
        fit = int(BLOCK_SECONDS * taken / max(now - self._since, 1e-9))
        self._steps = max(1, min(fit, GROWTH * taken, BLOCK))
        self._since = now
        self.count(taken if counted is None else counted)

    def count(self, taken: int) -> None:
        """After so many steps, all that belongs to them being done."""
        self._count += taken
        if self._each and self._count >= self._each:
            self._count = 0
            self._do()


class FixedSteps:
    """Equal steps; the first `restart` ones after an event with damping, also after one inside the step of a member."""

    CARRIED = ("place", "pace", "_cut", "_longest", "_happened", "_damped", "_ringing")

    def __init__(self, stepper: Stepper, book: Book, options: Options):
        #: where it is, and what is called there between two blocks
        self.place, self.between_blocks = MarchPosition(), nowhere
        self.stepper, self.book, self.step, self.restart = stepper, book, options.step, options.restart
        self._damped = Restart(stepper) if self.restart else None
        self._alone = self._damped is not None and self._damped.events_inside
        self._cut: list[float] = []
        self.pace = BlockSize()
        self._longest, self._happened = 0.0, False
        self._ringing = Ringing(stepper, options.step, self.restart)

    def takes_inputs(self, name: str) -> bool:
        """Whether the steps of one stretch may have different values of `name`, a free input."""
        s = self.stepper
        return not self.restart and isinstance(s, Monolithic) and s.between is None and name in s.free_inputs

    def over(self, stretch: Stretch, event: bool) -> RowBlocks:
        """The rows in (start, end]; `event`: something changed at the start."""
        self._ringing.changed(stretch)
        self.place = MarchPosition(left=self.restart if event else 0)
        return self.on(stretch)

    def on(self, stretch: Stretch) -> RowBlocks:
        """The rows from its place on."""
        begun = self.place
        stretch.inputs.within(begun.first, 0)  # those before are read past
        for piece, (t, h, n) in enumerate(pieces(stretch.start, stretch.end, self.step)):
            if piece < begun.piece:
                continue
            first, left = (begun.first, begun.left) if piece == begun.piece else (0, self.place.left)
            while first < n:
                self.place = MarchPosition(piece, first, left)
                self.between_blocks()
                if h < self.step * (1 - 1e-9) and not first:
                    self._cut.append(h)
                damped = left > 0 and self._damped is not None
                count = 1 if damped or self._alone else self._ringing.block(min(self.pace.steps, n - first))
                inputs = stretch.inputs.within(first, count)
                yield from self._booked(t, h, first, count, damped, inputs)
                first, left = first + count, self.restart if self._happened else max(left - 1, 0)
                self.place = MarchPosition(piece, first, left)
                self.pace.handed_over(count)

    def facts(self) -> dict[str, Any]:
        """Facts about the steps for the result."""
        return {"restarted": self._damped.taken} if self._damped else {}

    def notes(self) -> list[str]:
        """Notes of what was not as asked for, one line each."""
        cut = [_shorter(self._cut, self.book.steps, self.step)] if self._cut else []
        return cut + (self._damped.notes() if self._damped else []) + self._ringing.notes()

    def _booked(
        self, t: float, h: float, first: int, n: int, damped: bool, inputs: list[tuple[int, Event]]
    ) -> RowBlocks:
        """The rows of steps first..first+n-1 of the grid t + k h; those before one that fails, too.

        inputs: (step from `first`, event)
        """
        try:
            if damped and self._damped is not None:
                steps = self._damped.advance(t + first * h, h)
            elif inputs:
                steps = monolithic(self.stepper, "--input").advance_with(inputs, t, h, n, first)
            else:
                steps = self.stepper.advance(t, h, n, first)
        except StepFailure as failure:
            failure.asked, failure.longest = h, self._longest
            kept = failure.recorded.get("steps")
            self.book.inputs(inputs[: bisect_right(inputs, 0 if kept is None else len(kept.H), key=_number)])
            if kept is not None:
                yield self._added(t, h, first, kept)
            self.book.failed(failure)
            raise
        except Interrupted as stop:
            if "steps" in stop.recorded:
                yield self._added(t, h, first, stop.recorded["steps"])
            raise
        self._longest, self._happened = max(self._longest, h), bool(steps.events)
        self._ringing.add(steps, damped)
        self.book.inputs(inputs)
        yield self._added(t, h, first, steps)

    def _added(self, t: float, h: float, first: int, steps: Steps) -> RowBlock:
        times = t + h * np.arange(first, first + len(steps.H) + 1)
        self.book.add(times[:-1], np.full(len(steps.H), h), steps)
        return step_rows(times[:-1], times[1:], steps)


class AdaptiveSteps:
    """Steps that keep a tolerance; multiples of `landing` after each event are landed on."""

    CARRIED = ("place", "pace", "adaptive", "_restarted", "_wanted")

    def __init__(self, stepper: Stepper, book: Book, options: Options):
        #: where it is, and what is called there between two blocks
        self.place, self.between_blocks = MarchPosition(), nowhere
        self.book, self.restart, self.landing = book, options.restart, options.landing
        self.adaptive = _sized(stepper, options)
        self._restarted, self._wanted = 0, 0
        self.pace = BlockSize()

    def takes_inputs(self, name: str) -> bool:
        """Steps of any length stop where an input changes."""
        return False

    def over(self, stretch: Stretch, event: bool) -> RowBlocks:
        """The rows in (start, end]; `event`: something changed at the start."""
        self.adaptive.after_event()
        self.place = MarchPosition(t=stretch.start, left=self.restart if event else 0)
        return self.on(stretch)

    def on(self, stretch: Stretch) -> RowBlocks:
        """The rows from its place on."""
        start, end = stretch.start, stretch.end
        times, rows, left = [self.place.t], [], self.place.left
        try:
            for ahead in blocks_of_goals(start, end, self.landing):
                while times[-1] < ahead[-1]:
                    if not rows:
                        self.place = MarchPosition(t=times[-1], left=left)
                        self.between_blocks()
                    ends, steps, failure = self._taken(times[-1], ahead, left > 0, self.pace.steps - len(times) + 1)
                    left = max(left - 1, 0)
                    times += ends
                    rows += [] if steps is None else [steps]
                    if failure is not None:
                        raise failure
                    taken = len(times) - 1
                    if taken >= self.pace.steps or self.pace.full(taken):
                        yield self._booked(times, rows)
                        self.pace.handed_over(taken)
                        times, rows = times[-1:], []
        except StepFailure as failure:
            if rows:
                yield self._booked(times, rows)
            self.book.failed(failure)
            raise
        if rows:
            yield self._booked(times, rows)
            self.pace.handed_over(len(times) - 1)

    def facts(self) -> dict[str, Any]:
        """Facts about the steps for the result."""
        return {"restarted": self._restarted, **self.adaptive.facts()}

    def notes(self) -> list[str]:
        """Notes of what was not as asked for, one line each."""
        return [*not_damped(self._wanted - self._restarted, self._wanted), *self.adaptive.notes()]

    def _taken(
        self, t: float, ahead: Array, damped: bool, room: int
    ) -> tuple[list[float], Steps | None, StepFailure | None]:
        """Ends of at most `room` accepted steps from t, the steps, and why there are no more; one if it is to be `damped`."""
        if self._march is not None and not damped:
            found = self._march.take(t, ahead, room)
            return found.ends, found.steps, found.failure
        ends, steps = self.adaptive.advance(t, next_goal(ahead, t), damped)
        self._wanted += damped
        self._restarted += damped and steps.numerical is not None
        return ends, steps, None

    @cached_property
    def _march(self) -> NativeMarch | None:
        return self.adaptive.march()

    def _booked(self, times: list[float], rows: list[Steps]) -> RowBlock:
        steps, t = Steps.joined(rows), np.array(times)
        self.book.add(t[:-1], np.diff(t), steps)
        return step_rows(t[:-1], t[1:], steps)


def _sized(stepper: Stepper, options: Options) -> Adaptive | EnergySteps:
    """Steps of the size that the options ask for."""
    if options.by_energy:
        from phfmu.runs.march.energy_steps import EnergySteps

        return EnergySteps(stepper, options)
    from phfmu.runs.march.adaptive import Adaptive

    whole = monolithic(stepper, "--rtol")
    if options.restart:
        require_fit(whole)
    assert options.rtol is not None
    return Adaptive(whole, options, options.rtol)


def _number(numbered: tuple[int, Event]) -> int:
    return numbered[0]


def _shorter(cut: list[float], steps: int, step: float) -> str:
    verb = "is" if len(cut) == 1 else "are"
    return (
        f"{len(cut)} of {steps} steps {verb} shorter than {step:g} s, the shortest {min(cut):.3g} s: the grid starts anew at "
        "each event and input row, and the last step ends with the run"
    )


def step_rows(start: Array, end: Array, steps: Steps) -> RowBlock:
    """RowBlocks at the step ends, with those within the steps before them."""
    if steps.between is None:
        return end, steps.signals, np.zeros(len(end), bool)
    m = steps.between.shape[1]
    part = np.arange(1, m + 2) / (m + 1)
    times = start[:, None] + (end - start)[:, None] * part
    times[:, -1] = end
    values = np.concatenate([steps.between, steps.signals[:, None]], axis=1)
    inside = np.tile(part < 1.0, (len(end), 1))
    kept = ~(inside & np.isnan(values).all(axis=2))
    return times[kept], values[kept], inside[kept]
