"""Rows of a run under way as a recording: what a picture of them needs, and no more."""

from collections.abc import Mapping, Sequence

import numpy as np

from phfmu.report.energies import energy_columns
from phfmu.report.picture.choice import usual
from phfmu.report.recording import Floats, Mark, Signal, together
from phfmu.results.kinds import kinds_by_name


class LiveRecording:
    """Keeps the signals that are drawn: `chosen`, or the usual ones; `units` and `kinds` by name, where they are known."""

    CARRIED = ("_time", "_values", "_marks")

    def __init__(
        self,
        title: str,
        names: Sequence[str],
        marks: Sequence[Mark] = (),
        units: Mapping[str, str] | None = None,
        kinds: Mapping[str, str] | None = None,
        labels: Mapping[str, str] | None = None,
        chosen: Sequence[str] = (),
    ):
        self.title, self.names = title, list(names)
        self.kinds = kinds_by_name(self.names) if kinds is None else kinds
        self._marks, self._units, self._labels = list(marks), units or {}, labels or {}
        self._chosen = list(chosen) or usual(self.names, self.kinds)
        self._kept = list(dict.fromkeys([*self._chosen, *energy_columns(self.names, self.kinds)]))
        self._columns = [self.names.index(n) for n in self._kept]
        self._time: list[Floats] = []
        self._values: list[Floats] = []

    def add(self, time: Floats, values: Floats) -> None:
        """Take n rows: time [n], values [n, names]."""
        self._time.append(np.array(time))
        self._values.append(values[:, self._columns])

    def mark(self, time: float, text: str) -> None:
        """Take what happened at a time."""
        self._marks.append(Mark(time, text))

    @property
    def labelled(self) -> dict[str, str]:
        return {label: name for name, label in self._labels.items() if label}

    @property
    def rows(self) -> int:
        return sum(map(len, self._time))

    def usual(self) -> list[str]:
        return self._chosen

    def marks(self) -> list[Mark]:
        return together(self._marks)

    def read(self, names: Sequence[str]) -> list[Signal]:
        time = np.concatenate(self._time)
        at = {n: i for i, n in enumerate(self._kept)}
        return [
            Signal(
                n,
                self._units.get(n),
                time,
                np.concatenate([v[:, at[n]] for v in self._values]),
                kind=self.kinds.get(n, ""),
                label=self._labels.get(n, ""),
            )
            for n in names
        ]
