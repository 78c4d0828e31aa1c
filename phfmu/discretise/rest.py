"""Constraints at rest: which of redundant rows are left out at the start, and where their rows are in a plan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from phfmu.discretise.layout import Layout
from phfmu.discretise.plan import Holds
from phfmu.discretise.rank import constraint_jacobian, constraint_labels, dependences
from phfmu.discretise.terms import Terms


def at_start(terms: Terms) -> Terms:
    """The terms with what they have to know of their constraints at the start: sizes, and which rest."""
    owner = [t.rows[0][1] for t in terms.terms if t.kind == "constraint"]
    if not owner:
        return terms
    states = terms.model.states
    moving = [max(n, abs(s)) for v in states for n, s in zip(v.nominal, v.start, strict=True)]
    jacobian = constraint_jacobian(terms)
    sizes = abs(jacobian) @ np.array(moving)
    sizes[sizes == 0.0] = np.max(sizes, initial=0.0) or 1.0  # no gradient here, perhaps later
    rests = [owner[i] for d in dependences(jacobian) for i in d.resting]
    return replace(terms, speeds=dict(zip(owner, sizes.tolist(), strict=True)), resting=frozenset(rests))


def holds(layout: Layout) -> Holds:
    """Constraints of a step or instant plan, none for schemes that minimise or carry multipliers."""
    terms, w = layout.terms, layout.w_of
    if any(kind == "X" or kind.startswith("mu.") for kind, _, _ in layout.unknowns):
        return Holds()
    rows = [[w["a", a, i] for i in range(layout.k)] + [w[u] for u in [("m", a, 0)] if u in w] for a in terms.speeds]
    rests = np.array([a in terms.resting for a in terms.speeds], bool)
    return Holds(tuple(map(tuple, rows)), rests, np.array(list(terms.speeds.values())))


def hold_names(terms: Terms) -> tuple[str, ...]:
    """The constraints in order: multiplier, and what the declaration calls it."""
    names, labels = [n for v in terms.model.algebraics for n in v.names()], constraint_labels(terms.model)
    own = [names[a] for a in terms.speeds]
    return tuple(f"{n} ({labels[n]})" if n in labels else n for n in own)
