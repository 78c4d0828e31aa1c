"""Columns of result files with their units."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from phfmu.signals import MARKS

if TYPE_CHECKING:
    import pyarrow as pa

#: metadata keys of a column's unit in Arrow and Parquet, of what its signal is (see `phfmu.signals.SignalKind`), and of what
#: readers call it where the entries of a vector have names (gen.I[fd])
UNIT_KEY, KIND_KEY, LABEL_KEY = b"unit", b"kind", b"label"


def schema(
    names: Sequence[str],
    units: Sequence[str],
    marked: bool = False,
    kinds: Sequence[str] = (),
    labels: Sequence[str] = (),
) -> pa.Schema:
    """`time`, the column of marks, the signals, with their units, kinds and labels; "" is neither written nor known."""
    import pyarrow as pa

    def field(name: str, unit: str, kind: str, label: str) -> pa.Field:
        told = {key: text.encode() for key, text in ((UNIT_KEY, unit), (KIND_KEY, kind), (LABEL_KEY, label)) if text}
        return pa.field(name, pa.float64(), metadata=told or None)

    marks = [pa.field(MARKS, pa.int8(), metadata={KIND_KEY: b"mark"})] if marked else []
    none = [""] * len(names)
    own = [field(*told) for told in zip(names, units, kinds or none, labels or none, strict=True)]
    return pa.schema([field("time", "s", "", ""), *marks, *own])


def columns(time: NDArray[Any], marks: Iterable[NDArray[Any]], values: NDArray[Any]) -> list[pa.Array]:
    """`time` (n), the columns of marks (n each), and the signals of `values` (n x names) as Arrow has them.

    Made of their memory: `pyarrow.array` would import pandas, where that is installed, to ask whether an array is one of its.
    """
    import numpy as np
    import pyarrow as pa

    def column(of: NDArray[Any], type_: pa.DataType, dtype: type) -> pa.Array:
        return pa.Array.from_buffers(type_, len(of), [None, pa.py_buffer(np.ascontiguousarray(of, dtype))])

    own = [column(c, pa.float64(), np.float64) for c in np.ascontiguousarray(values.T)]
    return [column(time, pa.float64(), np.float64), *(column(m, pa.int8(), np.int8) for m in marks), *own]
