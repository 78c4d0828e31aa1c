"""A log read piece by piece: batches of a file or table as numpy columns, with bounded memory."""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phfmu.audit.kinds import ColumnType, RowKind
from phfmu.audit.log.archive import Stream, check_schema, there
from phfmu.audit.log.columns import COLUMNS, FIELDS
from phfmu.audit.log.seal import holds, require_whole
from phfmu.audit.summing.sums import Floats

if TYPE_CHECKING:
    import pyarrow as pa

#: rows decoded at a time
BATCH_ROWS = 1 << 16
#: most bytes that one column of a row group may have once it is unpacked
COLUMN_BYTES = 1 << 28

Names = NDArray[np.int64]


class InternedNames:
    """Names as numbers, the same over all batches; -1 stands for none."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self._codes: dict[str, int] = {}

    def codes(self, column: "pa.ChunkedArray | pa.Array") -> Names:
        """Codes [n] of a column of names."""
        import pyarrow as pa

        flat = column.combine_chunks() if isinstance(column, pa.ChunkedArray) else column
        if not pa.types.is_dictionary(flat.type):
            flat = flat.cast("string").dictionary_encode()
        table = np.array([self._code(name) for name in flat.dictionary.to_pylist()] + [-1], np.int64)
        return table[flat.indices.fill_null(len(table) - 1).to_numpy(zero_copy_only=False)]

    def _code(self, name: str | None) -> int:
        if name is None:
            return -1
        if name not in self._codes:
            self._codes[name] = len(self.names)
            self.names.append(name)
        return self._codes[name]

    def name(self, code: int) -> str | None:
        return self.names[code] if code >= 0 else None


@dataclass
class LogRows:
    """Rows of one kind: numbers (values [n], where there is one [n]) and names (codes [n]) by column."""

    step: NDArray[np.int64]
    numbers: dict[str, tuple[Floats, NDArray[np.bool_]]]
    names: dict[str, Names]

    @property
    def n(self) -> int:
        return len(self.step)

    def take(self, at: Any) -> "LogRows":
        """The rows `at` an index, mask or slice."""
        numbers = {key: (values[at], there[at]) for key, (values, there) in self.numbers.items()}
        return LogRows(self.step[at], numbers, {key: codes[at] for key, codes in self.names.items()})

    @staticmethod
    def joined(parts: Sequence["LogRows"]) -> "LogRows":
        """The rows of parts, one after the other."""
        if len(parts) == 1:
            return parts[0]
        first = parts[0]
        numbers = {
            key: (
                np.concatenate([p.numbers[key][0] for p in parts]),
                np.concatenate([p.numbers[key][1] for p in parts]),
            )
            for key in first.numbers
        }
        names = {key: np.concatenate([p.names[key] for p in parts]) for key in first.names}
        return LogRows(np.concatenate([p.step for p in parts]), numbers, names)

    def values(self, column: str) -> Floats:
        return self.numbers[column][0]


_NEEDED: dict[RowKind, tuple[str, ...]] = {
    RowKind.COMPONENT: (
        *("H0", "H1", "dH", "dissipated", "supplied", "numerical", "moved", "residual", "residual_rel"),
        *("varying", "component", "quality"),
    ),
    RowKind.PORT: ("supplied", "exchanged", "index", "component", "port", "junction", "quality"),
    RowKind.JUNCTION: ("junction", "quality", "residual", "exchanged"),
    RowKind.PART: FIELDS[RowKind.PART],
    RowKind.TERM: FIELDS[RowKind.TERM],
    RowKind.NETWORK: tuple(name for name in FIELDS[RowKind.NETWORK] if name != "iterations"),
    RowKind.EVENT: ("energy_jump", "lost", "kind", "component", "message"),
}
_COMMON = ("row", "step", "t0", "h")
_TEXTS = tuple(name for name, kind in COLUMNS.items() if kind in (ColumnType.NAME, ColumnType.TEXT))


class Batches:
    """Iterates over the batches of a source, each as {kind: LogRows}; `interned` are the names of all."""

    def __init__(self, source: "pa.Table | str | os.PathLike[str]") -> None:
        self.interned = InternedNames()
        self._source = source
        #: what the footer of an archive says of it, once its batches are read
        self.holds: dict[str, Any] = {}

    def __iter__(self) -> Iterator[dict[RowKind, LogRows]]:
        import pyarrow as pa

        shown = "the audit table" if isinstance(self._source, pa.Table) else str(self._source)
        try:
            for batch in self._batches():
                missing = [name for name in _COMMON if name not in batch.schema.names]
                if missing and batch.num_rows:
                    raise ValueError(f"{shown} is not an audit log: it has no column {', '.join(missing)}")
                yield self._by_kind(batch)
        except (pa.ArrowInvalid, pa.ArrowNotImplementedError, pa.ArrowTypeError, pa.ArrowKeyError) as error:
            raise ValueError(f"{shown} is not an audit log: {error}") from error
        except FileNotFoundError:
            raise
        except OSError as error:
            raise ValueError(f"{shown} is damaged: {error}") from error

    def _batches(self) -> Iterator["pa.RecordBatch"]:
        if not isinstance(self._source, str | os.PathLike):
            self.holds = holds(self._source.schema.metadata)
            yield from self._source.to_batches(max_chunksize=BATCH_ROWS)
            return
        path = there(self._source)
        if path.suffix == ".arrows":
            source = Stream(path)
            check_schema(source.schema.metadata, path)
            yield from source
        else:
            yield from self._parquet(path)

    def _by_kind(self, batch: "pa.RecordBatch") -> dict[RowKind, LogRows]:
        columns = dict(zip(batch.schema.names, batch.columns, strict=True))
        codes = self.interned.codes(columns["row"]) if "row" in columns else np.zeros(0, np.int64)
        found: dict[RowKind, LogRows] = {}
        read: dict[str, Any] = {}
        for kind, needed in _NEEDED.items():
            at = np.flatnonzero(codes == self.interned._code(kind))
            if not len(at):
                continue
            for name in (*_COMMON[1:], *needed):
                if name not in read:
                    read[name] = self._column(columns.get(name), name, batch.num_rows)
            numbers = {n: (read[n][0][at], read[n][1][at]) for n in ("t0", "h", *needed) if n not in _TEXTS}
            found[kind] = LogRows(
                read["step"][0][at].astype(np.int64), numbers, {n: read[n][at] for n in needed if n in _TEXTS}
            )
        return found

    def _column(self, column: Any, name: str, n: int) -> Any:
        if name in _TEXTS:
            return np.full(n, -1, np.int64) if column is None else self.interned.codes(column)
        if column is None:
            return np.full(n, np.nan), np.zeros(n, bool)
        there = column.is_valid().to_numpy(zero_copy_only=False)
        return column.fill_null(0).cast("float64").to_numpy(zero_copy_only=False), there

    def _parquet(self, path: Path) -> Iterator["pa.RecordBatch"]:
        """Batches of the columns that are judged; ValueError before anything too large is unpacked."""
        import pyarrow.parquet as pq

        require_whole(path)
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            metadata, names = file.metadata, file.schema_arrow.names
            check_schema(file.schema_arrow.metadata, path)
            self.holds = holds(file.schema_arrow.metadata)
        wanted = {*_COMMON, *(name for needed in _NEEDED.values() for name in needed)}
        for i in range(metadata.num_row_groups):
            _require_bounded(metadata.row_group(i), i, path, wanted)
        used = [name for name in names if name in wanted]
        texts = [name for name in used if name in _TEXTS]
        with pq.ParquetFile(path, metadata=metadata, read_dictionary=texts, page_checksum_verification=True) as file:
            yield from file.iter_batches(BATCH_ROWS, columns=used)


def _require_bounded(group: Any, number: int, path: Path, wanted: set[str]) -> None:
    for j in range(group.num_columns):
        column = group.column(j)
        if column.path_in_schema in wanted and column.total_uncompressed_size > COLUMN_BYTES:
            raise ValueError(
                f"{path}: row group {number} unpacks its column '{column.path_in_schema}' from "
                f"{column.total_compressed_size} to {column.total_uncompressed_size} bytes; at most {COLUMN_BYTES} are read. "
                "phfmu writes no such file: do not trust it"
            )
