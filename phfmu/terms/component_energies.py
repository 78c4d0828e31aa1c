"""H of every component of a model."""

from __future__ import annotations

import casadi as ca

from phfmu.terms.canonical import member
from phfmu.terms.term import Terms


def component_energies(terms: Terms) -> list[ca.SX]:
    """By the members of `terms`."""
    model = terms.model
    out = [ca.SX(0) for _ in terms.members]
    for e in model.energies:
        out[member(terms.members, e.owner)] += e.expr
    for pair in model.closed:
        out[member(terms.members, pair.owner)] += pair.hamiltonian
    return out
