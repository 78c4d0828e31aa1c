"""A grid step with state events: the steps that end on zeros of guards, and what happens there."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NoReturn, Protocol

from phfmu.engine.landing.locate import EPS, Location
from phfmu.outcome.limits import LIMITS


class Lander(Protocol):
    """The interface of what a grid step lands: one instance, or members together."""

    @property
    def location(self) -> Location:
        """Location of the guards as they are now: with switches each mode has its own."""
        ...

    @property
    def guards(self) -> int:
        """Number of the guards."""
        ...

    def happen(self, t: float, h: float, fired: list[int], events: int) -> Any:
        """Events number `events` of a grid step of length h, at t: states jump, parameters are set."""
        ...

    def refuse_again(self, t: float, fired: list[int]) -> NoReturn:
        """Guards that stay on zero after as many events as there are guards."""
        ...


def grid_step(
    lander: Lander, t: float, end: float, h: float, fired: list[int], events: int = 0, pause: bool = False
) -> Iterator[tuple[float, float, Any]]:
    """(start, length, None) of each step taken in [t, end], (time, 0, what happened) of each event.

    `fired`: guards that are on zero at t;  `events`: that happened before in the step;  `pause`: ends after those that
    happen at one time
    """
    while True:
        passes = 0
        while fired:
            events, passes = events + 1, passes + 1
            if passes > lander.guards + 1:
                lander.refuse_again(t, fired)
            yield t, 0.0, lander.happen(t, h, fired, events)
            fired = lander.location.already(t)
        if pause and events:
            return
        if end - t <= (LIMITS["REST_OF_STEP"] * EPS * max(abs(t), abs(end)) if events else 0.0):
            return
        taken, fired = lander.location.advance(t, end - t)
        if taken:
            yield t, taken, None
            t = end if taken == end - t else t + taken
