"""The columns of the audit table, and blocks of steps and events turned into them.

One wide table: the column `row` says what a row is (component, port, junction, part, network, event) and thereby
which columns it fills; the others are null. SI units; power positive INTO the component.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.audit.booked_steps import BookedSteps
from phfmu.audit.events import EventRow, StateRow
from phfmu.audit.kinds import ColumnType, Quality, RowKind

SCHEMA_VERSION = 1

COLUMNS: dict[str, ColumnType] = {
    "row": ColumnType.NAME,
    "step": ColumnType.I64,
    "t0": ColumnType.F64,  # [s], of an event: its time
    "h": ColumnType.F64,  # [s]
    "component": ColumnType.NAME,
    "port": ColumnType.NAME,
    "index": ColumnType.I32,  # of the pair within a vector port, from 1
    "junction": ColumnType.NAME,
    "part": ColumnType.NAME,  # of a junction's energy
    "term": ColumnType.NAME,  # of H, or part of R
    "kind": ColumnType.NAME,  # of an event: what happened
    "quality": ColumnType.NAME,  # exact | estimated | none; of a junction that no coupling closes: loose
    "H": ColumnType.F64,  # [J] network: sum over the components at the end of the step
    "H0": ColumnType.F64,  # [J]
    "H1": ColumnType.F64,  # [J]
    "dH": ColumnType.F64,  # [J]
    "dissipated": ColumnType.F64,  # [J]
    "supplied": ColumnType.F64,  # [J]
    "numerical": ColumnType.F64,  # [J] lost by a damping scheme (Radau); null elsewhere
    "external": ColumnType.F64,  # [J] supplied through ports without a junction
    "residual": ColumnType.F64,  # [J] component: as in `ledger.py`; junction: sum of supplied; part: its share
    "residual_rel": ColumnType.F64,  # r |residual| / (what r = 1e-11 allows), whatever --audit-rtol: closed at r if not above r
    "moved": ColumnType.F64,  # [J] sum over the component's energies of |change|; where null, varying counts
    "varying": ColumnType.F64,  # [J] max(|H0|, |H1|) without what of H is constant; where null, max(|H0|, |H1|) counts
    "exchanged": ColumnType.F64,  # [J] junction: half the sum of |supplied|; port: by the values that were exchanged
    "junction_residual": ColumnType.F64,  # [J] network: sum over the junctions
    "unexplained": ColumnType.F64,  # [J] network: balance - junction_residual
    "cum_dissipated": ColumnType.F64,
    "cum_external": ColumnType.F64,
    "cum_junction_residual": ColumnType.F64,
    "cum_unexplained": ColumnType.F64,
    "iterations": ColumnType.I32,  # network: of Newton's method, of a coupling that of its interface
    "accepted_by": ColumnType.NAME,  # network: by which test the coupling took the step
    "rejected": ColumnType.I32,  # network: longer trials of the step that were taken back (--energy-rtol)
    "energy_jump": ColumnType.F64,  # [J] event
    "lost": ColumnType.F64,  # [J] event: by a jump of the states at a guard
    "message": ColumnType.TEXT,
    "hash": ColumnType.TEXT,  # of a state, in hexadecimal digits
}

DTYPES = {
    ColumnType.I64: np.int64,
    ColumnType.I32: np.int32,
    ColumnType.F64: np.float64,
    ColumnType.NAME: np.int32,
    ColumnType.TEXT: object,
}

#: columns that rows of a kind fill
FIELDS: dict[RowKind, tuple[str, ...]] = {
    RowKind.COMPONENT: (
        *("component", "H0", "H1", "dH", "dissipated", "supplied", "numerical", "residual", "moved", "quality"),
        *("varying", "residual_rel"),
    ),
    RowKind.PORT: ("component", "port", "index", "junction", "quality", "supplied", "exchanged"),
    RowKind.JUNCTION: ("junction", "quality", "residual", "exchanged"),
    RowKind.PART: ("junction", "part", "residual"),
    RowKind.NETWORK: (
        *("H", "dH", "dissipated", "numerical", "external", "junction_residual", "unexplained"),
        *("cum_dissipated", "cum_external", "cum_junction_residual", "cum_unexplained", "iterations", "accepted_by"),
        "rejected",
    ),
    RowKind.TERM: ("component", "term", "dH", "dissipated"),
    RowKind.EVENT: ("kind", "component", "energy_jump", "lost", "message"),
    RowKind.HASH: ("component", "part", "hash"),
}

Encode = Callable[[str, Sequence[str | None]], NDArray[np.int32]]


@dataclass(frozen=True, slots=True)
class LogSection:
    """n rows of one kind: column -> (values [n], valid [n] or None for all). Names are codes, -1 for null."""

    n: int
    columns: dict[str, tuple[NDArray[Any], NDArray[np.bool_] | None]]


def _filled(column: str, values: Sequence[Any], encode: Encode) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    kind = COLUMNS[column]
    if kind is ColumnType.NAME:
        codes = encode(column, values)
        return codes, codes >= 0
    valid = np.array([value is not None for value in values], bool)
    if kind is ColumnType.TEXT:
        return np.array(values, object), valid
    return np.array([0 if value is None else value for value in values], DTYPES[kind]), valid


def event_section(events: Sequence[EventRow], encode: Encode) -> LogSection:
    """Rows of events."""
    return _section(RowKind.EVENT, events, {"t0": "t"}, encode)


def state_section(rows: Sequence[StateRow], encode: Encode) -> LogSection:
    """Rows of hashes of states."""
    return _section(RowKind.HASH, rows, {n: n for n in ("step", "t0", "h")}, encode)


def _section(kind: RowKind, rows: Sequence[EventRow | StateRow], more: Mapping[str, str], encode: Encode) -> LogSection:
    """Rows of a kind with its fields and with `more`, column -> attribute; columns without a value are left out."""
    fields = {**more, **{column: column for column in FIELDS[kind]}}
    values: dict[str, Sequence[Any]] = {"row": [kind] * len(rows)}
    values |= {column: [getattr(row, field) for row in rows] for column, field in fields.items()}
    columns = {column: _filled(column, entries, encode) for column, entries in values.items()}
    return LogSection(len(rows), {name: entry for name, entry in columns.items() if entry[1].any()})


def block_sections(block: BookedSteps, encode: Encode) -> list[LogSection]:
    """Component, port, junction and network rows of a judged block, without a loop over its steps."""
    booking, s = block.booking, block.steps
    names = {"component": list(booking.components), "quality": [booking.quality(name) for name in booking.components]}
    values = {
        "H0": block.H0,
        "H1": s.H,
        "dH": s.stored,
        "dissipated": s.dissipated,
        "supplied": s.supplied,
        "numerical": s.numerical,
        "residual": block.residual,
        "residual_rel": block.relative,
        "moved": s.moved,
        "varying": block.varying if booking.constants else None,
    }
    sections = [_repeat(block, RowKind.COMPONENT, names, values, encode)]
    if booking.ports:
        keys = ("component", "port", "index", "junction", "quality")
        names = {name: [getattr(port, name) for port in booking.ports] for name in keys}
        sections.append(_repeat(block, RowKind.PORT, names, {"supplied": s.pairs, "exchanged": s.exchanged}, encode))
    if booking.junctions:
        values = {"residual": block.junction_residual, "exchanged": block.junction_exchanged}
        names = {"junction": list(booking.junctions)}
        if booking.loose:
            names["quality"] = [Quality.LOOSE] * len(booking.junctions)
        sections.append(_repeat(block, RowKind.JUNCTION, names, values, encode))
    if s.works is not None and booking.parts:
        names = {name: [getattr(key, name) for key in booking.parts] for name in ("junction", "part")}
        sections.append(_repeat(block, RowKind.PART, names, {"residual": s.works}, encode))
    if s.terms is not None:
        sections += _terms(block, s.terms, encode)
    network = {name: column[:, None] for name, column in block.network.items()}
    sections.append(_repeat(block, RowKind.NETWORK, {}, network, encode))
    if s.iterations is not None:
        sections[-1].columns["iterations"] = s.iterations.astype(np.int32), None
    if s.rejected is not None:
        sections[-1].columns["rejected"] = s.rejected.astype(np.int32), None
    if s.accepted_by is not None:
        sections[-1].columns["accepted_by"] = encode("accepted_by", s.accepted_by.tolist()), None
    return sections


def _terms(block: BookedSteps, values: NDArray[Any], encode: Encode) -> Iterator[LogSection]:
    """Energies fill dH, parts of R dissipated."""
    for stores, column in ((True, "dH"), (False, "dissipated")):
        own = [j for j, key in enumerate(block.booking.terms) if key.stores is stores]
        if own:
            names = {name: [getattr(block.booking.terms[j], name) for j in own] for name in ("component", "term")}
            yield _repeat(block, RowKind.TERM, names, {column: np.ascontiguousarray(values[:, own])}, encode)


def _repeat(
    block: BookedSteps,
    kind: RowKind,
    names: dict[str, list[Any]],
    values: Mapping[str, NDArray[Any] | None],
    encode: Encode,
) -> LogSection:
    """m rows a step: constant columns tiled over the n steps, tables [n,m] flattened."""
    present = {name: table for name, table in values.items() if table is not None}
    n, m = next(iter(present.values())).shape
    columns: dict[str, tuple[NDArray[Any], NDArray[np.bool_] | None]] = {
        "row": (np.full(n * m, encode("row", [kind])[0]), None),
        "step": (np.repeat(block.step, m), None),
        "t0": (np.repeat(block.t0, m), None),
        "h": (np.repeat(block.h, m), None),
    }
    for name, entries in names.items():
        constant, valid = _filled(name, entries, encode)
        if valid.any():
            columns[name] = np.tile(constant, n), None if valid.all() else np.tile(valid, n)
    for name, table in present.items():
        columns[name] = table.ravel(), None
    return LogSection(n * m, columns)
