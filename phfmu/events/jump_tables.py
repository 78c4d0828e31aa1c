"""Jumps of state events as one kernel: L, c by component, S and e at a state.

With the columns of `jump_columns`, c+ = c- + S m; the jumps want c+ = -e c-, or 0 <= m and 0 <= c+ + e c- of which one is zero,
the constraints c+ = 0, and it costs

    lost = -1/2 m^T (c- + c+) = (1 - e^2)/2 c-^T S^-1 c-   (common e).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from phfmu.declare.error import DeclarationError
from phfmu.declare.event import StateEvent
from phfmu.declare.variable import ValueKind
from phfmu.events.jump_columns import jump_columns
from phfmu.plan.address import Address, row
from phfmu.plan.plan import Floats, Group, Ints, Powers
from phfmu.plan.spec import Spec, build
from phfmu.terms.canonical import Locator, make_term
from phfmu.terms.located import Row, RowAt
from phfmu.terms.term import TermKind, Terms

JUMP = TermKind("jump")


@dataclass(frozen=True, eq=False)
class JumpTables:
    """The n jumps of a model, and the constraints that hold through them: N columns together.

    of:      event -> its jump, -1 for none;  moved (m): states that jump;  component (c): those whose energy they change
    held:    names of the N - n constraints;  most (n): largest |c|;  pushes (n): 1 = its impulse is not negative
    group:   one kernel of x and p with the results [c by component (c N) | L by column (m N) | S (N N) | e (n)]
    """

    of: Ints
    moved: Ints
    component: Ints
    held: tuple[str, ...]
    most: Floats
    pushes: Powers
    group: Group

    @property
    def n(self) -> int:
        return len(self.most)

    @property
    def columns(self) -> int:
        """N."""
        return self.n + len(self.held)

    @property
    def size(self) -> int:
        """Length of the results."""
        return self.columns * (len(self.component) + len(self.moved) + self.columns) + self.n


def jump_tables(terms: Terms, events: Sequence[StateEvent]) -> JumpTables | None:
    """The jumps of the events, None if there are none and no constraint changes.  DeclarationError names what does not fit."""
    found = jump_columns(terms, events)
    if found is None:
        return None
    results = ca.vertcat(ca.vec(found.c.T), ca.vec(found.L), ca.vec(found.S), found.e)
    locator = Locator(terms.model, terms.pairs)
    term = make_term(
        JUMP, {"f": ca.densify(results)}, locator, "the jumps of state events", rows=[RowAt(Row.OBSERVABLE, 0)]
    )
    if extra := sorted(k.value for k in term.index.keys() - {ValueKind.STATE, ValueKind.PARAMETER}):
        raise DeclarationError(
            f"{terms.model.name}: the jumps of state events",
            f"columns or restitution depend on values of the kinds {', '.join(extra)}",
            "jumps may depend on states and parameters only",
            "symbol",
        )
    f = term.data["f"]
    out = [(Address(row, j), 0, f[j]) for j in range(f.numel())]
    kernel = build(Spec(1, term.symbols(ValueKind.STATE), term.symbols(ValueKind.PARAMETER), [], out, report=True))
    tables = [term.indices(ValueKind.STATE), (), term.indices(ValueKind.PARAMETER), range(f.numel())]
    arrays = [np.array(list(t), np.int32).reshape(1, -1) for t in tables]
    group = Group(kernel, 1, 1, *arrays, power=np.zeros(f.numel(), np.int8), owner=np.zeros(1, np.int32))
    jumps = [e.jump for e in events]
    numbers = iter(range(len(jumps)))
    return JumpTables(
        np.array([-1 if j is None else next(numbers) for j in jumps], np.int32),
        np.array(found.moved, np.int32),
        np.array(found.components, np.int32),
        found.held,
        np.array([j.most for j in jumps if j is not None], float),
        np.array([j.unilateral for j in jumps if j is not None], np.int8),
        group,
    )
