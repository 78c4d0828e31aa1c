"""A symmetric matrix of numbers as a sum of small ones: so that equal summands share code, and no code is long.

A matrix with off-diagonal entries a_ij is a sum of |a_ij| (e_i +- e_j)(e_i +- e_j)^T and of a diagonal: springs and dampers
between states and to the ground.  Where a_ii >= sum |a_ij| every summand is positive semidefinite.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from phfmu.importers.definite import Sparse, csc, parts

Array = NDArray[np.float64]
#: compilers take more than linear time for long functions: entries of one summand at most, unless one is small enough whole
ENTRIES = 200
#: summands of equal numbers that share a function: at least
SHARED = 8


@dataclass(frozen=True, eq=False)
class MatrixSummand:
    """A summand: `matrix` on the rows and columns `where`; a multiple of (x_i + sign x_j)^2 if `sign` is not 0."""

    where: list[int]
    matrix: Array
    sign: int = 0

    @property
    def entries(self) -> int:
        return int(np.count_nonzero(self.matrix))


def pieces(matrix: Sparse) -> list[MatrixSummand]:
    """The summands of a symmetric matrix: equal ones alone, the others joined."""
    found = [p for where in parts(matrix) for p in _part(csc(matrix[where][:, where]), where)]
    often = Counter(p.matrix.tobytes() for p in found)
    alone = [p for p in found if often[p.matrix.tobytes()] >= SHARED]
    joined, rest = [], []
    for p in (p for p in found if often[p.matrix.tobytes()] < SHARED):
        if rest and sum(q.entries for q in rest) + p.entries > ENTRIES:
            joined.append(_joined(rest))
            rest = []
        rest.append(p)
    return [*alone, *joined, *([_joined(rest)] if rest else [])]


def _part(block: Sparse, where: Array) -> Iterator[MatrixSummand]:
    """A connected part as it is, or link by link where it is large."""
    block.eliminate_zeros()
    if not block.nnz:
        return
    if block.nnz <= ENTRIES:
        yield MatrixSummand(where.tolist(), block.toarray())
        return
    upper = sp.coo_matrix(sp.triu(block, 1))
    left, size = block.diagonal(), np.asarray(abs(block).sum(axis=1)).ravel()
    for i, j, a in sorted(zip(upper.row.tolist(), upper.col.tolist(), upper.data.tolist(), strict=True)):
        left[i] -= abs(a)
        left[j] -= abs(a)
        sign = 1 if a > 0 else -1
        yield MatrixSummand([int(where[i]), int(where[j])], abs(a) * np.array([[1.0, sign], [sign, 1.0]]), sign)
    left[np.abs(left) <= 8 * np.finfo(float).eps * size] = 0.0
    yield from (MatrixSummand([int(where[i])], np.array([[left[i]]])) for i in np.flatnonzero(left))


def _joined(found: list[MatrixSummand]) -> MatrixSummand:
    if len(found) == 1:
        return found[0]
    rows = sorted({i for p in found for i in p.where})
    place = {i: k for k, i in enumerate(rows)}
    matrix = np.zeros((len(rows), len(rows)))
    for p in found:
        local = [place[i] for i in p.where]
        matrix[np.ix_(local, local)] += p.matrix
    return MatrixSummand(rows, matrix)
