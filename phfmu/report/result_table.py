"""The result table of a run as a recording: CSV or Parquet, first column `time`."""

import os
from collections.abc import Sequence

from phfmu.report.picture.choice import usual
from phfmu.report.recording import Mark, Signal
from phfmu.results.file import ResultFile


class ResultTable:
    """A table that `phfmu run -o` wrote. Errors: ValueError for a file that is none, is empty or was cut off."""

    def __init__(self, path: str | os.PathLike[str]):
        self._file = ResultFile(path)
        self.names, self.kinds = self._file.names, self._file.kinds

    @property
    def title(self) -> str:
        return self._file.path.name

    @property
    def labelled(self) -> dict[str, str]:
        return {label: name for name, label in self._file.labels.items()}

    def usual(self) -> list[str]:
        return usual(self.names, self.kinds)

    def marks(self) -> list[Mark]:
        return []

    def read(self, names: Sequence[str]) -> list[Signal]:
        """Signals by their exact names."""
        columns, time = self._file.columns(names), self._file.time
        units, kinds, labels = self._file.units, self.kinds, self._file.labels
        return [
            Signal(n, units.get(n), time, columns[n], kind=kinds.get(n, ""), label=labels.get(n, "")) for n in names
        ]
