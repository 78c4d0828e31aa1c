"""Inputs over time that hold between rows, as events."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.network.scene import Event

Array = NDArray[Any]


@dataclass(frozen=True)
class HeldInputs:
    """Input rows over time; the last row at or before t holds."""

    names: list[str]
    time: Array
    values: Array

    def events(self) -> list[Event]:
        """One event per changed value; before the first row the start values hold."""
        changed = np.ones(self.values.shape, bool)
        changed[1:] = self.values[1:] != self.values[:-1]
        times, values = self.time.tolist(), self.values.tolist()
        return [Event(times[i], self.names[j], values[i][j]) for i, j in np.argwhere(changed).tolist()]
