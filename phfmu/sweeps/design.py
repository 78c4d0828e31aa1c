"""Designs: values that vary from run to run, by axes on the command line, their product, or the rows of a table."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phfmu.sweeps.words import FORMS

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Design:
    """`rows` (runs x names): the value that each name takes in each run."""

    names: tuple[str, ...]
    rows: Floats

    def __post_init__(self) -> None:
        for i, name in enumerate(self.names):
            twice = [
                n for n in self.names[:i] if n == name or n.partition("[")[0] == name or n == name.partition("[")[0]
            ]
            if twice:
                raise ValueError(f"'{name}' and '{twice[0]}' vary the same number; leave one of them out")
        if not len(self.rows):
            raise ValueError("no runs: what varies has no values")
        bad = np.argwhere(~np.isfinite(self.rows))
        if len(bad):
            run, column = bad[0]
            raise ValueError(
                f"run {run + 1}: {self.names[column]} is {self.rows[run, column]}; expected a finite number"
            )


def grid(axes: Mapping[str, ArrayLike]) -> Design:
    """Every combination of the values of the axes; the last axis changes fastest."""
    values = [np.atleast_1d(np.asarray(v, float)) for v in axes.values()]
    rows = np.stack([m.ravel() for m in np.meshgrid(*values, indexing="ij")], axis=1) if values else np.zeros((1, 0))
    return Design(tuple(axes), rows)


def axes(items: Sequence[str]) -> Design:
    """Axes as on the command line, see `FORMS`; ValueError names the one that is none."""
    found: dict[str, Floats] = {}
    for item in items:
        name, _, text = item.partition("=")
        if name.strip() in found:
            raise ValueError(f"--vary {name.strip()} is given twice; give all its values at once")
        found[name.strip()] = _values(item, text)
    return grid(found)


def _values(item: str, text: str) -> Floats:
    kind, *parts = text.split(":") if text.startswith("log:") else ("", *text.split(":"))
    try:
        if len(parts) == 1 and not kind:
            return np.array([float(v) for v in parts[0].split(",")])
        start, stop, count = float(parts[0]), float(parts[1]), int(parts[2])
    except (ValueError, IndexError):
        raise ValueError(f"--vary {item}: expected {FORMS}") from None
    if len(parts) != 3 or count < 1 or not math.isfinite(start + stop):
        raise ValueError(f"--vary {item}: expected {FORMS} with a count from 1")
    if not kind:
        return np.linspace(start, stop, count)
    if start * stop <= 0:
        raise ValueError(f"--vary {item}: a logarithmic axis needs two ends of one sign, neither 0")
    return np.geomspace(start, stop, count)


def table(path: str) -> Design:
    """One run a row: the columns of a .csv or .parquet file are the names."""
    from pyarrow import ArrowInvalid, csv, parquet, types

    read = {".csv": csv.read_csv, ".parquet": parquet.read_table}.get(Path(path).suffix)
    if read is None:
        raise ValueError(f"--table {path}: expected a .csv or .parquet file")
    if not Path(path).is_file():
        raise ValueError(f"--table {path}: there is no such file; write one with a run a row, its columns the names")
    try:
        found = read(path)
    except ArrowInvalid as error:
        raise ValueError(f"--table {path}: {str(error).splitlines()[0]}") from None
    for field in found.schema:
        if not (types.is_integer(field.type) or types.is_floating(field.type)):
            raise ValueError(f"--table {path}: column '{field.name}' holds {field.type}; expected numbers")
    columns = [c.to_numpy().astype(float) for c in found.columns]
    return Design(tuple(found.column_names), np.stack(columns, axis=1) if columns else np.zeros((0, 0)))
