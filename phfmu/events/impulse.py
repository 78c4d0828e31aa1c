"""Impulses of jumps at one instant: x+ = x- + L m with c(x+) = -e c(x-), and what they cost."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Columns:
    """L (states x n), c by component (components x n), S = L^T H'' L (n x n), restitution e (n) of the jumps at a state."""

    L: Array
    c: Array
    S: Array
    e: Array

    def chosen(self, which: list[int]) -> Columns:
        return Columns(self.L[:, which], self.c[:, which], self.S[np.ix_(which, which)], self.e[which])


def impulses(S: Array, goal: Array, least: float) -> Array | None:
    """m = S^-1 goal by Cholesky's method; None where a pivot is below `least` of its diagonal: columns depend on each other."""
    n = len(goal)
    factor, m = np.zeros_like(S), goal.copy()
    for j in range(n):
        pivot = S[j, j] - factor[j, :j] @ factor[j, :j]
        if not pivot > least * S[j, j]:
            return None
        factor[j, j] = np.sqrt(pivot)
        for i in range(j + 1, n):
            factor[i, j] = (S[i, j] - factor[i, :j] @ factor[j, :j]) / factor[j, j]
        m[j] = (m[j] - factor[j, :j] @ m[:j]) / factor[j, j]
    for j in range(n - 1, -1, -1):
        m[j] = (m[j] - factor[j + 1 :, j] @ m[j + 1 :]) / factor[j, j]
    return m
