"""The spaces of a plan: where unknowns, rows, inputs and assembled values live."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from phfmu.declare.variable import ValueKind
from phfmu.plan.unknown import ALGEBRAIC, COSTATE, INCREMENT, Role, Unknown
from phfmu.terms.condense import CondensedVariables
from phfmu.terms.located import Row, RowAt, ValueAt
from phfmu.terms.term import Terms


@dataclass
class Layout:
    """Y = [unknowns | inputs at k nodes | h | Z],  Z = [costates at k nodes, rates | sources at k nodes, rates],
    R = [a row per unknown | outputs of the pairs at k nodes | reports].

    The values of condensed variables at k nodes are the last of the reports, and again the last of Z.

    `reports`: a key per reported row;  `rates`: costates and sources have rates too (instant plans, k = 1).
    """

    terms: Terms
    k: int
    unknowns: Sequence[Unknown]
    reports: Sequence[Hashable] = ()
    rates: bool = False
    sources: list[int] = field(init=False)
    _place: dict[tuple[Role, int, int], int] = field(init=False, repr=False)
    _report: dict[Hashable, int] = field(init=False, repr=False)
    _source: dict[int, int] = field(init=False, repr=False)
    _condensed: dict[int, int] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._place = {(u.role, u.index, u.node): i for i, u in enumerate(self.unknowns)}
        self._report = {key: i for i, key in enumerate(self.reports)}
        self.sources = [i for i, p in enumerate(self.terms.pairs) if p.port.source is not None]
        self._source = {p: j for j, p in enumerate(self.sources)}
        self._condensed = {a: j for j, a in enumerate(self.condensed)}

    # -- sizes ------------------------------------------------------------------------------------------------------

    @cached_property
    def nw(self) -> int:
        return len(self.unknowns)

    @cached_property
    def nv(self) -> int:
        return self.nw + self.terms.nu * self.k + 1

    @cached_property
    def condensed(self) -> tuple[int, ...]:
        """Algebraic variables that are no unknowns, but sums of other values."""
        return self.terms.found(CondensedVariables).variables

    @property
    def ncondensed(self) -> int:
        return len(self.condensed) * self.k

    @property
    def nobs(self) -> int:
        return len(self.reports) + self.ncondensed

    @property
    def nz(self) -> int:
        return (self.terms.n1 + len(self.sources)) * self.k * (2 if self.rates else 1) + self.ncondensed

    # -- unknowns and rows --------------------------------------------------------------------------------------------

    def at(self, role: Role, i: int, node: int = 0) -> int:
        """The unknown, and its row."""
        return self._place[role, i, node]

    def find(self, role: Role, i: int, node: int = 0) -> int | None:
        """The unknown, None where the scheme has none."""
        return self._place.get((role, i, node))

    def roles(self) -> set[Role]:
        return {u.role for u in self.unknowns}

    def row(self, row: RowAt, node: int = 0) -> int:
        """The place of a row of the terms: the unknown of equal number, an output of a pair, or a report."""
        return _ROW[row.kind](self, row.index, node)

    def output(self, pair: int, node: int) -> int:
        """Row of the output of a pair."""
        return self.nw + node * len(self.terms.pairs) + pair

    def report(self, key: Hashable) -> int:
        """Row of the report under `key`."""
        return self.nw + len(self.terms.pairs) * self.k + self._report[key]

    def condensed_row(self, a: int, node: int) -> int:
        """Row of the value of a condensed variable."""
        return self.nw + len(self.terms.pairs) * self.k + len(self.reports) + self._condensed_place(a, node)

    def _condensed_place(self, a: int, node: int) -> int:
        return node * len(self.condensed) + self._condensed[a]

    # -- assembled values ---------------------------------------------------------------------------------------------

    def slot(self, i: int, node: int) -> int:
        """Z index of the costate (or gradient) of state i at a node."""
        return node * self.terms.n1 + i

    def rate_slot(self, i: int) -> int:
        """Z index of dz/dt of state i."""
        return self.terms.n1 * self.k + i

    def source_slot(self, pair: int, node: int) -> int:
        """Z index of the source of a pair."""
        return self.terms.n1 * self.k * (2 if self.rates else 1) + node * len(self.sources) + self._source[pair]

    def source_rate_slot(self, pair: int) -> int:
        """Z index of its time derivative."""
        return self.source_slot(pair, 0) + len(self.sources)

    def condensed_slot(self, a: int, node: int) -> int:
        """Z index of the value of a condensed variable, known after the step only."""
        return self.nz - self.ncondensed + self._condensed_place(a, node)

    # -- values that kernels and constants read -------------------------------------------------------------------------

    def value(self, value: ValueAt, node: int = 0) -> int:
        """Y index of a costate, an algebraic variable or a port input."""
        return _VALUE[value.kind](self, value.index, node)

    def costate(self, i: int, node: int) -> int:
        """Y index of a costate: an unknown, or assembled."""
        w = self._place.get((COSTATE, i, node))
        return self.nv + self.slot(i, node) if w is None else w

    def costate_rate(self, i: int) -> int:
        """Y index of dz/dt of state i."""
        return self.nv + self.rate_slot(i)

    def input_index(self, pair: int, node: int) -> int:
        """Y index of the input of a pair: external, the value of a source, or the algebraic variable that feeds it."""
        variable = self.terms.bound.get(pair)
        if pair < self.terms.nu:
            return self.nw + node * self.terms.nu + pair
        if pair in self._source:
            return self.nv + self.source_slot(pair, node)
        assert variable is not None
        if variable in self._condensed:
            return self.nv + self.condensed_slot(variable, node)
        return self.at(ALGEBRAIC, variable, node)

    # -- for messages -------------------------------------------------------------------------------------------------

    def names(self) -> list[str]:
        """A name per row."""
        return [u.label + (f" (node {u.node + 1})" if self.k > 1 else "") for u in self.unknowns]

    def nominals(self) -> np.ndarray:
        return np.array([u.nominal for u in self.unknowns], float).reshape(-1)


#: functions (layout, index, node) -> place, by the kind of a row and of a value
_ROW: dict[Row, Callable[[Layout, int, int], int]] = {
    Row.BALANCE: lambda layout, i, node: layout.at(INCREMENT, i, node),
    Row.EQUATION: lambda layout, i, node: layout.at(ALGEBRAIC, i, node),
    Row.OUTPUT: Layout.output,
    Row.OBSERVABLE: lambda layout, i, node: layout.report(i),
    Row.CONDENSED: Layout.condensed_row,
}
_VALUE: dict[ValueKind, Callable[[Layout, int, int], int]] = {
    ValueKind.COSTATE: Layout.costate,
    ValueKind.ALGEBRAIC: lambda layout, i, node: layout.at(ALGEBRAIC, i, node),
    ValueKind.INPUT: Layout.input_index,
}
