"""Conditions on the states of coupled members at their junctions, whatever the junction unknowns are.

With y(U) the outputs at one instant and G = dy/dU, the junction rows r(xi) = P^T y(P xi + U_free) + C xi change by
M dxi, M = P^T G P + C.  Combinations N of the rows with N^T M = 0 constrain the states alone: sums of currents of
inductors, the spread of the velocities of rigidly joined masses.  Outputs of resistors and dampers follow xi instead.

M falls into blocks, of one junction each where outputs at an instant do not follow inputs; each has a rank of its own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import block_array, coo_array, csc_array, csr_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import LinearOperator, onenormest, splu

Array = NDArray[np.float64]
Ints = NDArray[np.intp]
#: rows, columns and entries of a part of a matrix
Part = tuple[Ints, Ints, Array]

SINGULAR = 1e-9  # singular value of M, relative to the largest of its block, that counts as zero
LARGE = 64  # rows of a block whose regularity is asked of its factors first
REGULAR = 1e-6  # a block with a larger inverse condition number (1-norm, estimated) has no such value


@dataclass(frozen=True)
class RankDecomposition:
    """The rows r of junctions at one instant, M xi = -r, parted.

    hidden:  projector Q: Q r is what no xi can change (n x n)
    """

    hidden: csr_array
    _small: csr_array
    _large: list[tuple[Ints, Ints, Any]]

    def answer(self, r: Array) -> Array:
        """The smallest xi with M xi = -(1 - Q) r, for rows r (steps x n)."""
        xi = -(r @ self._small.T)
        for rows, columns, solve in self._large:
            xi[:, columns] -= solve(r[:, rows])
        return xi


def hidden_part(M: Any, nominal: Array) -> csr_array:
    """Projector Q: Q r is the part of the junction rows r that no xi can change (n x n).  M: array or sparse."""
    return rank_decomposition(M, nominal).hidden


def rank_decomposition(M: Any, nominal: Array) -> RankDecomposition:
    """M: array or sparse (n x n);  nominal: of the junction unknowns xi."""
    n = len(nominal)
    entries: Any = coo_array(M)
    entries.eliminate_zeros()
    biggest = np.zeros(n)
    values = entries.data * nominal[entries.col]
    np.maximum.at(biggest, entries.row, np.abs(values))
    d = 1.0 / np.where(biggest > 0, biggest, 1.0)
    scaled: Any = csr_array((values * d[entries.row], (entries.row, entries.col)), shape=(n, n))
    hidden, small, large = list[Part](), list[Part](), []
    for own, its in _blocks(scaled):
        block = scaled[own][:, its]
        if len(own) == len(its) > LARGE and _inverse_condition(csc_array(block)) > REGULAR:
            large.append((own, its, _solver(splu(csc_array(block)), d[own], nominal[its])))
            continue
        N, inverse = _null_and_inverse(block)
        if N.shape[1]:
            hidden.append((own, own, (N @ N.T) * d[own] / d[own, None]))
        small.append((its, own, inverse * d[own] * nominal[its, None]))
    return RankDecomposition(_assembled(n, hidden), _assembled(n, small), large)


def _solver(factors: Any, d: Array, nominal: Array) -> Callable[[Array], Array]:
    return lambda r: np.array([factors.solve(row) for row in r * d]).reshape(r.shape) * nominal  # a row by itself


def _assembled(n: int, parts: list[Part]) -> csr_array:
    none = [np.zeros(0)]
    rows = np.concatenate([np.repeat(r, len(c)) for r, c, _ in parts] or none).astype(int)
    columns = np.concatenate([np.tile(c, len(r)) for r, c, _ in parts] or none).astype(int)
    return csr_array((np.concatenate([e.ravel() for *_, e in parts] or none), (rows, columns)), shape=(n, n))


def _blocks(M: Any) -> list[tuple[Ints, Ints]]:
    """Rows that share columns, and these."""
    n = M.shape[0]
    if n == 0:
        return []
    count, label = connected_components(block_array([[None, M], [M.T, None]]), directed=False)
    order = np.argsort(label, kind="stable")
    groups = np.split(order, np.searchsorted(label[order], np.arange(1, count)))
    return [(g[g < n], g[g >= n] - n) for g in groups if (g < n).any()]


def _null_and_inverse(block: Any) -> tuple[Array, Array]:
    """Orthonormal N (rows x ..) with N^T block = 0, and the pseudo-inverse of the block."""
    rows, columns = block.shape
    if columns == 0:
        return np.eye(rows), np.zeros((0, rows))
    left, s, right = np.linalg.svd(block.toarray())
    rank = int((s > SINGULAR * s[0]).sum())
    return left[:, rank:], (right[:rank].T / s[:rank]) @ left[:, :rank].T


def _inverse_condition(A: Any) -> float:
    """1 / (|A| |A^-1|) in the 1-norm, estimated; 0 of a singular matrix."""
    try:
        factors = splu(A)
    except RuntimeError:
        return 0.0
    operator: Any = LinearOperator
    inverse = operator(A.shape, matvec=factors.solve, rmatvec=lambda b: factors.solve(b, "T"))
    norms: Any = onenormest(A), onenormest(inverse)
    return float(1.0 / (norms[0] * norms[1]))
