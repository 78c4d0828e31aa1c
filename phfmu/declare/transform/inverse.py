"""Inverses of matrices of expressions, block by block."""

from __future__ import annotations

import casadi as ca
import numpy as np

from phfmu.declare.error import DeclarationError


def inverted(matrix: ca.SX) -> ca.SX:
    """The inverse of a matrix of expressions, block by block where rows and columns fall apart."""
    matrix = ca.sparsify(matrix)
    out = ca.SX(*matrix.shape)
    for rows, cols in blocks(matrix):
        if len(rows) != len(cols):
            raise DeclarationError(
                f"a {matrix.shape[0]} x {matrix.shape[1]} matrix to be inverted",
                f"rows {rows} and columns {cols} meet: structurally singular",
                "give it as many rows as columns with entries in common",
                "singular",
            )
        part = matrix[rows, cols]
        numbers = part.is_constant()
        value = ca.SX(np.linalg.inv(np.array(ca.DM(part)))) if numbers else _inverse(part)
        for r, i in enumerate(cols):
            for c, j in enumerate(rows):
                out[i, j] = value[r, c]
    return ca.sparsify(out)


def _inverse(matrix: ca.SX) -> ca.SX:
    return ca.inv_minor(matrix) if matrix.shape[0] <= 3 else ca.solve(matrix, ca.SX.eye(matrix.shape[0]))


def blocks(matrix: ca.SX) -> list[tuple[list[int], list[int]]]:
    """Connected sets of rows and columns of the sparsity pattern, in order of their first row; then lone columns."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    n, m = matrix.shape
    rows, cols = matrix.sparsity().get_triplet()
    pattern = coo_matrix((np.ones(len(rows)), (rows, [n + c for c in cols])), shape=(n + m, n + m))
    count, label = connected_components(pattern, directed=False)
    found = [(np.flatnonzero(label[:n] == k).tolist(), np.flatnonzero(label[n:] == k).tolist()) for k in range(count)]
    return found
