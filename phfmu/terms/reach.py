"""States that impulses s of the algebraic variables can move: E dx = J s.

A state moves if its own row contains an algebraic variable or the multiplier of a holonomic constraint, or if E couples
its rate with that of one that moves.  Angles do not: theta' = omega has no multiplier.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phfmu.declare.variable import ValueKind
from phfmu.terms.hidden import contained, variable_at
from phfmu.terms.located import Row
from phfmu.terms.term import CLOSED, CONSTRAINT, FLOW, MASS_BLOCK, Term, Terms
from phfmu.terms.velocities import velocity_of


def moved_by_impulses(terms: Terms) -> NDArray[np.bool_]:
    """Per state whether an impulse reaches it (n1)."""
    moved = np.zeros(terms.n1, bool)
    for c in terms.constants:
        if c.row.kind is Row.BALANCE and variable_at(c.source, terms.bound) is not None:
            moved[c.row.index] = True
    for t in terms.of(FLOW):
        reached = (r for j, r in enumerate(t.rows) if r.kind is Row.BALANCE and contained(t, j, terms.bound))
        moved[[r.index for r in reached]] = True
    velocity = velocity_of(terms)
    for t in terms.of(CONSTRAINT):
        moved[[velocity[q] for q in t.index[ValueKind.STATE]]] = True
    blocks = [_coupling(t) for t in terms.of(MASS_BLOCK, CLOSED)]
    found = -1
    while found != moved.sum():
        found = moved.sum()
        for where, pattern in blocks:
            moved[where] |= pattern @ moved[where]
    return moved


def _coupling(t: Term) -> tuple[NDArray[np.int_], NDArray[np.bool_]]:
    """States of a block of E, and the rates that each row of it contains; all of them where a row lacks its own."""
    rows, columns = t.data["E"].sparsity().get_triplet()
    pattern = np.zeros((len(t.rows), len(t.rows)), bool)
    pattern[rows, columns] = True
    pattern[~np.diag(pattern)] = True
    return np.array([r.index for r in t.rows], int), pattern
