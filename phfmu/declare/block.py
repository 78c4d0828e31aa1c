"""Blocks of the structure matrix J and of the dissipation matrix R."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca

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
    """

    variables: tuple[Variable | Port, ...]
    matrix: ca.SX
    owner: str = ""

    def mapped(self, image: Callable[[Any], Any]) -> Block:
        """A copy on the images of its variables and ports."""
        return replace(self, variables=tuple(map(image, self.variables)))


def block(variables: Sequence[Variable | Port], matrix: Any, *, owner: str = "") -> Block:
    """A block of R (symmetric, positive semidefinite) or J (skew) on the stacked `variables` and ports."""
    return Block(tuple(variables), ca.SX(_sx(matrix)), owner)


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
