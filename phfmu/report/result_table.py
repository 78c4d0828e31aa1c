"""The result table of a run as a recording: CSV or Parquet, first column `time`."""

import csv
import os
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from phfmu.report.recording import Mark, Signal
from phfmu.signals import CONSTRAINT, END, ENERGY, LEDGER, MEAN, total

if TYPE_CHECKING:
    import pyarrow as pa

#: key of a Parquet column's unit
UNIT_KEY = b"unit"
#: endings of what is not drawn unasked: mean and end values of a step, books and constraints
_BESIDE = (MEAN, END, ENERGY, *(total(name) for name, _, _ in LEDGER))


def usual(names: Sequence[str]) -> list[str]:
    """Signals that a picture shows unasked: all but means and ends of steps, energies and the marks of rows."""
    bases = {n: n.partition("[")[0] for n in names}
    chosen = [
        n for n, b in bases.items() if not b.endswith(_BESIDE) and not b.startswith(CONSTRAINT) and b != "interpolated"
    ]
    return chosen or list(names)


class ResultTable:
    """A table that `phfmu run -o` wrote. Errors: ValueError for what is none, is empty or was cut off."""

    def __init__(self, path: str | os.PathLike[str]):
        self.path = Path(path)
        self._units: dict[str, str] = {}
        header = self._parquet_header() if self.path.suffix == ".parquet" else self._csv_header()
        if not header or header[0] != "time":
            raise ValueError(f"{self.path} is not a result table of phfmu: its first column must be 'time'")
        self.names = header[1:]
        if len(set(header)) < len(header):
            twice = next(n for n in header if header.count(n) > 1)
            raise ValueError(f"{self.path} has {header.count(twice)} columns called '{twice}'; keep one")

    @property
    def title(self) -> str:
        return self.path.name

    def usual(self) -> list[str]:
        return usual(self.names)

    def marks(self) -> list[Mark]:
        return []

    def read(self, names: Sequence[str]) -> list[Signal]:
        """Signals by their exact names."""
        columns = self._columns(list(names))
        time = self._time
        return [Signal(n, self._units.get(n), time, columns[n]) for n in names]

    @cached_property
    def _time(self) -> Any:
        time = self._columns([])["time"]
        if not len(time):
            raise ValueError(f"{self.path} has no rows below its header")
        back = np.flatnonzero(~(np.diff(time) >= 0.0))
        if len(back) or not np.isfinite(time).all():
            k = int(back[0]) + 1 if len(back) else int(np.flatnonzero(~np.isfinite(time))[0])
            raise ValueError(
                f"{self.path}: row {k + 1} has time {time[k]:.9g} after {time[max(k - 1, 0)]:.9g}; times must not fall"
            )
        return time

    def _columns(self, names: list[str]) -> dict[str, Any]:
        wanted = ["time", *names]
        table = self._parquet(wanted) if self.path.suffix == ".parquet" else self._csv(wanted)
        return {n: table[n].to_numpy() for n in wanted}

    def _csv_header(self) -> list[str]:
        try:
            with open(self.path, newline="", encoding="utf-8-sig") as file:
                header = next(csv.reader(file), [])
        except (UnicodeDecodeError, csv.Error) as error:
            raise ValueError(f"{self.path} is not a CSV file in UTF-8: {error}") from error
        if not header:
            raise ValueError(f"{self.path} is empty; write one with: phfmu run TARGET -o {self.path}")
        with open(self.path, "rb") as file:
            file.seek(-1, os.SEEK_END)
            if file.read(1) != b"\n":
                raise ValueError(
                    f"{self.path} was cut off: its last line has no end. Take that line away and what is above can be read: "
                    f"sed -i '$d' {self.path}"
                )
        return header

    def _csv(self, wanted: list[str]) -> "pa.Table":
        import pyarrow as pa
        from pyarrow import csv as table

        kinds = table.ConvertOptions(include_columns=wanted, column_types=dict.fromkeys(wanted, pa.float64()))
        try:
            return table.read_csv(self.path, convert_options=kinds)
        except pa.ArrowInvalid as error:
            reason = str(error).partition("Row #")[2] or str(error)
            raise ValueError(
                f"{self.path} is damaged or not a table of numbers: {'row ' if reason != str(error) else ''}{reason}"
            ) from error

    def _parquet_header(self) -> list[str]:
        import pyarrow as pa
        import pyarrow.parquet as pq

        try:
            schema = pq.read_schema(self.path)
        except pa.ArrowInvalid as error:
            raise ValueError(f"{self.path} was cut off or is not a Parquet file: {error}") from error
        self._units = {f.name: f.metadata[UNIT_KEY].decode() for f in schema if UNIT_KEY in (f.metadata or {})}
        return schema.names

    def _parquet(self, wanted: list[str]) -> "pa.Table":
        import pyarrow as pa
        import pyarrow.parquet as pq

        try:
            return pq.read_table(self.path, columns=wanted, page_checksum_verification=True).cast(
                pa.schema([(n, pa.float64()) for n in wanted])
            )
        except (pa.ArrowInvalid, pa.ArrowNotImplementedError, OSError) as error:
            raise ValueError(f"{self.path} is damaged: {error}") from error
