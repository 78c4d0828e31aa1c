"""Columns of result files with their units."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pyarrow as pa

#: metadata key of a column's unit in Arrow and Parquet
UNIT_KEY = b"unit"


def schema(names: Sequence[str], units: Sequence[str], marked: bool = False) -> pa.Schema:
    """`time`, the column of marks, the signals, with their units."""
    import pyarrow as pa

    def field(name: str, kind: pa.DataType, unit: str) -> pa.Field:
        return pa.field(name, kind, metadata={UNIT_KEY: unit.encode()} if unit else None)

    marks = [pa.field("interpolated", pa.int8())] if marked else []
    own = [field(n, pa.float64(), u) for n, u in zip(names, units, strict=True)]
    return pa.schema([field("time", pa.float64(), "s"), *marks, *own])
