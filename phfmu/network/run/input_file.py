"""Input files: values over time as CSV or Parquet."""

from __future__ import annotations

import csv
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from phfmu.network.run.input_rows import InputRows

Array = NDArray[Any]


def read_inputs(path: str, known: list[str]) -> InputRows:
    """A table like the output, CSV or Parquet: `time`, then settable names; ValueError names line, column and value."""
    from phfmu.network.run.input_rows import InputRows, require_times

    header, places, numbers = (_parquet if Path(path).suffix == ".parquet" else _csv)(path)
    if not header or header[0] != "time":
        raise ValueError(f"{path}: the first column must be 'time', then one per input, separated by commas")
    names = _names(path, header[1:], known)
    if not places:
        raise ValueError(f"{path} has no rows below its header; give the values at one time at least")
    values = numbers()
    require_times(values[:, 0], path, places)
    return InputRows(names, values[:, 0], values[:, 1:], path)


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
