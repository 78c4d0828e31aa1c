"""Inputs as functions of time, between the rows of data: what a step takes at its quadrature nodes.

    u(t) = sum_m c_m (t - t_i)^m      for t_i < t <= t_i+1,

straight lines, or the cubic spline with continuous second derivatives (not-a-knot ends: cubic polynomials are
exact; C. de Boor, A Practical Guide to Splines, 1978, IV).  Two rows at one time are a jump, over which nothing is interpolated.
Before the first and after the last row their values hold.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


class Interpolant:
    """Functions of time through `values` (rows x names) at `time`, which does not decrease; `kind`: linear or cubic."""

    def __init__(self, names: Sequence[str], time: Array, values: Array, kind: str):
        self.names, self.kind = list(names), kind
        jumps = np.flatnonzero(np.diff(time) == 0)
        #: times of jumps, and the values after them (jumps x names)
        self.jumps = time[jumps]
        self.after = values[jumps + 1]
        self._time = time
        self._c = np.zeros((4 if kind == "cubic" else 2, len(time), len(self.names)))
        self._c[0] = values
        edges = [0, *(jumps + 1), len(time)]
        for a, b in zip(edges[:-1], edges[1:], strict=True):
            if b - a > 1:
                found = _curve(time[a:b], values[a:b], kind)
                self._c[: len(found), a : b - 1] = found

    def __call__(self, t: ArrayLike, after: bool = False) -> Array:
        """u (t x names) at times t; at a jump the value before it, or the one `after` it."""
        at = np.asarray(t, float)
        i = np.searchsorted(self._time, at, side="right" if after else "left") - 1
        i = np.clip(i, 0, len(self._time) - 1)
        s = np.clip(at - self._time[i], 0.0, None)[..., None]
        *lower, out = self._c[:, i]
        for c in reversed(lower):
            out = c + s * out
        return out

    def at_nodes(self, c: Array, t0: float, h: float, n: int, first: int) -> Array:
        """u (n x k x names) at the fractions c (k) of the steps first..first+n-1 of the grid t0 + k h."""
        start = t0 + h * np.arange(first, first + n)
        return self(start[:, None] + h * c)


def _curve(time: Array, values: Array, kind: str) -> Array:
    """Coefficients (2 or 4 x intervals x names) between rows at increasing times."""
    if kind == "cubic" and len(time) > 2:
        from scipy.interpolate import CubicSpline

        return np.ascontiguousarray(CubicSpline(time, values).c[::-1])
    return np.stack([values[:-1], np.diff(values, axis=0) / np.diff(time)[:, None]])
