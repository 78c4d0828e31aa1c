"""The rows of a run: thinned where that is asked for, handed on or collected."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.network.run.options import Options

Array = NDArray[Any]
#: (times, values, whether each row lies within a step)
Row = tuple[Array, Array, Array]

#: rows that can be counted
MOST = 2**62

#: of the distance of rows in time: what a row may be early
CLOSE = 1e-9


class Rows:
    """Rows by blocks: given to `options.keep`, or kept here; `last`: the time of the last one (s)."""

    def __init__(self, options: Options):
        self._keep, self._progress = options.keep, options.progress
        self._t0, self._every, self._seen = options.t0, options.every, 0
        self._place = -1.0  # of the last row among the multiples of a distance in time
        self._left_out: Row | None = None  # the last row, if it was not kept
        self._blocks: list[Row] = []
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
        """Which rows are kept (n)."""
        if isinstance(every, int):
            number = self._seen + np.arange(len(time))
            self._seen += len(time)
            return number % min(every, MOST) == 0
        place = np.floor((time - self._t0) / every + CLOSE)
        kept = np.diff(place, prepend=self._place) > 0  # the first row at or after each multiple
        self._place = float(place[-1])
        return kept

    def joined(self, width: int) -> Row:
        """All rows that were not handed on."""
        if not self._blocks:
            return np.zeros(0), np.zeros((0, width)), np.zeros(0, bool)
        time, values, inside = (np.concatenate(parts) for parts in zip(*self._blocks, strict=True))
        return time, values, inside
