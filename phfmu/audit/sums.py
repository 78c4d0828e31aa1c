"""Compensated sums: the same bits however a run is cut into rows and blocks."""

import math
from collections.abc import Iterable

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
        high, low = _running(x, self.high, self.low)
        self.high, self.low = float(high[-1]), float(low[-1])
        return high + low


def _running(x: Floats, high: float = 0.0, low: float = 0.0) -> tuple[Floats, Floats]:
    """`CompensatedSum.add` along the first axis of x; the running high and low parts, each shaped as x."""
    with np.errstate(invalid="ignore", over="ignore"):
        sums = np.cumsum(np.concatenate([np.full((1, *x.shape[1:]), high), x]), axis=0)
        before, after = sums[:-1], sums[1:]
        part = after - before
        error = (before - (after - part)) + (x - part)
        error = np.where(np.isfinite(error), error, 0.0)
        lows = np.cumsum(np.concatenate([np.full((1, *x.shape[1:]), low), error]), axis=0)
    return after, lows[1:]


def across(x: Floats) -> Floats:
    """Sum over the columns of x [n,m], each row as `total`; zeros for m = 0."""
    if x.shape[1] == 0:
        return np.zeros(x.shape[0])
    high, low = _running(x.T)
    return high[-1] + low[-1]


def total(x: Iterable[float]) -> float | None:
    """Sum of a few numbers; None if there are none."""
    accumulator, some = CompensatedSum(), False
    for value in x:
        accumulator.add(value)
        some = True
    return accumulator.value if some else None


def larger(a: float, b: float) -> float:
    """The larger of a >= 0 and |b|; what is not a finite number counts as infinite."""
    return max(a, abs(b)) if math.isfinite(b) else math.inf


def largest(x: Floats) -> float:
    """Largest magnitude in x, 0 for none; what is not a finite number counts as infinite."""
    return float(np.max(np.where(np.isfinite(x), np.abs(x), np.inf), initial=0.0))


def relative(residual: ArrayLike, magnitude: ArrayLike) -> Floats:
    """|residual| / magnitude elementwise: 0 for 0/0, infinite where one of them is not a finite number."""
    r, m = np.abs(np.asarray(residual, float)), np.asarray(magnitude, float)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        ratio = np.where(r == 0.0, 0.0, r / m)
    return np.where(np.isfinite(r) & np.isfinite(m), ratio, np.inf)
