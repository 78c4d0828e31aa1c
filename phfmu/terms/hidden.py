"""Hidden constraints: which algebraic rows must be differentiated once to give the algebraic variables (index 2).

Rows are matched with the algebraic variables they contain.  An unmatched row, and every row that shares its variables
(reached over alternating paths), is structurally over-determined: these rows constrain the states.  They are
differentiated; the variables among them stay determined by the rows they are matched with.
Source: the structural step of Pantelides, SIAM J. Sci. Stat. Comput. 9 (1988).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

import casadi as ca

from phfmu.declare.variable import ValueKind
from phfmu.matching import maximum_matching
from phfmu.terms.located import Row, RowAt, ValueAt
from phfmu.terms.term import FLOW, Term, Terms


@dataclass(frozen=True)
class HiddenConstraints:
    """Hidden constraints: `rows` to differentiate;  `solved_by`: such a row -> the variable its own form determines."""

    rows: frozenset[int] = frozenset()
    solved_by: dict[int, int] = field(default_factory=dict)

    def differentiates(self, row: RowAt) -> bool:
        """True if a row is one of those to differentiate."""
        return row.kind is Row.EQUATION and row.index in self.rows

    @property
    def checks(self) -> list[int]:
        """Rows that hold for consistent states only."""
        return sorted(self.rows - self.solved_by.keys())


class Level(StrEnum):
    """Derivative of a holonomic constraint: g(q) or the row Dg(q) v."""

    POSITION = "position"
    VELOCITY = "velocity"


@dataclass(frozen=True)
class Check:
    """A hidden constraint of the state: row of an algebraic variable, at the level of velocities (the row) or positions (g)."""

    name: str
    level: Level
    row: int


def variable_at(at: ValueAt, bound: dict[int, int]) -> int | None:
    """The algebraic variable of a value: itself, or the one that feeds an input."""
    if at.kind is ValueKind.INPUT:
        return bound.get(at.index)
    return at.index if at.kind is ValueKind.ALGEBRAIC else None


def contained(term: Term, j: int, bound: dict[int, int]) -> dict[ValueAt, int]:
    """Algebraic variables in output j of a flow term: local place -> variable."""
    found = {}
    for kind in (ValueKind.ALGEBRAIC, ValueKind.INPUT):
        for i, source in enumerate(term.index.get(kind, ())):
            variable = variable_at(ValueAt(kind, source), bound)
            if variable is not None and ca.depends_on(term.data["f"][j], term.local[kind][i]):
                found[ValueAt(kind, i)] = variable
    return found


def hidden_rows(terms: Terms) -> HiddenConstraints:
    """The over-determined algebraic rows of a model; `extract` has done this for its terms."""
    if not terms.na:
        return HiddenConstraints()
    columns: list[set[int]] = [set() for _ in range(terms.na)]
    bound = terms.bound
    for c in terms.constants:
        variable = variable_at(c.source, bound)
        if c.row.kind is Row.EQUATION and variable is not None:
            columns[c.row.index].add(variable)
    patterns: dict[tuple, list[list[ValueAt]]] = {}
    for t in terms.of(FLOW):
        if any(r.kind is Row.EQUATION for r in t.rows):
            for row, places in zip(t.rows, _pattern(t, bound, patterns), strict=True):
                if row.kind is Row.EQUATION:
                    found = (variable_at(ValueAt(at.kind, t.index[at.kind][at.index]), bound) for at in places)
                    columns[row.index] |= {v for v in found if v is not None}
    match = maximum_matching([sorted(found) for found in columns], terms.na)
    row_of = {c: r for r, c in enumerate(match) if c >= 0}
    reached, queue = set(), [r for r in range(terms.na) if match[r] < 0]
    while queue:
        r = queue.pop()
        if r not in reached:
            reached.add(r)
            queue += [row_of[c] for c in columns[r] if c in row_of]
    return HiddenConstraints(frozenset(reached), {r: match[r] for r in reached if match[r] >= 0})


def _pattern(t: Term, bound: dict[int, int], known: dict) -> list[list[ValueAt]]:
    """Per output the places of algebraic variables; the same for all terms of one kind and binding."""
    key = (t.key, tuple(i in bound for i in t.indices(ValueKind.INPUT)))
    if key not in known:
        known[key] = [list(contained(t, j, bound)) for j in range(len(t.rows))]
    return known[key]


def rates(term: Term, chosen: list[int], bound: dict[int, int]) -> dict[ValueAt, int]:
    """Algebraic variables whose rates occur in the differentiated outputs `chosen` of a flow term, by local place."""
    return {place: v for j in chosen for place, v in contained(term, j, bound).items()}
