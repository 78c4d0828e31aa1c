"""Input files: values over time as CSV or Parquet."""

from __future__ import annotations

import csv
from array import array
from collections.abc import Iterator
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pyarrow.parquet as pq

    from phfmu.runs.inputs.input_rows import InputRows

Array = NDArray[Any]


#: rows that are read at a time, and bytes of a column of Parquet
BLOCK, PIECE = 16384, 1 << 16

#: numbers (rows x columns), and where each of their rows stands in the file
Block = tuple[Array, Array]


def read_inputs(path: str, known: list[str]) -> InputRows:
    """A table like the output, CSV or Parquet: `time`, then settable names; ValueError names line, column and value.

    It is read by blocks of rows: what the memory holds of it are its numbers.
    """
    from phfmu.runs.inputs.input_rows import InputRows, require_times

    parquet = Path(path).suffix == ".parquet"
    if not Path(path).is_file():
        raise FileNotFoundError(f"--input {path}: no such file")
    header, blocks = (_parquet if parquet else _csv)(path)
    if not header or header[0] != "time":
        raise ValueError(f"{path}: the first column must be 'time', then one per input, separated by commas")
    names = _names(path, header[1:], known)
    numbers, last = array("d"), np.zeros(0)
    for values, where in blocks:
        times, places = np.append(last, values[:, 0]), np.append(where[: len(last)], where)
        require_times(times, path, lambda i, places=places: f"{'row' if parquet else 'line'} {places[i]}")
        numbers.frombytes(values.astype(float).tobytes())
        last = times[-1:]
    if not numbers:
        raise ValueError(f"{path} has no rows below its header; give the values at one time at least")
    table = np.frombuffer(numbers).reshape(-1, len(header))
    return InputRows(names, table[:, 0], table[:, 1:], path)


def _csv(path: str) -> tuple[list[str], Iterator[Block]]:
    rows = _rows(path)
    _, first = next(rows, (0, []))
    header = [n.strip() for n in first]
    return header, _csv_blocks(path, header, rows)


def _csv_blocks(path: str, header: list[str], rows: Iterator[tuple[int, list[str]]]) -> Iterator[Block]:
    while block := list(islice(rows, BLOCK)):
        lines, texts = [line for line, _ in block], [row for _, row in block]
        yield _converted(path, header, lines, texts), np.array(lines)


def _converted(path: str, header: list[str], lines: list[int], texts: list[list[str]]) -> Array:
    """All at once where all are numbers, else one by one, for the message."""
    with suppress(ValueError):
        values = np.array(texts, float)
        if values.shape == (len(texts), len(header)) and np.isfinite(values).all():
            return values
    return np.array([_numbers(f"{path}, line {n}", header, r) for n, r in zip(lines, texts, strict=True)])


def _parquet(path: str) -> tuple[list[str], Iterator[Block]]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        # columns are read in pieces, not by row groups, which may be the whole file
        file = pq.ParquetFile(path, buffer_size=PIECE, pre_buffer=False)
    except (pa.ArrowException, OSError) as error:
        raise ValueError(f"{path} is not a Parquet file: {error}") from error
    return list(file.schema_arrow.names), _parquet_blocks(path, file)


def _parquet_blocks(path: str, file: pq.ParquetFile) -> Iterator[Block]:
    import pyarrow as pa

    for field in file.schema_arrow:
        if not (pa.types.is_floating(field.type) or pa.types.is_integer(field.type)):
            raise ValueError(f"{path}, column {field.name}: {field.type} is not a number")
    first = 1
    try:
        for batch in file.iter_batches(BLOCK, use_threads=False):
            columns = [c.cast(pa.float64()).to_numpy(zero_copy_only=False) for c in batch.columns]
            values = np.column_stack(columns)
            for i, j in np.argwhere(~np.isfinite(values))[:1]:
                name = file.schema_arrow.names[j]
                raise ValueError(f"{path}, row {first + i}, column {name}: {values[i, j]} is not finite")
            yield values, np.arange(first, first + len(values))
            first += len(values)
    except (pa.ArrowException, OSError) as error:
        raise ValueError(f"{path} is damaged: {error}") from error


def _rows(path: str) -> Iterator[tuple[int, list[str]]]:
    """Line numbers and fields, without empty lines and comments."""
    with open(path, newline="", encoding="utf-8-sig") as file:
        reader = csv.reader(file)
        try:
            for row in reader:
                if row and not row[0].startswith("#"):
                    yield reader.line_num, row
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
