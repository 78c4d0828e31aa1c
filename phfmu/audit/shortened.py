"""Sheets of large networks: the rows that matter most, and one for the sum of all others."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from .kinds import CellKind, LedgerVerdict
from .sheets import Column, Sheet


def shortened(sheet: Sheet, most: int) -> Sheet:
    """At most `most` rows in their order: those that do not close, then those with the most energy; the last is all others."""
    n = len(sheet.rows)
    if n <= most:
        return sheet
    weight = [_weight(sheet.columns, row) for row in sheet.rows]
    told = set(sorted(range(n), key=lambda i: weight[i], reverse=True)[: most - 1])
    others = [row for i, row in enumerate(sheet.rows) if i not in told]
    cells = [_together(c, [row[j] for row in others]) for j, c in enumerate(sheet.columns)]
    kept = [row for i, row in enumerate(sheet.rows) if i in told]
    return Sheet(sheet.title, sheet.columns, (*kept, (f"{len(others)} others", *cells[1:])))


def _weight(columns: Sequence[Column], row: Sequence[Any]) -> tuple[bool, float]:
    energies = [abs(v) for c, v in zip(columns, row, strict=True) if c.kind is CellKind.ENERGY and v is not None]
    return LedgerVerdict.VIOLATED in row, max((e for e in energies if not math.isnan(e)), default=0.0)


def _together(column: Column, values: Sequence[Any]) -> Any:
    """Energies add up, of the worst the worst remains, and a word that all share."""
    there = [v for v in values if v is not None]
    if column.kind is CellKind.ENERGY and column.adds:
        return math.fsum(there)
    if column.kind in (CellKind.ENERGY, CellKind.RATIO):
        return max(there, key=abs, default=None)
    return values[0] if len(set(values)) == 1 else None
