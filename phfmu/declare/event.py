"""State events: a guard that is landed on, and what happens where it is zero.

    g(x, z, a, p, t) = 0    ends the step;    then    x+ = x- + L m,   c(x+) = -e c(x-),   c = L^T z,   L = E^-1 on,

and parameters take new values.  A parameter that an event sets is a mode: it is constant between events.  `m` is an impulse,
so a jump moves the state along L only.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from math import inf
from typing import Any, Literal

from phfmu.declare.variable import Variable

Law = Literal["free", "unilateral"]
LAWS: tuple[Law, ...] = ("free", "unilateral")


@dataclass(frozen=True, eq=False)
class Guard:
    """A function of values at an instant; its zeros are landed on.

    expr:       scalar expression of states, costates, algebraic variables (as they are at the instant), inputs, parameters, time
    direction:  of the crossing that counts: -1 falling, +1 rising, 0 both
    nominal:    typical magnitude; guards below 1e-10 of it at one instant are one event
    unit:       of `expr`
    """

    name: str
    expr: Any
    direction: int = 0
    nominal: float = 1.0
    unit: str = "1"


@dataclass(frozen=True, eq=False)
class Jump:
    """An impulse m along L = E^-1 on that turns c = on^T z into -restitution c, c the rate it works against.

    on:           variable -> column (len(variable) x 1) in which the impulse acts: of a force on a momentum, a voltage on a flux
    restitution:  e in [0, 1], a number or an expression of parameters; 0: c vanishes
    most:         the largest |c| that may jump, in the unit of c (chopping current of a breaker); more refuses the step
    owner:        member that the loss (1 - e^2)/2 c S^-1 c, S = L^T H'' L, is booked at
    law:          "free": m of either sign, a grip;  "unilateral": a contact that pushes only, 0 <= m, 0 <= c(x+) + e c(x-), one
                  of them zero; c is the rate at which it opens
    """

    on: Mapping[Variable, Any]
    restitution: Any = 0.0
    most: float = inf
    owner: str = ""
    law: Law = "free"

    @property
    def unilateral(self) -> bool:
        """A contact that pushes only."""
        return self.law == "unilateral"


@dataclass(frozen=True, eq=False)
class StateEvent:
    """An event: the jump and the new modes that follow when a guard is zero.

    when:   scalar parameter -> value: the event is armed while all have these values; {} = always
    sets:   scalar parameter -> value that it takes
    jump:   of the states, with its energy booked
    rest:   what is set besides, with restitution 0, where events would pile up: the last one was less than 1e-6 of the step ago,
            or 100 fell into the step.  {} = such a run is refused
    """

    guard: Guard
    when: Mapping[str, float] = field(default_factory=dict)
    sets: Mapping[str, float] = field(default_factory=dict)
    jump: Jump | None = None
    rest: Mapping[str, float] = field(default_factory=dict)

    @property
    def changed(self) -> set[str]:
        """Scalar parameters that it may set."""
        return {*self.sets, *self.rest}

    @property
    def named(self) -> set[str]:
        """Scalar parameters that it reads or sets by name."""
        return {*self.when, *self.changed}


def renamed(
    events: Iterable[StateEvent], new: Mapping[str, str], image: Callable[[Variable], Variable]
) -> tuple[StateEvent, ...]:
    """The events with the names of new parameters, old -> new, and the images of the variables that jump."""

    def named(values: Mapping[str, float]) -> dict[str, float]:
        return {new.get(n, n): value for n, value in values.items()}

    def moved(e: StateEvent) -> StateEvent:
        jump = e.jump and replace(e.jump, on={image(v): m for v, m in e.jump.on.items()})
        return replace(e, when=named(e.when), sets=named(e.sets), rest=named(e.rest), jump=jump)

    return tuple(map(moved, events))
