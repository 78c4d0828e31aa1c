"""Constraints at rest: which of redundant rows are left out at the start."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from phfmu.terms.rank import constraint_jacobian, constraint_labels, dependences
from phfmu.terms.term import CONSTRAINT, Terms


@dataclass(frozen=True)
class ConstraintsAtStart:
    """Of the holonomic constraints: multiplier -> natural size of Dg v;  multipliers of those that rest."""

    sizes: dict[int, float] = field(default_factory=dict)
    resting: frozenset[int] = frozenset()


def at_start(terms: Terms) -> Terms:
    """The terms with what they have to know of their constraints at the start: sizes, and which rest."""
    owner = [t.rows[0].index for t in terms.of(CONSTRAINT)]
    if not owner:
        return terms
    states = terms.model.states
    moving = [max(n, abs(s)) for v in states for n, s in zip(v.nominal, v.start, strict=True)]
    jacobian = constraint_jacobian(terms)
    sizes = abs(jacobian) @ np.array(moving)
    sizes[sizes == 0.0] = np.max(sizes, initial=0.0) or 1.0  # no gradient here, perhaps later
    rests = [owner[i] for d in dependences(jacobian) for i in d.resting]
    return terms.having(ConstraintsAtStart(dict(zip(owner, sizes.tolist(), strict=True)), frozenset(rests)))


def hold_names(terms: Terms) -> tuple[str, ...]:
    """The constraints in order: multiplier, and what the declaration calls it."""
    labels = constraint_labels(terms.model)
    own = [terms.algebraic_names[a] for a in terms.found(ConstraintsAtStart).sizes]
    return tuple(f"{n} ({labels[n]})" if n in labels else n for n in own)
