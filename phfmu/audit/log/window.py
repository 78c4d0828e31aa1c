"""A part of a log in time."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from phfmu.audit.events import EventRow
from phfmu.audit.kinds import RowKind
from phfmu.audit.log.reading import Batches, LogRows
from phfmu.audit.summary import LedgerSummary

#: of a step: ends that differ by less are one
CLOSE = 1e-6


@dataclass(frozen=True)
class Window:
    """Steps that lie in [start, end], and events at these times, in s."""

    start: float = -math.inf
    end: float = math.inf

    def __post_init__(self) -> None:
        if not self.start < self.end:
            raise ValueError(f"window {self.start:g}:{self.end:g} s: the start must be before the end")

    def of(self, batch: Mapping[RowKind, LogRows]) -> dict[RowKind, LogRows]:
        """The rows within, without the columns that depend on what came before."""
        found = {}
        for kind, rows in batch.items():
            t0 = rows.values("t0")
            h = np.zeros(rows.n) if kind is RowKind.EVENT else rows.values("h")
            kept = rows.take((t0 >= self.start - CLOSE * h) & (t0 + h <= self.end + CLOSE * h))
            for name, (values, there) in kept.numbers.items():
                if name.startswith("cum_") or name == "residual_rel":
                    kept.numbers[name] = values, np.zeros_like(there)
                if name in ("moved", "varying"):  # are held against residual_rel, in the whole log
                    kept.numbers[name] = values, np.zeros_like(there)
            if kept.n:
                found[kind] = kept
        return found


def judged_by(part: LedgerSummary, whole: LedgerSummary) -> LedgerSummary:
    """The sums of a part with the verdict on the whole, which knows all that was in play."""
    words = {c.component: c for c in whole.components}
    joined = {j.junction: j.verdict for j in whole.junctions}
    network = part.network and whole.network and replace(part.network, verdict=whole.network.verdict)
    return replace(
        part,
        components=[
            replace(c, verdict=words[c.component].verdict, worst_ratio=words[c.component].worst_ratio)
            for c in part.components
        ],
        junctions=[replace(j, verdict=joined[j.junction]) for j in part.junctions],
        network=network,
        violations=whole.violations,
    )


def event_rows(source: str, window: Window | None = None) -> Iterator[EventRow]:
    """The events of a log, in order, within a window."""
    batches = Batches(source)
    name = batches.interned.name
    for batch in batches:
        rows = (batch if window is None else window.of(batch)).get(RowKind.EVENT)
        if rows is None:
            continue
        energies = [rows.numbers[k] for k in ("energy_jump", "lost")]
        for i, t in enumerate(rows.values("t0").tolist()):
            kind, component, message = (name(rows.names[k][i]) for k in ("kind", "component", "message"))
            jump, lost = (float(values[i]) if there[i] else None for values, there in energies)
            yield EventRow(t, kind or "", component, jump, message, lost)
