"""The tables of a ledger as data: one sheet for components, ports, junctions, events and the network.

Columns and sheets that a run has nothing for are left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from phfmu.audit.events import EventRow
from phfmu.audit.kinds import CellKind, LedgerVerdict, Quality, RowKind
from phfmu.audit.summary import LedgerSummary
from phfmu.audit.tables.sheet_names import UNITS


@dataclass(frozen=True)
class SheetColumn:
    """A header, the value of an entry, whether it is an energy (J), another number or a word, and if energies add up."""

    header: str
    value: Callable[[Any], Any]
    kind: CellKind = CellKind.ENERGY
    adds: bool = True


#: header of the largest residual of a step as a share of what it may be, in percent
ALLOWANCE = "of allowance"


@dataclass(frozen=True)
class Sheet:
    """Rows of values under columns; the first is the name of the row."""

    title: RowKind
    columns: tuple[SheetColumn, ...]
    rows: tuple[tuple[Any, ...], ...]


@dataclass(frozen=True)
class Scale:
    """Scale in which energies are written: `unit`, or percent of `whole` [J], which `words` describe."""

    unit: str = "J"
    whole: float | None = None
    words: str = ""

    def of(self, joule: float) -> float:
        return joule / UNITS[self.unit] if self.whole is None else 100.0 * joule / self.whole

    @property
    def label(self) -> str:
        return self.unit if self.whole is None else "%"


JOULE = Scale()
#: verdicts on junctions that may make energy: what members turned over is told beside what they kept
MAKING = (LedgerVerdict.LOOSE, LedgerVerdict.ESTIMATED, LedgerVerdict.VIOLATED)
#: of what is stored: less than this flows by rounding alone
ROUNDING = 1e-12


def fitting(summary: LedgerSummary) -> str:
    """The unit in which the largest energy of the ledger is from 1 to 1000."""
    size = max(
        (abs(v) for c in summary.components for v in (c.H_start, c.H_end, c.supplied, c.dissipated)), default=0.0
    )
    steps = ("uJ", "mJ", "J", "kJ", "MJ", "GJ", "TJ")
    return next((u for u in reversed(steps) if math.isfinite(size) and size >= UNITS[u]), "J" if not size else steps[0])


def flowed(summary: LedgerSummary) -> float:
    """The energy [J] that came in from outside, by events, and out of what components had stored."""
    into = sum(p.supplied for p in summary.ports if p.junction is None and p.supplied > 0.0)
    return into + sum(max(-c.stored, 0.0) + max(c.jumps or 0.0, 0.0) for c in summary.components)


def shares(summary: LedgerSummary) -> Scale:
    """Percent of what flowed; of what was stored at the start where nothing but rounding did."""
    flow, there = flowed(summary), sum(abs(c.H_start) for c in summary.components)
    if flow > ROUNDING * there:
        return Scale(whole=flow, words="which flowed: came in, or was stored before")
    return Scale(whole=there or None, words="which were stored at the start; nothing came in or was taken from it")


def sheets(summary: LedgerSummary, events: Sequence[EventRow] = ()) -> Iterator[Sheet]:
    """All sheets of a summary; `events`: those to be listed."""
    yield from (sheet for sheet in all_sheets(summary, events) if sheet.rows)


def all_sheets(summary: LedgerSummary, events: Sequence[EventRow] = ()) -> tuple[Sheet, ...]:
    """All sheets of a summary, those without rows too."""
    flows = (_components(summary), _terms(summary), _ports(summary), _junctions(summary), _parts(summary))
    return (*flows, _network(summary), _events(events))


def _sheet(title: RowKind, columns: Sequence[SheetColumn], entries: Sequence[Any]) -> Sheet:
    return Sheet(title, tuple(columns), tuple(tuple(c.value(e) for c in columns) for e in entries))


def _components(summary: LedgerSummary) -> Sheet:
    columns = [
        SheetColumn("component", lambda c: c.component, CellKind.NAME),
        SheetColumn("H start", lambda c: c.H_start),
        SheetColumn("H end", lambda c: c.H_end),
        SheetColumn("stored", lambda c: c.stored),
    ]
    for name in ("dissipated", "numerical", "supplied", "jumps"):
        if any(getattr(c, name) for c in summary.components):
            columns.append(SheetColumn(name, lambda c, name=name: getattr(c, name)))
    if any(j.verdict in MAKING for j in summary.junctions) and any(c.gross for c in summary.components):
        columns.append(SheetColumn("gross", lambda c: c.gross))
    columns += [
        SheetColumn(ALLOWANCE, lambda c: c.worst_ratio, CellKind.RATIO),
        SheetColumn("verdict", lambda c: c.verdict, CellKind.WORD),
    ]
    return _sheet(RowKind.COMPONENT, columns, summary.components)


def _terms(summary: LedgerSummary) -> Sheet:
    columns = (
        SheetColumn("term", lambda t: f"{t.component}.{t.term}", CellKind.NAME),
        SheetColumn("stored", lambda t: t.energy if t.stores else None),
        SheetColumn("dissipated", lambda t: None if t.stores else t.energy),
    )
    return _sheet(RowKind.TERM, columns, summary.terms)


def _ports(summary: LedgerSummary) -> Sheet:
    columns = [
        SheetColumn("port", lambda p: f"{p.component}.{p.port}", CellKind.NAME),
        SheetColumn("supplied", lambda p: p.supplied),
    ]
    if any(p.junction for p in summary.ports):
        columns.append(SheetColumn("junction", lambda p: p.junction or "(external)", CellKind.WORD))
    if any(p.quality == Quality.ESTIMATED for p in summary.ports):
        columns.append(SheetColumn("quality", lambda p: p.quality, CellKind.WORD))
    return _sheet(RowKind.PORT, columns, summary.ports)


def _junctions(summary: LedgerSummary) -> Sheet:
    columns = [
        SheetColumn("junction", lambda j: j.junction, CellKind.NAME),
        SheetColumn("residual", lambda j: j.residual),
        SheetColumn("gross", lambda j: j.gross),
        SheetColumn("worst step", lambda j: j.worst_residual, adds=False),
        SheetColumn("exchanged", lambda j: j.exchanged),
        SheetColumn("verdict", lambda j: j.verdict, CellKind.WORD),
    ]
    return _sheet(RowKind.JUNCTION, columns, summary.junctions)


def _parts(summary: LedgerSummary) -> Sheet:
    columns = [
        SheetColumn("junction", lambda p: p.junction, CellKind.NAME),
        SheetColumn("part", lambda p: p.part, CellKind.WORD),
        SheetColumn("residual", lambda p: p.residual),
        SheetColumn("worst step", lambda p: p.worst_residual, adds=False),
    ]
    return _sheet(RowKind.PART, columns, summary.parts)


def _network(summary: LedgerSummary) -> Sheet:
    network = summary.network
    if network is None:
        return Sheet(RowKind.NETWORK, (), ())
    jumps = [c.jumps for c in summary.components if c.jumps]
    guessed = [p.supplied for p in summary.ports if p.quality == Quality.ESTIMATED]
    values = {
        "stored": network.stored,
        "dissipated": network.dissipated,
        "lost by the scheme": network.numerical,
        "brought by events": math.fsum(jumps) if jumps else None,
        "supplied from outside": network.external,
        "supplied through estimated ports": math.fsum(guessed) if guessed else None,
        "created by the junctions": network.junction_residual,
        "unexplained": network.unexplained,
        "unexplained, worst step": network.worst_unexplained,
    }
    columns = (
        SheetColumn("network", lambda e: e[0], CellKind.NAME),
        SheetColumn("energy", lambda e: e[1]),
        SheetColumn("verdict", lambda e: network.verdict if e[0] == "unexplained" else "", CellKind.WORD),
    )
    return _sheet(RowKind.NETWORK, columns, [(k, v) for k, v in values.items() if v is not None])


def _events(events: Sequence[EventRow]) -> Sheet:
    columns = [
        SheetColumn("event", lambda e: e.kind, CellKind.NAME),
        SheetColumn("t [s]", lambda e: e.t, CellKind.TIME),
    ]
    if any(e.component for e in events):
        columns.append(SheetColumn("component", lambda e: e.component or "", CellKind.WORD))
    if any(e.energy_jump for e in events):
        columns.append(SheetColumn("jump", lambda e: e.energy_jump))
    if any(e.lost for e in events):
        columns.append(SheetColumn("lost", lambda e: e.lost))
    columns.append(SheetColumn("message", lambda e: e.message or "", CellKind.WORD))
    return _sheet(RowKind.EVENT, columns, events)
