"""The table of a sweep as it is drawn: what varied, and the measures of each run."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from phfmu.pick import pick
from phfmu.report.recording import Floats
from phfmu.words import counted

if TYPE_CHECKING:
    import pyarrow as pa

#: the last columns of every sweep
_LAST = ["steps", "ledger", "error"]
#: `max(gen.w)`: no name that varies has such brackets
_MEASURE = re.compile(r"\w+\(.+\)")


@dataclass(frozen=True)
class SweepTable:
    """`varied`: name -> value in each run [runs];  `measured`: measure -> its numbers [runs], NaN for a run that failed."""

    title: str
    varied: dict[str, Floats]
    measured: dict[str, Floats]
    notes: tuple[str, ...] = ()

    def chosen(self, patterns: Sequence[str]) -> SweepTable:
        """Some of the measures, by name or pattern; ValueError for one that there is not."""
        names = pick(patterns, list(self.measured), self.title, "a sweep holds its measures")
        return SweepTable(self.title, self.varied, {n: self.measured[n] for n in names or self.measured}, self.notes)

    def grid(self, measure: str) -> tuple[Floats, Floats, Floats] | None:
        """The values [m], [n] of two names that vary, and the measure [n x m]; None unless each pair was run once."""
        x, y = self.varied.values()
        across, i = np.unique(x, return_inverse=True)
        up, j = np.unique(y, return_inverse=True)
        if len(across) * len(up) != len(x) or len(np.unique(i * len(up) + j)) != len(x):
            return None
        values = np.full((len(up), len(across)), np.nan)
        values[j, i] = self.measured[measure]
        return across, up, values


def logarithmic(values: Floats) -> bool:
    """Whether values are spaced by factors, over half a decade or more."""
    found = np.unique(values)
    if len(found) < 3 or found[0] <= 0.0 or found[-1] < 3.0 * found[0]:
        return False
    steps = np.diff(np.log(found))
    return bool(np.ptp(steps) < 0.01 * steps.mean())


def is_sweep(path: str | os.PathLike[str]) -> bool:
    """Whether the file is a table that `phfmu sweep -o` wrote."""
    place = Path(path)
    if not place.is_file() or not place.stat().st_size:
        return False
    if place.suffix == ".csv":
        with open(place, encoding="utf-8-sig", errors="replace") as file:
            return [n.strip().strip('"') for n in file.readline().split(",")[-3:]] == _LAST
    if place.suffix != ".parquet":
        return False
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        return pq.read_schema(place).names[-3:] == _LAST
    except pa.ArrowInvalid:
        return False


def read_sweep(path: str | os.PathLike[str]) -> SweepTable:
    """The table of a sweep. Errors: ValueError for one without runs or measures, or what cannot be read."""
    import pyarrow as pa

    place = Path(path)
    try:
        table = _table(place)
    except (pa.ArrowInvalid, OSError) as error:
        raise ValueError(f"{place} is damaged: {str(error).splitlines()[0]}") from error
    columns = {n: _numbers(table[n]) for n in table.column_names[:-3]}
    measured = {n: v for n, v in columns.items() if _MEASURE.fullmatch(n)}
    varied = {n: v for n, v in columns.items() if n not in measured}
    if not measured or not varied or not table.num_rows:
        raise ValueError(
            f"{place} has no runs with measures; write one with: phfmu sweep TARGET --vary .. -o {place.name}"
        )
    reasons = [e for e in table["error"].to_pylist() if e]
    notes = (f"{counted(len(reasons), 'run')} of {table.num_rows} failed: {reasons[0]}",) if reasons else ()
    return SweepTable(place.name, varied, measured, notes)


def _table(place: Path) -> pa.Table:
    if place.suffix == ".parquet":
        import pyarrow.parquet as pq

        return pq.read_table(place)
    from pyarrow import csv

    return csv.read_csv(place)


def _numbers(column: Any) -> Floats:
    return column.cast("float64").combine_chunks().fill_null(np.nan).to_numpy(zero_copy_only=False)
