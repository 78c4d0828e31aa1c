"""Zeros of a guard within a step, from its values at 2k + 2 points; the twin of runtime/events/event_roots.c.

The fit is a polynomial in Bernstein form, whose coefficients change their sign at least as often as it does (Descartes): halved
until one change is left, it gives every crossing in order.  A guard that is zero at the start is divided by tau first.
Source: Lane, Riesenfeld, BIT 21 (1981).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import comb

import numpy as np
from numpy.typing import NDArray

from phfmu.outcome.limits import LIMITS

Array = NDArray[np.float64]

DEPTH = 40  # halvings after which coefficients of both signs are a touch, no crossing
BISECTIONS = 52
HALF, ASIDE = 0.5, 0.4375  # where an interval is parted; aside if there is a zero in its middle


@dataclass(frozen=True)
class Crossing:
    """A zero of a guard at the fraction tau of the step, with the slope d guard / d tau."""

    tau: float
    slope: float


@dataclass(frozen=True)
class Fit:
    """`tau` (m+1): points from 0 to 1;  `whole`, `divided`: values there, and values/tau behind 0, to Bernstein coefficients."""

    tau: Array
    whole: Array
    divided: Array

    def coefficients(self, values: Array, from_zero: bool) -> Array:
        """Coefficients of the guard, or of guard/tau where the guard is zero at the start."""
        if from_zero:
            return _product(self.divided, values[1:] / self.tau[1:])
        b = _product(self.whole, values)
        b[0], b[-1] = values[0], values[-1]
        return b


@cache
def fit(k: int) -> Fit:
    """For steps with k nodes: 2k + 2 Chebyshev points with both ends."""
    m = 2 * k + 1
    tau = (1.0 - np.cos(np.pi * np.arange(m + 1) / m)) / 2.0
    return Fit(tau, _inverse(tau), _inverse(tau[1:]))


def _product(matrix: Array, values: Array) -> Array:
    """matrix @ values, summed from the first column to the last, as compiled code does."""
    return np.cumsum(matrix * values, axis=1)[:, -1].copy()


def _inverse(tau: Array) -> Array:
    n = len(tau) - 1
    return np.linalg.inv(np.array([[comb(n, i) * t**i * (1 - t) ** (n - i) for i in range(n + 1)] for t in tau]))


def parted(b: Array, t: float) -> tuple[Array, Array]:
    """Coefficients on [0, t] and [t, 1] (de Casteljau)."""
    b = b.copy()
    left, right = np.empty_like(b), np.empty_like(b)
    n = len(b)
    for i in range(n):
        left[i], right[n - 1 - i] = b[0], b[n - 1 - i]
        b[: n - 1 - i] += t * (b[1 : n - i] - b[: n - 1 - i])
    return left, right


def value(b: Array, t: float) -> float:
    """The polynomial at t."""
    b = b.copy()
    for n in range(len(b) - 1, 0, -1):
        b[:n] += t * (b[1 : n + 1] - b[:n])
    return float(b[0])


def slope(b: Array, t: float, from_zero: bool) -> float:
    """d guard / d tau at t."""
    rate = value(np.diff(b) * (len(b) - 1), t)
    return value(b, t) + t * rate if from_zero else rate


def crossing(b: Array, direction: int, from_zero: bool) -> Crossing | None:
    """The first crossing in the direction (0: any), None if there is none."""
    found = _isolated(b, direction, 0.0, 1.0, 0)
    if found is None:
        return None
    low, high = found
    sign = value(b, low)
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        if value(b, middle) * sign > 0:
            low = middle
        else:
            high = middle
    return Crossing(high, slope(b, high, from_zero))


def _isolated(b: Array, direction: int, low: float, high: float, depth: int) -> tuple[float, float] | None:
    """An interval with the first crossing in the direction and no other."""
    signs = np.sign(b[b != 0])
    changes = int(np.sum(signs[1:] != signs[:-1]))
    if changes == 0 or depth == DEPTH:
        return None
    if changes == 1 and b[0] and b[-1]:
        return (low, high) if direction in (0, signs[-1]) else None
    t = HALF
    left, right = parted(b, t)
    if left[-1] == 0.0:
        t = ASIDE
        left, right = parted(b, t)
    middle = low + t * (high - low)
    return _isolated(left, direction, low, middle, depth + 1) or _isolated(right, direction, middle, high, depth + 1)


def hermite(start: float, end: float, slope_start: float, slope_end: float) -> Array:
    """Bernstein coefficients of the cubic with these values and slopes at 0 and 1."""
    return np.array([start, start + slope_start / 3, end - slope_end / 3, end])


def hermite_from_zero(end: float, slope_start: float, slope_end: float) -> Array:
    """Bernstein coefficients of degree 2 of the same cubic with start 0, divided by the variable."""
    return hermite(0.0, end, slope_start, slope_end)[1:] * [3.0, 1.5, 1.0]


def turn(start: float, end: float, slope_start: float, slope_end: float) -> float | None:
    """The fraction of a step at which a guard turns back that may have been zero; values and slopes d guard / d tau at its ends.

    It approaches zero at the start, fast enough, and leaves it at the end on the same side.  In between it is the cubic of the
    four numbers, which is beyond zero, or as near to it as a part of its distance from the chord: else None.
    """
    side = np.sign(start)
    if not (
        abs(slope_start) * LIMITS["TURN_REACH"] >= abs(start)
        and end * side > 0
        and slope_start * side < 0 < slope_end * side
    ):
        return None
    b = hermite(start, end, slope_start, slope_end)
    at = crossing(np.diff(b), 0, False)
    if at is None:
        return None
    least, chord = value(b, at.tau), start + at.tau * (end - start)
    return at.tau if least * side <= LIMITS["TURN_NEAR"] * abs(chord - least) else None


def vertex(left: tuple[float, float], middle: tuple[float, float], right: tuple[float, float]) -> float:
    """The place where the parabola through three points (x, y) is least; the middle one where it is not curved upwards."""
    (a, ya), (b, yb), (c, yc) = left, middle, right
    before, after = (yb - ya) / (b - a), (yc - yb) / (c - b)
    curved = (after - before) / (c - a)
    return (a + b - before / curved) / 2 if curved > 0 else b
