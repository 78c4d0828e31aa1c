"""The result table of a run as a recording: CSV or Parquet, first column `time`."""

import os
from collections.abc import Sequence

from phfmu.report.recording import Mark, Signal
from phfmu.results.file import ResultFile
from phfmu.signals import CONSTRAINT, END, ENERGY, LEDGER, MEAN, total

#: endings of what is not drawn unasked: mean and end values of a step, books and constraints
_BESIDE = (MEAN, END, ENERGY, *(total(name) for name, _, _ in LEDGER))


def usual(names: Sequence[str]) -> list[str]:
    """Signals that a picture shows unasked: all but means and ends of steps, energies and the marks of rows."""
    bases = {n: n.partition("[")[0] for n in names}
    chosen = [
        n for n, b in bases.items() if not b.endswith(_BESIDE) and not b.startswith(CONSTRAINT) and b != "interpolated"
    ]
    return chosen or list(names)


class ResultTable:
    """A table that `phfmu run -o` wrote. Errors: ValueError for what is none, is empty or was cut off."""

    def __init__(self, path: str | os.PathLike[str]):
        self._file = ResultFile(path)
        self.names = self._file.names

    @property
    def title(self) -> str:
        return self._file.path.name

    def usual(self) -> list[str]:
        return usual(self.names)

    def marks(self) -> list[Mark]:
        return []

    def read(self, names: Sequence[str]) -> list[Signal]:
        """Signals by their exact names."""
        columns, time = self._file.columns(names), self._file.time
        return [Signal(n, self._file.units.get(n), time, columns[n]) for n in names]
