"""Result columns of a model: the variables of its FMU, read from an instance's signals."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.discretise.model import Model
from phfmu.fmu.variables import variables

Array = NDArray[np.float64]


class Columns:
    """Names and gather tables of every calculated variable (no parameters, inputs or time)."""

    def __init__(self, model: Model, layout: dict[str, slice]):
        place = {f"PH_{block}".upper(): where.start for block, where in layout.items()}
        chosen = [v for v in variables(model) if v.block in place and v.causality != "independent"]
        self.names = [v.name for v in chosen]
        self._blocks = list(layout)
        entries = [place[v.block] + v.first + np.arange(v.count) for v in chosen]
        self._gather = np.concatenate(entries) if entries else np.zeros(0, int)
        self._starts = np.cumsum([0, *(v.count for v in chosen)])[:-1]

    def pick(self, signals: Array) -> Array:
        """Rows of signals -> rows of columns."""
        if not self.names:
            return np.zeros((len(signals), 0))
        return np.add.reduceat(signals[:, self._gather], self._starts, axis=1)

    def now(self, instance: Any) -> Array:
        """The columns at the present time."""
        signals = instance.signals()
        return self.pick(np.concatenate([signals[b] for b in self._blocks])[None])[0]
