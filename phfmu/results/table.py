"""A table of signals over time, and ways out of it: pandas, polars, Arrow, files, a notebook."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phfmu.results.schema import columns, schema
from phfmu.results.writer import TableWriter, check_table

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[Any]

#: rows that a notebook shows at each end
SHOWN = 3


@dataclass
class Table:
    """Rows over `time` (rows) in s: `values` (rows x names), and the unit of each name ("1": none, "": not known)."""

    names: list[str]
    time: Array
    values: Array
    units: list[str]
    #: what each signal is (`phfmu.signals.SignalKind`), "": not known; empty: none is
    kinds: list[str] = field(default_factory=list[str], kw_only=True)
    #: what readers call each signal where the entries of a vector have names, gen.I[fd], else ""; empty: none has
    labels: list[str] = field(default_factory=list[str], kw_only=True)

    def column(self, name: str) -> Array:
        """One signal over time; KeyError lists close names."""
        return self.values[:, self._place(name)]

    def unit(self, name: str) -> str:
        """The unit of one signal; KeyError lists close names."""
        return self.units[self._place(name)]

    def to_arrow(self) -> pa.Table:
        """A pyarrow table: `time`, then the signals; units, kinds and labels in the metadata of the fields."""
        import pyarrow as pa

        found = columns(self.time, [], self.values)
        return pa.table(found, schema=schema(self.names, self.units, kinds=self.kinds, labels=self.labels))

    def to_pandas(self) -> Any:
        """A pandas frame with `time` as index; `frame.attrs["units"]`: name -> unit."""
        pandas = _package("pandas")
        frame = pandas.DataFrame(self.values, columns=self.names, index=pandas.Index(self.time, name="time"))
        frame.attrs["units"] = dict(zip(self.names, self.units, strict=True))
        return frame

    def to_polars(self) -> Any:
        """A polars frame with the column `time`; polars keeps no units."""
        return _package("polars").from_arrow(self.to_arrow())

    def save(self, path: str | Path, *, units_row: bool = False) -> Path:
        """Write .csv (with .columns.json) or .parquet, as `phfmu run -o` does. Errors: ValueError, OSError.

        `units_row`: a second line of units in CSV
        """
        check_table(str(path), "save")
        names, units, kinds, labels = self.names, self.units, self.kinds, self.labels
        writer = TableWriter(Path(path), names, units, kinds=kinds, labels=labels, units_row=units_row)
        writer.add(self.time, self.values, np.zeros(len(self.time), bool))
        writer.close()
        return Path(path)

    def _place(self, name: str) -> int:
        try:
            return self.names.index(name)
        except ValueError:
            from phfmu.words import meant

            raise KeyError(f"no signal '{name}'; {meant(name, self.names)}") from None

    def __repr__(self) -> str:
        return f"<{self._title()}>"

    def _title(self) -> str:
        n = len(self.time)
        span = f", {self.time[0]:g} to {self.time[-1]:g} s" if n else ""
        return f"{type(self).__name__}: {len(self.names)} signals, {n} rows{span}"

    def _repr_html_(self) -> str:
        """For notebooks: every signal with its unit, range and last value."""
        from phfmu.html import grid

        rows = [
            (name, "" if unit == "1" else unit, f"{low:.6g}", f"{high:.6g}", f"{last:.6g}")
            for name, unit, low, high, last in zip(
                self.names, self.units, *_ranges(self.values, len(self.names)), strict=True
            )
        ]
        return grid(self._title(), ("signal", "unit", "least", "largest", "last"), rows)


def _ranges(values: Array, n: int) -> tuple[Array, Array, Array]:
    if not len(values):
        return np.full(n, np.nan), np.full(n, np.nan), np.full(n, np.nan)
    return values.min(axis=0), values.max(axis=0), values[-1]


def _package(name: str) -> Any:
    from importlib import import_module

    try:
        return import_module(name)
    except ImportError:
        raise ImportError(f"this needs {name}: pip install {name}") from None
