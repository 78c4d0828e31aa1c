"""Result tables and input files."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phfmu.files import beside, require_writable

if TYPE_CHECKING:
    import pyarrow as pa

    from phfmu.network.run.held import HeldInputs

Array = NDArray[Any]


def check_table(path: str) -> None:
    """ValueError if a table could not be written there; asked before a run, not after it."""
    target = Path(path)
    if target.suffix not in (".csv", ".parquet"):
        raise ValueError(f"-o {path}: the ending must be .csv or .parquet")
    require_writable(target, f"-o {path}")


class TableWriter:
    """Writes `time` and all signals as CSV (RFC 4180, UTF-8, the shortest digits that give the number) or Parquet.

    By the file's ending. Rows go to a file beside the target while they are made, which takes the target's place on
    `close`: memory does not grow with the run, and what was there before stays until then. `marked`: with the column
    `interpolated`, 1 for rows within a step.
    """

    def __init__(self, target: Path, names: Sequence[str], marked: bool):
        self._target = Path(os.path.realpath(target))
        self.names = ["time", *(["interpolated"] if marked else []), *names]
        self._marked = marked
        self._format: Any = None
        self._partial: Path | None = None
        #: rows taken, and the time of the last one
        self.rows, self.last = 0, 0.0

    def add(self, time: Array, values: Array, inside: Array) -> None:
        """Take n rows: time (n), values (n x names), whether each lies within a step (n)."""
        import pyarrow as pa

        if self._partial is None:
            self._partial = beside(self._target)
            self._format = (_Parquet if self._target.suffix == ".parquet" else _CSV)(self._partial, self._schema())
        marks = [inside.astype(np.int8)] if self._marked else []
        columns = [pa.array(c) for c in (time, *marks, *np.ascontiguousarray(values.T))]
        with self._cut_on_failure():
            self._format.add(pa.record_batch(columns, schema=self._schema()))
        self.rows += len(time)
        self.last = float(time[-1])

    def close(self) -> None:
        """Put the table in its place."""
        if self._partial is not None:
            with self._cut_on_failure():
                self._format.close()
                os.replace(self._partial, self._target)
            self._partial = None

    @contextmanager
    def _cut_on_failure(self) -> Iterator[None]:
        """After a failure, such as a full disk: back to the rows before it, or to no table."""
        try:
            yield
        except OSError as error:
            if not self._format.cut() and self._partial is not None:
                self._partial.unlink()
                self.rows, self._partial = 0, None
            raise OSError(f"{self._target} cannot be written: {error}") from error

    def _schema(self) -> pa.Schema:
        import pyarrow as pa

        types = [pa.float64(), *([pa.int8()] if self._marked else [])]
        return pa.schema(zip(self.names, types + [pa.float64()] * (len(self.names) - len(types)), strict=True))


class _CSV:
    """Rows as text, handed to the system as they come."""

    def __init__(self, path: Path, schema: pa.Schema):
        from pyarrow.csv import CSVWriter, WriteOptions

        self._path, self._whole = path, 0
        self._file = open(path, "wb")
        head = io.StringIO()
        csv.writer(head, lineterminator="\n").writerow(schema.names)
        self._file.write(head.getvalue().encode())
        self._writer = CSVWriter(self._file, schema, write_options=WriteOptions(include_header=False))

    def add(self, batch: pa.RecordBatch) -> None:
        self._writer.write_batch(batch)
        self._file.flush()
        self._whole = self._file.tell()

    def cut(self) -> bool:
        """End with the last whole block; whether there is one."""
        with suppress(OSError):
            self._file.close()
        os.truncate(self._path, self._whole)
        return self._whole > 0

    def close(self) -> None:
        if not self._file.closed:
            self._writer.close()
            self._file.close()


class _Parquet:
    """Rows in groups of about `GROUP_BYTES`; the file is readable once it is closed."""

    GROUP_BYTES = 1 << 26

    def __init__(self, path: Path, schema: pa.Schema):
        from pyarrow.parquet import ParquetWriter

        self._schema, self._batches, self._size = schema, [], 0
        self._writer = ParquetWriter(path, schema, write_page_checksum=True)

    def add(self, batch: pa.RecordBatch) -> None:
        self._batches.append(batch)
        self._size += batch.nbytes
        if self._size >= self.GROUP_BYTES:
            self._write()

    def cut(self) -> bool:
        """Without its end such a file cannot be read."""
        return False

    def close(self) -> None:
        self._write()
        self._writer.close()

    def _write(self) -> None:
        import pyarrow as pa

        self._writer.write_table(pa.Table.from_batches(self._batches, self._schema).combine_chunks())
        self._batches, self._size = [], 0


def read_inputs(path: str, known: list[str]) -> HeldInputs:
    """A table like the output, CSV or Parquet: `time`, then settable names; ValueError names line, column and value."""
    from phfmu.network.run.held import HeldInputs

    header, places, numbers = (_parquet if Path(path).suffix == ".parquet" else _csv)(path)
    if not header or header[0] != "time":
        raise ValueError(f"{path}: the first column must be 'time', then one per input, separated by commas")
    names = _names(path, header[1:], known)
    if not places:
        raise ValueError(f"{path} has no rows below its header; give the values at one time at least")
    values = numbers()
    late = np.flatnonzero(np.diff(values[:, 0]) <= 0)
    if late.size:
        i = late[0] + 1
        before, now = values[i - 1 : i + 1, 0]
        raise ValueError(f"{path}, {places[i]}: time {now:.9g} after {before:.9g}; times must increase")
    return HeldInputs(names, values[:, 0], values[:, 1:])


#: names of the columns, where each row stands, and what reads the numbers
Source = tuple[list[str], list[str], Callable[[], Array]]


def _csv(path: str) -> Source:
    rows = _rows(path)
    header = [n.strip() for n in rows[0][1]] if rows else []
    texts = [row for _, row in rows[1:]]
    places = [f"line {line}" for line, _ in rows[1:]]

    def numbers() -> Array:
        with suppress(ValueError):
            values = np.array(texts, float)
            if values.shape == (len(texts), len(header)) and np.isfinite(values).all():
                return values
        return np.array([_numbers(f"{path}, {p}", header, r) for p, r in zip(places, texts, strict=True)])

    return header, places, numbers


def _parquet(path: str) -> Source:
    import pyarrow as pa
    import pyarrow.parquet as pq

    if not Path(path).is_file():
        raise FileNotFoundError(f"--input {path}: no such file")
    try:
        table = pq.read_table(path)
    except (pa.ArrowException, OSError) as error:
        raise ValueError(f"{path} is not a Parquet file: {error}") from error
    header = list(table.column_names)

    def numbers() -> Array:
        columns = []
        for name, column in zip(header, table.columns, strict=True):
            if not (pa.types.is_floating(column.type) or pa.types.is_integer(column.type)):
                raise ValueError(f"{path}, column {name}: {column.type} is not a number")
            values = column.cast(pa.float64()).to_numpy()
            bad = np.flatnonzero(~np.isfinite(values))
            if bad.size:
                raise ValueError(f"{path}, row {bad[0] + 1}, column {name}: {values[bad[0]]} is not finite")
            columns.append(values)
        return np.column_stack(columns)

    return header, [f"row {i + 1}" for i in range(table.num_rows)], numbers


def _rows(path: str) -> list[tuple[int, list[str]]]:
    """Line numbers and fields, without empty lines and comments."""
    if not Path(path).is_file():
        raise FileNotFoundError(f"--input {path}: no such file")
    with open(path, newline="", encoding="utf-8-sig") as file:
        reader = csv.reader(file)
        try:
            return [(reader.line_num, r) for r in reader if r and not r[0].startswith("#")]
        except (UnicodeDecodeError, csv.Error) as error:
            raise ValueError(f"{path} is not a CSV file in UTF-8: {error}") from error


def _names(path: str, names: list[str], known: list[str]) -> list[str]:
    for name in names:
        if name not in known:
            from difflib import get_close_matches

            close = get_close_matches(name, known, 3)
            there = ", ".join(known[:12]) or "none"
            hint = f"did you mean {', '.join(close)}?" if close else f"there are: {there}"
            raise ValueError(f"{path}: unknown input '{name}'; {hint}")
        if names.count(name) > 1:
            raise ValueError(f"{path}: {names.count(name)} columns are called '{name}'; keep one")
    return names


def _numbers(place: str, names: list[str], row: list[str]) -> list[float]:
    if len(row) != len(names):
        raise ValueError(f"{place}: {len(row)} values, expected {len(names)} ({', '.join(names[:6])})")
    values = []
    for name, text in zip(names, row, strict=True):
        try:
            value = float(text)
        except ValueError:
            raise ValueError(f"{place}, column {name}: '{text}' is not a number") from None
        if not np.isfinite(value):
            raise ValueError(f"{place}, column {name}: {text.strip()} at time {row[0]} is not finite")
        values.append(value)
    return values
