"""Values of inputs over time as rows: held until the next one, or interpolated between them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.network.members.interpolant import Interpolant
from phfmu.network.members.interpolations import INTERPOLATIONS
from phfmu.network.scene import Event
from phfmu.words import counted, meant

Array = NDArray[Any]

#: rows that become events at a time
BLOCK = 16384
#: fewer rows are steps of an input, not data sampled over the run
SAMPLED = 10


@dataclass(frozen=True)
class InputRows:
    """`values` (rows x names) at times that do not decrease; rows at one time are a jump, the last of them holds after it.

    source: what the rows are called in messages
    """

    names: Sequence[str]
    time: Array
    values: Array
    source: str = "inputs"

    def events(self, names: Collection[str] | None = None, since: float = -inf) -> Iterator[Event]:
        """One event per changed value of held columns (None: all) in order, from a time on; before the first row the start
        values hold.

        They are made as they are asked for, so that the memory holds the rows alone.
        """
        chosen = [j for j, n in enumerate(self.names) if names is None or n in names]
        own, first = [self.names[j] for j in chosen], int(np.searchsorted(self.time, since))
        before = self.values[first - 1, chosen] if first else None
        for begin in range(first, len(self.time), BLOCK):
            time = self.time[begin : begin + BLOCK + 1]
            last = np.append(time[1:] > time[:-1], True)[:BLOCK]  # of rows at one time
            times, values = time[: len(last)][last], self.values[begin : begin + BLOCK][last][:, chosen]
            if not len(values):
                continue
            changed = np.ones(values.shape, bool)
            changed[1:] = values[1:] != values[:-1]
            if before is not None:
                changed[0] = values[0] != before
            before = values[-1]
            for i, j in np.argwhere(changed).tolist():
                yield Event(float(times[i]), own[j], float(values[i, j]))

    def interpolant(self, kind: str, starts: dict[str, float], t0: float) -> Interpolant | None:
        """The columns of free inputs as functions of time; `starts`: values of the free inputs, which hold before the rows."""
        chosen = [j for j, n in enumerate(self.names) if n in starts]
        if kind == "held" or not chosen:
            return None
        names, time, values = [self.names[j] for j in chosen], self.time, self.values[:, chosen]
        if time[0] > t0:
            before = [starts[n] for n in names]
            time, values = np.concatenate([[t0, time[0]], time]), np.vstack([before, before, values])
        return Interpolant(names, time, values, kind)

    def notes(self, t0: float, stop: float) -> list[str]:
        """Lines about rows before the start and after the end, and data that begin late or end early."""
        time, path = self.time, self.source
        early, late = int(np.searchsorted(time, t0)), len(time) - int(np.searchsorted(time, stop, "right"))
        lines = []
        if early:
            lines.append(
                f"{path}: {counted(early, 'row')} before the start, from t = {time[0]:g} s; "
                f"{'the last of them' if early > 1 else 'it'} holds at {t0:g} s"
            )
        if time[0] > t0:
            lines.append(f"{path}: begins at t = {time[0]:g} s, the start values hold before")
        gap = 2 * self._distance if len(time) > SAMPLED else stop
        if time[-1] < stop - gap:
            lines.append(f"{path}: ends at t = {time[-1]:g} s, its last row holds until the end at {stop:g} s")
        if late:
            first = float(time[len(time) - late])
            lines.append(f"{path}: {counted(late, 'row')} after the end at {stop:g} s, from t = {first:g} s, not used")
        return lines

    @property
    def _distance(self) -> float:
        """The median of the times between rows, of many between some."""
        at = np.arange(0, len(self.time) - 1, 1 + len(self.time) // BLOCK)
        return float(np.median(self.time[at + 1] - self.time[at]))

    def between(self, found: Interpolant | None, kind: str, step: float) -> list[str]:
        """Lines about what the interpolation does not reach: columns that are held, rows closer than steps."""
        if kind == "held":
            return []
        lines = []
        held = [n for n in self.names if found is None or n not in found.names]
        if held:
            lines.append(
                f"{self.source}: {', '.join(held)}: held between rows, as parameters and signals have one value in a step"
            )
        if found is not None and len(self.time) > SAMPLED:
            distance = self._distance
            if 0 < distance < 0.5 * step:
                lines.append(
                    f"{self.source}: {step / distance:.3g} rows in a step of {step:g} s; what they do between the nodes of a "
                    "step is not seen"
                )
        return lines


def input_rows(data: Any, known: Sequence[str]) -> InputRows:
    """Rows of a mapping or table (Arrow, pandas, polars) of columns: `time`, then names out of `known`.

    Errors: KeyError for unknown names, ValueError for no time, other lengths, values that are not finite, times that decrease.
    """
    if isinstance(data, InputRows):
        return data
    names = next(
        (list(c) for c in (getattr(data, n, None) for n in ("column_names", "columns")) if c is not None), None
    )
    names = list(data) if names is None or not all(isinstance(n, str) for n in names) else names
    if "time" not in names or len(names) < 2:
        raise ValueError(
            f"inputs: expected a column 'time' and one per input, got {', '.join(map(str, names)) or 'none'}"
        )
    columns = {n: np.asarray(data[n], float) for n in names}
    time, own = columns.pop("time"), [n for n in names if n != "time"]
    for n in own:
        if n not in known:
            raise KeyError(f"inputs: unknown input '{n}'; {meant(n, list(known))}")
        if columns[n].shape != time.shape or time.ndim != 1 or not time.size:
            raise ValueError(
                f"inputs: {n} has the shape {columns[n].shape}, time {time.shape}; expected one value per time"
            )
    found = InputRows(own, time, np.column_stack([columns[n] for n in own]))
    require_times(found.time, found.source, lambda i: f"row {i + 1}")
    bad = np.argwhere(~np.isfinite(found.values))
    if bad.size:
        i, j = bad[0]
        raise ValueError(f"inputs, row {i + 1}, column {own[j]}: {found.values[i, j]} is not finite")
    return found


def require_times(time: Array, source: str, place: Callable[[int], str]) -> None:
    """Raise ValueError where times decrease or are not finite; equal ones are a jump; `place`: what row i is called."""
    wrong = np.flatnonzero(~(np.diff(time) >= 0))
    if wrong.size:
        i = wrong[0] + 1
        raise ValueError(f"{source}, {place(i)}: time {time[i]:.9g} after {time[i - 1]:.9g}; times must not decrease")
    if not np.isfinite(time).all():
        raise ValueError(f"{source}: time {time[~np.isfinite(time)][0]} is not finite")


def require_interpolation(kind: str) -> None:
    """Raise ValueError for a word that is none."""
    if kind not in INTERPOLATIONS:
        raise ValueError(f"--interpolate {kind}: expected {', '.join(INTERPOLATIONS)}")
