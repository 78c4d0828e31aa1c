"""Result tables and input files."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from phfmu.network.run import HeldInputs, Result


def write_table(path: str, result: Result) -> None:
    """Write `time` and all signals as CSV (%.17g) or Parquet, by the file's ending."""
    target = Path(path)
    if target.suffix == ".parquet":
        import pyarrow as pa
        import pyarrow.parquet as pq

        columns = {"time": result.time} | {n: result.values[:, i] for i, n in enumerate(result.names)}
        pq.write_table(pa.table(columns), target)
    elif target.suffix == ".csv":
        header = ",".join(["time", *(_quoted(n) for n in result.names)])
        np.savetxt(target, np.column_stack([result.time, result.values]), "%.17g", ",", header=header, comments="")
    else:
        raise ValueError(f"-o {path}: the ending must be .csv or .parquet")


def _quoted(name: str) -> str:
    return f'"{name}"' if "," in name else name


def read_inputs(path: str, known: list[str]) -> HeldInputs:
    """A CSV like the output: `time`, then settable names; ValueError names line, column and value."""
    from phfmu.network.run import HeldInputs

    source = Path(path)
    if not source.is_file():
        raise FileNotFoundError(f"--input {path}: no such file")
    with source.open(newline="") as file:
        rows = [r for r in csv.reader(file) if r and not r[0].startswith("#")]
    if not rows or rows[0][0].strip() != "time":
        raise ValueError(f"{path}: the first column must be 'time', then one column per input")
    names = [n.strip() for n in rows[0][1:]]
    for name in names:
        if name not in known:
            from difflib import get_close_matches

            close = get_close_matches(name, known, 3)
            hint = f"did you mean {', '.join(close)}?" if close else f"there are: {', '.join(known[:12])}"
            raise ValueError(f"{path}: unknown input '{name}'; {hint}")
    values = np.empty((len(rows) - 1, len(names) + 1))
    for i, row in enumerate(rows[1:]):
        if len(row) != len(names) + 1:
            raise ValueError(f"{path}, row {i + 2}: {len(row)} values, expected {len(names) + 1}")
        for j, text in enumerate(row):
            try:
                values[i, j] = float(text)
            except ValueError:
                raise ValueError(f"{path}, row {i + 2}, column {(['time'] + names)[j]}: '{text}' is not a number") from None
            if not np.isfinite(values[i, j]):
                raise ValueError(
                    f"{path}, row {i + 2}: {(['time'] + names)[j]} = {text} at time {row[0]} is not finite"
                )
    if (np.diff(values[:, 0]) <= 0).any():
        raise ValueError(f"{path}: time must increase from row to row")
    return HeldInputs(names, values[:, 0], values[:, 1:])
