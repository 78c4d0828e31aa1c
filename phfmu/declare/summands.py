"""An energy that is a sum, taken apart: a term for every set of states, so that equal summands share one kernel."""

from __future__ import annotations

from collections.abc import Iterator
from collections.abc import Set as AbstractSet
from dataclasses import replace

import casadi as ca

from phfmu.declare.energy import Energy, EnergyKind, resolve_kind
from phfmu.declare.lengths import as_strain


def summands(term: Energy, states: AbstractSet[int]) -> list[Energy]:
    """`term` as terms of the summands of H that act on the same states (given by their element hashes).

    Quadratic and strain terms stay whole; so does a term whose correction is to go to states that a summand lacks.
    Constants go with the first term.  Functions of a length are strain terms.
    """
    if term.kind is not EnergyKind.GENERAL:
        return [term]
    groups: dict[frozenset[int], ca.SX] = {}
    constant = ca.SX(0)
    for part in _parts(term.expr, states):
        own = _own(part, states)
        if own:
            groups[own] = groups[own] + part if own in groups else part
        else:
            constant += part
    chosen = {v.sx[j].element_hash() for v in term.correct for j in range(v.n)}
    if len(groups) < 2 or (chosen and any(chosen.isdisjoint(own) for own in groups)):
        return [as_strain(term, states)]
    first, *others = groups.values()
    return [as_strain(resolve_kind(replace(term, expr=e), states), states) for e in (first + constant, *others)]


def _own(expr: ca.SX, states: AbstractSet[int]) -> frozenset[int]:
    return frozenset(s.element_hash() for s in ca.symvar(expr)) & states


def _parts(expr: ca.SX, states: AbstractSet[int]) -> Iterator[ca.SX]:
    """The summands of a scalar expression from left to right, each with its sign and the factors without states before it."""
    stack = [(expr, ca.SX(1))]
    while stack:
        e, factor = stack.pop()
        rest, more = _factored(e, states)
        if rest.is_op(ca.OP_ADD) or rest.is_op(ca.OP_SUB):
            factor = factor * more
            stack.append((rest.dep(1), -factor if rest.is_op(ca.OP_SUB) else factor))
            stack.append((rest.dep(0), factor))
        else:
            yield factor * e


def _factored(expr: ca.SX, states: AbstractSet[int]) -> tuple[ca.SX, ca.SX]:
    """What is left of `expr` without its factors that no state is in, and these."""
    factor = ca.SX(1)
    while True:
        if expr.is_op(ca.OP_NEG):
            expr, factor = expr.dep(0), -factor
        elif expr.is_op(ca.OP_TWICE):
            expr, factor = expr.dep(0), 2 * factor
        elif expr.is_op(ca.OP_MUL) and not _own(expr.dep(0), states):
            expr, factor = expr.dep(1), factor * expr.dep(0)
        elif expr.is_op(ca.OP_MUL) and not _own(expr.dep(1), states):
            expr, factor = expr.dep(0), factor * expr.dep(1)
        elif expr.is_op(ca.OP_DIV) and not _own(expr.dep(1), states):
            expr, factor = expr.dep(0), factor / expr.dep(1)
        else:
            return expr, factor
