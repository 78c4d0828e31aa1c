"""The Dirac-dissipative scheme: a discrete gradient on the Dirac structure, the costate f an unknown of its own (k = 1).

    E (x' - x) = h (J - R) f + h B u,      y = B^T f,      E^T f = DG H(x, x'),

with E at the middle of the step.  Every solution keeps the power balance, whatever else is asked of f.  Where E is
singular the equations leave x2' (semi-explicit models), or part of f, open; a closure completes them:

    end, start, midpoint     f2 = z2bar, see `closure.py`
    minimal                  |f - zbar| is as small as these equations allow, see `minimal.py`
    a function               closure(x, x', f) = 0 with x = (states, algebraic variables), as many rows as are open

Source: Kinon, Morandin, Schulze, Appl. Numer. Math. 223 (2026), (25), (26), Example 6, Theorem 5.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from phfmu.declare.energy import EnergyKind
from phfmu.declare.error import DeclarationError
from phfmu.declare.expressions.operations import degree
from phfmu.declare.variable import ValueKind
from phfmu.gradients import gradients
from phfmu.gradients.discrete import Summand, node_gradients
from phfmu.gradients.quadrature import nodes
from phfmu.plan.address import (
    Address,
    algebraic,
    costate,
    costate_row,
    gradient,
    increment,
    own_costate,
    row,
    with_algebraics,
)
from phfmu.plan.layout import Layout
from phfmu.plan.planner import SchemeMaps
from phfmu.plan.spec import Arguments, Spec, substituted
from phfmu.plan.unknown import COSTATE, Unknown
from phfmu.schemes import closure, minimal
from phfmu.schemes.closure import carried
from phfmu.schemes.nodal import NodeKernels
from phfmu.schemes.scheme import GaussScheme, Triplet, node_constants, node_unknowns
from phfmu.terms.located import Row, RowAt
from phfmu.terms.term import CLOSED, MASS_BLOCK, Term, TermKind, Terms

#: rows given by the user
GIVEN = TermKind("given")

Constraint = Callable[[ca.SX, ca.SX, ca.SX], ca.SX]


@dataclass(frozen=True)
class DiracDissipative(GaussScheme):
    """One step with the costate f as unknown.

    closure: "end" | "start" | "midpoint" | "minimal" | a function (x, x', f) -> rows;  `at`: the point of zbar in
    "minimal";  gradient: as for `Collocated(1)`.
    """

    closure: str | Constraint = "midpoint"
    at: str = "midpoint"
    gradient: str = "per-term"
    name: str = "dirac-dissipative"

    @property
    def _minimal(self) -> bool:
        return self.closure == "minimal"

    def prepare(self, terms: Terms) -> Terms:
        """The terms with the closure; DeclarationError if it does not fit."""
        closure.require(self.at, self.name)
        if callable(self.closure):
            return _constrained(terms, self.closure)
        if self._minimal:
            return minimal.prepare(terms)
        closure.require(self.closure, self.name)
        _require_regular(terms)
        return closure.add(terms)

    def unknowns(self, terms: Terms) -> list[Unknown]:
        out = node_unknowns(terms, 1, range(terms.n1)) + closure.unknowns(terms)
        return out + minimal.multipliers(terms) if self._minimal else out

    def constants(self, layout: Layout) -> list[Triplet]:
        own = {r.index for t in layout.terms.of(MASS_BLOCK, CLOSED) for r in t.rows}
        costates = [layout.at(COSTATE, i) for i in range(layout.terms.n1) if i not in own]
        out = node_constants(layout, range(layout.terms.n1)) + [(w, w, 1.0, 0) for w in costates]
        return out + minimal.constants(layout, out) if self._minimal else out

    def maps(self, layout: Layout) -> SchemeMaps:
        return closure.maps(layout)

    def specs(self, term: Term) -> list[Spec]:
        """Kernels of one term."""
        if term.kind is closure.CLOSURE:
            return closure.specs(term, str(self.closure))
        if term.kind is minimal.NEARNESS:
            return minimal.nearness(term, self.at)
        if term.kind is GIVEN:
            return [_given(term)]
        found = self._pair(term) if term.kind is CLOSED else NodeKernels(self.nodes, self.gradient).specs(term)
        return found + minimal.adjoint(term, found, self.at) if self._minimal else found

    def _pair(self, term: Term) -> list[Spec]:
        """E d and E^T f with E at the midpoint, and the discrete gradient of the pair's H."""
        x, data, n = term.local[ValueKind.STATE], term.data, len(term.rows)
        args = Arguments(term, 1)
        d = args.matrix(increment, n)
        kind = EnergyKind.QUADRATIC if degree(data["H"], x) in (0, 1, 2) else EnergyKind.GENERAL
        w, dh = node_gradients(self.gradient, Summand(kind, data["H"], x), d, nodes(1))
        slots = Spec(0, args.x, args.p, args.y, [(Address(gradient, j), 0, w[j]) for j in range(n)], stored=dh)
        args = Arguments(term, 1)
        d, f = args.matrix(increment, n), args.matrix(own_costate, n)
        e = ca.sparsify(gradients.at(data["E"], x, x + d / 2))
        lhs, back = ca.mtimes(e, d), ca.mtimes(e.T, f)
        out = [(Address(row, j), 0, lhs[j]) for j in range(n)] + [
            (Address(costate_row, j), 0, back[j]) for j in range(n)
        ]
        return [slots, Spec(1, args.x, args.p, args.y, out)]


def _require_regular(terms: Terms) -> None:
    """Raise DeclarationError if a pair's E is singular at the start: then E^T f = DG H leaves f open."""
    model = terms.model
    for pair in model.closed:
        e = ca.Function("E", [model.x, ca.vertcat(*(p.sx for p in model.parameters))], [ca.densify(pair.E)])
        start = [s for v in model.states for s in v.start], [s for p in model.parameters for s in p.start]
        rank, n = int(np.linalg.matrix_rank(np.array(e(*start)))), pair.E.shape[0]
        if rank < n:
            names = ", ".join(v.name for v in pair.variables)
            raise DeclarationError(
                model.name,
                f"E of the pair on {names} has rank {rank} of {n} at the start, so that its costate f is not "
                "determined by the point closures",
                "use --closure minimal, or DiracDissipative(closure=function)",
                "descriptor",
            )


def _constrained(terms: Terms, constraint: Constraint) -> Terms:
    """The terms with the user's rows on the open algebraic states and costates."""
    model = terms.model
    open_costates = minimal.open_costates(terms)
    n = terms.na + len(open_costates)
    x = ca.vertcat(model.x, *(v.sx for v in model.algebraics))
    new, f = (ca.SX.sym(n, x.numel()) for n in ("new", "f"))
    rows = ca.SX(constraint(x, new, f))
    if rows.shape != (n, 1):
        raise DeclarationError(
            model.name,
            f"the closure gives {rows.shape[0]} x {rows.shape[1]} rows, but {n} are open (algebraic variables and "
            "costates that E^T f = grad H does not contain)",
            f"give {n}",
        )
    local = {ValueKind.STATE: model.x, ValueKind.ALGEBRAIC: ca.vertcat(*(v.sx for v in model.algebraics)),
             ValueKind.PARAMETER: ca.vertcat(*(p.sx for p in model.parameters))}  # fmt: skip
    index = {ValueKind.STATE: tuple(range(terms.n1)), ValueKind.COSTATE: tuple(range(terms.n1)),
             ValueKind.ALGEBRAIC: tuple(range(terms.na)), ValueKind.PARAMETER: tuple(range(terms.np))}  # fmt: skip
    costates = tuple(RowAt(Row.BALANCE, i) for i in open_costates)
    term = Term(GIVEN, (GIVEN, id(constraint)), local, index, {"rows": rows, "new": new, "f": f}, costates)
    return replace(terms, terms=[*terms.terms, term])


def _given(term: Term) -> Spec:
    """The user's rows with x' = (x + D, X) and f = (Z, f2)."""
    args, local = Arguments(term, 1), term.local
    n, m = local[ValueKind.STATE].numel(), local[ValueKind.ALGEBRAIC].numel()
    d, new = args.matrix(increment, n), args.matrix(carried, m)
    f = ca.vertcat(args.matrix(costate, n), args.matrix(algebraic, m))
    pairs = [(term.data["new"], ca.vertcat(local[ValueKind.STATE] + d, new)), (term.data["f"], f)]
    (rows,) = substituted([term.data["rows"]], pairs)
    places = [Address(carried, j) for j in range(m)] + [Address(costate_row, j) for j in range(len(term.rows))]
    out = [(place, 0, rows[j]) for j, place in enumerate(places)]
    return Spec(
        1, ca.vertcat(local[ValueKind.STATE], local[ValueKind.ALGEBRAIC]), args.p, args.y, out, old=with_algebraics
    )
