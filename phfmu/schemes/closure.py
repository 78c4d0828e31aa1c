"""Closures: equations that tie the algebraic state x2 to its costate over a step (k = 1).

The equations of a step determine the costate f2 of the algebraic rows; x2 itself is closed by f2 = z2bar(x2, x2'):

    end        f2 = x2'             the number belongs to the middle of the step, so x2' is of order 1 at its end
    start      f2 = x2              the same number filed one step earlier: x2 of the step is redefined, x2' stays open
    midpoint   f2 = (x2 + x2')/2    order 2 at the step's end; an inconsistent start alternates and does not decay

Source: Kinon, Morandin, Schulze, Appl. Numer. Math. 223 (2026), Examples 5 and 6, Proposition 1.
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca

from phfmu.declare.error import DeclarationError
from phfmu.declare.variable import ValueKind
from phfmu.gradients.quadrature import nodes
from phfmu.plan.address import Address, algebraic, with_algebraics
from phfmu.plan.layout import Layout
from phfmu.plan.planner import SchemeMaps
from phfmu.plan.spec import Arguments, Spec
from phfmu.plan.unknown import ALGEBRAIC, Role, Unknown, of_algebraics
from phfmu.schemes.scheme import node_maps
from phfmu.terms.term import EMPTY, Term, TermKind, Terms

POINTS = ("end", "start", "midpoint")

#: an algebraic state that is carried from step to step
CARRIED = Role("carried algebraic variable")
#: the equation of one
CLOSURE = TermKind("closure")


def carried(layout: Layout, term: Term, j: int, node: int) -> int:
    """The new value of the j-th algebraic variable that the term reads; as a result: its closure."""
    return layout.at(CARRIED, term.index[ValueKind.ALGEBRAIC][j], node)


def require(point: str, scheme: str) -> None:
    """Raise DeclarationError if `point` is not one of POINTS."""
    if point not in POINTS:
        raise DeclarationError(scheme, f"closure '{point}' is not known", f"choose from {', '.join(POINTS)}")


def unknowns(terms: Terms) -> list[Unknown]:
    """The algebraic state x2' (start: x2) of the step."""
    return of_algebraics(terms, CARRIED, "closure of", range(terms.na))


def add(terms: Terms) -> Terms:
    """`terms` with one closure equation per algebraic variable."""
    local = {ValueKind.ALGEBRAIC: ca.SX.sym("a")}
    new = [Term(CLOSURE, (CLOSURE,), local, {ValueKind.ALGEBRAIC: (i,)}, {}) for i in range(terms.na)]
    return replace(terms, terms=[*terms.terms, *new])


def value(point: str, old: ca.SX, new: ca.SX) -> ca.SX:
    """z2bar(x2, x2')."""
    return (old + new) / 2 if point == "midpoint" else new


def specs(term: Term, point: str) -> list[Spec]:
    """0 = f2 - z2bar(x2, x2')."""
    args, old = Arguments(term, 1), ca.SX.sym("old")
    f, new = args.matrix(algebraic, 1), args.matrix(carried, 1)
    before = old if point == "midpoint" else EMPTY
    out = [(Address(carried), 0, f - value(point, old, new))]
    return [Spec(1, before, EMPTY, args.y, out, old=with_algebraics)]


def maps(layout: Layout) -> SchemeMaps:
    """The maps of one node, but x2' is carried on; f2 starts from x2 too (weight 0: it is not reported)."""
    base = node_maps(layout, nodes(1))
    carried = [(i, layout.at(CARRIED, i), 1.0, 0) for i in range(layout.terms.na)]
    started = [(i, layout.at(ALGEBRAIC, i), 0.0, 0) for i in range(layout.terms.na)]
    return SchemeMaps(base.update, carried + started, base.guess, base.weights, base.nodes, carries=True)
