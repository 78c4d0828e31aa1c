"""Columns of result files with their units."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from phfmu.signals import MARKS

if TYPE_CHECKING:
    import pyarrow as pa

#: metadata keys of a column's unit in Arrow and Parquet, and of what its signal is (see `phfmu.signals.SignalKind`)
UNIT_KEY, KIND_KEY = b"unit", b"kind"


def schema(names: Sequence[str], units: Sequence[str], marked: bool = False, kinds: Sequence[str] = ()) -> pa.Schema:
    """`time`, the column of marks, the signals, with their units and kinds; "" is neither written nor known, nor are no kinds."""
    import pyarrow as pa

    def field(name: str, unit: str, kind: str) -> pa.Field:
        told = {key: text.encode() for key, text in ((UNIT_KEY, unit), (KIND_KEY, kind)) if text}
        return pa.field(name, pa.float64(), metadata=told or None)

    marks = [pa.field(MARKS, pa.int8(), metadata={KIND_KEY: b"mark"})] if marked else []
    own = [field(n, u, k) for n, u, k in zip(names, units, kinds or [""] * len(names), strict=True)]
    return pa.schema([field("time", "s", ""), *marks, *own])
