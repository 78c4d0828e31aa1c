"""Result files read again: CSV or Parquet, first column `time`."""

from __future__ import annotations

import csv
import os
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phfmu.results.columns_file import read_columns
from phfmu.results.kinds import kinds_by_name
from phfmu.results.schema import KIND_KEY, LABEL_KEY, UNIT_KEY
from phfmu.results.table import Table

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[Any]


def open_result(path: str | os.PathLike[str], signals: Sequence[str] = ()) -> Table:
    """The table that `phfmu run -o` or `Result.save` wrote; `signals`: names or patterns of the columns to read, none: all.

    Errors: FileNotFoundError; ValueError for a file that is no such table, is empty or was cut off, and for unknown signals.
    """
    from phfmu.pick import pick

    if not Path(path).is_file():
        raise FileNotFoundError(f"no file '{path}'; make one with: phfmu run TARGET -o {path}")
    file = ResultFile(path)
    names = pick(signals, file.names, str(path)) if signals else file.names
    columns = file.columns(names)
    values = np.column_stack([columns[n] for n in names]) if names else np.zeros((len(file.time), 0))
    units, kinds, labels = ([told.get(n, "") for n in names] for told in (file.units, file.kinds, file.labels))
    return Table(list(names), file.time, values, units, kinds=kinds, labels=labels)


class ResultFile:
    """Columns of one file, read when they are asked for. Errors: ValueError for a file that is none, is empty or was cut off."""

    def __init__(self, path: str | os.PathLike[str]):
        self.path = Path(path)
        #: name -> unit, of those that the file tells
        self.units: dict[str, str] = {}
        #: name -> what the signal is, told by the file, of others by their names
        self.kinds: dict[str, str] = {}
        #: name -> what readers call it, where the entries of a vector have names
        self.labels: dict[str, str] = {}
        self._lines_above = 1  # of CSV: names, and units where they are told
        header = self._parquet_header() if self.path.suffix == ".parquet" else self._csv_header()
        if not header or header[0] != "time":
            raise ValueError(f"{self.path} is not a result table of phfmu: its first column must be 'time'")
        self.names = header[1:]
        self.kinds = kinds_by_name(self.names) | self.kinds
        if len(set(header)) < len(header):
            twice = next(n for n in header if header.count(n) > 1)
            raise ValueError(f"{self.path} has {header.count(twice)} columns called '{twice}'; keep one")

    @cached_property
    def time(self) -> Array:
        """Times of the rows, s."""
        time = self.columns([])["time"]
        if not len(time):
            raise ValueError(f"{self.path} has no rows below its header")
        back = np.flatnonzero(~(np.diff(time) >= 0.0))
        if len(back) or not np.isfinite(time).all():
            k = int(back[0]) + 1 if len(back) else int(np.flatnonzero(~np.isfinite(time))[0])
            raise ValueError(
                f"{self.path}: row {k + 1} has time {time[k]:.9g} after {time[max(k - 1, 0)]:.9g}; times must not fall"
            )
        return time

    def columns(self, names: Sequence[str]) -> dict[str, Array]:
        """`time` and the columns `names`."""
        wanted = ["time", *names]
        table = self._parquet(wanted) if self.path.suffix == ".parquet" else self._csv(wanted)
        return {n: table[n].to_numpy() for n in wanted}

    def _csv_header(self) -> list[str]:
        try:
            with open(self.path, newline="", encoding="utf-8-sig") as file:
                rows = csv.reader(file)
                header, second = next(rows, []), next(rows, [])
        except (UnicodeDecodeError, csv.Error) as error:
            raise ValueError(f"{self.path} is not a CSV file in UTF-8: {error}") from error
        if not header:
            raise ValueError(f"{self.path} is empty; write one with: phfmu run TARGET -o {self.path}")
        self._tell(read_columns(self.path))
        if second[:1] == ["s"]:  # a line of units: times are numbers
            self._lines_above = 2
            self.units = dict(zip(header, second, strict=False))
        with open(self.path, "rb") as file:
            file.seek(-1, os.SEEK_END)
            if file.read(1) != b"\n":
                raise ValueError(
                    f"{self.path} was cut off: its last line has no end. Take that line away and what is above can be read: "
                    f"sed -i '$d' {self.path}"
                )
        return header

    def _csv(self, wanted: list[str]) -> pa.Table:
        import pyarrow as pa
        from pyarrow import csv as table

        kinds = table.ConvertOptions(include_columns=wanted, column_types=dict.fromkeys(wanted, pa.float64()))
        lines = table.ReadOptions(skip_rows_after_names=self._lines_above - 1)
        try:
            return table.read_csv(self.path, read_options=lines, convert_options=kinds)
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
        keys = (UNIT_KEY, KIND_KEY, LABEL_KEY)
        self._tell({k: {f.name: f.metadata[k].decode() for f in schema if k in (f.metadata or {})} for k in keys})
        return schema.names

    def _tell(self, columns: Mapping[bytes, dict[str, str]]) -> None:
        """Take what is told of the columns."""
        self.units, self.kinds, self.labels = (columns.get(key, {}) for key in (UNIT_KEY, KIND_KEY, LABEL_KEY))

    def _parquet(self, wanted: list[str]) -> pa.Table:
        import pyarrow as pa
        import pyarrow.parquet as pq

        try:
            return pq.read_table(self.path, columns=wanted, page_checksum_verification=True).cast(
                pa.schema([(n, pa.float64()) for n in wanted])
            )
        except (pa.ArrowInvalid, pa.ArrowNotImplementedError, OSError) as error:
            raise ValueError(f"{self.path} is damaged: {error}") from error
