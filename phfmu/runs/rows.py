"""The rows of a run: thinned where that is asked for, handed on or collected.

Their columns are the signals of the stepper and then its free inputs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.network.couplings.stepper import Follows, Stepper
from phfmu.network.members.inputs import held_rows, places
from phfmu.pick import pick
from phfmu.results.kinds import kinds_by_name
from phfmu.runs.march.stretches import CLOSE, Stretch
from phfmu.runs.options import Options

Array = NDArray[Any]
#: (times, values, whether each row lies within a step)
RowBlock = tuple[Array, Array, Array]
RowBlocks = Iterator[RowBlock]

#: rows that can be counted
MOST = 2**62


class RowCollector:
    """Rows by blocks: given to `options.keep`, or kept here; `last`: the time of the last one (s)."""

    CARRIED = ("_seen", "_place", "_left_out", "_blocks", "last")

    def __init__(self, options: Options):
        self._keep, self._progress = options.keep, options.progress
        self._t0, self._every, self._seen = options.t0, options.every, 0
        self._place = -1.0  # of the last row among the multiples of a distance in time
        self._left_out: RowBlock | None = None  # the last row, if it was not kept
        self._blocks: list[RowBlock] = []
        self.last = np.nan

    def take(self, time: Array, values: Array, inside: Array) -> None:
        """One block: times (n), values (n x names), whether each row lies within a step (n)."""
        self.last = float(time[-1])
        if self._every is None:
            self._give(time, values, inside)
        else:
            kept = self._chosen(time, self._every)
            self._left_out = None if kept[-1] else (time[-1:], values[-1:], inside[-1:])
            if kept.any():
                self._give(time[kept], values[kept], inside[kept])
        if self._progress is not None:
            self._progress(self.last)

    def end(self) -> None:
        """The last row of the run is kept, too."""
        if self._left_out is not None:
            self._give(*self._left_out)
            self._left_out = None

    def _give(self, time: Array, values: Array, inside: Array) -> None:
        if self._keep is None:
            self._blocks.append((time, values, inside))
        else:
            self._keep(time, values, inside)

    def _chosen(self, time: Array, every: int | float) -> Array:
        """The rows that are kept (n)."""
        if isinstance(every, int):
            number = self._seen + np.arange(len(time))
            self._seen += len(time)
            return number % min(every, MOST) == 0
        place = np.floor((time - self._t0) / every + CLOSE)
        kept = np.diff(place, prepend=self._place) > 0  # the first row at or after each multiple
        self._place = float(place[-1])
        return kept

    def joined(self, width: int) -> RowBlock:
        """Rows that were not handed on, as one block."""
        if not self._blocks:
            return np.zeros(0), np.zeros((0, width)), np.zeros(0, bool)
        time, values, inside = (np.concatenate(parts) for parts in zip(*self._blocks, strict=True))
        return time, values, inside


class RunColumns:
    """Columns `names` with `units`, `kinds` and `labels`, chosen by patterns out of all that there is (none: all of them).

    An input stands in a row with the value that it had in the step that ends there; at the start, with that of the start.  One
    that is interpolated stands there with its value at that time, before a jump.
    Errors: ValueError for a pattern that means no column.
    """

    CARRIED = ("_now",)

    def __init__(self, stepper: Stepper, patterns: Sequence[str] = (), step: float = 1.0):
        self._stepper, self._step = stepper, step
        self._inputs = list(stepper.inputs())
        everything = [*stepper.names, *self._inputs]
        self.names = pick(patterns, everything, "the run") if patterns else everything
        units = stepper.units
        self.units = [units[n] for n in self.names]
        kinds = {**kinds_by_name(everything), **stepper.kinds, **dict.fromkeys(self._inputs, "input")}
        self.kinds = [kinds.get(n, "") for n in self.names]
        labels = stepper.labels
        self.labels = [labels.get(n, "") for n in self.names]
        place = {n: i for i, n in enumerate(everything)}
        at = np.array([place[n] for n in self.names], int)
        own = at < len(stepper.names)
        #: columns of the stepper and of the inputs: where they are, and where they go
        self._signals, self._given = (
            (at[own], np.flatnonzero(own)),
            (at[~own] - len(stepper.names), np.flatnonzero(~own)),
        )
        self._all = not patterns
        data = stepper.followed if isinstance(stepper, Follows) else None
        own_data = [] if data is None else [(n, i) for i, n in enumerate(data.names) if n in self.names]
        self._data, self._from_data = data if own_data else None, (
            [self.names.index(n) for n, _ in own_data], [i for _, i in own_data]
        )  # fmt: skip
        self._stretch = Stretch(0.0, 0.0, [])
        self._now = np.zeros(0)  # inputs in the steps that the last rows end

    def begin(self, stretch: Stretch) -> None:
        """A stretch whose events happened."""
        if not self._inputs:
            return
        at = {n: i for i, n in enumerate(self._inputs)}
        self._stretch = stretch
        self._places: Callable[[str], list[int]] = cache(partial(places, at))
        self._now = np.array(list(self._stepper.inputs().values()))

    def rows(self, time: Array, values: Array, after: bool = False) -> Array:
        """The columns (n x names) of rows at `time` (n) of the stretch, with what the stepper tells.

        `after`: what inputs are after a jump in their data at that time
        """
        if self._all and not self._inputs:
            return values
        out = np.empty((len(time), len(self.names)))
        if self._all:
            out[:, : values.shape[1]] = values
        else:
            out[:, self._signals[1]] = values[:, self._signals[0]]
        if len(self._given[0]):
            out[:, self._given[1]] = self._held_at(time)[:, self._given[0]]
        if self._data is not None:
            out[:, self._from_data[0]] = self._data(time, after)[:, self._from_data[1]]
        return out

    def _held_at(self, time: Array) -> Array:
        """Inputs (n x inputs) in the steps that end at `time` (n), not before the rows that were asked for last."""
        if not (some := self._stretch.inputs.kept()):
            return np.broadcast_to(self._now, (len(time), len(self._now)))
        after = self._stretch.start + (np.array([k for k, _ in some], float) + CLOSE) * self._step
        changes = [(self._places(e.name), e.value) for _, e in some]
        held = held_rows(self._now, len(some) + 1, changes, range(1, len(some) + 1))
        done = np.searchsorted(after, time)
        self._now = held[done[-1]]
        return held[done]
