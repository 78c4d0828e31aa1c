"""The derivative of entering a mode of ideal switches: what the constraints of the mode do to the states at an event.

The states move along what the algebraic variables act on, by impulses j that the rows of the mode leave open, until these hold:

    E (x+ - x) = f_a j,    g_a j = 0,    g(x+, a) = 0 for some a,

with f_a and g_a at x.  All three are derived; where impulses or variables have several solutions the states have one.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.declare.variable import time
from phfmu.derivatives.by import TangentDirections
from phfmu.derivatives.event_maps import EventInstant, Slope
from phfmu.events.modes import Modes

Array = NDArray[np.float64]

#: singular values below this part of the largest are none
RANK = 1e-10


class ModeEntry:
    """Entering the modes of a model, along `directions`."""

    def __init__(self, modes: Modes, directions: TangentDirections):
        system, self._directions = modes.system, directions
        e = system.equations
        fa, g, ga, mass = e.rows[2], e.rows[3], e.rows[5], e.rows[-1]
        nx, na = e.x.numel(), e.a.numel()
        after, j, b = ca.SX.sym("after", nx), ca.SX.sym("j", na), ca.SX.sym("b", na)
        there = ca.substitute(ca.densify(g), ca.vertcat(e.x, e.a), ca.vertcat(after, ca.SX.zeros(na)))
        rows = ca.vertcat(
            ca.densify(mass) * (after - e.x) - ca.mtimes(ca.densify(fa), j),
            ca.mtimes(ca.densify(ga), j),
            there + ca.mtimes(ca.densify(ga), b),
        )
        found, given = ca.vertcat(after, j, b), ca.vertcat(e.x, time, e.p, e.u)
        out = [ca.jacobian(rows, found), ca.jacobian(rows, given), fa, ga, mass]
        arguments = [e.x, e.a, e.u, e.p, time, after, j, b]
        self._function = ca.Function("entry", arguments, [ca.densify(o) for o in ca.cse([ca.SX(o) for o in out])])
        self._scale = np.concatenate([system.size, system.nominal, system.nominal])
        self._size, self._nominal = system.size, system.nominal

    def slope(self, before: EventInstant, after: Array) -> Slope:
        """Derivatives of the states after entering by those before it, with the parameters of the mode that is entered."""
        nx, na = len(before.x), len(before.a)
        nothing = np.zeros(na)

        def at(j: Array, b: Array) -> list[Array]:
            found = self._function(before.x, before.a, before.u, before.p, before.t, after, j, b)
            return [np.array(v) for v in found]

        _, _, fa, ga, mass = at(nothing, nothing)
        push = _solved(
            np.vstack([fa, ga]), np.concatenate([mass.ravel() * (after - before.x), nothing])[:, None], self._nominal
        )
        own, given, *_ = at(push[:, 0], nothing)
        x = -_solved(own, given, self._scale)[:nx]
        _, p, u = np.split(x, [nx + 1, nx + 1 + len(before.p)], axis=1)
        return Slope(x[:, :nx], x[:, nx], self._directions.of(p, u))


def _solved(A: Array, b: Array, scale: Array) -> Array:
    """The least solution in units of `scale` of A x = b, whose rows are scaled."""
    scaled = A * scale
    largest = np.abs(scaled).max(axis=1, initial=0.0)
    there = largest > 0.0
    scaled, right = scaled[there] / largest[there, None], b[there] / largest[there, None]
    return np.linalg.lstsq(scaled, right, rcond=RANK)[0] * scale[:, None]
