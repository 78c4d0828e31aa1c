"""The rule on dimensions: energies in joule, every term of a row in the unit of its row.

With the unit [x] of a state and [e] of a diagonal entry of E the costate z has J/([e][x]) and the row E x' has [e][x]/s;
an algebraic variable and the input of a port are costates themselves.  The row that belongs to a costate has W/[z], so that
an entry of J or R has [row]/[z of its column], one of B [row]/[u], and a constraint g with multiplier lambda J/[lambda].
Warnings: numbers may carry a unit that nobody sees.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import casadi as ca

from phfmu.checks.sample import Sample
from phfmu.declare.entries.entries import Entries, Entry
from phfmu.declare.entries.entry_kind import EntryKind
from phfmu.declare.error import Problem
from phfmu.declare.expressions.dimension import (
    JOULE,
    NONE,
    SECOND,
    WATT,
    Dimension,
    DimensionAnalysis,
    Known,
    Number,
    counted_numbers,
    of_unit,
)
from phfmu.declare.port import Port
from phfmu.declare.variable import Variable, time

#: the dimension an entry (row, column) should have, and what it is, in words
Wanted = Callable[[int, int], tuple[Dimension | None, str]]

REMEDY = "correct a unit or the expression; a number that stands for a quantity becomes a parameter with its unit"


def dimensions(entries: Entries, sample: Sample) -> list[Problem]:
    """Units fit wherever they are used; a model that declares no units at all is not judged."""
    m = entries.model
    if all(v.unit == "1" for v in (*m.states, *m.algebraics, *m.parameters)):
        return []
    return list(_Check(entries).problems())


@dataclass
class _Check:
    entries: Entries
    #: dimension of every symbol (by its hash); None: not known
    symbols: dict[int, Dimension | None] = field(default_factory=dict)

    def __post_init__(self) -> None:
        m = self.entries.model
        self.symbols[time.element_hash()] = SECOND
        for v in (*m.states, *m.algebraics, *m.parameters):
            self._know(v.sx, of_unit(v.unit))
        for p in m.ports:
            self._know(p.u, of_unit(p.input_unit))
        for v in m.states:
            self._know(v.z, JOULE.times(of_unit(v.unit), -1))
        self._masses()

    def _know(self, symbols: ca.SX, dimension: Dimension | None) -> None:
        for s in ca.vertsplit(symbols):
            self.symbols[s.element_hash()] = dimension

    def _masses(self) -> None:
        """z of states with E: J/([e][x]) by the diagonal; of closed-form pairs by their z."""
        for e in self.entries.of(EntryKind.E):
            z = ca.vertcat(*(v.z for v in e.rows))
            x = ca.vertcat(*(v.sx for v in e.rows))
            diagonal = self.known(ca.diag(ca.densify(e.expr)))
            for j, mass in enumerate(diagonal):
                own = self.symbols[x[j].element_hash()]
                if isinstance(mass, Dimension) and own is not None:
                    self._know(z[j], JOULE.times(own, -1).times(mass, -1))
                else:
                    self._know(z[j], None)
        for pair in self.entries.pairs:
            z = ca.vertcat(*(v.z for v in pair.origin.variables))
            for j, d in enumerate(self.known(ca.densify(ca.SX(pair.origin.z)))):
                self._know(z[j], d if isinstance(d, Dimension) else None)

    def known(self, expr: ca.SX) -> list[Known]:
        return DimensionAnalysis(expr, self.symbols).entries()

    # -- what should be ------------------------------------------------------------------------------------------------

    def costates(self, rows: tuple[Variable | Port, ...]) -> list[Dimension | None]:
        """Dimensions of costates of the rows of a block: z of states, effort of algebraic variables, input of ports."""
        found: list[Dimension | None] = []
        for v in rows:
            for known in self.known(ca.densify(self.entries.model.effort(v))):
                found.append(known if isinstance(known, Dimension) else None)
        return found

    def problems(self) -> Iterator[Problem]:
        for e in self.entries.sound:
            wanted = self._wanted(e)
            if wanted is not None:
                yield from self._entry(e, wanted)
        for pair in self.entries.pairs:
            hamiltonian = Entry(EntryKind.H, f"{pair.label}: H", ca.SX(pair.origin.hamiltonian))
            yield from self._entry(hamiltonian, lambda r, c: (JOULE, "an energy is in"))

    def _wanted(self, e: Entry) -> Wanted | None:
        wanted = {
            EntryKind.H: self._wanted_energy,
            **dict.fromkeys((EntryKind.J, EntryKind.R), self._wanted_matrix),
            EntryKind.B: self._wanted_port,
            EntryKind.E: self._wanted_mass,
            EntryKind.COSTATE: self._wanted_costate,
            EntryKind.SOURCE: self._wanted_source,
            EntryKind.CONSTRAINT: self._wanted_constraint,
            EntryKind.OBSERVABLE: lambda e: self._wanted_unit(e.origin.unit),
            EntryKind.GUARD: lambda e: self._wanted_unit(e.origin.guard.unit),
        }.get(e.what)
        return None if wanted is None else wanted(e)

    def _wanted_energy(self, e: Entry) -> Wanted:
        del e
        return lambda r, c: (JOULE, "an energy is in")

    def _wanted_matrix(self, e: Entry) -> Wanted:
        z = self.costates(e.rows)
        return lambda r, c: _entry_of(e.names()[r], z[r], e.names()[c], z[c])

    def _wanted_port(self, e: Entry) -> Wanted:
        z, u = self.costates(e.rows), of_unit(e.origin.input_unit)
        return lambda r, c: _entry_of(e.names()[r], z[r], e.origin.input_names()[c], u)

    def _wanted_costate(self, e: Entry) -> Wanted:
        z = self.costates(e.rows)
        return lambda r, c: (z[r], "its costate is in")

    def _wanted_source(self, e: Entry) -> Wanted:
        return lambda r, c: (of_unit(e.origin.input_unit), f"input {e.origin.input_names()[r]} is in")

    def _wanted_unit(self, unit: str) -> Wanted:
        return lambda r, c: (of_unit(unit), "it is declared in")

    def _wanted_constraint(self, e: Entry) -> Wanted:
        """lambda g is an energy, if all rows of one multiplier have one dimension: one unit cannot fit several."""
        unit, name = e.origin.multiplier.unit, e.rows[0].name
        exprs = ca.vertcat(
            *(ca.sparsify(g.expr) for g in self.entries.of(EntryKind.CONSTRAINT) if g.rows[0].name == name)
        )
        kinds = {(d.exponents, d.factor) for d in self.known(exprs) if isinstance(d, Dimension)}
        should = JOULE.times(of_unit(unit), -1) if len(kinds) == 1 else None
        return lambda r, c: (should, f"its multiplier in {unit} needs")

    def _wanted_mass(self, e: Entry) -> Wanted:
        """E^T z = grad H: entry (i, j) has J/([x_j][z_i])."""
        z = self.costates(e.rows)
        x = [of_unit(v.unit) for v in e.rows if isinstance(v, Variable) for _ in range(v.n)]

        def wanted(r: int, c: int) -> tuple[Dimension | None, str]:
            zr = z[r]
            return (None if zr is None else JOULE.times(x[c], -1).times(zr, -1)), "E^T z = grad H needs"

        return wanted

    # -- what is -------------------------------------------------------------------------------------------------------

    def _entry(self, e: Entry, wanted: Wanted) -> Iterator[Problem]:
        """The first clash inside an entry, else the first of its dimensions that does not fit."""
        expr = ca.sparsify(e.expr)
        walk = DimensionAnalysis(expr, self.symbols)
        found = walk.entries()
        if walk.clashes:
            yield Problem("dimension", e.label, walk.clashes[0], REMEDY, "warning")
            return
        for d, r, c in zip(found, *expr.sparsity().get_triplet(), strict=True):
            if isinstance(d, Number):
                d = NONE if abs(d.value) == 1.0 and e.what in (EntryKind.J, EntryKind.B) else None
            should, why = wanted(r, c)
            if d is None or should is None or d.fits(should):
                continue
            yield Problem("dimension", _place(e, expr, r, c), f"is in {d}{counted_numbers(d)}, but {why} {should}",
                          REMEDY, "warning")  # fmt: skip
            return


def _place(e: Entry, expr: ca.SX, r: int, c: int) -> str:
    if expr.numel() == 1:
        return e.label
    return f"{e.label}, entry [{r + 1}]" if expr.shape[1] == 1 else f"{e.label}, entry [{r + 1}, {c + 1}]"


def _entry_of(row: str, z: Dimension | None, column: str, given: Dimension | None) -> tuple[Dimension | None, str]:
    """The row of costate z has W/[z], its entry W/([z][given])."""
    if z is None or given is None:
        return None, ""
    return WATT.times(z, -1).times(given, -1), f"row '{row}' and column '{column}' need"
