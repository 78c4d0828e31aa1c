"""Hidden constraints: which algebraic rows must be differentiated once to give the algebraic variables (index 2).

Rows are matched with the algebraic variables they contain.  An unmatched row, and every row that shares its variables
(reached over alternating paths), is structurally over-determined: these rows constrain the states.  They are
differentiated; the variables among them stay determined by the rows they are matched with.
Source: the structural step of Pantelides, SIAM J. Sci. Stat. Comput. 9 (1988).
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from phfmu.terms.term import FLOW, Hidden, Term, Terms


@dataclass(frozen=True)
class Check:
    """A hidden constraint of the state: row of an algebraic variable, level "velocity" (the row) or "position" (g)."""

    name: str
    level: str
    row: int


def contained(term: Term, j: int, bound: dict[int, int]) -> dict[tuple[str, int], int]:
    """Algebraic variables in output j of a flow term: (local kind, local index) -> variable."""
    found = {}
    for kind in ("a", "u"):
        for i, source in enumerate(term.index.get(kind, ())):
            variable = source if kind == "a" else bound.get(source)
            if variable is not None and ca.depends_on(term.data["f"][j], term.local[kind][i]):
                found[(kind, i)] = variable
    return found


def hidden_rows(terms: Terms) -> Hidden:
    """The over-determined algebraic rows of a model; `extract` has done this for its terms."""
    import numpy as np
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import maximum_bipartite_matching

    if not terms.na:
        return Hidden()
    columns: list[set[int]] = [set() for _ in range(terms.na)]
    bound = terms.bound
    for kind, row, source, i, _ in terms.constants:
        if kind == "a" and (source == "a" or source == "u" and i in bound):
            columns[row].add(i if source == "a" else bound[i])
    patterns: dict[tuple, list[list[tuple[str, int]]]] = {}
    for t in terms.of(FLOW):
        if any(kind == "a" for kind, _ in t.rows):
            for row, places in zip(t.rows, _pattern(t, bound, patterns), strict=True):
                if row[0] == "a":
                    columns[row[1]] |= {_variable(t, place, bound) for place in places}
    rows = np.repeat(np.arange(terms.na), [len(c) for c in columns])
    cols = np.array([c for found in columns for c in sorted(found)], int)
    pattern = csr_matrix((np.ones(len(rows), np.int8), (rows, cols)), shape=(terms.na, terms.na))
    match = maximum_bipartite_matching(pattern, perm_type="column")
    row_of = {int(c): r for r, c in enumerate(match) if c >= 0}
    reached, queue = set(), [r for r in range(terms.na) if match[r] < 0]
    while queue:
        r = queue.pop()
        if r not in reached:
            reached.add(r)
            queue += [row_of[c] for c in columns[r] if c in row_of]
    return Hidden(frozenset(reached), {r: int(match[r]) for r in reached if match[r] >= 0})


def _pattern(t: Term, bound: dict[int, int], known: dict) -> list[list[tuple[str, int]]]:
    """Per output the places of algebraic variables; the same for all terms of one kind and binding."""
    key = (t.key, tuple(i in bound for i in t.index.get("u", ())))
    if key not in known:
        known[key] = [list(contained(t, j, bound)) for j in range(len(t.rows))]
    return known[key]


def _variable(t: Term, place: tuple[str, int], bound: dict[int, int]) -> int:
    kind, i = place
    return t.index[kind][i] if kind == "a" else bound[t.index["u"][i]]


def rates(term: Term, chosen: list[int], bound: dict[int, int]) -> dict[tuple[str, int], int]:
    """Algebraic variables whose rates occur in the differentiated outputs `chosen` of a flow term."""
    return {place: v for j in chosen for place, v in contained(term, j, bound).items()}
