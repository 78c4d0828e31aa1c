"""Which states an impulse of the algebraic variables can move: E dx = J s, s the impulses.

A state moves if its own row contains an algebraic variable or the multiplier of a holonomic constraint, or if E couples
its rate with that of one that moves.  Angles do not: theta' = omega has no multiplier.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phfmu.terms.hidden import contained
from phfmu.terms.term import CLOSED, CONSTRAINT, FLOW, MASS_BLOCK, Term, Terms


def moved_by_impulses(terms: Terms) -> NDArray[np.bool_]:
    """Per state whether an impulse reaches it (n1)."""
    moved = np.zeros(terms.n1, bool)
    for kind, row, source, i, _ in terms.constants:
        if kind == "x" and (source == "a" or (source == "u" and i in terms.bound)):
            moved[row] = True
    for t in terms.terms:
        if t.kind is FLOW:
            moved[[i for j, (kind, i) in enumerate(t.rows) if kind == "x" and contained(t, j, terms.bound)]] = True
        elif t.kind is CONSTRAINT:
            moved[[terms.velocity_of[q] for q in t.index["x"]]] = True
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
    return np.array([i for _, i in t.rows], int), pattern
