"""The short forms in which blocks of a declaration may be given."""

from __future__ import annotations

from typing import Any

import casadi as ca

from phfmu.declare.variable import Variable, _sx


def stacked(where: Variable | tuple[Variable, ...]) -> tuple[Variable, ...]:
    """The variables a block of E stands on."""
    return (where,) if isinstance(where, Variable) else tuple(where)


def square(value: Any, n: int) -> ca.SX:
    """A block of E in full: a scalar is a multiple of the identity, a column is a diagonal; zeros are left out."""
    matrix = ca.sparsify(ca.SX(_sx(value)))
    if matrix.numel() == 1 and n > 1:
        return matrix * ca.SX.eye(n)
    return ca.diag(matrix) if matrix.shape == (n, 1) and n > 1 else matrix


def coefficient(value: Any, rows: int, cols: int) -> ca.SX:
    """A block of B in full: a scalar between a variable and a port of equal size is a multiple of the identity."""
    matrix = ca.SX(_sx(value))
    return matrix * ca.SX.eye(rows) if matrix.numel() == 1 and rows == cols > 1 else matrix
