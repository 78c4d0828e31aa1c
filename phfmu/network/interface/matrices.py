"""Matrices of junction rows: arrays where there are few unknowns, sparse where there are many."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, csr_array, diags_array, issparse

Array = NDArray[Any]
#: rows, columns and entries (rows x columns) of a part of a matrix
Part = tuple[Array, Array, Array]

DENSE = 64  # most junction unknowns whose matrices are arrays


def small(C: Any) -> Any:
    """A sparse matrix as it is multiplied with fastest: an array of no more than 64 unknowns."""
    return C.toarray() if C.shape[0] <= DENSE else C


def assembled(C: Any, parts: Iterable[Part]) -> Any:
    """C, as `small` makes it, and parts of its size, added: an array, or a csc_array of more than 64 unknowns."""
    n = C.shape[0]
    if n <= DENSE:
        matrix = C.copy()
        for rows, columns, entries in parts:
            matrix[rows[:, None], columns] += entries
        return matrix
    return csc_array(C + summed(n, parts))


def summed(n: int, parts: Iterable[Part]) -> csr_array:
    """Parts added (n x n); exact zeros are no entries."""
    found, none = list(parts), [np.zeros(0)]
    rows = np.concatenate([np.repeat(r, len(c)) for r, c, _ in found] or none).astype(int)
    columns = np.concatenate([np.tile(c, len(r)) for r, c, _ in found] or none).astype(int)
    entries = np.concatenate([e.ravel() for _, _, e in found] or none)
    out = csr_array((entries, (rows, columns)), shape=(n, n))
    out.eliminate_zeros()
    return out


def update(matrix: Any, r: Array) -> Array:
    """dxi of matrix dxi = -r with rows scaled by their largest entries; LinAlgError if it is singular."""
    if not issparse(matrix):
        scale = 1.0 / np.maximum(np.abs(matrix).max(axis=1), 1e-300)
        return np.linalg.solve(matrix * scale[:, None], -r * scale)
    from scipy.sparse.linalg import splu

    scale = 1.0 / np.maximum(abs(matrix).max(axis=1).toarray().ravel(), 1e-300)
    try:
        return splu(csc_array(diags_array(scale) @ matrix)).solve(-r * scale)
    except RuntimeError as error:  # exactly singular
        raise np.linalg.LinAlgError(str(error)) from None
