"""What happens within a step of a unit, from the outputs it has for that."""

from __future__ import annotations

import numpy as np

from phfmu.engine.steps import StepEvent
from phfmu.fmu.reader import FMUInstance
from phfmu.signals import HAPPENED, JUMPED, total
from phfmu.words import counted


class UnitHappenings:
    """Changes of `energy.events` and `events.*` over a step; nothing of units without them.  `found`: of the last step."""

    def __init__(self, unit: FMUInstance, name: str):
        known = () if unit.estimated else unit.interface.variables
        self._unit, self._member = unit, name
        self.names = [n for n in (total(JUMPED[0]), *(n for n, _, _ in HAPPENED)) if n in known]
        self.found: list[StepEvent] = []

    def begin(self) -> None:
        """Before a step."""
        if self.names:
            self._before = self._unit.get(self.names)

    def end(self, t: float) -> None:
        """After it, at time t."""
        if not self.names:
            return
        after = self._unit.get(self.names)
        change, self.found = after - self._before, []
        if len(change) == 1:
            if change[0]:
                name = f"{self._member}: parameters in it"
                self.found = [StepEvent(t, change, np.zeros(1), name, "parameters in the unit", "parameter")]
        elif change[1]:
            words = f"{counted(int(change[1]), 'state event')} in the unit"
            self.found = [StepEvent(float(after[2]), change[:1], change[3:], f"{self._member}: {words}", words)]
