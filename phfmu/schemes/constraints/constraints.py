"""Holonomic constraints g(q, t) = 0: discrete Jacobians, and the two-level form that also keeps Dg v + g_t = 0.

Collocated:  G_i z_v,i + r_i = 0 with a discrete Jacobian G_i and rate r_i, so g is exact; Dg v is not.
Two-level (GGL form, odd k): with a second multiplier mu and a shift n of the velocity,

    M n_i = S_i^T mu,   z_v,i = v_i + n_i,   M v_i' = f_i - G_i^T lambda_i - K_i^T mu,
    G_i z_v,i + r_i = 0,   Dg(q', t') v' + g_t(q', t') = 0,

where (K, S) is a discrete gradient of w(q, v) = Dg v + g_t: both levels and the power balance are exact (extends
O. Gonzalez, Comput. Methods Appl. Mech. Engrg. 174, 1999, to ports and dissipation; docs/proofs/constraints.md).
A moving constraint does work; it is the output of its `drive` port.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from phfmu.declare.expressions.operations import degree, piecewise
from phfmu.declare.variable import ValueKind
from phfmu.gradients.gradients import QUOTIENT_GUARD, general, guarded, projected
from phfmu.gradients.quadrature import Nodes, gauss
from phfmu.plan.address import (
    Address,
    increment,
    row,
    step_size,
)
from phfmu.plan.layout import Layout
from phfmu.plan.spec import Arguments, Result, Spec, substituted
from phfmu.plan.unknown import Role
from phfmu.schemes.constraints.velocities import (
    force,
    velocity_costate,
    velocity_costate_row,
    velocity_gradient,
    velocity_increment,
    with_velocities,
)
from phfmu.terms.term import Term

#: the multiplier of the velocity level
VELOCITY_LEVEL = Role("velocity multiplier")


def velocity_level(layout: Layout, term: Term, j: int, node: int) -> int:
    """The velocity multiplier of a constraint; as a result: the constraint on that level."""
    del j, node
    return layout.at(VELOCITY_LEVEL, term.rows[0].index)


@dataclass(frozen=True)
class _ConstraintStep:
    """The step of one constraint: q and t at its start, increments d (n x k) of q, step size h (None if g is at rest)."""

    q: ca.SX
    d: ca.SX
    t: ca.SX | None
    h: ca.SX | None
    nd: Nodes

    def at(self, exprs: list[ca.SX], tau: float, also: list[tuple[ca.SX, ca.SX]] | None = None) -> list[ca.SX]:
        """Expressions of q and t at the fraction tau of the step; `also`: more symbols and their values there."""
        pairs = [(self.q, self.q + ca.mtimes(self.d, ca.DM(self.nd.integral(tau))))]
        if self.t is not None and self.h is not None:
            pairs.append((self.t, self.t + tau * self.h))
        return substituted(exprs, [*pairs, *(also or [])])

    def at_end(self, exprs: list[ca.SX]) -> list[ca.SX]:
        """Expressions of q and t at the end of the step."""
        return self.at(exprs, 1.0)

    def moving(self, g: ca.SX) -> ca.SX:
        """The partial derivative of g by time."""
        return ca.SX(0) if self.t is None else ca.gradient(g, self.t)


def _path(term: Term, args: Arguments, d: ca.SX, nd: Nodes) -> _ConstraintStep:
    t = term.local.get(ValueKind.TIME)
    return _ConstraintStep(term.local[ValueKind.STATE], d, t, None if t is None else args.symbol(step_size), nd)


def quadratic(term: Term) -> bool:
    """True if the constraint has degree 2 at most in q (bars, directors, joints)."""
    p = degree(term.data["g"], term.local[ValueKind.STATE])
    return p is not None and p <= 2


def _node_rows(g: ca.SX, path: _ConstraintStep, simple: bool) -> tuple[list[ca.SX], list[ca.SX]]:
    """Rows G_i and rates r_i with sum_i b_i (G_i D_i + h r_i) = g(q', t') - g(q, t).

    At rest:  Dg(X_i) for quadratic g, the mean value by exact quadrature for polynomials and by
              secants for functions in pieces, else Dg(X_i) + beta D_i^T with
              beta = [g' - g - sum_j b_j Dg(X_j) D_j] / sum_j b_j |D_j|^2.
    Moving:   G_i = Dg(X_i, t_i), r_i = g_t(X_i, t_i) + [g' - g - sum_j b_j (Dg D_j + h g_t)] / h.
    """
    nd, d = path.nd, path.d
    grad, rate = ca.gradient(g, path.q), path.moving(g)
    pairs = [path.at([grad, rate], float(c)) for c in nd.c]
    rows, rates = [p[0] for p in pairs], [p[1] for p in pairs]
    if path.t is None and (simple or nd.c[-1] == 1.0):  # Radau: the last row is Dg at the end, while g drifts
        return rows, rates
    if path.t is None and (piecewise(g, path.q) or degree(g, path.q) is not None):
        return ca.horzsplit(general(g, path.q, d, nd, np.ones(path.q.numel()))[0]), rates
    defect = path.at_end([g])[0] - g - sum((nd.b[i] * ca.dot(rows[i], d[:, i]) for i in range(nd.k)), ca.SX(0))
    if path.h is not None:
        defect -= path.h * sum((nd.b[i] * rates[i] for i in range(nd.k)), ca.SX(0))
        return rows, [r + defect / path.h for r in rates]
    size = sum((nd.b[i] * ca.dot(d[:, i], d[:, i]) for i in range(nd.k)), ca.SX(0))
    beta = guarded(defect, size, QUOTIENT_GUARD)
    return [rows[i] + beta * d[:, i] for i in range(nd.k)], rates


def _turning(g: ca.SX, path: _ConstraintStep, v: ca.SX, dv: ca.SX, simple: bool) -> tuple[list[ca.SX], list[ca.SX]]:
    """K_i and S_i, node gradients of w = Dg v + g_t by q and by v.

    At rest sum_i b_i (K_i D_i + S_i V_i) = w(q', v') - w(q, v); what is missing in a moving constraint is its work.
    """
    nd, n = path.nd, path.q.numel()
    w = ca.dot(ca.gradient(g, path.q), v) + path.moving(g)

    def along(tau: float) -> ca.SX:
        there = [(v, v + ca.mtimes(dv, ca.DM(nd.integral(tau))))]
        return ca.vertcat(*path.at([ca.gradient(w, path.q), ca.gradient(g, path.q)], tau, there))

    if simple:
        both = ca.horzcat(*(along(float(c)) for c in nd.c))
    elif path.t is None:
        metric = np.repeat([1.0, 0.0], n)
        both = general(w, ca.vertcat(path.q, v), ca.vertcat(path.d, dv), nd, metric)[0]
    else:
        m = nd.k + 2
        both = projected([along(float(tau)) for tau in gauss(m)[0]], m, nd)
    return [both[:n, i] for i in range(nd.k)], [both[n:, i] for i in range(nd.k)]


def collocated(term: Term, nd: Nodes) -> list[Spec]:
    """Rows of the plain scheme: -G_i^T lambda_i on v, 0 = G_i z_v,i + r_i."""
    args, n, k = Arguments(term, nd.k), term.local[ValueKind.STATE].numel(), nd.k
    d, z, lam = args.matrix(increment, n), args.matrix(velocity_costate, n), args.matrix(force, 1)
    path = _path(term, args, d, nd)
    rows, rates = _node_rows(term.data["g"], path, quadratic(term))
    out: list[Result] = []
    for i in range(k):
        out += [(Address(velocity_increment, j, i), 1, rows[i][j] * lam[i]) for j in range(n)]
        out.append((Address(row, 0, i), 0, -ca.dot(rows[i], z[:, i]) - rates[i]))
        if path.t is not None:
            out.append((Address(row, 1, i), 0, -lam[i] * ca.dot(rows[i], z[:, i])))
    return [Spec(1, args.x, args.p, args.y, out)]


def two_level(term: Term, nd: Nodes) -> list[Spec]:
    """Rows of the two-level form; `light` velocities have the row sum_i b_i [m n_i - S_i^T mu] = 0 instead of n_i."""
    k, args, g, n = nd.k, Arguments(term, nd.k), term.data["g"], term.local[ValueKind.STATE].numel()
    v = ca.SX.sym("v", n)
    d, dv = args.matrix(increment, n), args.matrix(velocity_increment, n)
    z, lam, mu = args.matrix(velocity_costate, n), args.matrix(force, 1), args.symbol(velocity_level)
    path, simple = _path(term, args, d, nd), quadratic(term)
    rows, rates = _node_rows(g, path, simple)
    turn, shift = _turning(g, path, v, dv, simple)
    light, b = term.data["light"], path.nd.b
    out: list[Result] = []
    for i in range(k):
        out += [(Address(velocity_increment, j, i), 1, rows[i][j] * lam[i] + turn[i][j] * mu) for j in range(n)]
        out.append((Address(row, 0, i), 0, -ca.dot(rows[i], z[:, i]) - rates[i]))
        if path.h is not None:
            turned = ca.dot(turn[i], d[:, i]) + ca.dot(shift[i], dv[:, i])
            out.append((Address(row, 1, i), 0, -lam[i] * ca.dot(rows[i], z[:, i]) - mu / path.h * turned))
    grad, rate = path.at_end([ca.gradient(g, path.q), path.moving(g)])
    out.append((Address(velocity_level), 0, -ca.dot(grad, v + ca.mtimes(dv, ca.DM(b))) - rate))
    for j in np.flatnonzero(light):
        out.append(
            (
                Address(velocity_costate_row, int(j), k - 1),
                0,
                -sum((b[i] * shift[i][int(j)] for i in range(k)), ca.SX(0)) * mu,
            )
        )
    time = term.symbols(ValueKind.TIME)
    kernels = [Spec(1, ca.vertcat(path.q, v, time), args.p, args.y, out, old=with_velocities)]
    mass = term.data["mass"]
    add: list[Result] = [(Address(velocity_gradient, j, i), 0, shift[i][j] * mu / mass[j])
                 for i in range(k) for j in range(n) if not light[j]]  # fmt: skip
    if add:
        kernels.insert(0, Spec(0, ca.vertcat(path.q, v, time), args.p, _needed(args, add), add, old=with_velocities))
    return kernels


def _needed(args: Arguments, out: list[Result]) -> list[tuple[Address, ca.SX]]:
    """The arguments that results of stage 0 depend on: those of stage 1 (costates) do not exist yet."""
    results = ca.vertcat(*(expr for _, _, expr in out))
    return [(address, s) for address, s in args.y if ca.depends_on(results, s)]
