"""Is a symmetric matrix of numbers positive semidefinite, and if not, along which direction?"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import eigsh, splu

Array = NDArray[Any]
#: scipy.sparse.csc_matrix, whose stubs know no shape
Sparse = Any

#: of the numbers compared: an eigenvalue of the balanced matrix above this fraction of the largest, negative, is rounding
RELATIVE = 1e-9
#: larger parts are factorised instead of diagonalised
DENSE = 400


def csc(value: Any, dtype: Any = None) -> Sparse:
    """A sparse matrix in compressed columns."""
    return sp.csc_matrix(value, dtype=dtype)


def parts(matrix: Sparse) -> list[Array]:
    """Connected components of a pattern: indices of rows and columns that share entries."""
    count, label = connected_components(matrix, directed=False)
    order = np.argsort(label, kind="stable")
    return np.split(order, np.cumsum(np.bincount(label, minlength=count))[:-1])


def descent(matrix: Sparse) -> tuple[float, Array] | None:
    """v^T W v and the unit vector v along which a symmetric W is most negative, None if W is semidefinite.

    Rows are balanced first, so that units do not count: a congruence keeps the signs of eigenvalues.
    """
    worst, found = 0.0, None
    for where in parts(matrix):
        block = csc(matrix[where][:, where])
        size = _sizes(block)
        scaling = sp.diags(1 / size)
        balanced = csc(scaling @ block @ scaling)
        w = _lowest(balanced)
        if w is None or w[0] >= worst:
            continue
        worst = w[0]
        v = np.zeros(matrix.shape[0])
        v[where] = _direction(block, w[1] / size)
        found = float(v @ (matrix @ v)), v
    return found


def _sizes(block: Sparse) -> Array:
    diagonal = np.abs(block.diagonal())
    size = np.sqrt(np.where(diagonal > 0, diagonal, np.asarray(abs(block).max(axis=1).todense()).ravel()))
    return np.where(size > 0, size, 1.0)


def _lowest(balanced: Sparse) -> tuple[float, Array] | None:
    """The lowest eigenvalue and its vector if it is negative beyond rounding."""
    n = balanced.shape[0]
    if n <= DENSE:
        values, vectors = np.linalg.eigh(balanced.toarray())
        return (values[0], vectors[:, 0]) if values[0] < -RELATIVE * max(values[-1], 1.0) else None
    shift = RELATIVE * max(abs(balanced).sum(axis=0).max(), 1.0)
    if _pivots_positive(csc(balanced + shift * sp.eye(n))):
        return None
    values, vectors = eigsh(balanced, k=1, which="SA", tol=1e-3)  # pyright: ignore[reportArgumentType]
    return float(values[0]), vectors[:, 0]


def _pivots_positive(matrix: Sparse) -> bool:
    """All pivots of the symmetric elimination are positive: the matrix is positive definite."""
    try:
        lu = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    except RuntimeError:  # exactly singular
        return False
    return bool(np.array_equal(lu.perm_r, lu.perm_c) and (lu.U.diagonal() > 0).all())


def _direction(block: Sparse, v: Array) -> Array:
    """The eigenvector of the block itself where it shows the same, else `v`."""
    if len(v) <= DENSE:
        values, vectors = np.linalg.eigh(block.toarray())
        if values[0] < -RELATIVE * abs(values[-1]):
            return vectors[:, 0]
    return v / np.linalg.norm(v)


def in_words(v: Array, names: Sequence[str]) -> str:
    """The largest entries of a direction, e.g. `0.83 p[1] - 0.55 p[2]`."""
    order = [i for i in np.argsort(-np.abs(v), kind="stable") if abs(v[i]) > 1e-3 * np.abs(v).max()]
    sign = 1.0 if v[order[0]] > 0 else -1.0
    words = [f"{'-' if sign * v[i] < 0 else '+'} {abs(v[i]):.3g} {names[i]}" for i in order[:5]]
    rest = f" + .. ({len(order) - 5} more)" if len(order) > 5 else ""
    return " ".join(words).removeprefix("+ ") + rest
