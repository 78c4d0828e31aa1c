"""Reading the audit log back: streams, also torn ones, and the Parquet files they become.

A stream that was cut off anywhere (kill -9, power, full disk) gives back every complete batch, one with damaged bytes every
batch that is not.
"""

import json
import mmap
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from phfmu.audit.kinds import ColumnType, RowKind
from phfmu.audit.log.blocks import Decoder, StreamBlocks, messages
from phfmu.audit.log.columns import COLUMNS, SCHEMA_VERSION
from phfmu.audit.log.lock import try_lock
from phfmu.audit.log.seal import HOLDS_KEY, require_whole, seal
from phfmu.files import beside, remains, require_writable

if TYPE_CHECKING:
    import pyarrow as pa

SCHEMA_KEY = b"phfmu.audit.schema"
#: process and machine that write a stream, and the table they write beside it; not in the Parquet file
WRITER_KEY = b"phfmu.audit.writer"
_ROW_GROUP = 1 << 17


def stream_path(path: str | os.PathLike[str]) -> Path:
    """The stream beside X.parquet is X.arrows; ValueError for another ending."""
    path = Path(path)
    if path.suffix not in (".parquet", ".arrows"):
        raise ValueError(f"audit log {str(path)!r} must end in .parquet, e.g. {path.stem}.audit.parquet")
    return path.with_suffix(".arrows")


class LogInUse(OSError):
    """The log is being written by another run."""


def require_free(path: str | os.PathLike[str], shown: str) -> None:
    """Errors if a log X.parquet cannot be begun: asked before a run, not after it.

    ValueError: ending, folder, permissions; LogInUse, FileExistsError: a stream of a running or broken run is there.
    """
    stream = stream_path(path)
    require_writable(stream.with_suffix(".parquet"), shown)
    if stream.exists():
        raise occupied(stream)


def occupied(stream: Path) -> Exception:
    """Why the stream that is there already cannot be written."""
    try:
        with held(stream):
            return FileExistsError(
                f"{stream} is left from a run that did not end; "
                f"keep its rows with `phfmu audit recover {stream}` or delete it"
            )
    except OSError as error:
        return error


@contextmanager
def held(stream: Path) -> Iterator[None]:
    """The lock of a stream nobody writes; LogInUse if a run does."""
    fd = os.open(stream, os.O_RDWR | getattr(os, "O_BINARY", 0))
    try:
        if not try_lock(fd, str(stream)):
            raise LogInUse(f"{stream} is being written by {_writer(stream)}; wait for its end, or name another log")
        yield
    finally:
        os.close(fd)


def _writer(stream: Path) -> str:
    try:
        found = _written_by(stream)
        return f"process {found['pid']} on {found['host']}"
    except (ValueError, KeyError, TypeError):
        return "another process"


def _written_by(stream: Path) -> Any:
    return json.loads((Stream(stream).schema.metadata or {})[WRITER_KEY])


def _left_of_table(stream: Path) -> tuple[Path, ...]:
    """The unfinished tables of the run that wrote the stream."""
    try:
        return tuple(remains(Path(_written_by(stream)["table"])))
    except (ValueError, KeyError, TypeError):
        return ()


class Stream:
    """Iterates over the batches of a stream whose checks hold.

    `torn`: an incomplete batch ended it;  `damaged`: how many others fail their check.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        with _bytes_of(path) as data:
            found = StreamBlocks(data)
            if not found.blocks:
                raise ValueError(f"{path} was cut off in its header or is not an audit stream; it holds no rows")
            first = found.blocks[0]
            self.schema = _schema_of(data[first.start : first.end]) if first.number == 0 else arrow_schema(_LOST)
        self._blocks, self.torn, self.damaged = found.blocks, found.torn, found.damaged

    def __iter__(self) -> Iterator["pa.RecordBatch"]:
        decoder = Decoder(self.schema)
        with _bytes_of(self._path) as data:
            for block in self._blocks:
                batch = decoder.batch(data[block.start : block.end], block.names)
                if batch is not None:
                    yield batch


#: metadata of a stream that has lost its header
_LOST = {SCHEMA_KEY: str(SCHEMA_VERSION).encode()}


@contextmanager
def _bytes_of(path: Path) -> Iterator[Any]:
    """The bytes of a file, which are read when they are asked for."""
    with open(path, "rb") as file:
        if os.fstat(file.fileno()).st_size == 0:
            yield b""
            return
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            yield data


def _schema_of(block: bytes) -> "pa.Schema":
    import pyarrow as pa

    return pa.ipc.read_schema(next(messages(block)))


def arrow_schema(metadata: Mapping[bytes, bytes]) -> "pa.Schema":
    """The columns of a log, with metadata."""
    import pyarrow as pa

    types = {
        ColumnType.I64: pa.int64(),
        ColumnType.I32: pa.int32(),
        ColumnType.F64: pa.float64(),
        ColumnType.NAME: pa.dictionary(pa.int32(), pa.string()),
        ColumnType.TEXT: pa.string(),
    }
    return pa.schema([pa.field(name, types[kind]) for name, kind in COLUMNS.items()], metadata=dict(metadata))


def _used(columns: set[str]) -> list[str]:
    """Columns to keep, in the order of the schema; `row` stays so that an empty run is a table too."""
    return [name for name in COLUMNS if name in columns or name == "row"]


@dataclass(frozen=True, slots=True)
class Compaction:
    """The result of compacting a stream: rows, and whether an incomplete batch ended it or others failed their check."""

    rows: int
    torn: bool
    damaged: int


def compact(stream: Path, target: Path, expected: int | None = None) -> Compaction:
    """Write the complete batches of a stream as Parquet without its empty columns.

    expected: rows of a run that ended; where the stream has others, nothing is written.  Two passes, so that memory does not grow
    with the run; the target appears only when it is whole and on the disk.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    first = Stream(stream)
    check_schema(first.schema.metadata, stream)
    columns: set[str] = set()
    rows, steps, end = 0, 0, None
    for batch in first:
        rows += batch.num_rows
        columns |= {name for name, c in zip(batch.schema.names, batch.columns, strict=True) if c.null_count < len(c)}
        more, end = _steps(batch, end)
        steps += more
    found = Compaction(rows, first.torn, first.damaged)
    if expected not in (None, rows):
        return found
    keep, held = _used(columns), {"steps": steps, "end": end}
    held |= {} if expected is not None else {"torn": found.torn, "damaged": found.damaged}
    about = {key: value for key, value in first.schema.metadata.items() if key != WRITER_KEY}
    about[HOLDS_KEY] = json.dumps(held).encode()
    schema = pa.schema([first.schema.field(name) for name in keep], metadata=about)
    partial = beside(target)
    try:
        with pq.ParquetWriter(partial, schema, compression="zstd", write_page_checksum=True) as writer:
            group: list[pa.RecordBatch] = []
            for batch in first:
                group.append(batch.select(keep))
                if sum(b.num_rows for b in group) >= _ROW_GROUP:
                    writer.write_table(_table(group, schema))
                    group = []
            if group:
                writer.write_table(_table(group, schema))
        seal(partial)
        os.replace(partial, target)
    finally:
        partial.unlink(missing_ok=True)
    return found


def _steps(batch: "pa.RecordBatch", end: float | None) -> tuple[int, float | None]:
    """Steps of a batch, and the end of the last one [s]."""
    kinds = batch["row"].dictionary.to_pylist()
    if RowKind.NETWORK not in kinds:
        return 0, end
    codes = batch["row"].indices.fill_null(-1).to_numpy(zero_copy_only=False)
    network = np.flatnonzero(codes == kinds.index(RowKind.NETWORK))
    if not len(network):
        return 0, end
    last = int(network[-1])
    return len(network), batch["t0"][last].as_py() + batch["h"][last].as_py()


def _table(batches: list["pa.RecordBatch"], schema: "pa.Schema") -> "pa.Table":
    import pyarrow as pa

    return pa.Table.from_batches(batches, schema).unify_dictionaries().combine_chunks()


@dataclass(frozen=True, slots=True)
class Recovered:
    """The result of recovering a broken run's stream.

    `torn`: it ended in an incomplete batch;  `damaged`: how many batches fail their check;  `kept`: where the stream is then;
    `tables`: what is left of the table the run wrote too, the last written first (earlier ones are of earlier runs).
    """

    path: Path
    rows: int
    torn: bool
    tables: tuple[Path, ...] = ()
    damaged: int = 0
    kept: Path | None = None


def recover(path: str | os.PathLike[str]) -> Recovered:
    """Turn the stream of a broken run (X.arrows, or named by its X.parquet) into X.parquet and remove it.

    All batches whose check holds are kept, before and after those that are damaged; a damaged stream is not removed, it
    becomes X.arrows.damaged.
    Errors: FileNotFoundError without a stream; LogInUse if its run is under way; ValueError if no batch is complete.
    """
    stream = stream_path(path)
    if not stream.exists():
        raise FileNotFoundError(f"no stream {stream} to recover; a run that ended well leaves only its Parquet file")
    target = stream.with_suffix(".parquet")
    with held(stream):
        found = compact(stream, target)
        tables = _left_of_table(stream)
    if not found.damaged:
        stream.unlink()
        return Recovered(target, found.rows, found.torn, tables)
    kept = stream.with_name(f"{stream.name}.damaged")
    stream.replace(kept)
    return Recovered(target, found.rows, found.torn, tables, found.damaged, kept)


def read(path: str | os.PathLike[str]) -> "pa.Table":
    """The audit table of a Parquet file or of a stream, also one still being written; empty columns left out.

    Errors: FileNotFoundError; ValueError for a file that is not an audit log, or of a newer schema.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    path = there(path)
    if path.suffix == ".arrows":
        source = Stream(path)
        check_schema(source.schema.metadata, path)
        table = _table(list(source), source.schema)
        return table.select(_used({n for n in table.column_names if table[n].null_count < table.num_rows}))
    require_whole(path)
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            check_schema(file.schema_arrow.metadata, path)
            return file.read()
    except pa.ArrowInvalid as error:
        raise ValueError(f"{path} is not an audit log: {error}") from error
    except OSError as error:
        raise ValueError(f"{path} is damaged: {error}") from error


def there(path: str | os.PathLike[str]) -> Path:
    """The path of a log that exists; FileNotFoundError says where its rows are."""
    path = Path(path)
    if not path.exists():
        stream = path.with_suffix(".arrows")
        hint = f"; {_state(stream)}" if stream.exists() else ""
        raise FileNotFoundError(f"no audit log {path}{hint}")
    return path


def _state(stream: Path) -> str:
    """The state of a run as a stream without its Parquet file tells it."""
    try:
        with held(stream):
            return f"its run did not end: `phfmu audit recover {stream}`"
    except LogInUse:
        return f"{_writer(stream)} is still writing it; what is complete so far: `phfmu audit {stream}`"
    except OSError:
        return f"its rows are in {stream}"


def check_schema(metadata: Mapping[bytes, bytes] | None, path: Path) -> None:
    found = (metadata or {}).get(SCHEMA_KEY)
    if found is None:
        raise ValueError(f"{path} is not an audit log: it lacks the key {SCHEMA_KEY.decode()!r}")
    if int(found) > SCHEMA_VERSION:
        raise ValueError(f"{path} has audit schema {int(found)}, this phfmu reads up to {SCHEMA_VERSION}; update phfmu")


def metadata(table: "pa.Table") -> dict[str, Any]:
    """The log's metadata: the writer's keys, phfmu.audit.schema and phfmu.audit.versions; JSON is decoded."""
    decoded: dict[str, Any] = {}
    for key, value in (table.schema.metadata or {}).items():
        try:
            decoded[key.decode()] = json.loads(value)
        except ValueError:
            decoded[key.decode()] = value.decode()
    return decoded
