"""Null spaces of small matrices that may be singular: their bases, and solutions of least norm."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: singular values below this part of the largest are none
RANK = 1e-10


def scaled_rows(matrix: Array) -> Array:
    """Rows divided by their largest entry, without those that are zero."""
    largest = np.abs(matrix).max(axis=1, initial=0)
    return matrix[largest > 0] / largest[largest > 0, None]


def null_space(matrix: Array, n: int) -> Array:
    """An orthonormal basis of the null space of rows of length n, a column each."""
    if not matrix.size:
        return np.eye(n)
    _, values, v = np.linalg.svd(matrix)
    rank = int((values > RANK * max(values[0], 1.0)).sum())
    return v[rank:].T


def apart(N: Array) -> Array:
    """Orthonormal columns with the same span: those that share no entries stay apart."""
    parts, left = [], list(range(len(N)))
    coupled = np.abs(N @ N.T) > RANK
    while left:
        group, queue = set(), [left[0]]
        while queue:
            i = queue.pop()
            if i not in group:
                group.add(i)
                queue += [j for j in left if coupled[i, j]]
        left = [i for i in left if i not in group]
        rows = sorted(group)
        own = np.zeros_like(N)
        own[rows] = N[rows]
        u, s, _ = np.linalg.svd(own, full_matrices=False)
        parts.append(u[:, s > 0.5])
    return np.hstack(parts) if parts else N


def pivots(N: Array) -> list[int]:
    """A row for each column, so that the matrix of these rows is regular."""
    left, out = N.copy(), []
    for j in range(N.shape[1]):
        i = int(np.argmax(np.abs(left[:, j])))
        out.append(i)
        left[:, j + 1 :] -= np.outer(left[:, j], left[i, j + 1 :] / left[i, j])
        left[i] = 0.0
    return out


def inverse(S: Array) -> Array:
    """Inverse of a square matrix, scaled; of what depends on each other that which is least in norm."""
    scale = np.sqrt(np.maximum(np.abs(np.diag(S)), np.finfo(float).tiny))
    if len(S) == 1 and S[0, 0] != 0.0:
        return 1.0 / S
    return np.linalg.pinv(S / np.outer(scale, scale), rcond=RANK) / np.outer(scale, scale)
