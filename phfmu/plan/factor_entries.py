"""Entries of the factors L and U of a sparse matrix whose pivots stand on its diagonal, counted without a number.

Row k of U has the columns of row k of the matrix and of those rows of U that its part of L names.  A row of U is looked through
only up to the first k whose row of L names it and whose column it has: what it has beyond, row k of U has too.
Source: Eisenstat, Liu, SIAM J. Matrix Anal. Appl. 13 (1992), on pruned graphs of unsymmetric matrices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from heapq import heapify, heappop, heappush

import numpy as np
from numpy.typing import NDArray

from phfmu.matching import columns_of_rows


@dataclass(frozen=True)
class FactorEntries:
    """Numbers of entries: `below` the diagonal of each column of L;  `right` of the diagonal of each row of U."""

    below: NDArray[np.int64]
    right: NDArray[np.int64]

    @property
    def total(self) -> int:
        """Number of the entries of L and U, the diagonal in both."""
        return int(self.below.sum() + self.right.sum()) + 2 * len(self.right)

    @property
    def multiplications(self) -> int:
        """Number of multiplications of the elimination, divisions aside."""
        return int(self.below @ self.right)


def factor_entries(rows: Sequence[Sequence[int]]) -> FactorEntries:
    """The entries, from the columns of each row; a diagonal that is not among them counts as there."""
    n = len(rows)
    below, right = np.zeros(n, np.int64), np.zeros(n, np.int64)
    through: list[set[int]] = []
    for k, row in enumerate(rows):
        there, todo = {k, *row}, [c for c in row if c < k]
        heapify(todo)
        lower = []
        while todo:
            j = heappop(todo)
            lower.append(j)
            new = through[j] - there
            there |= new
            for c in new:
                if c < k:
                    heappush(todo, c)
        below[lower] += 1
        right[k] = len(there) - len(lower) - 1
        through.append({c for c in there if c > k})
        for j in lower:
            if k in through[j]:
                through[j] = {c for c in through[j] if c <= k}
    return FactorEntries(below, right)


def permuted_entries(
    row: NDArray[np.integer], col: NDArray[np.integer], order: NDArray[np.integer], pivot: NDArray[np.integer] | None
) -> FactorEntries:
    """Entries of the factors of a pattern (row, col) with its columns in this order.

    pivot: the rows of the pivots, None: row k of column k
    """
    n = len(order)
    place, at = np.empty(n, np.int64), np.arange(n)
    place[order] = np.arange(n)
    if pivot is not None:
        at[pivot] = np.arange(n)
    return factor_entries(columns_of_rows(at[row], place[col], n, n))
