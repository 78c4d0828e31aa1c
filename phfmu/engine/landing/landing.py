"""Grid steps of coupled members with state events, their location and jumps; the twin of runtime/events/events.c.

Instances by themselves land in compiled code.  docs/understand/events.md has the rules.
"""

from __future__ import annotations

from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.landing.event_jump import AGAIN, PILE, SLIDES, Guards, Jumps
from phfmu.engine.landing.locate import EPS
from phfmu.events.event_plan import Settings
from phfmu.outcome.limits import LIMITS
from phfmu.outcome.steps import EventRecord

Array = NDArray[Any]


class Landing:
    """The state events of one of the members that land together."""

    def __init__(self, instance: Any):
        self.instance, self.plan = instance, instance.model.events
        self.jumps = Jumps(instance, self.plan, Guards(self.plan))
        self._last = np.zeros(self.plan.n)  # when each event of the grid step happened last

    def refuse_again(self, t: float, fired: list[int]) -> NoReturn:
        self.jumps.refuse(t, AGAIN, fired)

    def begin(self) -> None:
        """A grid step begins."""
        self._last = np.full(self.plan.n, -np.inf)

    def decided(self, t: float, h: float, fired: list[int], events: int) -> tuple[Array, list[int]]:
        """Parameters after the events, and which of these come to rest."""
        plan = self.plan
        crowded = events >= LIMITS["MOST_EVENTS"]
        piled = [i for i in fired if crowded or t - self._last[i] < LIMITS["PILE_UP"] * h]
        rests = [i for i in piled if plan.rest.ptr[i + 1] > plan.rest.ptr[i]]
        if crowded and not rests:
            slides = any(t - self._last[i] <= LIMITS["REST_OF_STEP"] * EPS * abs(t) for i in fired)
            self.jumps.refuse(t, SLIDES if slides else PILE, fired)
        p = self.instance.parameters
        for i in fired:
            _set(p, plan.sets, i)
        for i in rests:
            _set(p, plan.rest, i)
        return p, rests

    def follows(
        self, t: float, h: float, decided: tuple[Array, list[int], list[int]], jumped: tuple[Array, Array]
    ) -> EventRecord:
        """Takes the parameters p of the events `fired`, some of which rest; `jumped`: energies got and lost by component."""
        (p, fired, rests), (energy, lost) = decided, jumped
        self.instance.set_parameters(p)
        self.instance.initialise()
        self._last[fired] = t
        return EventRecord(t, tuple(fired), tuple(rests), energy, lost, self.instance.row())


def _set(p: Array, settings: Settings, i: int) -> None:
    p[settings.p[settings.of(i)]] = settings.value[settings.of(i)]
