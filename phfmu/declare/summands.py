"""An energy that is a sum, taken apart: a term for every set of states, so that equal summands share one kernel."""

from __future__ import annotations

from collections.abc import Iterator
from collections.abc import Set as AbstractSet
from dataclasses import replace

import casadi as ca

from phfmu.declare.energy import Energy, resolve_kind


def summands(term: Energy, states: AbstractSet[int]) -> list[Energy]:
    """`term` as terms of the summands of H that act on the same states (given by their element hashes).

    Quadratic and strain terms stay whole; so does a term whose correction is to go to states that a summand lacks.
    Constants go with the first term.
    """
    if term.kind != "general":
        return [term]
    groups: dict[frozenset[int], ca.SX] = {}
    constant = ca.SX(0)
    for part in _parts(term.expr):
        own = frozenset(s.element_hash() for s in ca.symvar(part)) & states
        if own:
            groups[own] = groups[own] + part if own in groups else part
        else:
            constant += part
    chosen = {v.sx[j].element_hash() for v in term.correct for j in range(v.n)}
    if len(groups) < 2 or (chosen and any(chosen.isdisjoint(own) for own in groups)):
        return [term]
    first, *others = groups.values()
    return [resolve_kind(replace(term, expr=e), states) for e in (first + constant, *others)]


def _parts(expr: ca.SX) -> Iterator[ca.SX]:
    """The summands of a scalar expression from left to right, with their signs."""
    stack = [(expr, False)]
    while stack:
        e, negative = stack.pop()
        if e.is_op(ca.OP_NEG):
            stack.append((e.dep(0), not negative))
        elif e.is_op(ca.OP_ADD) or e.is_op(ca.OP_SUB):
            stack.append((e.dep(1), negative != e.is_op(ca.OP_SUB)))
            stack.append((e.dep(0), negative))
        else:
            yield -e if negative else e
