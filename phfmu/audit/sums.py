"""Compensated sums: the same bits however a run is cut into rows and blocks."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.integer]


class CompensatedSum:
    """Sum = high + low: the rounding error of every addition is found exactly and summed beside it."""

    __slots__ = ("high", "low")

    def __init__(self) -> None:
        self.high = 0.0
        self.low = 0.0

    @property
    def value(self) -> float:
        return self.high + self.low

    def add(self, x: float) -> float:
        """Add one number and return the sum."""
        after = self.high + x
        part = after - self.high
        error = (self.high - (after - part)) + (x - part)
        self.high = after
        if math.isfinite(error):
            self.low += error
        return after + self.low

    def extend(self, x: Floats) -> Floats:
        """Add x [n] one after the other and return the n running sums [n]."""
        return extend([self], x[:, None])[:, 0]


def extend(sums: Sequence[CompensatedSum], x: Floats) -> Floats:
    """Add column j of x [n,m] to sum j, row after row, and return the running sums [n,m]."""
    if len(x) == 1:
        return np.array([[each.add(value) for each, value in zip(sums, x[0].tolist(), strict=True)]])
    high, low = _running(x, np.array([s.high for s in sums]), np.array([s.low for s in sums]))
    for each, h, w in zip(sums, high[-1].tolist(), low[-1].tolist(), strict=True):
        each.high, each.low = h, w
    return high + low


def _running(x: Floats, high: ArrayLike, low: ArrayLike) -> tuple[Floats, Floats]:
    """`CompensatedSum.add` down the columns of x [n,m]; the running high and low parts [n,m]."""
    x, shape = np.asfortranarray(x), (len(x) + 1, x.shape[1])  # a sum runs over what lies side by side
    sums, lows = np.empty(shape, order="F"), np.empty(shape, order="F")
    sums[0], lows[0], sums[1:] = high, low, x
    with np.errstate(invalid="ignore", over="ignore"):
        np.cumsum(sums, axis=0, out=sums)
        lows[1:] = _error(sums[:-1], x, sums[1:])
        np.cumsum(lows, axis=0, out=lows)
    return sums[1:], lows[1:]


def _error(before: Floats, x: Floats, after: Floats) -> Floats:
    """What the addition after = before + x has rounded off."""
    part = after - before
    error = after - part
    np.subtract(before, error, out=error)
    np.subtract(x, part, out=part)
    error += part
    if not np.isfinite(error.sum()):  # of one that is not; a sum that overflows is looked at once more
        error[~np.isfinite(error)] = 0.0
    return error


class Sums:
    """Compensated sums by name; one that was never added to is absent."""

    def __init__(self) -> None:
        self._parts: dict[tuple[str, ...], CompensatedSum] = {}

    def __getitem__(self, key: tuple[str, ...]) -> CompensatedSum:
        return self._parts.setdefault(key, CompensatedSum())

    def extend(self, keys: Sequence[tuple[str, ...]], x: Floats) -> Floats:
        """Add columns of x [n,m] to m sums; the running sums [n,m]."""
        return extend([self[key] for key in keys], x) if keys else x

    def get(self, *key: str) -> float | None:
        return self._parts[key].value if key in self._parts else None


def across(x: Floats) -> Floats:
    """Sum over the columns of x [n,m], each row compensated; zeros for m = 0."""
    high, low = np.zeros(len(x)), np.zeros(len(x))
    with np.errstate(invalid="ignore", over="ignore"):
        for column in np.ascontiguousarray(x.T):
            after = high + column
            low += _error(high, column, after)
            high = after
    return high + low


def larger(a: float, b: float) -> float:
    """The larger of a >= 0 and |b|; what is not a finite number counts as infinite."""
    return max(a, abs(b)) if math.isfinite(b) else math.inf


def largest(x: Floats) -> float:
    """Largest magnitude in x, 0 for none; what is not a finite number counts as infinite."""
    return float(np.max(np.where(np.isfinite(x), np.abs(x), np.inf), initial=0.0))


def ratio(size: ArrayLike, allowed: ArrayLike) -> Floats:
    """|size| / allowed elementwise: 0 for 0/0, infinite where one of them is not a finite number."""
    r, m = np.abs(np.asarray(size, float)), np.asarray(allowed, float)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        found = np.where(r == 0.0, 0.0, r / m)
    return np.where(np.isfinite(r) & np.isfinite(m), found, np.inf)
