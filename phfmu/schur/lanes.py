"""Local functions of the Schur stepper: one point of a step each, evaluated at all its nodes at once.

An argument or result is either a lane (a value at every node and at the end point) or one number.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import casadi as ca
import numpy as np

from phfmu.declare.expressions.operations import ANALYTIC, degree
from phfmu.declare.variable import ValueKind
from phfmu.gradients.gradients import stress
from phfmu.gradients.quadrature import nodes
from phfmu.plan.differences import Differences, differences
from phfmu.terms.term import Term

EMPTY = ca.SX(0, 1)

#: operations that exist for lanes: those of vectors, and functions taken lane by lane
LANE_OPERATIONS = ANALYTIC - {
    ca.OP_ASIN, ca.OP_ACOS, ca.OP_ATAN, ca.OP_SINH, ca.OP_COSH, ca.OP_LOG1P, ca.OP_EXPM1, ca.OP_HYPOT,
    ca.OP_ERF, ca.OP_ASINH, ca.OP_ACOSH, ca.OP_ATANH,
}  # fmt: skip
#: operations of single numbers
OPERATIONS = ANALYTIC | {
    ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_NOT, ca.OP_AND, ca.OP_OR, ca.OP_IF_ELSE_ZERO, ca.OP_FABS,
}  # fmt: skip

#: kinds of functions of numbers
NUMBERS = ("start", "stress", "mass", "load")


@dataclass(frozen=True)
class LaneKernel:
    """One local function; `kind` names its arguments and results (d coordinates, e their rates):

    constraint  (d, e, p) -> (Dg, e^T D2g)            lanes
    strain      (d, p) -> DC                          lanes
    pointwise   (C, p) -> (phi', phi'')               lanes, phi of degree two: S_i = phi'(C_i)
    stress      (C at the start, increments of C at the k nodes, p) -> (S at the nodes, phi'' in the middle)   numbers
    start       (d, p) -> C                           numbers, at the start of the step
    force       (d, e, u, p) -> forces                lanes
    mass        (p) -> 1/m;   load  (p) -> constant forces   numbers
    """

    kind: str
    name: str
    function: ca.Function

    @property
    def nx(self) -> int:
        return self.function.numel_in(0) if self.kind not in ("stress", "mass", "load") else 0

    @property
    def nz(self) -> int:
        return self.function.numel_in(1) if self.kind == "force" else 0

    @property
    def nu(self) -> int:
        return self.function.numel_in(2) if self.kind == "force" else 0

    @property
    def np(self) -> int:
        return self.function.numel_in(self.function.n_in() - 1)

    @property
    def no(self) -> int:
        return self.function.numel_out(0)


class NoLanes(Exception):
    """A local function has an operation that lanes do not have."""


_kernels: dict[str, LaneKernel] = {}


def lane_kernel(kind: str, args: Sequence[ca.SX], results: Sequence[ca.SX]) -> LaneKernel:
    """The kernel of these expressions; equal content gives one object.  NoLanes if it cannot be evaluated in lanes."""
    f = ca.Function("f", list(args), [ca.densify(r) for r in results])
    require_lanes(kind, f)
    digest = hashlib.sha256((kind + f.serialize()).encode()).hexdigest()[:16]
    return _kernels.setdefault(digest, LaneKernel(kind, f"{kind}_{digest}", f))


def require_lanes(kind: str, f: ca.Function) -> None:
    """NoLanes for a function of a kind that has an operation which cannot be evaluated there."""
    if {f.instruction_id(i) for i in range(f.n_instructions())} - (OPERATIONS if kind in NUMBERS else LANE_OPERATIONS):
        raise NoLanes


def _p(term: Term) -> ca.SX:
    return term.symbols(ValueKind.PARAMETER)


@dataclass(frozen=True)
class Lanes:
    """The kernels of one kind of term with the coordinates of its positions, velocities and results."""

    kernels: tuple[LaneKernel, ...]
    x: Differences = Differences(())
    z: Differences = Differences(())
    o: Differences = Differences(())


def _singles(n: int) -> Differences:
    return Differences(tuple((j, -1) for j in range(n)))


def constraint(term: Term) -> Lanes:
    """Gradient of g and its derivative along v, both with respect to the coordinates."""
    q, g = term.local[ValueKind.STATE], term.data["g"]
    x = differences(ca.Function("g", [q, _p(term)], [g]), 0)
    d, back = x.substitution(q, "d")
    g, v = ca.substitute(g, q, back), ca.SX.sym("v", d.numel())
    grad = ca.gradient(g, d)
    return Lanes((lane_kernel("constraint", [d, v, _p(term)], [grad, ca.jtimes(grad, d, v)]),), x)


def strain(term: Term, k: int) -> Lanes:
    """Gradient of C, the stresses at the k nodes, and C itself, of a term phi(C(q))."""
    q, s = term.local[ValueKind.STATE], term.local[ValueKind.INVARIANT]
    x = differences(ca.Function("C", [q, _p(term)], [term.data["C"]]), 0)
    d, back = x.substitution(q, "d")
    c = ca.substitute(term.data["C"], q, back)
    gradient = lane_kernel("strain", [d, _p(term)], [ca.gradient(c, d)])
    return Lanes((gradient, _stresses(term.data["phi"], s, _p(term), k), lane_kernel("start", [d, _p(term)], [c])), x)


def _stresses(phi: ca.SX, s: ca.SX, p: ca.SX, k: int) -> LaneKernel:
    slope = ca.gradient(ca.gradient(phi, s), s)
    if (degree(phi, s) or 0) == 2:
        return lane_kernel("pointwise", [s, p], [ca.gradient(phi, s), slope])
    start, rate, nd = ca.SX.sym("c"), ca.SX.sym("r", k), nodes(k)
    node, _ = stress(phi, s, start, rate.T, nd)
    middle = start + ca.dot(ca.SX(ca.DM(nd.a[k // 2])), rate)
    return lane_kernel("stress", [start, rate, p], [node.T, ca.substitute(slope, s, middle)])


def potential(term: Term) -> Lanes:
    """Force -DV of a quadratic potential; a constant one is a load."""
    q = term.local[ValueKind.STATE]
    force = -ca.gradient(term.data["H"], q)
    if not ca.depends_on(force, q):
        return Lanes((lane_kernel("load", [_p(term)], [force]),), o=_singles(q.numel()))
    x = differences(ca.Function("f", [q, _p(term)], [force]), 0)
    return _force(term, {ValueKind.STATE: q}, force, x, Differences(()))


def flow(term: Term, outputs: Sequence[int]) -> Lanes:
    """The chosen outputs of a flow."""
    kinds = (ValueKind.STATE, ValueKind.COSTATE, ValueKind.INPUT)
    args = {kind: term.local[kind] for kind in kinds if kind in term.local}
    force = ca.vertcat(*(term.data["f"][j] for j in outputs))
    f = ca.Function("f", [*(args.get(kind, EMPTY) for kind in kinds), _p(term)], [force])
    return _force(term, args, force, differences(f, 0), differences(f, 1))


def _force(term: Term, args: dict[ValueKind, ca.SX], force: ca.SX, x: Differences, z: Differences) -> Lanes:
    """A force in the coordinates of its arguments; opposite results become one."""
    q, v = args.get(ValueKind.STATE, EMPTY), args.get(ValueKind.COSTATE, EMPTY)
    d, x_back = x.substitution(q, "d")
    e, z_back = z.substitution(v, "e")
    force = ca.substitute([force], [q, v], [x_back, z_back])[0] if q.numel() + v.numel() else force
    inputs = [d, e, args.get(ValueKind.INPUT, EMPTY), _p(term)]
    o = _opposites(ca.Function("f", inputs, [ca.densify(force)]))
    chosen = ca.vertcat(*(force[plus] for plus, _ in o.pairs))
    return Lanes((lane_kernel("force", inputs, [chosen]),), x, z, o)


def _opposites(f: ca.Function) -> Differences:
    """Pairs of results that add up to zero, found by sampling."""
    rng = np.random.default_rng(1)
    values = np.array([np.asarray(f.call([rng.uniform(0.5, 1.5, f.numel_in(i)) for i in range(f.n_in())])[0]).ravel()
                       for _ in range(2)])  # fmt: skip
    free, pairs = list(range(values.shape[1])), []
    while free:
        a = free.pop(0)
        b = next((b for b in free if np.allclose(values[:, a], -values[:, b], rtol=1e-12, atol=1e-14)), -1)
        if b >= 0:
            free.remove(b)
        pairs.append((a, b))
    return Differences(tuple(pairs))


def mass(term: Term) -> Lanes:
    """The inverse 1/m of a mass."""
    return Lanes((lane_kernel("mass", [_p(term)], [1 / term.data["m"]]),), o=_singles(1))


def no_mass(term: Term) -> bool:
    """True if a mass is zero whatever the parameters are."""
    return ca.SX(term.data["m"]).is_zero()


@cache
def spectrum(k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A^-2 = T M T^-1 in real form: M as (real, re, im) of its eigenvalues, T and T^-1 (k = 1 or 3)."""
    value, vector = np.linalg.eig(np.linalg.matrix_power(np.linalg.inv(nodes(k).a), 2))
    if k == 1:
        return np.real(value), np.eye(1), np.eye(1)
    real, upper = int(np.argmin(np.abs(np.imag(value)))), int(np.argmax(np.imag(value)))
    pair = vector[:, upper]
    t = np.column_stack([np.real(vector[:, real]), 2 * np.real(pair), -2 * np.imag(pair)])
    found = [np.real(value)[real], np.real(value)[upper], np.imag(value)[upper]]
    return np.array(found), t, np.linalg.inv(t)
