"""Writing the audit log: an Arrow IPC stream while the run is under way, a Parquet file once it is over."""

import io
import json
import os
import socket
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, BinaryIO, Self

import numpy as np

from phfmu.audit.kinds import ColumnType
from phfmu.audit.log.archive import SCHEMA_KEY, WRITER_KEY, arrow_schema, compact, occupied, stream_path
from phfmu.audit.log.blocks import BLOCK_KEY, opened, sealed
from phfmu.audit.log.columns import (
    COLUMNS,
    DTYPES,
    SCHEMA_VERSION,
    LogSection,
    block_sections,
    event_section,
    state_section,
)
from phfmu.audit.log.lock import try_lock

if TYPE_CHECKING:
    import pyarrow as pa

    from phfmu.audit.booked_steps import BookedSteps
    from phfmu.audit.events import EventRow, StateRow

FLUSH_ROWS = 1024
FLUSH_SECONDS = 0.1

_VERSIONS_KEY = b"phfmu.audit.versions"
_PACKAGES = ("phfmu", "casadi", "numpy", "pyarrow")


class AuditWriter:
    """Writes the rows of a `Ledger` to X.arrows and compacts them to X.parquet on close.

    Use as a context manager: on an exception the log is closed and compacted all the same. `metadata` are
    free keys (units per port, model hash, options); values that are not strings are kept as JSON. `table`: the result table
    of the same run, about whose remains `recover` tells; `going_on`: what `mark` told of a stream that was left. From the
    start the stream is a readable log, and locked until `close`.
    Errors: ValueError for an ending other than .parquet; LogInUse if another run writes the log; FileExistsError if a
    broken run's stream is there.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        metadata: Mapping[str, Any] | None = None,
        table: str | os.PathLike[str] | None = None,
        going_on: Mapping[str, Any] | None = None,
    ) -> None:
        import pyarrow as pa

        # absolute: what a run loads may change the working folder
        self.stream = Path(os.path.abspath(stream_path(path)))
        self.path = self.stream.with_suffix(".parquet")
        self._codes: dict[str, dict[str, int]] = {name: {} for name, kind in COLUMNS.items() if kind is ColumnType.NAME}
        self._names: dict[str, pa.Array] = {}
        self._events: list[EventRow] = []
        self._sections: list[LogSection] = []
        self._pending = 0
        #: rows taken so far
        self.rows = 0
        self._flushed_at = time.monotonic()
        self._schema = _schema(metadata or {}, table)
        self._file: Any = _created(self.stream) if going_on is None else _again(self.stream, going_on["size"])
        options = pa.ipc.IpcWriteOptions(compression="lz4", emit_dictionary_deltas=True)
        self._bytes, self._blocks = io.BytesIO(), 0
        #: by column, names that were known at the start of the block before, and of this one
        self._told = [dict.fromkeys(self._codes, 0)] * 2
        self._writer = pa.ipc.new_stream(self._bytes, self._schema, options=options)
        if going_on is None:
            self._put([])
            return
        self._codes, self._told = going_on["codes"], going_on["told"]
        self._blocks, self.rows = going_on["blocks"], going_on["rows"]
        self._writer.write_batch(self._batch([]))  # the stream has the schema and these names
        self._bytes.seek(0)
        self._bytes.truncate()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def write_steps(self, block: "BookedSteps") -> None:
        """Take n steps, column by column."""
        self._check_open()
        sections = block_sections(block, self._encode)
        self._sections += sections
        self._took(sum(section.n for section in sections))
        self._flush_if_due()

    def write_event(self, event: "EventRow") -> None:
        """Take one event."""
        self._check_open()
        self._events.append(event)
        self._took(1)
        self._flush_if_due()

    def write_states(self, rows: "Sequence[StateRow]") -> None:
        """Take hashes of states."""
        self._check_open()
        self._sections.append(state_section(rows, self._encode))
        self._took(len(rows))
        self._flush_if_due()

    def flush(self) -> None:
        """Hand all pending rows to the operating system as one batch; call it before raising an error."""
        self._check_open()
        self._flushed_at = time.monotonic()
        if not self._pending:
            return
        if self._events:
            self._sections.append(event_section(self._events, self._encode))
        sections, self._sections, self._events, self._pending = self._sections, [], [], 0
        self._put(sections)

    def close(self, keep: bool = False) -> Path:
        """Flush, compact to Parquet, remove the stream (`keep`: by `drop`) and return the Parquet path; again is harmless.

        Errors: OSError, e.g. of a full disk, or where the stream does not hold what was written; it is kept then and
        `recover` gives its complete batches.
        """
        if self._file is not None:
            try:
                self.flush()
                self._writer.close()
                self._file.write(self._bytes.getvalue())
                self._file.flush()
                rows = compact(self.stream, self.path, self.rows).rows
                if rows != self.rows:
                    raise OSError(f"the stream holds {rows} of {self.rows} rows")
            except OSError as error:
                self._release()
                raise OSError(
                    f"{self.path} is not made ({error}); the rows before are in {self.stream}: make room, then "
                    f"`phfmu audit recover {self.stream}`"
                ) from error
            self._release()
            if not keep:
                self.drop()
        return self.path

    def drop(self) -> None:
        """Remove the stream of a log that is closed, which a run could go on from until then."""
        self.stream.unlink(missing_ok=True)

    def mark(self) -> dict[str, Any]:
        """Flush all rows to the disk and return the position of the stream, for `going_on`."""
        self.flush()
        os.fsync(self._file.fileno())
        return {
            "size": self._file.tell(), "codes": self._codes, "told": self._told, "blocks": self._blocks, "rows": self.rows
        }  # fmt: skip

    def leave(self) -> None:
        """End without a table; the stream stays, for another writer that goes on from a mark."""
        if self._file is not None:
            self._release()

    def discard(self) -> None:
        """End without a log, as if none had been begun; what was at its path before stays."""
        if self._file is not None:
            self._release()
            self.stream.unlink()

    def _release(self) -> None:
        """Give the file and its lock back; what could not be written by now is dropped."""
        file, self._file = self._file, None
        with suppress(OSError):
            file.close()

    def _put(self, sections: list[LogSection]) -> None:
        try:
            self._writer.write_batch(self._batch(sections), custom_metadata={BLOCK_KEY: opened(self._new_names())})
            block = bytearray(self._bytes.getvalue())
            self._bytes.seek(0)
            self._bytes.truncate()
            sealed(block, self._blocks)
            self._blocks += 1
            self._file.write(block)
            self._file.flush()
        except OSError as error:
            raise OSError(f"{self.stream} cannot be written: {error}") from error

    def _new_names(self) -> dict[str, tuple[int, list[str]]]:
        """Names by column that are new since the start of the block before."""
        before, self._told = self._told[0], [self._told[1], {name: len(codes) for name, codes in self._codes.items()}]
        return {n: (before[n], list(codes)[before[n] :]) for n, codes in self._codes.items() if len(codes) > before[n]}

    def _check_open(self) -> None:
        if self._file is None:
            raise ValueError(f"audit log {self.path} is closed; open a new AuditWriter for another run")

    def _took(self, rows: int) -> None:
        self._pending += rows
        self.rows += rows

    def _flush_if_due(self) -> None:
        if self._pending >= FLUSH_ROWS or time.monotonic() - self._flushed_at >= FLUSH_SECONDS:
            self.flush()

    def _encode(self, column: str, names: Sequence[str | None]) -> np.ndarray[Any, np.dtype[np.int32]]:
        codes = self._codes[column]
        return np.array([-1 if name is None else codes.setdefault(name, len(codes)) for name in names], np.int32)

    def _dictionary(self, column: str) -> "pa.Array":
        import pyarrow as pa

        known = self._names.get(column)
        if known is None or len(known) != len(self._codes[column]):
            known = self._names[column] = pa.array(list(self._codes[column]), pa.string())
        return known

    def _batch(self, sections: list[LogSection]) -> "pa.RecordBatch":
        import pyarrow as pa

        n = sum(section.n for section in sections)
        arrays = []
        for column, kind in COLUMNS.items():
            type_ = pa.int32() if kind is ColumnType.NAME else self._schema.field(column).type
            if any(column in section.columns for section in sections):
                values, null = _joined(column, sections, n)
                array = pa.array(values, type_, mask=null, from_pandas=False)
            else:
                array = pa.nulls(n, type_)
            if kind is ColumnType.NAME:
                array = pa.DictionaryArray.from_arrays(array, self._dictionary(column))
            arrays.append(array)
        return pa.RecordBatch.from_arrays(arrays, schema=self._schema)


def _created(path: Path) -> BinaryIO:
    """A new file under a lock."""
    try:
        fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666)
    except FileExistsError:
        raise occupied(path) from None
    while not try_lock(fd, str(path)):
        time.sleep(0.01)  # somebody looks at it in this moment
    return open(fd, "wb")


def _again(path: Path, size: int) -> BinaryIO:
    """The file of a run that was ended, under a lock, up to where it was at a mark."""
    try:
        fd = os.open(path, os.O_RDWR | getattr(os, "O_BINARY", 0))
    except FileNotFoundError:
        raise ValueError(f"{path}, the audit of the run, is not there any more; begin the run anew") from None
    if not try_lock(fd, str(path)):
        os.close(fd)
        raise occupied(path)
    file = open(fd, "r+b")
    if file.seek(0, os.SEEK_END) < size:
        file.close()
        raise ValueError(f"{path} is shorter than it was at the checkpoint: {size} bytes; begin the run anew")
    file.truncate(size)
    file.seek(size)
    return file


def _joined(column: str, sections: list[LogSection], n: int) -> tuple[Any, Any]:
    """One column of all sections, one after the other, and where it is null."""
    values, null = np.zeros(n, DTYPES[COLUMNS[column]]), np.ones(n, bool)
    start = 0
    for section in sections:
        if column in section.columns:
            part, valid = section.columns[column]
            values[start : start + section.n] = part
            null[start : start + section.n] = False if valid is None else ~valid
        start += section.n
    return values, null


def _schema(metadata: Mapping[str, Any], table: str | os.PathLike[str] | None) -> "pa.Schema":
    versions = {"python": sys.version.split()[0]}
    for package in _PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            continue
    keys: dict[bytes, bytes] = {
        key.encode(): (value if isinstance(value, str) else json.dumps(value)).encode()
        for key, value in metadata.items()
    }
    keys |= {SCHEMA_KEY: str(SCHEMA_VERSION).encode(), _VERSIONS_KEY: json.dumps(versions).encode()}
    writer = {"pid": os.getpid(), "host": socket.gethostname()}
    writer |= {"table": os.path.realpath(table)} if table else {}
    keys[WRITER_KEY] = json.dumps(writer).encode()
    return arrow_schema(keys)
