"""Elimination order of a sparse matrix with zero diagonals.

Columns with a structurally zero diagonal (multipliers, node voltages) are matched with a neighbour row and merged
with it into one node before the minimum-degree ordering; without that, fill explodes on long networks.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import NDArray


class StructurallySingular(ValueError):
    """The matrix has no full structural rank; `rows` and `cols` are the unmatched ones."""

    def __init__(self, rows: list[int], cols: list[int]):
        super().__init__(f"{len(rows)} equations cannot be matched with an unknown of their own")
        self.rows, self.cols = rows, cols


def elimination_order(
    n: int, row: NDArray[np.int32], col: NDArray[np.int32], regularised: NDArray[np.int32]
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Column order and preferred pivot row per step, for the pattern (row, col) of an n x n matrix.

    `regularised`: columns whose diagonal is present but numerically zero.  StructurallySingular if no matching exists.
    """
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import maximum_bipartite_matching

    if n == 0:
        return np.zeros(0, np.int32), np.zeros(0, np.int32)
    weak = np.zeros(n, bool)
    weak[regularised] = True
    real = ~((row == col) & weak[col])
    pattern = csr_matrix((np.ones(real.sum(), np.int8), (row[real], col[real])), shape=(n, n))
    has_diagonal = pattern.diagonal() != 0
    full = maximum_bipartite_matching(pattern, perm_type="column")  # row -> column
    if (full < 0).any():
        rows = np.flatnonzero(full < 0)
        cols = np.setdiff1d(np.arange(n), full)
        raise StructurallySingular([int(i) for i in rows], [int(i) for i in cols])

    # partners: every weak column takes a neighbouring row; strong columns are preferred, they keep their own pivot
    zero = np.flatnonzero(~has_diagonal)
    partner = np.full(n, -1)
    if zero.size:
        columns = pattern.tocsc()[:, zero]
        match = maximum_bipartite_matching(columns.tocsr(), perm_type="row")
        for c, r in zip(zero, match, strict=True):
            partner[c] = r if r >= 0 else int(np.flatnonzero(full == c)[0])
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
    row_of = {int(c): int(r) for r, c in enumerate(full)}
    pivot = [c if has_diagonal[c] else (c if has_diagonal[partner[c]] else row_of[c]) for c in order]
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
