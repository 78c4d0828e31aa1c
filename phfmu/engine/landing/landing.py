"""Grid steps of coupled members with state events: what is located and what happens; the twin of runtime/events/events.c.

Instances by themselves land in compiled code.  docs/understand/events.md has the rules.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NoReturn, Protocol

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.landing.event_jump import AGAIN, PILE, SLIDES, Guards, Jumps
from phfmu.engine.landing.grid_step import grid_step
from phfmu.engine.landing.locate import EPS, Arrival, Location
from phfmu.events.event_plan import Settings
from phfmu.outcome.limits import LIMITS
from phfmu.outcome.steps import Happened

Array = NDArray[Any]
Taken = tuple[float, float, dict[str, Array]]  # a step: start, size, recorded row


@dataclass(frozen=True)
class Change:
    """How the mode of switches changed: by component the energy that it got and what was lost (J); `names`: each, on or off."""

    energy: Array
    lost: Array
    names: tuple[str, ...]


class Structure(Protocol):
    """The interface of an instance for each mode of its switches; see `SwitchedInstance`."""

    @property
    def present(self) -> Any:
        """The instance of the present mode."""
        ...

    @property
    def unsettled(self) -> bool:
        """Modes were set that are not taken yet."""
        ...

    @property
    def parameters(self) -> Array:
        """With the modes that were set."""
        ...

    def change(self, p: Array, h: float) -> Change:
        """Takes the parameters p and the mode that follows."""
        ...

    def row(self) -> Array:
        """All signals, as `run` records them."""
        ...


class Landing:
    """Takes the steps of an instance with state events, or of that of the present mode of a `structure`."""

    def __init__(self, instance: Any, structure: Structure | None = None):
        self.structure, self._parts = structure, dict[int, tuple[Location, Jumps]]()
        self._arrival = Arrival(np.zeros(instance.model.events.n))
        self._adopt(instance)
        self._last = np.zeros(self.plan.n)  # when each event of the grid step happened last

    def _adopt(self, instance: Any) -> None:
        self.instance, self.plan = instance, instance.model.events
        if id(instance) not in self._parts:
            guards = Guards(self.plan)
            location = Location(instance, self.plan, guards, self._arrival)
            self._parts[id(instance)] = location, Jumps(instance, self.plan, guards)
        self.location, self.jumps = self._parts[id(instance)]

    def within(
        self, t: float, end: float, h: float, read: Callable[[], dict[str, Array]], changed: bool, pause: bool = False
    ) -> Iterator[Taken | Happened]:
        """The steps (start, length, row made by `read`) and events in [t, end], of a grid of steps h.

        `changed`: values were set before;  `pause`: ends after the events of one time.
        """
        events = 0
        self.begin()
        if changed and self.structure is not None and self.structure.unsettled:
            settled = self.happen(t, h, [], 0)
            if settled.switched:
                events = 1
                yield settled
        fired = self.location.begun(t, end - t) if changed else []
        for start, taken, happened in grid_step(self, t, end, h, fired, events, pause):
            yield (start, taken, read()) if taken else happened

    @property
    def guards(self) -> int:
        return self.plan.n

    def refuse_again(self, t: float, fired: list[int]) -> NoReturn:
        self.jumps.refuse(t, AGAIN, fired)

    def begin(self) -> None:
        """A grid step begins."""
        self._last = np.full(self.plan.n, -np.inf)

    def happen(self, t: float, h: float, fired: list[int], events: int) -> Happened:
        """Events number `events` of a grid step of length h, at t: the states jump, parameters are set."""
        p, rests = self.decided(t, h, fired, events)
        ncomp = self.instance.model.step.ncomp
        energy, lost = self.jumps.jump(t, p, fired, rests) if fired else np.zeros((2, ncomp))
        return self.follows(t, h, (p, fired, rests), (energy, lost))

    def decided(self, t: float, h: float, fired: list[int], events: int) -> tuple[Array, list[int]]:
        """Parameters after the events, and which of these come to rest."""
        plan = self.plan
        crowded = events >= LIMITS["MOST_EVENTS"]
        piled = [i for i in fired if crowded or t - self._last[i] < LIMITS["PILE_UP"] * h]
        rests = [i for i in piled if plan.rest.ptr[i + 1] > plan.rest.ptr[i]]
        if crowded and not rests:
            slides = any(t - self._last[i] <= LIMITS["REST_OF_STEP"] * EPS * abs(t) for i in fired)
            self.jumps.refuse(t, SLIDES if slides else PILE, fired)
        p = (self.structure or self.instance).parameters
        for i in fired:
            _set(p, plan.sets, i)
        for i in rests:
            _set(p, plan.rest, i)
        return p, rests

    def follows(
        self, t: float, h: float, decided: tuple[Array, list[int], list[int]], jumped: tuple[Array, Array]
    ) -> Happened:
        """Takes the parameters p of the events `fired`, some of which rest; `jumped`: energies got and lost by component."""
        (p, fired, rests), (energy, lost) = decided, jumped
        if self.structure is None:
            self.instance.set_parameters(p)
            self.instance.initialise()
            switched: tuple[str, ...] = ()
        else:
            found = self.structure.change(p, h)
            energy, lost, switched = energy + found.energy, lost + found.lost, found.names
            self._adopt(self.structure.present)
        self._last[fired] = t
        return Happened(t, tuple(fired), tuple(rests), energy, lost, (self.structure or self.instance).row(), switched)


def _set(p: Array, settings: Settings, i: int) -> None:
    p[settings.p[settings.of(i)]] = settings.value[settings.of(i)]
