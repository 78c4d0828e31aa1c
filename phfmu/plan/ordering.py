"""Elimination order of a sparse matrix with zero diagonals.

Columns with a structurally zero diagonal (multipliers, node voltages) are matched with a neighbour row and merged
with it into one node before the minimum-degree ordering; without that, fill explodes on long networks.
"""

from __future__ import annotations

import sys
from collections import deque
from dataclasses import dataclass
from functools import cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.matching import columns_of_rows, maximum_matching
from phfmu.plan.factor_entries import permuted_entries

Ints = NDArray[np.int32]
#: pivots without fill come first if they are this part of all at least, and if entries of L + U fall to this part at least
LEAST, GAIN = 0.1, 0.95


class StructurallySingular(ValueError):
    """The matrix has no full structural rank; `rows` and `cols` are the unmatched ones."""

    def __init__(self, rows: list[int], cols: list[int]):
        super().__init__(f"{len(rows)} equations cannot be matched with an unknown of their own")
        self.rows, self.cols = rows, cols


@dataclass(frozen=True)
class _MatrixPattern:
    """Places of the entries of an n x n matrix that are not zero."""

    n: int
    row: NDArray[np.int32]
    col: NDArray[np.int32]

    def fill(self, order: Ints, pivot: Ints) -> int:
        """Entries of L + U with these pivots, all of them numerically good; without end if some are missing."""
        if not np.array_equal(np.sort(pivot), np.arange(self.n)):
            return sys.maxsize
        return permuted_entries(self.row, self.col, order, pivot).total


def elimination_order(
    n: int, row: NDArray[np.int32], col: NDArray[np.int32], regularised: NDArray[np.int32]
) -> tuple[Ints, Ints]:
    """Column order and preferred pivot row per step, for the pattern (row, col) of an n x n matrix.

    Of two orders the one with fewer entries of L + U: minimum degree for all, or after the pivots that add no entries.
    `regularised`: columns whose diagonal is present but numerically zero.  StructurallySingular if no matching exists.
    """
    if n == 0:
        return np.zeros(0, np.int32), np.zeros(0, np.int32)
    weak = np.zeros(n, bool)
    weak[regularised] = True
    real = ~((row == col) & weak[col])
    whole = _MatrixPattern(n, row[real], col[real])
    order, pivot = _minimum_degree(whole, row, col)
    first = _Doubletons(whole)
    if len(first.pivots) < LEAST * n:
        return order, pivot
    try:
        other = first.before()
    except StructurallySingular:
        return order, pivot
    better = whole.fill(*other) < GAIN * whole.fill(order, pivot)
    return other if better else (order, pivot)


class _Doubletons:
    """Pivots on the diagonal whose row or column has at most two entries left, one after another: none of them adds entries.

    Minimum degree works on A + A^T, where eliminating a position, D_q - h/2 D_v, looks as if it joined all its neighbours;
    in A it does not.
    """

    def __init__(self, pattern: _MatrixPattern):
        n = self.n = pattern.n
        self.rows: list[set[int]] = [set() for _ in range(n)]
        self.cols: list[set[int]] = [set() for _ in range(n)]
        for r, c in zip(pattern.row.tolist(), pattern.col.tolist(), strict=True):
            self.rows[r].add(c)
            self.cols[c].add(r)
        self.pivots: list[int] = []
        self._queue = deque(range(n))
        while self._queue:
            i = self._queue.popleft()
            if i in self.rows[i] and min(len(self.rows[i]), len(self.cols[i])) <= 2:
                self._eliminate(i)

    def _eliminate(self, i: int) -> None:
        self.pivots.append(i)
        others, touched = self.rows[i] - {i}, self.cols[i] - {i}
        self.rows[i], self.cols[i] = set(), set()
        for d in others:
            self.cols[d].discard(i)
            self.cols[d] |= touched
        for k in touched:
            self.rows[k].discard(i)
            self.rows[k] |= others
        self._queue.extend(sorted(others | touched))

    def before(self) -> tuple[Ints, Ints]:
        """The order with these pivots first, then those of minimum degree of what is left."""
        kept = sorted(set(range(self.n)) - set(self.pivots))
        place = {i: k for k, i in enumerate(kept)}
        row = np.array([k for k, i in enumerate(kept) for _ in self.rows[i]], np.int32)
        col = np.array([place[c] for i in kept for c in self.rows[i]], np.int32)
        order, pivot = (np.zeros(0, np.int32),) * 2
        if kept:
            order, pivot = _minimum_degree(_MatrixPattern(len(kept), row, col), row, col)
        names, first = np.array([*kept, -1], np.int32), np.array(self.pivots, np.int32)
        return np.append(first, names[order]), np.append(first, names[pivot])


def _minimum_degree(pattern: _MatrixPattern, row: NDArray[np.int32], col: NDArray[np.int32]) -> tuple[Ints, Ints]:
    """Minimum degree, with columns without a diagonal joined to a neighbour; (row, col): all entries, also those of size 0."""
    n = pattern.n
    has_diagonal = np.zeros(n, bool)
    has_diagonal[pattern.row[pattern.row == pattern.col]] = True

    @cache
    def full() -> NDArray[np.int_]:
        """Row -> column of a matching of most rows, -1 for the others; it may take long, and few patterns need it."""
        return np.array(maximum_matching(columns_of_rows(pattern.row, pattern.col, n, n), n))

    if ca.sprank(ca.Sparsity.triplet(n, n, pattern.row.tolist(), pattern.col.tolist())) < n:
        rows, cols = np.flatnonzero(full() < 0), np.setdiff1d(np.arange(n), full())
        raise StructurallySingular([int(i) for i in rows], [int(i) for i in cols])

    # partners: every weak column takes a neighbouring row; strong columns are preferred, they keep their own pivot
    zero = np.flatnonzero(~has_diagonal)
    partner = np.full(n, -1)
    if zero.size:
        own = ~has_diagonal[pattern.col]
        place = np.cumsum(~has_diagonal) - 1
        columns = columns_of_rows(pattern.row[own], place[pattern.col[own]], n, len(zero))
        for r, c in enumerate(maximum_matching(columns, len(zero))):
            if c >= 0:
                partner[zero[c]] = r
        for c in zero[partner[zero] < 0]:
            partner[c] = int(np.flatnonzero(full() == c)[0])
    node = np.arange(n)
    for c in zero:
        r = partner[c]
        a, b = _root(node, int(c)), _root(node, int(r))
        node[max(a, b)] = min(a, b)
    roots = np.array([_root(node, i) for i in range(n)])
    labels, merged = np.unique(roots, return_inverse=True)
    m = len(labels)
    sparsity = ca.Sparsity.triplet(m, m, merged[row].tolist(), merged[col].tolist())
    sparsity = sparsity + sparsity.T + ca.Sparsity.diag(m)
    quotient = sparsity.amd()
    members: list[list[int]] = [[] for _ in range(m)]
    for i in np.argsort(~has_diagonal, kind="stable"):
        members[merged[i]].append(int(i))
    order = [i for q in quotient for i in members[q]]
    weak = any(not has_diagonal[c] and not has_diagonal[partner[c]] for c in order)
    row_of = {int(c): int(r) for r, c in enumerate(full())} if weak else {}
    pivot = [c if has_diagonal[c] or has_diagonal[partner[c]] else row_of[c] for c in order]
    return np.array(order, np.int32), np.array(_distinct(pivot, order, merged), np.int32)


def _distinct(pivot: list[int], order: list[int], node: NDArray[np.int_]) -> list[int]:
    """`pivot` with every row once: a row chosen before is replaced by one of its node that nobody chose, else -1."""
    left: dict[int, list[int]] = {}
    for r in sorted(set(order).difference(pivot)):
        left.setdefault(int(node[r]), []).append(r)
    taken: set[int] = set()
    for j, c in enumerate(order):
        if pivot[j] in taken:
            free = left.get(int(node[c]))
            pivot[j] = free.pop() if free else -1
        taken.add(pivot[j])
    return pivot


def _root(node: NDArray[np.int_], i: int) -> int:
    while node[i] != i:
        i = int(node[i])
    return i
