"""A log judged: its rows become blocks again, go through the same ledger as those of a run, and are held against it."""

import math
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import NDArray

from phfmu.audit.booked_steps import book_steps
from phfmu.audit.booking import Booking, PartKey, PortKey, TermKey
from phfmu.audit.contradictions import Contradictions
from phfmu.audit.judge import DEFAULT_RTOL
from phfmu.audit.kinds import Quality, RowKind
from phfmu.audit.ledger import Ledger
from phfmu.audit.log.reading import Batches, InternedNames, LogRows
from phfmu.audit.log.window import Window, judged_by
from phfmu.audit.summary import LedgerSummary
from phfmu.audit.summing.sums import Floats
from phfmu.audit.tables.report import SummaryTableOptions, summary_table
from phfmu.audit.violation import Violation
from phfmu.outcome.steps import Steps

if TYPE_CHECKING:
    import pyarrow as pa

Ints = NDArray[np.int64]
#: rows that may wait for the network row of their step
WAITING_ROWS = 1 << 22

_STEPPED = (RowKind.COMPONENT, RowKind.PORT, RowKind.JUNCTION, RowKind.PART)
_OPTIONAL = ("numerical", "moved", "varying", "exchanged")


def audit_table(
    source: "pa.Table | str | os.PathLike[str] | LedgerSummary",
    rtol: float = DEFAULT_RTOL,
    **shown: Unpack[SummaryTableOptions],
) -> str:
    """Text of where the energy went, from an audit table, its file or a ledger's summary; see `summary_table` for `shown`.

    `rtol` judges a table; a summary is judged.
    """
    summary = source if isinstance(source, LedgerSummary) else summarise(source, rtol)
    return summary_table(summary, **shown)


def verdict(source: "pa.Table | str | os.PathLike[str]", rtol: float = DEFAULT_RTOL) -> list[Violation]:
    """The violations in an audit table or log file; empty if everything closes."""
    return summarise(source, rtol).violations


def summarise(
    source: "pa.Table | str | os.PathLike[str]", rtol: float = DEFAULT_RTOL, window: Window | None = None
) -> LedgerSummary:
    """The ledger of an audit table or log file, as `Ledger.summary` gives it at the end of the run.

    Nothing derived is taken from the rows: residuals, junctions, the network and its sums are computed again, and rows
    that say otherwise are violations of the kind `file`. One pass; memory does not grow with the log.
    `window`: sums are those of the steps and events within it; the verdict is that of the whole log, which is read twice then.
    Errors: ValueError for a file that is not an audit log, or would unpack to far more than phfmu writes.
    """
    whole = Batches(source)
    judged = _summed(whole, rtol, whole.interned, whole)
    if window is None:
        return judged
    batches = Batches(source)
    return judged_by(_summed((window.of(batch) for batch in batches), rtol, batches.interned), judged)


def _summed(
    batches: Iterable[Mapping[RowKind, LogRows]], rtol: float, interned: InternedNames, whole: Batches | None = None
) -> LedgerSummary:
    """The ledger of the rows of `batches`; `whole`: they are all of a source, which says how many steps it holds."""
    reader = _BlockReader(interned, rtol)
    for batch in batches:
        reader.take(batch)
    reader.finish(whole.holds if whole is not None else {})
    return reader.ledger.summary()


@dataclass(frozen=True)
class _RowsByStep:
    """Rows of one kind in the order of their steps: `first`[k] is where step k begins, `count`[k] how many it has."""

    rows: LogRows
    first: Ints
    count: Ints


class _BlockReader:
    """Turns rows into blocks as soon as their steps are complete, which the network row of a step says."""

    def __init__(self, interned: InternedNames, rtol: float) -> None:
        self.ledger = Ledger(rtol=rtol)
        self._interned = interned
        self._waiting: dict[RowKind, LogRows] = {}
        self._bookings: dict[tuple[bytes, ...], Booking] = {}
        self._contradictions = Contradictions(self.ledger, interned)
        self._next: int | None = None

    def take(self, batch: Mapping[RowKind, LogRows]) -> None:
        """Take the rows of a batch, and book all steps that are complete now."""
        for kind, rows in batch.items():
            if kind is RowKind.TERM:
                self._add_terms(rows)
                continue
            self._waiting[kind] = LogRows.joined([self._waiting[kind], rows]) if kind in self._waiting else rows
        network = self._waiting.pop(RowKind.NETWORK, None)
        if network is None:
            waiting = sum(rows.n for rows in self._waiting.values())
            if waiting > WAITING_ROWS:
                raise ValueError(f"{waiting} rows of the log belong to no network row; it is not a log of phfmu")
            return
        steps, at = np.unique(network.step, return_index=True)
        self._check_order(network.step, steps)
        grouped = {RowKind.NETWORK: _grouped(network.take(at), steps)}
        for kind in _STEPPED:
            rows = self._waiting.pop(kind, None)
            if rows is not None:
                done = rows.step <= steps[-1]
                if not done.all():
                    self._waiting[kind] = rows.take(~done)
                grouped[kind] = self._own(kind, rows.take(done), steps)
        self._book(grouped)

    def _add_terms(self, rows: LogRows) -> None:
        """Sum what terms stored or lost; the rows of each in their order."""
        component, term, name = rows.names["component"], rows.names["term"], self._interned.name
        (stored, stores), (lost, _) = (rows.numbers[k] for k in ("dH", "dissipated"))
        keys, own = np.unique(np.stack([component, term, stores], axis=1), axis=0, return_inverse=True)
        values = np.where(stores, stored, lost)
        for i, (c, t, kind) in enumerate(keys.tolist()):
            self.ledger.terms([TermKey(name(c) or "", name(t) or "", bool(kind))], values[own == i][:, None])

    def finish(self, held: Mapping[str, Any]) -> None:
        """Say what is left, and what is not there; `held`: what the footer of an archive says that it holds."""
        self._book_events(self._waiting.pop(RowKind.EVENT, None), None)
        for kind, rows in self._waiting.items():
            self._contradictions.tell(
                int(rows.step[0]), f"{rows.n} {kind} rows from step {rows.step[0]} on have no network row"
            )
        self._contradictions.held(held)

    def _check_order(self, found: Ints, steps: Ints) -> None:
        expected = steps[0] if self._next is None else self._next
        jumps = np.flatnonzero(np.diff(found, prepend=expected - 1) != 1)
        if len(jumps):
            k = int(jumps[0])
            before = int(found[k - 1]) if k else int(expected) - 1
            self._contradictions.tell(
                int(found[k]), f"step {before} is followed by step {found[k]}: rows are missing or doubled"
            )
        self._next = int(steps[-1]) + 1

    def _own(self, kind: RowKind, rows: LogRows, steps: Ints) -> _RowsByStep:
        """The rows of the steps there are."""
        place = np.minimum(np.searchsorted(steps, rows.step), len(steps) - 1)
        known = steps[place] == rows.step
        if not known.all():
            lost = int(rows.step[~known][0])
            self._contradictions.tell(
                lost, f"{(~known).sum()} {kind} rows, the first of step {lost}, have no network row"
            )
            rows = rows.take(known)
        return _grouped(rows, steps)

    def _book(self, grouped: dict[RowKind, _RowsByStep]) -> None:
        """Book runs of steps of one booking between events, in order."""
        network = grouped[RowKind.NETWORK].rows
        middle = network.values("t0") + 0.5 * network.values("h")
        edges = {0, network.n, *_changes(grouped)}
        events = self._waiting.get(RowKind.EVENT)
        if events is not None:
            edges.update(np.searchsorted(middle, events.values("t0")).tolist())
        cuts = sorted(edges)
        for a, b in zip(cuts[:-1], cuts[1:], strict=True):
            self._book_events(self._waiting.pop(RowKind.EVENT, None), float(middle[a]))
            self._book_run(grouped, a, b)

    def _book_events(self, events: LogRows | None, until: float | None) -> None:
        """Book the events up to a time; the others wait."""
        if events is None:
            return
        t = events.values("t0")
        due = np.ones(events.n, bool) if until is None else ~(t > until)
        energy, there = events.numbers["energy_jump"]
        kinds, components, messages = (events.names[name] for name in ("kind", "component", "message"))
        name = self._interned.name
        for i in np.flatnonzero(due):
            jump = float(energy[i]) if there[i] else None
            self.ledger.event(float(t[i]), name(kinds[i]) or "", name(components[i]), jump, name(messages[i]))
        if not due.all():
            self._waiting[RowKind.EVENT] = events.take(~due)

    def _book_run(self, grouped: dict[RowKind, _RowsByStep], a: int, b: int) -> None:
        """Book steps a..b-1, which have one booking, and hold the recorded rows against them."""
        n, tables = b - a, {}
        for kind, g in grouped.items():
            m = int(g.count[a]) if len(g.count) else 0
            tables[kind] = g.rows.take(slice(int(g.first[a]), int(g.first[a]) + n * m)), m
        booking = self._booking(tables)
        network = tables[RowKind.NETWORK][0]
        rows, c = tables.get(RowKind.COMPONENT, (None, 0))
        ports, q = tables.get(RowKind.PORT, (None, 0))
        parts, divided = tables.get(RowKind.PART, (None, 0))

        def required(source: LogRows | None, name: str, m: int, default: float = math.nan) -> Floats:
            if source is None:
                return np.zeros((n, m))
            values, there = source.numbers[name]
            return np.where(there, values, default).reshape(n, m)

        def optional(name: str) -> Floats | None:
            if rows is None or not rows.numbers[name][1][:c].any():
                return None
            values, there = rows.numbers[name]
            most = np.maximum(np.abs(rows.values("H0")), np.abs(rows.values("H1")))
            return np.where(there, values, most if name in ("moved", "varying") else 0.0).reshape(n, c)

        H0, H1, stored = (required(rows, name, c) for name in ("H0", "H1", "dH"))
        lost, gained = (required(rows, name, c, 0.0) for name in ("dissipated", "supplied"))
        pairs, damped, moved = required(ports, "supplied", q), optional("numerical"), optional("moved")
        exchanged = None
        if ports is not None and (there := ports.numbers["exchanged"][1])[:q].any():
            exchanged = np.where(there, ports.values("exchanged"), ports.values("supplied")).reshape(n, q)
        works = required(parts, "residual", divided) if booking.parts else None
        steps = Steps(H1, stored, lost, gained, pairs, damped, moved, works=works, exchanged=exchanged)
        t0, h, varying = network.values("t0"), network.values("h"), optional("varying")
        block = book_steps(booking, network.step, t0, h, steps, H0, varying=varying)
        self._contradictions.hold(self.ledger.take(block), tables)

    def _booking(self, tables: Mapping[RowKind, tuple[LogRows, int]]) -> Booking:
        """Names of the columns, from the first step."""
        parts = {kind: rows.take(slice(0, m)) for kind, (rows, m) in tables.items() if kind in _STEPPED}
        key = tuple(x.tobytes() for p in parts.values() for x in (*p.names.values(), *_index(p)))
        if key not in self._bookings:
            self._bookings[key] = self._new_booking(parts)
        return self._bookings[key]

    def _new_booking(self, parts: Mapping[RowKind, LogRows]) -> Booking:
        name = self._interned.name
        keys, components, silent = [], (), set()
        if RowKind.PORT in parts:
            p = parts[RowKind.PORT]
            for i in range(p.n):
                component, port, junction, quality = (
                    name(p.names[k][i]) for k in ("component", "port", "junction", "quality")
                )
                value, there = p.numbers["index"]
                index = int(value[i]) if there[i] else None
                estimated = Quality.ESTIMATED if quality == Quality.ESTIMATED else Quality.EXACT
                keys.append(PortKey(component or "", port or "", index, junction, quality=estimated))
        if RowKind.COMPONENT in parts:
            p = parts[RowKind.COMPONENT]
            components = tuple(name(code) or "" for code in p.names["component"])
            owners = {key.component for key in keys}
            for i, component in enumerate(components):
                claimed = name(p.names["quality"][i])
                if claimed == Quality.SILENT and component not in owners and not p.values("dH")[i]:
                    silent.add(component)
        loose = RowKind.JUNCTION in parts and Quality.LOOSE in map(name, parts[RowKind.JUNCTION].names["quality"])
        divided = [parts[RowKind.PART].names[k] for k in ("junction", "part")] if RowKind.PART in parts else []
        known = tuple(PartKey(name(a) or "", name(b) or "") for a, b in zip(*divided, strict=True))
        met = {key.junction for key in keys}
        if lost := {key.junction for key in known if key.junction not in met}:
            step = int(parts[RowKind.PART].step[0])
            self._contradictions.tell(step, f"step {step} has parts of {', '.join(sorted(lost))}, where no ports meet")
            known = ()
        booking = Booking(components, tuple(keys), frozenset(silent), loose, known)
        if RowKind.COMPONENT in parts:
            for component, code in zip(components, parts[RowKind.COMPONENT].names["quality"], strict=True):
                claimed, found = name(code) or Quality.EXACT, booking.quality(component)
                if claimed != found:
                    step = int(parts[RowKind.COMPONENT].step[0])
                    self._contradictions.tell(
                        step, f"{component}: step {step} calls its books '{claimed}'; by its ports they are '{found}'"
                    )
        if len(set(components)) < len(components):
            step = int(parts[RowKind.COMPONENT].step[0])
            self._contradictions.tell(step, f"step {step} has two rows of one component")
        return booking


def _index(rows: LogRows) -> Iterator[NDArray[Any]]:
    """Numbers of the pairs of vector ports, 0 for the others, and which have one."""
    if "index" in rows.numbers:
        value, there = rows.numbers["index"]
        yield np.where(there, value, 0.0)
        yield there


def _grouped(rows: LogRows, steps: Ints) -> _RowsByStep:
    place = np.searchsorted(steps, rows.step)
    count = np.bincount(place, minlength=len(steps))
    order = np.argsort(place, kind="stable")
    if (np.diff(place) < 0).any():
        rows = rows.take(order)
    return _RowsByStep(rows, np.concatenate([[0], np.cumsum(count)[:-1]]), count)


def _changes(grouped: Mapping[RowKind, _RowsByStep]) -> set[int]:
    """Steps at which the rows of a step are not those of the step before: other names, other columns filled."""
    edges = {0}
    for kind in _STEPPED:
        if kind in grouped:
            edges.update((np.flatnonzero(np.diff(grouped[kind].count)) + 1).tolist())
    cuts = sorted({*edges, len(grouped[RowKind.NETWORK].first)})
    for kind in _STEPPED:
        if kind not in grouped:
            continue
        g = grouped[kind]
        marks = [
            *g.rows.names.values(),
            *(g.rows.numbers[k][1] for k in _OPTIONAL if k in g.rows.numbers),
            *_index(g.rows),
        ]
        for a, b in zip(cuts[:-1], cuts[1:], strict=True):
            m, first = int(g.count[a]), int(g.first[a])
            for mark in marks:
                table = mark[first : first + (b - a) * m].reshape(b - a, m)
                edges.update((np.flatnonzero((table[1:] != table[:-1]).any(axis=1)) + a + 1).tolist())
    return edges
