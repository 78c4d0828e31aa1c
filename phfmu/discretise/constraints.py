"""Holonomic constraints g(q) = 0: discrete Jacobians, and the two-level form that also keeps Dg v = 0.

Collocated:  G_i z_v,i = 0 with a discrete Jacobian G_i, so g is exact; Dg v is not.
Two-level (GGL form, odd k): with a second multiplier mu and a shift n of the velocity,

    M n_i = G_i^T mu,   z_v,i = v_i + n_i,   M v_i' = f_i - G_i^T lambda_i - K_i^T mu,   K_i = v_i^T D2g,
    G_i z_v,i = 0,      Dg(q') v' = 0,

both constraints and the power balance are exact (extends O. Gonzalez, Comput. Methods Appl. Mech. Engrg. 174, 1999, to
ports and dissipation; docs/concepts/schemes.md gives the proof).
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from phfmu.discretise.arguments import EMPTY, Arguments
from phfmu.discretise.gradients import JOINT_GUARD, at, degree, general, guarded
from phfmu.discretise.quadrature import gauss, nodes
from phfmu.discretise.spec import Address, Spec
from phfmu.discretise.terms import DeclarationError, Term, Terms


def _node_rows(g: ca.SX, q: ca.SX, d: ca.SX, k: int) -> list[ca.SX]:
    """Discrete Jacobian rows G_i with sum_i b_i G_i D_i = g(q') - g(q); Dg(X_i) for quadratic g.

    Polynomial g: the mean value by exact quadrature.  Else G_i = Dg(X_i) + beta D_i^T with
    beta = [g(q') - g(q) - sum_j b_j Dg(X_j) D_j] / sum_j b_j |D_j|^2.
    """
    nd = nodes(k)
    if degree(g, q) is not None:
        return ca.horzsplit(general(g, q, d, nd, np.ones(q.numel()))[0])
    grad = ca.gradient(g, q)
    rows = [at(grad, q, q + ca.mtimes(d, ca.DM(nd.a[i]))) for i in range(k)]
    end = at(g, q, q + ca.mtimes(d, ca.DM(nd.b)))
    num = end - g - sum((nd.b[i] * ca.dot(rows[i], d[:, i]) for i in range(k)), ca.SX(0))
    den = sum((nd.b[i] * ca.dot(d[:, i], d[:, i]) for i in range(k)), ca.SX(0))
    beta = guarded(num, den, JOINT_GUARD)
    return [rows[i] + beta * d[:, i] for i in range(k)]


def collocated(term: Term, k: int) -> list[Spec]:
    """Rows of the plain scheme: -G_i^T lambda_i on v, 0 = G_i z_v,i."""
    args, q = Arguments(term, k), term.local["x"]
    d = args.matrix("D", q.numel())
    z, lam = args.matrix("v", q.numel()), args.matrix("l", 1)
    rows = _node_rows(term.data["g"], q, d, k)
    out: list[tuple[Address, int, ca.SX]] = []
    for i in range(k):
        out += [(("velocity", j, i), 1, rows[i][j] * lam[i]) for j in range(q.numel())]
        out.append((("row", 0, i), 0, -ca.dot(rows[i], z[:, i])))
    return [Spec(1, args.x, args.p, args.y, out)]


def two_level(term: Term, k: int) -> list[Spec]:
    """Rows of the two-level form."""
    args, q, g, nd = Arguments(term, k), term.local["x"], term.data["g"], nodes(k)
    n = q.numel()
    v = ca.SX.sym("v", n)
    d, dv = args.matrix("D", n), args.matrix("V", n)
    z, lam, mu = args.matrix("v", n), args.matrix("l", 1), args.symbol("m", 0, 0)
    grad = ca.gradient(g, q)
    rows = _node_rows(g, q, d, k)
    q_end, v_end = q + ca.mtimes(d, ca.DM(nd.b)), v + ca.mtimes(dv, ca.DM(nd.b))
    v_node = [v + ca.mtimes(dv, ca.DM(nd.a[i])) for i in range(k)]
    p = degree(g, q)
    if p is not None and p <= 2:
        turn = [ca.jtimes(grad, q, v_node[i]) for i in range(k)]
        shift = rows
    elif k > 1:
        raise DeclarationError(
            f"the two-level scheme of order {2 * k} needs quadratic constraints (bars, directors); use --order 2, or write "
            "the constraint with more variables so that it is quadratic"
        )
    else:
        turn, shift = [_turn(grad, q, d, v_node[0])], [(grad + at(grad, q, q_end)) / 2]
    out: list[tuple[Address, int, ca.SX]] = []
    for i in range(k):
        out += [(("velocity", j, i), 1, rows[i][j] * lam[i] + turn[i][j] * mu) for j in range(n)]
        out.append((("row", 0, i), 0, -ca.dot(rows[i], z[:, i])))
    out.append((("m", 0, 0), 0, -ca.dot(at(grad, q, q_end), v_end)))
    mass = term.data["mass"]
    add = [(("shift", j, i), 0, shift[i][j] * mu / mass[j]) for i in range(k) for j in range(n)]
    seen = [(a, s) for a, s in args.y if a[0] in ("D", "m")]
    return [
        Spec(0, args.x, args.p, seen, add),
        Spec(1, ca.vertcat(args.x, v), args.p, args.y, out),
    ]


def _turn(grad: ca.SX, q: ca.SX, d: ca.SX, v: ca.SX) -> ca.SX:
    """K with K D = (Dg(q') - Dg(q)) v for non-quadratic g (k = 1): quadrature of D2g plus a rank-one correction."""
    t, w = gauss(4)
    base = ca.SX(q.numel(), 1)
    for tq, wq in zip(t, w, strict=True):
        base += float(wq) * at(ca.jtimes(grad, q, v), q, q + float(tq) * d)
    num = ca.dot(at(grad, q, q + d) - grad, v) - ca.dot(base, d)
    return base + guarded(num, ca.dot(d, d), JOINT_GUARD) * d


def prepare(terms: Terms) -> Terms:
    """Give every constraint the masses of its velocities; DeclarationError where the form M v' = ..., z_v = v is absent."""
    constraint = [t for t in terms.terms if t.kind == "constraint"]
    shifted = sorted({terms.velocity_of[q] for t in constraint for q in t.index["x"]})
    _require_velocities(terms, shifted)
    mass = {t.rows[0][1]: t for t in terms.terms if t.kind == "mass"}
    new = [_with_masses(t, [mass.get(terms.velocity_of[q]) for q in t.index["x"]]) if t.kind == "constraint" else t
           for t in terms.terms]  # fmt: skip
    return replace(terms, terms=new)


def _with_masses(term: Term, masses: list[Term | None]) -> Term:
    """The constraint with the mass expressions as data, its parameters extended by theirs (None = unit mass)."""
    symbols, index, data = [term.local.get("p", EMPTY)], list(term.index.get("p", ())), []
    for m in masses:
        local = EMPTY if m is None else m.local.get("p", EMPTY)
        fresh = ca.SX.sym("p", local.numel())
        value = ca.SX(1) if m is None else m.data["m"]
        data.append(ca.substitute([value], [local], [fresh])[0] if local.numel() else value)
        symbols.append(fresh)
        index += [] if m is None else list(m.index.get("p", ()))
    key = ("masses", term.key, tuple(None if m is None else m.key for m in masses))
    p = ca.vertcat(*symbols)
    local = term.local | ({"p": p} if p.numel() else {})
    return replace(term, key=key, local=local, index=term.index | {"p": tuple(index)}, data=term.data | {"mass": data})


def _require_velocities(terms: Terms, shifted: list[int]) -> None:
    model = terms.model
    parameters = ca.vertcat(*(p.sx for p in model.parameters))
    gradient = ca.Function("g", [model.x, parameters], [ca.gradient(model.hamiltonian, model.x)])
    rng = np.random.default_rng(1)
    x = rng.standard_normal(terms.n1)
    p = np.array([s for v in model.parameters for s in v.start])
    g = np.array(gradient(x, p)).ravel()
    mass = {t.rows[0][1]: _value(t, p) for t in terms.terms if t.kind == "mass"}
    names = [n for v in model.states for n in v.names()]
    for v in shifted:
        if not mass.get(v, 1.0) > 0:
            raise DeclarationError(
                f"{model.name}: the two-level scheme divides by the mass of '{names[v]}', which is {mass[v]:g}; give it a "
                "positive mass"
            )
        if abs(g[v] / mass.get(v, 1.0) - x[v]) > 1e-9 * (1 + abs(x[v])) or v in terms.solved_costates:
            raise DeclarationError(
                f"{model.name}: the two-level scheme needs velocities as states (M v' = ..., z = v) with a diagonal M; "
                f"'{names[v]}' is not one. Use --scheme semi-explicit"
            )


def _value(term: Term, p: np.ndarray) -> float:
    symbols = term.local.get("p", EMPTY)
    f = ca.Function("m", [symbols], [term.data["m"]])
    return float(f(p[list(term.index.get("p", ()))]))
