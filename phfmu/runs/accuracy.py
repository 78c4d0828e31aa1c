"""Accuracy of a finished run by comparison with the same run in finer steps, row by row (Richardson extrapolation).

With d = |y_h - y_(h/2)| and errors that shrink by r when the step is halved (r = 2^p at order p), the error of y_h is d r/(r - 1)
(L. F. Richardson, Phil. Trans. R. Soc. A 210, 1911).  The r of each signal is observed where a run in coarser steps can be had,
|y_2h - y_h| / |y_h - y_(h/2)| at the times of all three, and never taken to be larger than the scheme declares.

Values are compared at the times that both runs have; means of a step with the mean of those of its halves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf, log2

import numpy as np
from numpy.typing import NDArray

from phfmu.signals import MEAN
from phfmu.words import counted

Array = NDArray[np.float64]

#: most numbers that a record keeps
ROOM = 4_000_000
#: times that differ by less than this part of a step are one
CLOSE = 1e-6
#: a signal or a difference below this part of the largest of its unit, or of its range, is rounding
ROUNDING = 1e-11
#: least ratio of differences from which an error can be told: of order 0.3
LEAST = 2**0.3
#: what is not a solution: residuals of constraints and books, marks, counted events, and energies of a step
NOT_COMPARED = ("constraint", "mark", "event")
BOOKS = (".residual", ".gap", "energy.residual", "energy.gap")


class RunRecord:
    """Rows of a run by their times, thinned evenly to what there is room for; takes what a run gives to `Options`."""

    def __init__(self, step: float, room: int = ROOM):
        self.step, self._room, self._stride, self._seen = step, room, 1, 0
        self.names: list[str] = []
        self.units: list[str] = []
        self.kinds: list[str] = []
        self.happened: list[float] = []
        self._time: list[Array] = []
        self._rows: list[Array] = []
        self._length: list[Array] = []
        self._last = np.nan
        self._kept = 0
        self.low = self.high = np.zeros(0)

    def columns(
        self, names: Sequence[str], units: Sequence[str], kinds: Sequence[str], labels: Mapping[str, str] | None = None
    ) -> None:
        """Takes the names of the columns, before the first row."""
        self.names, self.units, self.kinds = list(names), list(units), list(kinds)
        self.low, self.high = np.full(len(names), inf), np.full(len(names), -inf)

    def event(self, time: float, message: str) -> None:
        """A state event."""
        self.happened.append(time)

    def keep(self, time: Array, values: Array, inside: NDArray[np.bool_]) -> None:
        """A block of rows; those within steps are left out."""
        time, values = time[~inside], values[~inside]
        if not len(time):
            return
        self.low, self.high = np.fmin(self.low, values.min(axis=0)), np.fmax(self.high, values.max(axis=0))
        length = np.diff(time, prepend=self._last)
        self._last = float(time[-1])
        chosen = (self._seen + np.arange(len(time))) % self._stride == 0
        self._seen += len(time)
        self._take(time[chosen], values[chosen].copy(), length[chosen])
        while self._kept * max(len(self.names), 1) > self._room and self._kept > 2:
            self._thin()

    def _take(self, time: Array, values: Array, length: Array) -> None:
        self._time.append(time)
        self._rows.append(values)
        self._length.append(length)
        self._kept += len(time)

    def _thin(self) -> None:
        time, rows, length = (np.concatenate(parts)[::2] for parts in (self._time, self._rows, self._length))
        self._time, self._rows, self._length, self._kept, self._stride = [], [], [], 0, 2 * self._stride
        self._take(time, rows, length)

    def table(self) -> tuple[Array, Array, Array]:
        """Times, rows and what lies between each row and the one before it; of rows at one time the last."""
        if not self._time:
            return np.zeros(0), np.zeros((0, len(self.names))), np.zeros(0)
        time, rows, length = (np.concatenate(parts) for parts in (self._time, self._rows, self._length))
        last = np.append(np.diff(time) > CLOSE * self.step, True)
        return time[last], rows[last], length[last]


class RepeatRecord(RunRecord):
    """Rows of another run of the same columns at the times of a record: `rows`, nan where it has none, and those `before`."""

    def __init__(self, record: RunRecord, step: float):
        super().__init__(step)
        self.at = record.table()[0]
        self.rows = self.before = np.zeros((0, 0))
        self.lengths = np.full(len(self.at), np.nan)
        self._end: tuple[Array, Array] | None = None

    def columns(
        self, names: Sequence[str], units: Sequence[str], kinds: Sequence[str], labels: Mapping[str, str] | None = None
    ) -> None:
        super().columns(names, units, kinds)
        self.rows, self.before = (np.full((len(self.at), len(names)), np.nan) for _ in range(2))

    def keep(self, time: Array, values: Array, inside: NDArray[np.bool_]) -> None:
        time, values = time[~inside], values[~inside]
        if not len(time):
            return
        if self._end is not None:
            time, values = np.append(self._end[0], time), np.vstack([self._end[1], values])
        self._end = time[-1:].copy(), values[-1:].copy()
        near = CLOSE * self.step
        first, last = (np.searchsorted(self.at, t + d) for t, d in ((time[0], -near), (time[-1], near)))
        wanted = np.arange(first, last)
        row = np.searchsorted(time, self.at[wanted] + near, side="right") - 1  # the last one at that time
        found = (row >= 0) & (np.abs(time[row] - self.at[wanted]) <= near)
        wanted, row = wanted[found], row[found]
        self.rows[wanted] = values[row]
        known = row > 0
        self.before[wanted[known]] = values[row[known] - 1]
        self.lengths[wanted[known]] = time[row[known]] - time[row[known] - 1]


@dataclass(frozen=True)
class RefinementChange:
    """The largest change of a signal by finer steps, when, what part of the range of the signal it is, and what follows.

    order: at which it shrinks with the step, None where that was not observed;  error: of the finished run, None where the
    changes do not shrink
    """

    name: str
    unit: str
    size: float
    time: float
    scale: float
    order: float | None
    error: float | None

    @property
    def relative(self) -> float:
        """The change over the range of the signal."""
        return self.size / self.scale if self.scale > 0 else (inf if self.size else 0.0)


@dataclass(frozen=True)
class Accuracy:
    """Changes by signal, largest part of the range first; how many signals were rounding; lines about events and times."""

    changes: list[RefinementChange]
    rounding: int
    notes: list[str]
    order: float | None

    @property
    def observed(self) -> float | None:
        """The median of the orders that signals show."""
        orders = [c.order for c in self.changes if c.order is not None and c.error is not None]
        return float(np.median(orders)) if orders else None


def accuracy(
    record: RunRecord, finer: RepeatRecord, coarser: RepeatRecord | None, ratio: float, order: float | None
) -> Accuracy:
    """Changes of the rows of a record with finer steps.

    ratio: by how much errors shrink from it to `finer` if all is as declared;  order: as declared, None if nothing is
    """
    time, rows, length = record.table()
    with np.errstate(invalid="ignore"):
        fine, usable = _matched(record, rows, length, finer)
        usable &= ~_between(time, record.happened, finer.happened)[:, None]
        size = np.where(usable, np.abs(rows - fine), np.nan)
        ratios = _ratios(rows, size, coarser, record.kinds) if coarser is not None else np.full(rows.shape[1], np.nan)
    scale = _scales(record)
    largest = _largest(record, scale)
    changes, rounding = [], 0
    for j, (name, unit, kind) in enumerate(zip(record.names, record.units, record.kinds, strict=True)):
        of_step = kind == "energy" and name.endswith(MEAN)
        if kind in NOT_COMPARED or of_step or name.endswith(BOOKS) or np.isnan(size[:, j]).all():
            continue
        if scale[j] <= ROUNDING * largest[j]:
            rounding += 1
            continue
        i = int(np.nanargmax(size[:, j]))
        d, r = float(size[i, j]), float(ratios[j])
        seen = r if np.isfinite(r) and d > ROUNDING * scale[j] else None
        p = None if seen is None else log2(max(seen, 1e-3))
        error = None if seen is not None and seen < LEAST else d * _tail(min(seen or ratio, ratio))
        changes.append(RefinementChange(name, unit, d, float(time[i]), float(scale[j]), p, error))
    changes.sort(key=lambda c: -c.relative)
    return Accuracy(changes, rounding, _notes(record, finer, len(time)), order)


def _tail(r: float) -> float:
    return r / (r - 1)


def _matched(record: RunRecord, rows: Array, length: Array, finer: RepeatRecord) -> tuple[Array, NDArray[np.bool_]]:
    """Values of the finer run at the times of the record, and which can be compared: means over the same steps only."""
    fine, usable = finer.rows.copy(), ~np.isnan(finer.rows) & ~np.isnan(rows)
    means = [j for j, kind in enumerate(record.kinds) if kind in ("mean", "algebraic")]
    if means:
        halves = (np.abs(finer.lengths - 0.5 * length) <= CLOSE * record.step)[:, None]
        fine[:, means] = 0.5 * (finer.rows[:, means] + finer.before[:, means])
        usable[:, means] &= halves & ~np.isnan(finer.before[:, means])
    return fine, usable


def _ratios(rows: Array, size: Array, coarser: RepeatRecord, kinds: Sequence[str]) -> Array:
    """By how much the changes of each signal shrink from coarser steps, nan where that is not known."""
    both = ~np.isnan(coarser.rows) & ~np.isnan(size)
    first = np.where(both, np.abs(coarser.rows - rows), 0.0).max(axis=0, initial=0.0)
    then = np.where(both, size, 0.0).max(axis=0, initial=0.0)
    of_steps = np.isin(kinds, ("mean", "algebraic"))
    return np.where((then > 0) & ~of_steps, first / np.where(then > 0, then, 1.0), np.nan)


def _between(time: Array, a: Sequence[float], b: Sequence[float]) -> NDArray[np.bool_]:
    """Times between an event in one run and the same event in the other."""
    out = np.zeros(len(time), bool)
    for s, t in zip(a, b, strict=False):
        out |= (time >= min(s, t)) & (time <= max(s, t))
    return out


def _scales(record: RunRecord) -> Array:
    """The range of each signal; of a constant its magnitude, of energies the largest range of all of them."""
    span = np.where(np.isfinite(record.low), record.high - record.low, 0.0)
    size = np.maximum(np.abs(record.low), np.abs(record.high))
    scale = np.where(span > ROUNDING * size, span, np.where(np.isfinite(size), size, 0.0))
    energy = np.array([kind == "energy" for kind in record.kinds], bool)
    return np.where(energy, scale[energy].max(initial=0.0), scale)


def _largest(record: RunRecord, scale: Array) -> Array:
    """The largest scale of all signals in the same unit."""
    most: Mapping[str, float] = {
        u: max(float(s) for s, v in zip(scale, record.units, strict=True) if v == u) for u in set(record.units)
    }
    return np.array([most[u] for u in record.units])


def _notes(record: RunRecord, finer: RepeatRecord, rows: int) -> list[str]:
    """Lines about events that differ, and about the rows that were compared."""
    a, b, notes = record.happened, finer.happened, list[str]()
    if len(a) != len(b):
        notes.append(
            f"{counted(len(a), 'state event')} here, {len(b)} with finer steps: what comes after the first that only one run "
            "has is another motion"
        )
    elif a:
        late = max(abs(s - t) for s, t in zip(a, b, strict=True))
        notes.append(f"{counted(len(a), 'state event')} in both runs, at times that differ by {late:.3g} s at most")
    found = int((~np.isnan(finer.rows).all(axis=1)).sum())
    notes.append(f"compared at {found} of {rows} rows, the times that both runs have")
    return notes
