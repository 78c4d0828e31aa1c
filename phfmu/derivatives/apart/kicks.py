"""Derivatives of the impulses at the ports of a member: of the states that they move, of their work, of what makes them neutral.

x* = x + L(x, p) s,     work s . mean(y),     y(x, p) at the end of a step,     S(x, p) v for given v.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.declare.phdae import PHDAE
from phfmu.derivatives.plan_function import PointwiseFunction
from phfmu.engine.impulses import port_kernels

Array = NDArray[np.float64]


class KickSlopes:
    """Impulses of one member (n) and `vectors` many v, derived by its states, the parameters at some places, and s."""

    def __init__(self, declaration: PHDAE, parameters: Sequence[int], vectors: int):
        kernels = port_kernels(declaration)
        f, own = kernels.forms, list(parameters)
        self.n, self.vectors = kernels.n, vectors
        self.states, self.pairs = list(f.states), list(f.pairs)
        s, v = ca.SX.sym("s", self.n), ca.SX.sym("v", self.n * vectors)
        shift, mean = kernels.shift.call([f.x, f.p, s])
        moved = ca.vertcat(shift, s * mean)
        by = ca.horzcat(ca.jacobian(moved, f.x), ca.jacobian(moved, f.p[own]), ca.jacobian(moved, s))
        self._kick = PointwiseFunction([f.x, f.p, s], [moved, by])
        held = ca.vec(ca.mtimes(f.S, ca.reshape(v, self.n, vectors)))
        told = ca.vertcat(f.y, held)
        self._end = PointwiseFunction([f.x, f.p, v], [ca.horzcat(ca.jacobian(told, f.x), ca.jacobian(told, f.p[own]))])
        self._jump = PointwiseFunction([f.x, f.p], [f.S])

    def kick(self, x: Array, p: Array, s: Array) -> tuple[Array, Array]:
        """Changes of the moved states (n x states), and derivatives of them and of the works by [x | parameters | s]."""
        moved, by = self._kick.at((x, p, s))
        return moved.full()[:, : len(self.states), 0], by.full()

    def end(self, x: Array, p: Array, v: Array) -> tuple[Array, Array]:
        """Derivatives of y, and of S v (n x vectors x impulses) for v (n x vectors x impulses), by [x | parameters]."""
        found = self._end.at((x, p, v.reshape(len(x), -1)))[0].full()
        return found[:, : self.n], found[:, self.n :].reshape(len(x), self.vectors, self.n, -1)

    def jump(self, x: Array, p: Array) -> Array:
        """S (n x impulses x impulses)."""
        return self._jump.at((x, p))[0].full()
