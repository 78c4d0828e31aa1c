"""The minimal closure of the Dirac-dissipative scheme: among all solutions the one whose costate is nearest to z.

    min 1/2 |f - zbar(x, x')|^2  over (x', f)   subject to   c(x', f) = 0,   c: the equations of the scheme.

Its solution satisfies, with one multiplier mu per equation,  c = 0  and  d/d(x', f) [1/2 |f - zbar|^2 + mu^T c] = 0.  As
c is a sum of local terms, so is mu^T c: the second half is built kernel by kernel.  The norm runs over the costates that
the equations can leave open: algebraic variables, and states of pairs with their own E.  Others have f = E^-T DG H.
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca

from phfmu.discretise import closure
from phfmu.discretise.arguments import EMPTY, Arguments
from phfmu.discretise.layout import Layout
from phfmu.discretise.scheme import Triplet, Unknown
from phfmu.discretise.spec import Address, Spec, substituted
from phfmu.discretise.terms import Term, Terms

PRIMAL = ("D", "z", "a", "X", "v", "l")


def open_costates(terms: Terms) -> list[int]:
    """States whose row of E^T f = grad H is empty: nothing but a closure ties their costates."""
    out = []
    for t in terms.terms:
        if t.kind == "closed":
            e, slope = ca.sparsify(t.data["E"]), ca.gradient(t.data["H"], t.local["x"])
            out += [i for j, (_, i) in enumerate(t.rows) if not e[:, j].nnz() and not ca.sparsify(slope[j]).nnz()]
    return sorted(out)


def prepare(terms: Terms) -> Terms:
    """`terms` with the distances |f2 - z2bar|, and with inputs told apart by whether they are unknowns."""
    marked = []
    for t in terms.terms:
        bound = tuple(i in terms.bound for i in t.index.get("u", ()))
        marked.append(replace(t, key=(t.key, bound), data=t.data | {"bound": bound}) if any(bound) else t)
    near = [
        Term("nearness", ("nearness",), {"a": ca.SX.sym("a")}, {"a": (i,)}, {}, (("X", i),)) for i in range(terms.na)
    ]
    return replace(terms, terms=marked + near)


def multipliers(terms: Terms) -> list[Unknown]:
    """One per equation: balances, costates, algebraic rows."""
    without = set(open_costates(terms))
    out: list[Unknown] = [("mu.D", i, 0) for i in range(terms.n1)]
    out += [("mu.Z", i, 0) for i in range(terms.n1) if i not in without]
    return out + [("mu.a", i, 0) for i in range(terms.na)]


def constants(layout: Layout, equations: list[Triplet]) -> list[Triplet]:
    """The part of d(mu^T c) that comes from the constant entries of c."""
    return [
        (layout.stationary(source), layout.multiplier(row), value, power)
        for row, source, value, power in equations
        if row < layout.nw and source < layout.nw
    ]


def nearness(term: Term, at: str) -> list[Spec]:
    """Derivatives of 1/2 (f2 - z2bar(x2, x2'))^2 for one algebraic variable."""
    args, old = Arguments(term, 1), ca.SX.sym("old")
    f, new = args.matrix("a", 1), args.matrix("X", 1)
    distance = (f - closure.value(at, old, new)) ** 2 / 2
    out = [(("stat.a", 0, 0), 0, ca.gradient(distance, f)), (("stat.X", 0, 0), 0, ca.gradient(distance, new))]
    return [Spec(1, old if at == "midpoint" else EMPTY, EMPTY, args.y, out)]


def adjoint(term: Term, specs: list[Spec], at: str) -> list[Spec]:
    """Kernels of d(mu^T c) for the kernels `specs` of c, and of d|f - zbar|^2/2 for a pair with its own E."""
    found = [s for spec in specs for s in _transposed(term, spec)]
    return found + [_pair(term, at)] if term.kind == "closed" else found


def _transposed(term: Term, spec: Spec) -> list[Spec]:
    rows = [(_equation(term, a), q, e) for a, q, e in spec.out if _equation(term, a) and ca.sparsify(e).nnz()]
    y = [
        (a, s)
        for a, s in spec.y
        if a[0] in PRIMAL or a[0] == "u" and term.data.get("bound", ())[a[1] : a[1] + 1] == (True,)
    ]
    powers = sorted({q for _, q, _ in rows})
    mu = {a: ca.SX.sym("mu") for a, _, _ in rows}
    sign = -1.0 if spec.stage == 0 else 1.0  # 0 = E^T f - W
    out: list[tuple[Address, int, ca.SX]] = []
    for q in powers:
        total = sum((sign * mu[a] * e for a, power, e in rows if power == q), ca.SX(0))
        for (kind, j, node), s in y:
            slope = ca.sparsify(ca.gradient(total, s))
            if slope.nnz():
                out.append(((f"stat.{kind}", j, node), q, slope))
    if not out:
        return []
    arguments: list[tuple[Address, ca.SX]] = [
        ((f"mu.{a[0]}", a[1], a[2]), symbol) for a, symbol in mu.items() if a is not None
    ]
    return [Spec(1, spec.x, spec.p, [*spec.y, *arguments], out)]


def _equation(term: Term, address: Address) -> Address | None:
    """The equation that a result contributes to; None for outputs, sources and the rows of closures."""
    kind, j, node = address
    if kind == "W":
        return ("costate", j, node)
    if kind == "row" and term.rows[j][0] not in ("x", "a"):
        return None
    return address if kind in ("row", "costate", "velocity") else None


def _pair(term: Term, at: str) -> Spec:
    """Derivatives of 1/2 |f - zbar|^2, zbar = z at the chosen point, for a pair with its own E."""
    args, x, n = Arguments(term, 1), term.local["x"], len(term.rows)
    d, f = args.matrix("D", n), args.matrix("z", n)
    part = {"start": 0.0, "midpoint": 0.5, "end": 1.0}[at]
    (z,) = substituted([term.data["z"]], [(x, x + part * d)])
    distance = ca.sumsqr(f - z) / 2
    out = [
        ((f"stat.{kind}", j, 0), 0, ca.gradient(distance, v[j])) for kind, v in (("D", d), ("z", f)) for j in range(n)
    ]
    return Spec(1, args.x, args.p, args.y, [o for o in out if ca.sparsify(o[2]).nnz()])
