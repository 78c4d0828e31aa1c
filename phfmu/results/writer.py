"""Result files: rows as CSV or Parquet, written while they are made."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from phfmu.files import beside, remains, require_writable
from phfmu.results.columns_file import write_columns
from phfmu.results.schema import UNIT_KEY, columns, schema

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[Any]


def check_table(path: str, option: str = "-o") -> None:
    """Raise ValueError if a table could not be written there; asked before a run, not after it."""
    target = Path(path)
    if target.suffix not in (".csv", ".parquet"):
        raise ValueError(f"{option} {path}: the ending must be .csv or .parquet")
    require_writable(target, f"{option} {path}")


class TableWriter:
    """Writes `time` and all signals as CSV (RFC 4180, UTF-8, the shortest digits that give the number) or Parquet.

    By the file's ending. Rows go to a file beside the target while they are made, which takes the target's place on
    `close`: memory does not grow with the run, and what was there before stays until then. `units` and `kinds` are in the
    metadata of Parquet's columns, as are `labels`; beside a CSV, X.columns.json holds them, and a second line the units with
    `units_row`. `marked`: with the column `interpolated`, 1 for rows within a step. `marks`: rows go to a stream first, of which
    `mark` tells where it is, and from which another writer goes on (`going_on`); the table is made of it on `close`.
    """

    def __init__(
        self,
        target: Path,
        names: Sequence[str],
        units: Sequence[str],
        marked: bool = False,
        units_row: bool = False,
        kinds: Sequence[str] = (),
        labels: Sequence[str] = (),
        going_on: Mapping[str, Any] | None = None,
        marks: bool = False,
    ):
        self._target = Path(os.path.realpath(target))
        self._names, self._units, self._kinds, self._labels = list(names), list(units), list(kinds), list(labels)
        self._marked, self._units_row = marked, units_row
        self._format: Any = None
        self._partial: Path | None = None
        self._left: Path | None = None
        #: rows taken, and the time of the last one
        self.rows, self.last = 0, 0.0
        self._marks = marks or going_on is not None
        if going_on is not None and going_on["partial"] is not None:
            self.rows, self.last = going_on["rows"], going_on["last"]
            self._partial = Path(going_on["partial"])
            self._format = _Stream(self._partial, self._schema(), self._table, going_on["size"])

    def add(self, time: Array, values: Array, inside: Array) -> None:
        """Take n rows: time (n), values (n x names), whether each lies within a step (n)."""
        import pyarrow as pa

        if self._partial is None:
            self._partial = beside(self._target)
            kinds = self._schema()
            self._format = _Stream(self._partial, kinds, self._table) if self._marks else self._table(self._partial)
        found = columns(time, [inside] if self._marked else [], values)
        with self._cut_on_failure():
            self._format.add(pa.record_batch(found, schema=self._schema()))
        self.rows += len(time)
        self.last = float(time[-1])

    def _table(self, path: Path) -> _CSV | _Parquet:
        """The table itself, by the ending of the target."""
        kinds = self._schema()
        return _Parquet(path, kinds) if self._target.suffix == ".parquet" else _CSV(path, kinds, self._units_row)

    def mark(self) -> dict[str, Any]:
        """Flush all rows to the disk and return the position of the stream, for `going_on`."""
        size = self._format.mark() if self._partial is not None else 0
        partial = None if self._partial is None else str(self._partial)
        return {"partial": partial, "size": size, "rows": self.rows, "last": self.last}

    def leave(self) -> None:
        """End without a table; the stream stays, for another writer that goes on from a mark."""
        if self._partial is not None:
            self._format.leave()
            self._partial = None

    def close(self) -> None:
        """Put the table in its place."""
        if self._partial is not None:
            with self._cut_on_failure():
                self._format.close()
                if self._target.suffix == ".csv":
                    write_columns(self._target, self._schema())
                if isinstance(self._format, _Stream):
                    self._left = self._partial
                    os.replace(self._format.made(), self._target)
                else:
                    os.replace(self._partial, self._target)
            self._partial = None

    def drop(self) -> None:
        """Remove the stream that the table was made of, which a run could go on from until then."""
        if self._left is not None:
            self._left.unlink(missing_ok=True)
            self._left = None

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
        return schema(self._names, self._units, self._marked, self._kinds, self._labels)


class _CSV:
    """Rows as text, handed to the system as they come."""

    def __init__(self, path: Path, schema: pa.Schema, units_row: bool):
        from pyarrow.csv import CSVWriter, WriteOptions

        self._path, self._whole = path, 0
        self._file = open(path, "wb")
        head = io.StringIO()
        rows = csv.writer(head, lineterminator="\n")
        rows.writerow(schema.names)
        if units_row:
            rows.writerow((f.metadata or {}).get(UNIT_KEY, b"").decode() for f in schema)
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


class _Stream:
    """Rows as a stream of Arrow, which can be gone on from any whole row block; made a `table` of on `close`."""

    def __init__(
        self, path: Path, schema: pa.Schema, table: Callable[[Path], _CSV | _Parquet], size: int | None = None
    ):
        self._path, self._table = path, table
        self._file = open(path, "r+b" if size is not None else "wb")
        for left in remains(path):  # tables that were not finished
            left.unlink()
        if size is None:
            self._file.write(schema.serialize())
        elif self._file.seek(0, os.SEEK_END) < size:
            raise ValueError(f"{path} is shorter than it was at the checkpoint: {size} bytes; begin the run anew")
        else:
            self._file.truncate(size)
            self._file.seek(size)
        self._whole = self._file.tell()

    def add(self, batch: pa.RecordBatch) -> None:
        self._file.write(batch.serialize())
        self._file.flush()
        self._whole = self._file.tell()

    def mark(self) -> int:
        """Bytes that are on the disk."""
        os.fsync(self._file.fileno())
        return self._whole

    def leave(self) -> None:
        self._file.close()

    def cut(self) -> bool:
        """End with the last whole block; whether there is one."""
        with suppress(OSError):
            self._file.close()
        os.truncate(self._path, self._whole)
        return self._whole > 0

    def close(self) -> None:
        self._file.close()

    def made(self) -> Path:
        """The table of all rows, in a file of its own."""
        import pyarrow as pa

        made = beside(self._path)
        table = self._table(made)
        with open(self._path, "rb") as file:
            for batch in pa.ipc.open_stream(file):
                table.add(batch)
        table.close()
        return made


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
