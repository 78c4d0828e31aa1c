"""Blocks of the structure matrix J and of the dissipation matrix R."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca

from phfmu.declare.entries.coefficients import coefficient
from phfmu.declare.entries.copies import copied
from phfmu.declare.error import DeclarationError
from phfmu.declare.port import Port
from phfmu.declare.variable import Variable, _sx


@dataclass(frozen=True, eq=False)
class Block:
    """A square block of J or R on the rows and columns of `variables` (stacked).

    Ports among them give feedthrough.  With blocks Gamma of J (skew) and W of R (symmetric) on variables and ports,

        [E x'; -y] = (Gamma - W) [z; u],   Gamma = [J, B; -B^T, -N],   W = [R, P; P^T, S],   that is
        E x' = (J - R) z + (B - P) u,      y = (B + P)^T z + (S + N) u,

    and H' = -[z; u]^T W [z; u] + y^T u, passive if W is positive semidefinite.
    Source: Mehrmann, Unger, Acta Numerica 32 (2023), Definition 4.1.

    value:   the n x n block, or with a factor the r x r matrix between it and its transpose
    factor:  None, or G (r x n): the block is G^T value G.  One of R acts by G z then, and its entries are never formed:
             f = -G^T (W (G z)), and the power it takes is (G z)^T W (G z), which is not negative whatever G is
    """

    variables: tuple[Variable | Port, ...]
    value: ca.SX
    owner: str = ""
    factor: ca.SX | None = None

    @cached_property
    def matrix(self) -> ca.SX:
        """Its entries, n x n."""
        return self.value if self.factor is None else ca.mtimes([self.factor.T, self.value, self.factor])

    @cached_property
    def pattern(self) -> ca.DM:
        """Places of its entries that are not zero by their structure."""
        one = ca.DM(self.value.sparsity(), 1.0)
        if self.factor is None:
            return one
        outer = ca.DM(self.factor.sparsity(), 1.0)
        return ca.mtimes([outer.T, one, outer])

    @property
    def n(self) -> int:
        """Its number of rows."""
        return (self.value if self.factor is None else self.factor).shape[1]

    @property
    def parts(self) -> list[ca.SX]:
        """The expressions that it is made of."""
        return [self.value] if self.factor is None else [self.value, self.factor]

    def mapped(self, image: Callable[[Any], Any]) -> Block:
        """A copy on the images of its variables and ports."""
        return copied(self, variables=tuple(map(image, self.variables)))

    def changed(self, change: Callable[[ca.SX], ca.SX]) -> Block:
        """A copy with other expressions."""
        return replace(self, value=change(self.value), factor=None if self.factor is None else change(self.factor))

    def on(self, rows: Sequence[int]) -> Block:
        """A copy with those entries only that stand in these rows and columns."""
        if self.factor is not None:
            factor = ca.SX(*self.factor.shape)
            factor[:, rows] = self.factor[:, rows]
            return replace(self, factor=ca.sparsify(factor))
        value = ca.SX(*self.value.shape)
        value[rows, rows] = self.value[rows, rows]
        return replace(self, value=ca.sparsify(value))


def block(variables: Sequence[Variable | Port], matrix: Any, *, factor: Any = None, owner: str = "") -> Block:
    """A block of R (symmetric, positive semidefinite) or J (skew) on the stacked `variables` and ports.

    factor:  G (r x n), the block is G^T matrix G: of a damper the row of the rate G z that it brakes, its `matrix` the
             coefficient.  A number is that multiple of the r x r identity then

    Errors: DeclarationError if the shapes of factor, matrix and variables do not fit.
    """
    on, value = tuple(variables), ca.SX(_sx(matrix))
    if factor is None:
        return Block(on, value, owner)
    g, n = ca.sparsify(ca.SX(_sx(factor))), sum(v.n for v in on)
    value = ca.sparsify(coefficient(value, g.shape[0], g.shape[0]))
    if g.shape[1] != n or value.shape != (g.shape[0], g.shape[0]):
        raise DeclarationError(
            f"block on {', '.join(v.name for v in on)}",
            f"its factor is {g.shape[0]} x {g.shape[1]} and its matrix {value.shape[0]} x {value.shape[1]}",
            f"give the factor {n} columns, one for each entry of these variables, and the matrix a row and a column for each row "
            "of the factor",
            "shape",
        )
    return Block(on, value, owner, g)


def skew(rows: Variable | Port, cols: Variable | Port, matrix: Any, *, owner: str = "") -> Block:
    """The block of J with J[rows, cols] = matrix and J[cols, rows] = -matrix^T: it carries energy between them, and keeps it.

        rows' = ... + matrix z_cols,    cols' = ... - matrix^T z_rows

    skew(q, p, 1) is q' = z_p, p' = -z_q: velocity in the row of the position, minus the force in that of the momentum.
    skew(a, b, n) with a number n > 0 and H = (a^2 + b^2)/2 turns the point (a, b) with the rate n from the axis of b to that
    of a: clockwise where a points right and b up.  skew(b, a, n) = skew(a, b, -n) turns it the other way.

    matrix:  rows.n x cols.n, may depend on x, z, parameters, inputs and time; a number on variables of equal size is that
             multiple of the identity
    """
    g = ca.SX(_sx(matrix))
    if g.numel() == 1 and rows.n == cols.n > 1:
        g = g * ca.SX.eye(rows.n)
    top = ca.horzcat(ca.SX(rows.n, rows.n), g)
    return Block((rows, cols), ca.vertcat(top, ca.horzcat(-g.T, ca.SX(cols.n, cols.n))), owner)


def damping(variable: Variable | Port, value: Any, *, owner: str = "") -> Block:
    """The block R = diag(value) on `variable`; on a port: the feedthrough y = diag(value) u."""
    v = ca.SX(_sx(value))
    v = ca.repmat(v, variable.n) if v.numel() == 1 else v
    return Block((variable,), ca.diag(v), owner)
