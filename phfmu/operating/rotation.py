"""Equations of a member and the rotation that its balanced motions are orbits of.

A balanced component looks the same when its three phases are turned: if every three-phase port turns by
G = d/d(angle), its states turn by X(x) = S x + c.  A steady state at the angular frequency w is a motion along
this rotation,

    x'(0) = f(x, a, u) = w (S x + c),

so that it is the solution of algebraic equations at one instant.  S and c follow from the declaration alone: the
equations must be equivariant, which is linear in S and c (and in the rotation T a + e of the algebraic variables).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, log2, sqrt
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.declare.phdae import PHDAE
from phfmu.declare.port import ELECTRICAL, Port
from phfmu.declare.variable import time
from phfmu.signals import ordered_ports
from phfmu.terms.extraction.extract import extract
from phfmu.terms.rows import costate_symbols, costates, flow_expressions, output_expressions
from phfmu.terms.term import CONSTRAINT

Array = NDArray[np.float64]

#: generator of the rotation of phases a, b, c: it takes cos(t - alpha) to its derivative, alpha = 0, 2 pi/3, -2 pi/3
TURN = np.array([[0.0, -1.0, 1.0], [1.0, 0.0, -1.0], [-1.0, 1.0, 0.0]]) / sqrt(3.0)
#: orthonormal basis of the balanced quantities: cos and sin of the angle of phase a, without zero sequence
BALANCED = sqrt(2.0 / 3.0) * np.array([[1.0, 0.0], [-0.5, sqrt(0.75)], [-0.5, -sqrt(0.75)]])
#: of the residual of equivariance, relative to its terms, above which a member has no such rotation
EQUIVARIANT = 1e-8
#: entries of S and c that are rounding
ROUNDING = 1e-11
#: terms of the series of an exponential: the next one of a matrix of norm 1 is below rounding
SERIES = 20


def three_phase(port: Port) -> bool:
    """Whether the entries of the port are the phases of a three-phase system."""
    return port.domain.name == ELECTRICAL.name and port.size == 3


@dataclass(frozen=True)
class Sizes:
    """Numbers of states, algebraic variables, scalar pairs, parameters and observables that are read."""

    x: int
    a: int
    u: int
    p: int
    seen: int

    @property
    def z(self) -> int:
        """Entries of (x, a, u, p)."""
        return self.x + self.a + self.u + self.p

    @property
    def rows(self) -> int:
        """Entries of (f, r, y, seen)."""
        return self.x + self.a + self.u + self.seen


class MemberEquations:
    """The equations out = (f, r, y, seen) of alike members in z = (x, a, u, p) at t = 0, with their Jacobian, and their rotation.

    f: rates of the states, r: algebraic rows, y: outputs of all pairs, seen: the observables that signals read.
    Ports that are fed from inside have their source in the place of u.  `S` (nx x nx), `c` (nx): the rotation;
    `asymmetry`: largest residual of equivariance, relative to its terms.
    """

    def __init__(self, model: PHDAE, read: Sequence[str] = ()):
        terms = extract(model)
        if terms.of(CONSTRAINT) or model.closed:
            what = "holonomic constraints" if terms.of(CONSTRAINT) else "a closed pair of E and z"
            raise ValueError(
                f"operating point: {model.name} has {what}, which have no such equations; use other coordinates"
            )
        self.ports = ordered_ports(model)
        z = costate_symbols(model)
        x, a, p = model.x, _stack(v.sx for v in model.algebraics), _stack(v.sx for v in model.parameters)
        u = ca.SX.sym("u", len(terms.pairs))
        f, r = flow_expressions(terms, z, u)
        y = _stack(output_expressions(terms, range(len(terms.pairs)), z, u).values())
        told = {n: e for o in model.observables for n, e in zip(o.names(), ca.vertsplit(ca.SX(o.expr)), strict=True)}
        told |= {n: v.sx[i] for v in (*model.states, *model.algebraics) for i, n in enumerate(v.names())}
        told |= {n: y[k + i] for port, k in self.ports for i, n in enumerate(port.output_names())}
        seen = _stack(told[n] for n in read)
        out = ca.substitute([f, r, y, seen], [z], [costates(terms)])
        self.size = Sizes(x.numel(), a.numel(), u.numel(), p.numel(), seen.numel())
        free = ca.Function("free", [x, a, u, p], [ca.vertcat(*out[:3])])
        sources = {k: _source(port) for port, k in self.ports if port.source is not None}
        fed = ca.SX(u)
        for k, source in sources.items():
            fed[k : k + source.numel()] = source
        whole = ca.substitute(ca.substitute(ca.vertcat(*out), u, fed), time, 0)
        #: first pair of each port that is fed from inside -> function of p: its source and its derivative by time, at t = 0
        self.sources = {
            k: ca.Function("source", [p], ca.substitute([s, ca.jacobian(s, time)], [time], [ca.SX(0)]))
            for k, s in sources.items()
        }
        stacked = ca.vertcat(x, a, u, p)
        jacobian = ca.jacobian(whole, stacked)
        self.pattern = tuple(np.array(i) for i in jacobian.sparsity().get_triplet())
        self._function = ca.Function("equations", [stacked], [whole, jacobian])
        self.free = ca.Function(
            "free", [x, a, u, p], [free(x, a, u, p), ca.jacobian(free(x, a, u, p), ca.vertcat(x, a, u))]
        )
        self.S, self.c, self.asymmetry = self._rotation(model)

    def evaluate(self, z: Array) -> tuple[Array, Array]:
        """out (m x rows) and the nonzeros of its Jacobian (m x nnz), in the order of `pattern`, of m members."""
        out, jacobian = self._function.map(len(z))(z.T)
        return np.array(out.full()).T, np.array(jacobian.nonzeros()).reshape(len(z), -1)

    def turn_of_inputs(self) -> Array:
        """G on the three-phase pairs, 0 on all others (nu x nu)."""
        turn = np.zeros((self.size.u, self.size.u))
        for port, k in self.ports:
            if three_phase(port):
                turn[k : k + 3, k : k + 3] = TURN
        return turn

    def _nominal(self, model: PHDAE) -> Array:
        """Nominal sizes of x, a and u."""
        sizes = [v.nominal for v in (*model.states, *model.algebraics)]
        ports = [np.broadcast_to(np.asarray(port.nominal, float), port.n) for port, _ in self.ports]
        nominal = np.abs(np.concatenate([np.zeros(0), *(np.atleast_1d(s) for s in sizes), *ports]))
        return np.where(nominal == 0, 1.0, nominal)

    def _samples(self, model: PHDAE, count: int):
        """Values and Jacobians of (f, r, y) at random points of nominal size: x, a, u, out, J, size of the terms."""
        rng, n = np.random.default_rng(0), self.size
        scale = self._nominal(model)
        p = np.array([s for v in model.parameters for s in v.start])
        for _ in range(count):
            point = scale * rng.normal(size=len(scale))
            x, a, u = np.split(point, [n.x, n.x + n.a])
            out, J = (np.array(m.full()) for m in self.free(x, a, u, p))
            yield x, a, u, out.ravel(), J, np.abs(J) @ scale + 1e-300

    def _rotation(self, model: PHDAE) -> tuple[Array, Array, float]:
        """S, c and what equivariance misses: least squares over random points, in which algebraic variables and rows turn too."""
        n, turn = self.size, self.turn_of_inputs()
        parts = np.cumsum([n.x * n.x, n.x, n.a * n.a, n.a])
        rows, rights = [], []
        for x, a, u, out, J, scale in self._samples(model, 3 + 2 * (n.x + n.a)):
            f, r, y = np.split(out, [n.x, n.x + n.a])
            Jx, Ja, Ju = np.split(J, [n.x, n.x + n.a], axis=1)
            A = np.zeros((len(out), parts[-1] + n.a * n.a))
            A[:, : parts[0]] = (Jx[:, :, None] * x).reshape(len(out), -1)
            A[:, parts[0] : parts[1]] = Jx
            A[:, parts[1] : parts[2]] = (Ja[:, :, None] * a).reshape(len(out), -1)
            A[:, parts[2] : parts[3]] = Ja
            for i in range(n.x):
                A[i, i * n.x : (i + 1) * n.x] -= f
            for i in range(n.a):
                A[n.x + i, parts[3] + i * n.a : parts[3] + (i + 1) * n.a] -= r
            right = -Ju @ (turn @ u)
            right[n.x + n.a :] += turn @ y
            rows.append(A / scale[:, None])
            rights.append(right / scale)
        A, b = np.vstack(rows), np.concatenate(rights)
        if not A.size:
            return np.zeros((n.x, n.x)), np.zeros(n.x), 0.0
        column = np.abs(A).max(axis=0)
        column[column == 0] = 1.0
        found = np.linalg.lstsq(A / column, b, rcond=1e-11)[0]
        missed = float(np.abs(A / column @ found - b).max())
        S, c, *_ = np.split(found / column, parts)
        S, size = S.reshape(n.x, n.x), self._nominal(model)[: n.x]
        S[np.abs(S) * size < ROUNDING * size[:, None]] = 0.0
        c[np.abs(c) < ROUNDING * size] = 0.0
        return S, c, missed

    def turn(self, angle: float) -> tuple[Array, Array]:
        """A (nx x nx) and b (nx): states A x + b after a rotation of the phases by `angle` [rad]."""
        A, b = self.turns([angle])
        return A[0], b[0]

    def turns(self, angles: Sequence[float]) -> tuple[Array, Array]:
        """A (m x nx x nx) and b (m x nx) of the rotations by m angles [rad]: exp(angle [S, c; 0, 0]), all at once.

        The series of the exponential, whose powers of the matrix all angles share, at an angle halved until its terms
        fall from the first on; squared as many times.
        """
        n, turned = self.size.x, np.asarray(angles, np.float64)
        whole = np.zeros((n + 1, n + 1))
        whole[:n, :n], whole[:n, n] = self.S, self.c
        reach = float(np.abs(turned).max(initial=0.0)) * float(np.abs(whole).sum(axis=0).max())
        halvings = max(0, ceil(log2(reach))) if reach > 0.0 else 0
        powers = [np.eye(n + 1)]
        for k in range(1, SERIES):
            powers.append(powers[-1] @ whole / k)
        shares = (turned / 2.0**halvings)[:, None] ** np.arange(SERIES)
        found = np.einsum("mk,kij->mij", shares, np.array(powers))
        for _ in range(halvings):
            found = found @ found
        return found[:, :n, :n], found[:, :n, n]

    def turned(self, x: Any, angle: float) -> Array:
        """The states after a rotation of the phases by `angle` [rad]."""
        A, b = self.turn(angle)
        return A @ np.asarray(x, np.float64) + b


def _source(port: Port) -> ca.SX:
    """The expressions of time and parameters that feed the pairs of a port."""
    source = ca.SX(port.source)
    return ca.repmat(source, port.n) if source.numel() < port.n else source


def _stack(parts: Any) -> ca.SX:
    return ca.vertcat(ca.SX(0, 1), *parts)
