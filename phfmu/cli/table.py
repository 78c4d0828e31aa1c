"""Result tables and input files."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from phfmu.network.run import HeldInputs, Result


def check_table(path: str) -> None:
    """ValueError if `write_table` could not write there; asked before a run, not after it."""
    target = Path(path)
    if target.suffix not in (".csv", ".parquet"):
        raise ValueError(f"-o {path}: the ending must be .csv or .parquet")
    if not target.parent.is_dir():
        raise ValueError(f"-o {path}: there is no folder '{target.parent}'; make it first")
    if target.is_dir():
        raise ValueError(f"-o {path} is a folder; name a file")


def write_table(path: str, result: Result) -> None:
    """Write `time` and all signals as CSV (%.17g) or Parquet, by the file's ending."""
    check_table(path)
    target = Path(path)
    marks = {} if result.interpolated is None else {"interpolated": result.interpolated}
    if target.suffix == ".parquet":
        import pyarrow as pa
        import pyarrow.parquet as pq

        columns = {"time": result.time} | marks | {n: result.values[:, i] for i, n in enumerate(result.names)}
        pq.write_table(pa.table(columns), target)
        return
    header = ",".join(["time", *marks, *(_quoted(n) for n in result.names)])
    table = np.column_stack([result.time, *marks.values(), result.values])
    np.savetxt(target, table, "%.17g", ",", header=header, comments="")


def _quoted(name: str) -> str:
    return f'"{name}"' if "," in name else name


def read_inputs(path: str, known: list[str]) -> HeldInputs:
    """A CSV like the output: `time`, then settable names; ValueError names line, column and value."""
    from phfmu.network.run import HeldInputs

    rows = _rows(path)
    if not rows or rows[0][1][0].strip() != "time":
        raise ValueError(f"{path}: the first column must be 'time', then one per input, separated by commas")
    names = _names(path, [n.strip() for n in rows[0][1][1:]], known)
    if len(rows) == 1:
        raise ValueError(f"{path} has no rows below its header; give the values at one time at least")
    values = np.array([_numbers(f"{path}, line {line}", ["time", *names], row) for line, row in rows[1:]])
    late = np.flatnonzero(np.diff(values[:, 0]) <= 0)
    if late.size:
        i = late[0] + 1
        before, now = values[i - 1 : i + 1, 0]
        raise ValueError(f"{path}, line {rows[i + 1][0]}: time {now:.9g} after {before:.9g}; times must increase")
    return HeldInputs(names, values[:, 0], values[:, 1:])


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
