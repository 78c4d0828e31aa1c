"""Impulses of jumps at one instant: x+ = x- + L m with c(x+) = -e c(x-), contacts that push only among them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ImpulseColumns:
    """L (states x N), c by component (components x N), S = L^T H'' L (N x N) of jumps and then constraints at a state; e (n).

    e: restitutions of the jumps, which come first
    """

    L: Array
    c: Array
    S: Array
    e: Array

    def chosen(self, jumps: list[int]) -> ImpulseColumns:
        """Columns of some jumps, and of all constraints."""
        which = [*jumps, *range(len(self.e), len(self.S))]
        return ImpulseColumns(self.L[:, which], self.c[:, which], self.S[np.ix_(which, which)], self.e[jumps])


def impulses(S: Array, goal: Array, acts: NDArray[np.bool_], strict: int, least: float) -> Array | None:
    """m with S m = goal in the columns that act by Cholesky's method, zero in the others.

    None where one of the first `strict` pivots is below `least` of its diagonal: columns depend on each other.  Later columns
    that depend on those before them (redundant constraints, nodes that nothing is joined to) get m = 0.
    """
    n, factor, m = len(goal), factored(S, acts, strict, least), goal.copy()
    if factor is None:
        return None
    sign = signs(S)
    for j in range(n):
        m[j] = (m[j] - factor[j, :j] @ m[:j]) / factor[j, j] if factor[j, j] else 0.0
    m *= sign
    for j in range(n - 1, -1, -1):
        if factor[j, j]:
            m[j] = (m[j] - factor[j + 1 :, j] @ m[j + 1 :]) / factor[j, j]
    return m


def signs(S: Array) -> Array:
    """Signs of the pivots of S: 1, and -1 of velocities without mass, whose diagonal is 0."""
    return np.where(S.diagonal() == 0.0, -1.0, 1.0)


def factored(S: Array, acts: NDArray[np.bool_], strict: int, least: float) -> Array | None:
    """F of `impulses`, S = F D F^T with D of `signs`; columns that do not act or depend on those before them are 0."""
    n, sign = len(S), signs(S)
    factor = np.zeros_like(S)
    for j in range(n):
        squares = factor[j, :j] ** 2
        pivot = sign[j] * (S[j, j] - squares @ sign[:j])
        size = S[j, j] if S[j, j] else squares @ (sign[:j] > 0)
        if not acts[j] or not pivot > least * size:
            if acts[j] and j < strict:
                return None
            continue
        factor[j, j] = np.sqrt(pivot)
        for i in range(j + 1, n):
            factor[i, j] = sign[j] * (S[i, j] - (sign[:j] * factor[i, :j]) @ factor[j, :j]) / factor[j, j]
    return factor


def pushing(
    S: Array, goal: Array, pushes: NDArray[np.bool_], least: float, rounding: float, most: int
) -> NDArray[np.bool_] | None:
    """The columns that act, with 0 <= m, 0 <= S m - goal, one of them zero, in the first ones (jumps) where `pushes`; others act.

    The first that is wrong by more than `rounding` changes sides until none is, which ends for S positive definite (Murty,
    Opsearch 11, 1974); None where columns depend on each other, or after `most` sets.
    """
    acts, own = np.ones(len(goal), bool), np.flatnonzero(pushes)
    for _ in range(most):
        m = impulses(S, goal, acts, len(pushes), least)
        if m is None:
            return None
        value = np.where(acts, S.diagonal() * m, S @ m - goal)[own]
        wrong = value < -rounding * (np.abs(S) @ np.abs(m) + np.abs(goal))[own]
        if not wrong.any():
            return acts
        acts[own[wrong.argmax()]] ^= True
    return None
