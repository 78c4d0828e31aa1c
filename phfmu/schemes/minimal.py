"""The minimal closure of the Dirac-dissipative scheme: among all solutions the one whose costate is nearest to z.

    min 1/2 |f - zbar(x, x')|^2  over (x', f)   subject to   c(x', f) = 0,   c: the equations of the scheme.

Its solution satisfies, with one multiplier mu per equation,  c = 0  and  d/d(x', f) [1/2 |f - zbar|^2 + mu^T c] = 0.  As
c is a sum of local terms, so is mu^T c: the second half is built kernel by kernel.  The norm runs over the costates that
the equations can leave open: algebraic variables, and states of pairs with their own E.  Others have f = E^-T DG H.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import casadi as ca

from phfmu.declare.variable import ValueKind
from phfmu.plan.address import (
    Address,
    Place,
    algebraic,
    costate,
    costate_row,
    gradient,
    increment,
    own_costate,
    port_input,
    row,
    with_algebraics,
)
from phfmu.plan.layout import Layout
from phfmu.plan.spec import Arguments, Result, Spec, substituted
from phfmu.plan.unknown import ALGEBRAIC, COSTATE, INCREMENT, Role, Unknown, of_algebraics, of_states
from phfmu.schemes import closure
from phfmu.schemes.closure import carried
from phfmu.schemes.constraints.velocities import force, velocity_costate, velocity_increment
from phfmu.schemes.scheme import Triplet
from phfmu.terms.located import Row
from phfmu.terms.term import CLOSED, EMPTY, Term, TermKind, Terms

#: the point of zbar in a step
PART = {"start": 0.0, "midpoint": 0.5, "end": 1.0}
#: the distance of a costate from its algebraic variable
NEARNESS = TermKind("nearness")
#: equations of the scheme, by the unknowns of equal number -> their multipliers
MULTIPLIER = {role: Role(f"multiplier of the row of {role.name}") for role in (INCREMENT, COSTATE, ALGEBRAIC)}
#: arguments of kernels that are always unknowns
PRIMAL = (increment, costate, own_costate, algebraic, carried, velocity_costate, force)


@cache
def multiplier(equation: Place) -> Place:
    """The multiplier of an equation."""

    def place(layout: Layout, term: Term, j: int, node: int) -> int:
        return _multiplier(layout, equation(layout, term, j, node))

    return place


@cache
def stationary(argument: Place) -> Place:
    """The row that says the minimum does not change with an unknown."""

    def place(layout: Layout, term: Term, j: int, node: int) -> int:
        return _stationary(layout, argument(layout, term, j, node))

    return place


def _multiplier(layout: Layout, row: int) -> int:
    own = layout.unknowns[row]
    return layout.at(MULTIPLIER[own.role], own.index, own.node)


def _stationary(layout: Layout, w: int) -> int:
    """The multiplier's entry if it has one, else its own."""
    own = layout.unknowns[w]
    found = layout.find(MULTIPLIER[own.role], own.index, own.node) if own.role in MULTIPLIER else None
    return w if found is None else found


def open_costates(terms: Terms) -> list[int]:
    """States whose row of E^T f = grad H is empty: nothing but a closure ties their costates."""
    out = []
    for t in terms.of(CLOSED):
        e, slope = ca.sparsify(t.data["E"]), ca.gradient(t.data["H"], t.local[ValueKind.STATE])
        out += [r.index for j, r in enumerate(t.rows) if not e[:, j].nnz() and not ca.sparsify(slope[j]).nnz()]
    return sorted(out)


def prepare(terms: Terms) -> Terms:
    """`terms` with the distances |f2 - z2bar|, and with inputs told apart by whether they are unknowns."""
    marked = []
    for t in terms.terms:
        bound = tuple(i in terms.bound for i in t.indices(ValueKind.INPUT))
        marked.append(replace(t, key=(t.key, bound), data=t.data | {"bound": bound}) if any(bound) else t)
    near = [
        Term(NEARNESS, (NEARNESS,), {ValueKind.ALGEBRAIC: ca.SX.sym("a")}, {ValueKind.ALGEBRAIC: (i,)}, {})
        for i in range(terms.na)
    ]
    return replace(terms, terms=marked + near)


def multipliers(terms: Terms) -> list[Unknown]:
    """One per equation: balances, costates, algebraic rows."""
    without = set(open_costates(terms))
    with_own = [i for i in range(terms.n1) if i not in without]
    out = of_states(terms, MULTIPLIER[INCREMENT], "least distance, balance of", range(terms.n1))
    out += of_states(terms, MULTIPLIER[COSTATE], "least distance, costate of", with_own)
    return out + of_algebraics(terms, MULTIPLIER[ALGEBRAIC], "least distance, equation of", range(terms.na))


def constants(layout: Layout, equations: list[Triplet]) -> list[Triplet]:
    """The part of d(mu^T c) that comes from the constant entries of c."""
    return [
        (_stationary(layout, source), _multiplier(layout, row), value, power)
        for row, source, value, power in equations
        if row < layout.nw and source < layout.nw
    ]


def nearness(term: Term, at: str) -> list[Spec]:
    """Derivatives of 1/2 (f2 - z2bar(x2, x2'))^2 for one algebraic variable."""
    args, old = Arguments(term, 1), ca.SX.sym("old")
    f, new = args.matrix(algebraic, 1), args.matrix(carried, 1)
    distance = (f - closure.value(at, old, new)) ** 2 / 2
    out = [(Address(stationary(p)), 0, ca.gradient(distance, s)) for p, s in ((algebraic, f), (carried, new))]
    return [Spec(1, old if at == "midpoint" else EMPTY, EMPTY, args.y, out, old=with_algebraics)]


def adjoint(term: Term, specs: list[Spec], at: str) -> list[Spec]:
    """Kernels of d(mu^T c) for the kernels `specs` of c, and of d|f - zbar|^2/2 for a pair with its own E."""
    found = [s for spec in specs for s in _transposed(term, spec)]
    return found + [_pair(term, at)] if term.kind is CLOSED else found


def _transposed(term: Term, spec: Spec) -> list[Spec]:
    rows = [(_equation(term, a), q, e) for a, q, e in spec.out if _equation(term, a) and ca.sparsify(e).nnz()]
    y = [
        (a, s)
        for a, s in spec.y
        if a.place in PRIMAL or a.place is port_input and term.data.get("bound", ())[a.j : a.j + 1] == (True,)
    ]
    powers = sorted({q for _, q, _ in rows})
    mu = {a: ca.SX.sym("mu") for a, _, _ in rows}
    sign = -1.0 if spec.stage == 0 else 1.0  # 0 = E^T f - W
    out: list[Result] = []
    for q in powers:
        total = sum((sign * mu[a] * e for a, power, e in rows if power == q), ca.SX(0))
        for a, s in y:
            slope = ca.sparsify(ca.gradient(total, s))
            if slope.nnz():
                out.append((replace(a, place=stationary(a.place)), q, slope))
    if not out:
        return []
    arguments = [(replace(a, place=multiplier(a.place)), symbol) for a, symbol in mu.items() if a is not None]
    return [replace(spec, stage=1, y=[*spec.y, *arguments], out=out, stored=None, lost=None, numerical=None)]


def _equation(term: Term, address: Address) -> Address | None:
    """The equation that a result contributes to; None for outputs, sources and the rows of closures."""
    if address.place is gradient:
        return replace(address, place=costate_row)
    if address.place is row and term.rows[address.j].kind not in (Row.BALANCE, Row.EQUATION):
        return None
    return address if address.place in (row, costate_row, velocity_increment) else None


def _pair(term: Term, at: str) -> Spec:
    """Derivatives of 1/2 |f - zbar|^2, zbar = z at the chosen point, for a pair with its own E."""
    args, x, n = Arguments(term, 1), term.local[ValueKind.STATE], len(term.rows)
    d, f = args.matrix(increment, n), args.matrix(own_costate, n)
    (z,) = substituted([term.data["z"]], [(x, x + PART[at] * d)])
    distance = ca.sumsqr(f - z) / 2
    read = ((increment, d), (own_costate, f))
    out = [(Address(stationary(place), j), 0, ca.gradient(distance, v[j])) for place, v in read for j in range(n)]
    return Spec(1, args.x, args.p, args.y, [o for o in out if ca.sparsify(o[2]).nnz()])
