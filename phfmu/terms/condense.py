"""Algebraic variables of a network condensed out of the equations of a step: an equation gives them with a factor of one.

A junction brings its common variable c, and for every port that outputs c the input u of that port. With exactly one such
port the rows 0 = y - c and 0 = (sum of the other variables) + u have the pivots 1 at c and u: c is an output y = B^T z of its
member, u the sum of what the other ports give. Put into the other rows they leave the Schur complement of J - R, which is
skew-symmetric less a dissipation as before, so the states of a step are the same to rounding, and no parameter is fixed by
it. Pairs (i, v) of a member with 0 = u - v, 0 = i - G v are such rows too.

The values themselves are evaluated once after the step: means and energies of the ports stay. Variables and rows of hidden
constraints (nodes without capacitance, loops of capacitances) are left alone.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca

from phfmu.declare.variable import ValueKind
from phfmu.terms.hidden import HiddenConstraints, variable_at
from phfmu.terms.located import Constant, Row, RowAt, ValueAt
from phfmu.terms.term import EMPTY, FLOW, OBSERVABLE, Term, Terms

#: an output of a flow term: the place of the term, and which one
Flow = tuple[int, int]


@dataclass(frozen=True)
class CondensedVariables:
    """The algebraic variables that are no unknowns of a step."""

    variables: tuple[int, ...] = ()


def condensed(terms: Terms) -> Terms:
    """Terms of a network without the algebraic variables that have a constant pivot; the same object where there are none."""
    if not terms.model.junctions:
        return terms
    rows = _RowSums(terms)
    rows.eliminate()
    if not rows.given:
        return terms
    found = CondensedVariables(tuple(sorted(rows.given)))
    return replace(terms, terms=_rewritten(terms, rows), constants=rows.constants()).having(found)


class _RowSums:
    """All rows as sums of constant entries and outputs of flow terms, with algebraic variables put in one after another.

    given: variable -> its row of kind CONDENSED, which has its value;  readers: variable -> the flow terms that read it
    """

    def __init__(self, terms: Terms):
        self.bound, hidden = terms.bound, terms.found(HiddenConstraints)
        self.entries: dict[RowAt, dict[ValueAt, float]] = defaultdict(dict)
        self.flows: dict[RowAt, dict[Flow, float]] = defaultdict(dict)
        self.users: dict[int, dict[RowAt, None]] = defaultdict(dict)
        self.readers: dict[int, set[int]] = defaultdict(set)
        self.given: dict[int, RowAt] = {}
        self._rows = set(range(terms.na)) - hidden.rows
        self._variables = set(range(terms.na)) - set(hidden.solved_by.values())
        for c in terms.constants:
            self._add(c.row, self._source(c.source), c.value)
        for i, t in enumerate(terms.terms):
            self._read(i, t)

    def _source(self, source: ValueAt) -> ValueAt:
        variable = variable_at(source, self.bound)
        return source if variable is None else ValueAt(ValueKind.ALGEBRAIC, variable)

    def _read(self, i: int, t: Term) -> None:
        read = {
            variable_at(ValueAt(k, j), self.bound) for k in (ValueKind.ALGEBRAIC, ValueKind.INPUT) for j in t.indices(k)
        }
        if t.kind is FLOW:
            for variable in read - {None}:
                self.readers[variable].add(i)  # type: ignore[index]
            for j, row in enumerate(t.rows):
                self.flows[row][i, j] = self.flows[row].get((i, j), 0.0) + 1.0
        elif t.kind is not OBSERVABLE:
            self._variables -= read
            self._rows -= {row.index for row in t.rows if row.kind is Row.EQUATION}

    def _add(self, row: RowAt, source: ValueAt, value: float) -> None:
        entries = self.entries[row]
        total = entries.get(source, 0.0) + value
        if total:
            entries[source] = total
        else:
            entries.pop(source, None)
        if source.kind is ValueKind.ALGEBRAIC:
            if total:
                self.users[source.index][row] = None
            else:
                self.users[source.index].pop(row, None)

    # -- elimination --------------------------------------------------------------------------------------------------

    def eliminate(self) -> None:
        """Pairs one after another: row c gives u and row u gives c, so that rows and unknowns left have the same numbers."""
        left = sorted(self._rows)
        while left:
            rest = [r for r in left if r not in self.given and not self._taken(r)]
            if len(rest) == len(left):
                return
            left = rest

    def _taken(self, r: int) -> bool:
        for source in list(self.entries[RowAt(Row.EQUATION, r)]):
            a = source.index
            if source.kind is ValueKind.ALGEBRAIC and a in self._rows and self._gives(r, a) and self._gives(a, r):
                self._put_in(r, a)
                self._put_in(a, r)
                return True
        return False

    def _gives(self, r: int, variable: int) -> bool:
        """True if row r gives the variable: flow terms read values that are known before they are evaluated, and no row becomes
        longer than by what is taken out of it."""
        row = RowAt(Row.EQUATION, r)
        entries, flows = self.entries[row], self.flows[row]
        if variable not in self._variables or abs(entries.get(ValueAt(ValueKind.ALGEBRAIC, variable), 0.0)) != 1.0:
            return False
        if ValueAt(ValueKind.ALGEBRAIC, r) in entries or (flows and self.readers[variable]):
            return False
        uses = len(self.readers[variable]) + sum(t.kind is not Row.CONDENSED for t in self.users[variable]) - 1
        return min(len(entries) + len(flows) - 1, uses) <= 1

    def _put_in(self, r: int, variable: int) -> None:
        """variable = -(the rest of row r) / its factor, in all rows and values that have it."""
        row, source = RowAt(Row.EQUATION, r), ValueAt(ValueKind.ALGEBRAIC, variable)
        factor = self.entries[row][source]
        self._add(row, source, -factor)
        entries, flows = self.entries.pop(row), self.flows.pop(row)
        for other in entries:
            if other.kind is ValueKind.ALGEBRAIC:
                self.users[other.index].pop(row)
                self.readers[other.index] |= self.readers[variable]
        own = self.given[variable] = RowAt(Row.CONDENSED, variable)
        for target in [*self.users.pop(variable, ()), own]:
            share = -1.0 / factor if target == own else -self.entries[target].pop(source) / factor
            for other, value in entries.items():
                self._add(target, other, share * value)
            for flow, value in flows.items():
                self.flows[target][flow] = self.flows[target].get(flow, 0.0) + share * value

    def constants(self) -> list[Constant]:
        return [Constant(row, source, v) for row, entries in self.entries.items() for source, v in entries.items()]


def _rewritten(terms: Terms, rows: _RowSums) -> list[Term]:
    """The terms with values of condensed variables put in and their outputs in the rows that take them."""
    targets: dict[int, dict[RowAt, dict[int, float]]] = defaultdict(lambda: defaultdict(dict))
    for row, flows in rows.flows.items():
        for (i, j), factor in flows.items():
            if factor:
                targets[i][row][j] = factor
    known: dict[tuple[Any, ...], Term] = {}
    out = []
    for i, t in enumerate(terms.terms):
        if t.kind is not FLOW:
            out.append(t)
            continue
        found = targets[i]
        solved = {row: parts for row, parts in found.items() if row.kind is not Row.CONDENSED}
        values = {row: parts for row, parts in found.items() if row.kind is Row.CONDENSED}
        reads = _FlowArguments(t, rows)
        if solved or "loss" in t.data:
            out.append(_term(t, reads, solved, known))
        if values:
            out.append(_term(replace(t, data={k: v for k, v in t.data.items() if k != "loss"}), reads, values, known))
    return out


class _FlowArguments:
    """Arguments of a flow term, with condensed variables replaced by sums of others.

    index: per kind the global indices;  places: per old local place (kind, place) its parts (factor, kind, new place)
    """

    def __init__(self, term: Term, rows: _RowSums):
        self.index: dict[ValueKind, list[int]] = {}
        self.places: dict[tuple[ValueKind, int], tuple[tuple[float, ValueKind, int], ...]] = {}
        self.changed = False
        replaced = []
        for kind, indices in term.index.items():
            for j, i in enumerate(indices):
                variable = variable_at(ValueAt(kind, i), rows.bound)
                if variable in rows.given:
                    replaced.append((kind, j, variable))
                else:
                    self.places[kind, j] = ((1.0, kind, len(self.index.setdefault(kind, []))),)
                    self.index[kind].append(i)
        for kind, j, variable in replaced:
            parts = rows.entries[rows.given[variable]].items()
            self.places[kind, j] = tuple((factor, s.kind, self._place(s)) for s, factor in parts)
            self.changed = True

    def _place(self, source: ValueAt) -> int:
        found = self.index.setdefault(source.kind, [])
        if source.index not in found:
            found.append(source.index)
        return found.index(source.index)

    def values(self, term: Term, local: dict[ValueKind, ca.SX]) -> tuple[list[ca.SX], list[ca.SX]]:
        """Old local symbols, and the expressions that stand for them."""
        old, new = [], []
        for (kind, j), parts in self.places.items():
            old.append(term.local[kind][j])
            new.append(sum((f * local[k][n] for f, k, n in parts), ca.SX(0)))
        return old, new


def _term(
    t: Term, reads: _FlowArguments, targets: dict[RowAt, dict[int, float]], known: dict[tuple[Any, ...], Term]
) -> Term:
    """`t` with new arguments, and its outputs summed up in the rows `targets`; terms of one kind stay one kind."""
    own: dict[RowAt, dict[int, float]] = {}
    for j, row in enumerate(t.rows):
        own.setdefault(row, {})[j] = 1.0
    if not reads.changed and own == targets:
        return t
    order = sorted(
        targets, key=lambda row: (min(targets[row]), row.kind is not t.rows[min(targets[row])].kind, row.index)
    )
    sums = tuple((row.kind, tuple(sorted(targets[row].items()))) for row in order)
    kinds = tuple((kind, len(indices)) for kind, indices in reads.index.items())
    key = (t.key, "loss" in t.data, kinds, tuple(sorted(_plain(reads.places))), sums)
    if key not in known:
        local = {kind: ca.SX.sym(kind.value, len(indices)) for kind, indices in reads.index.items()}
        old, new = reads.values(t, local)
        f = t.data["f"]
        moved = {"f": ca.vertcat(EMPTY, *(sum((v * f[j] for j, v in parts), ca.SX(0)) for _, parts in sums))}
        moved |= {"loss": t.data["loss"]} if "loss" in t.data else {}
        replaced = (
            ca.substitute(list(moved.values()), [ca.vertcat(*old)], [ca.vertcat(*new)]) if old else [*moved.values()]
        )
        known[key] = replace(t, key=key, local=local, data=t.data | dict(zip(moved, replaced, strict=True)))
    index = {kind: tuple(indices) for kind, indices in reads.index.items()}
    return replace(known[key], index=index, rows=tuple(order), owner=t.owner)


def _plain(places: dict[tuple[ValueKind, int], tuple[tuple[float, ValueKind, int], ...]]) -> Iterable[tuple[Any, ...]]:
    """The places in words that can be sorted."""
    return ((kind.value, j, tuple((f, k.value, n) for f, k, n in parts)) for (kind, j), parts in places.items())
