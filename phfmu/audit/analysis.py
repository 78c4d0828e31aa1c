"""The audit table judged and summed."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .rows import ESTIMATED
from .summary import ComponentSummary, JunctionSummary, LedgerSummary, NetworkSummary, PortSummary
from .sums import CompensatedSum, Floats, largest, relative

if TYPE_CHECKING:
    import pyarrow as pa

DEFAULT_RTOL = 1e-11

Codes = tuple[NDArray[np.int64], list[str]]


@dataclass(frozen=True, slots=True)
class Violation:
    """A component's step whose residual exceeds rtol (sum |H_s| + |supplied| + |dissipated|)."""

    component: str
    step: int
    t0: float
    h: float
    residual: float
    allowed: float
    relative: float


class _Rows:
    """The rows of one kind as numpy columns, in the order of the file."""

    def __init__(self, table: "pa.Table", kind: str) -> None:
        import pyarrow.compute as pc

        if "row" in table.column_names and table.num_rows:
            table = table.filter(pc.call_function("equal", [table["row"].cast("string"), kind]))
        self._table = table
        self.n = table.num_rows

    def has(self, name: str) -> bool:
        """True if some row of this kind fills the column."""
        return name in self._table.column_names and self._table[name].null_count < self.n

    def numbers(self, name: str, absent: float) -> Floats:
        """A column [n]; `absent` where it is null. What is not a number in the file stays so."""
        if not self.has(name):
            return np.full(self.n, absent)
        column = self._table[name]
        filled = column.fill_null(absent) if column.null_count and not math.isnan(absent) else column
        return filled.cast("float64").to_numpy()

    def integers(self, name: str) -> NDArray[np.int64]:
        if not self.has(name):
            return np.zeros(self.n, np.int64)
        return self._table[name].fill_null(0).cast("int64").to_numpy()

    def names(self, name: str) -> Codes:
        """Codes [n], -1 for null, and what they stand for."""
        if not self.has(name):
            return np.full(self.n, -1), []
        column = self._table[name].cast("string").dictionary_encode().unify_dictionaries().combine_chunks()
        return column.indices.fill_null(-1).to_numpy().astype(np.int64), column.dictionary.to_pylist()


def _groups(codes: Codes) -> Iterator[tuple[str, NDArray[np.int64]]]:
    """Each name with the rows it stands in, in order of first appearance."""
    order = np.argsort(codes[0], kind="stable")
    edges = np.searchsorted(codes[0][order], np.arange(len(codes[1]) + 1))
    for code, name in enumerate(codes[1]):
        members = order[edges[code] : edges[code + 1]]
        if len(members):
            yield name, members


def _sum(x: Floats) -> float:
    accumulator = CompensatedSum()
    return float(accumulator.extend(x)[-1]) if len(x) else 0.0


def _balance(rows: _Rows) -> tuple[Floats, Floats]:
    """Residual of every component row, recomputed, and what it is measured against; both [n]."""
    lost, gained, damped = (rows.numbers(name, 0.0) for name in ("dissipated", "supplied", "numerical"))
    stored = np.maximum(np.abs(rows.numbers("H0", math.nan)), np.abs(rows.numbers("H1", math.nan)))
    if rows.has("scale"):
        scale = rows.numbers("scale", -1.0)
        stored = np.where(scale == -1.0, stored, scale)
    with np.errstate(invalid="ignore", over="ignore"):
        residual = rows.numbers("dH", math.nan) + lost + damped - gained
        return residual, stored + np.abs(gained) + np.abs(lost) + np.abs(damped)


def _estimated(rows: _Rows) -> NDArray[np.bool_]:
    codes, names = rows.names("quality")
    return np.isin(codes, [i for i, name in enumerate(names) if name == ESTIMATED])


def verdict(table: "pa.Table", rtol: float = DEFAULT_RTOL) -> list[Violation]:
    """Component rows with |residual| > rtol (sum |H_s| + |supplied| + |dissipated|), in the file's order.

    What is not a finite number is a violation. Components with estimated port energies are not judged.
    """
    rows = _Rows(table, "component")
    residual, magnitude = _balance(rows)
    ratio = relative(residual, magnitude)
    bad = np.flatnonzero((ratio > rtol) & ~_estimated(rows))
    codes, names = rows.names("component")
    step, t0, h = rows.integers("step"), rows.numbers("t0", math.nan), rows.numbers("h", math.nan)
    return [
        Violation(
            names[codes[i]],
            int(step[i]),
            float(t0[i]),
            float(h[i]),
            float(residual[i]),
            float(rtol * magnitude[i]),
            float(ratio[i]),
        )
        for i in bad
    ]


def summarise(table: "pa.Table") -> LedgerSummary:
    """The ledger of an audit table, as `Ledger.summary` gives it while the run is under way."""
    steps = _Rows(table, "network")
    t0, h = steps.numbers("t0", math.nan), steps.numbers("h", math.nan)
    events = _Rows(table, "event")
    kinds, kind_names = events.names("kind")
    return LedgerSummary(
        steps=steps.n,
        t_start=float(t0[0]) if steps.n else math.nan,
        t_end=float(t0[-1] + h[-1]) if steps.n else math.nan,
        components=_components(_Rows(table, "component"), events),
        ports=_ports(_Rows(table, "port")),
        junctions=_junctions(_Rows(table, "junction")),
        network=_network(steps) if steps.n else None,
        events={name: len(members) for name, members in _groups((kinds, kind_names))},
    )


def _components(rows: _Rows, events: _Rows) -> list[ComponentSummary]:
    residual, magnitude = _balance(rows)
    ratio, estimated = relative(residual, magnitude), _estimated(rows)
    H0, H1, dH = (rows.numbers(name, math.nan) for name in ("H0", "H1", "dH"))
    lost, gained, damped = (rows.numbers(name, math.nan) for name in ("dissipated", "supplied", "numerical"))
    step, t0 = rows.integers("step"), rows.numbers("t0", math.nan)
    jump = events.numbers("energy_jump", math.nan)
    jumps = {name: _present(jump[members]) for name, members in _groups(events.names("component"))}
    summaries = []
    for name, members in _groups(rows.names("component")):
        worst = members[int(np.argmax(ratio[members]))]
        summaries.append(
            ComponentSummary(
                name,
                float(H0[members[0]]),
                float(H1[members[-1]]),
                stored=_sum(dH[members]),
                dissipated=_present(lost[members]),
                supplied=_present(gained[members]),
                jumps=jumps.get(name),
                worst_residual=float(residual[worst]),
                worst_relative=float(ratio[worst]),
                worst_step=int(step[worst]),
                worst_t0=float(t0[worst]),
                magnitude=largest(magnitude[members]),
                quality=ESTIMATED if estimated[members].any() else "exact",
                numerical=_present(damped[members]),
            )
        )
    return summaries


def _present(x: Floats) -> float | None:
    """Sum of what is there; None if nothing is."""
    there = x[~np.isnan(x)]
    return _sum(there) if len(there) else None


def _ports(rows: _Rows) -> list[PortSummary]:
    codes, ports = rows.names("port")
    junctions, junction_names = rows.names("junction")
    energy, estimated = rows.numbers("supplied", math.nan), _estimated(rows)
    summaries = []
    for component, members in _groups(rows.names("component")):
        for port, within in _groups((codes[members], ports)):
            at = members[within]
            junction = junctions[at[0]]
            summaries.append(
                PortSummary(
                    component,
                    port,
                    junction_names[junction] if junction >= 0 else None,
                    ESTIMATED if estimated[at].any() else "exact",
                    _sum(energy[at]),
                )
            )
    return summaries


def _junctions(rows: _Rows) -> list[JunctionSummary]:
    residual, exchanged = rows.numbers("residual", math.nan), rows.numbers("exchanged", math.nan)
    return [
        JunctionSummary(name, _sum(residual[members]), _present(exchanged[members]), largest(residual[members]))
        for name, members in _groups(rows.names("junction"))
    ]


def _network(rows: _Rows) -> NetworkSummary:
    unexplained = rows.numbers("unexplained", math.nan)
    optional = ("dissipated", "external", "junction_residual", "numerical")
    lost, external, created, damped = (_sum(rows.numbers(name, 0.0)) if rows.has(name) else None for name in optional)
    stored = _sum(rows.numbers("dH", math.nan))
    return NetworkSummary(stored, lost, external, created, _sum(unexplained), largest(unexplained), damped)
