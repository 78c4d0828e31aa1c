"""Linear interpolation between the rows of a run, with its derivatives."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class LinearInterpolation:
    """Values at times t (m) from rows at times `rows` (n); `between`: how many of the times are on no row.

    ValueError for times outside the run, which are called `what`; `remedy`: what to do about that.
    """

    def __init__(self, rows: Array, t: Array, what: str = "times", remedy: str = ""):
        close = 1e-9 * max(float(rows[-1] - rows[0]), 1e-300) / max(len(rows) - 1, 1)
        if len(t) and (t.min() < rows[0] - close or t.max() > rows[-1] + close):
            raise ValueError(
                f"{what} from {t.min():g} s to {t.max():g} s are not within the run, {rows[0]:g} s to {rows[-1]:g} s{remedy}"
            )
        k = np.clip(np.searchsorted(rows, t + close, "right") - 1, 0, max(len(rows) - 2, 0))
        after = np.minimum(k + 1, len(rows) - 1)
        width = np.where(rows[after] > rows[k], rows[after] - rows[k], 1.0)
        self._k, self._after, self._n, self._width = k, after, len(rows), width
        self._part = np.clip((t - rows[k]) / width, 0.0, 1.0)
        self.between = int(np.sum((self._part > 1e-6) & (self._part < 1 - 1e-6)))

    def of(self, values: Array) -> Array:
        """Values there (m) from those of the rows (n)."""
        return values[self._k] + self._part * (values[self._after] - values[self._k])

    def slopes(self, values: Array) -> Array:
        """Slopes (m) of the lines through values of the rows (n); where times T of the rows move, values there move by
        of(dy) - slopes(y) of(dT)."""
        return (values[self._after] - values[self._k]) / self._width

    def back(self, bars: Array) -> Array:
        """Derivatives of a number by the values of the rows (n), from those by the values there (m)."""
        found = np.zeros(self._n)
        np.add.at(found, self._k, (1.0 - self._part) * bars)
        np.add.at(found, self._after, self._part * bars)
        return found
