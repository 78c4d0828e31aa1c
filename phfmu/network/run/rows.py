"""The rows of a run: handed on, or collected."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.network.run.options import Options

Array = NDArray[Any]
#: (times, values, whether each row lies within a step)
Row = tuple[Array, Array, Array]


class Rows:
    """Rows by blocks: given to `options.keep`, or kept here; `last`: the time of the last one (s)."""

    def __init__(self, options: Options):
        self._keep, self._progress = options.keep, options.progress
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
