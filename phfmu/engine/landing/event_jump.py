"""Jumps of the states where guards are zero, with their energies; the twin of runtime/events/event_jump.c.

Guards and jumps of a model at an instant, in Python.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.reference.evaluate import TABLES, Stage
from phfmu.events.event_plan import EventPlan
from phfmu.events.impulse import ImpulseColumns, impulses, pushing
from phfmu.outcome.limits import LIMITS
from phfmu.outcome.status import EventRefused
from phfmu.plan.plan import Group

Array = NDArray[Any]


class Guards:
    """Values of the guards and columns of the jumps; x = [states | t], y = [a | u]."""

    def __init__(self, plan: EventPlan):
        self.plan = plan
        self._guards, self._rates = _stage(plan.groups), _stage(plan.rates)
        self._jump = None if plan.jump is None else _stage((plan.jump.group,))

    def values(self, x: Array, y: Array, p: Array) -> Array:
        """All guards (n)."""
        return self._guards.sums(1.0, self.plan.n, x, y, p)

    def rates(self, x: Array, y: Array, p: Array) -> Array:
        """d guard / dt of all guards (n), 0 of those that are not rated."""
        return self._rates.sums(1.0, self.plan.n, x, y, p)

    def columns(self, x: Array, p: Array) -> ImpulseColumns:
        """The columns of all jumps and constraints."""
        jump = self.plan.jump
        assert jump is not None and self._jump is not None
        n, c, m = jump.columns, len(jump.component), len(jump.moved)
        found = self._jump.sums(1.0, jump.size, x, np.zeros(0), p)
        y, L, S, e = np.split(found, np.cumsum([c * n, m * n, n * n]))
        return ImpulseColumns(L.reshape(n, m).T, y.reshape(c, n), S.reshape(n, n), e)


def _stage(groups: tuple[Group, ...]) -> Stage:
    return Stage(groups, [g.kernel.function for g in groups], TABLES)


DEPENDENT, MOST, GAIN, PILE, AGAIN, SLIDES, NO_MODE, SHARED = range(8)  # places in event_failure.REASONS


@dataclass(frozen=True)
class Laws:
    """Laws of n jumps: rests: it ends with restitution 0;  most: largest |c|;  pushes: its impulse is not negative."""

    rests: NDArray[np.bool_]
    most: Array
    pushes: NDArray[np.bool_]


def struck(
    columns: Callable[[], ImpulseColumns],
    move: Callable[[ImpulseColumns, Array], None],
    laws: Laws,
    refuse: Callable[[int, Sequence[int] | None, float, float], NoReturn],
) -> Array:
    """The work of the impulses of jumps and constraints (components x columns): `columns` as they are, `move` along them.

    `refuse`: takes a reason, places of jumps (None: of all events), a value and its limit.
    """
    at = columns()
    n, before = len(laws.most), at.c.copy()
    e = np.zeros(len(at.S))
    e[:n] = np.where(laws.rests, 0.0, at.e)
    goal, m = -(1.0 + e) * at.c.sum(axis=0), np.zeros(len(e))
    for j, c in enumerate(at.c.sum(axis=0)[:n]):
        if abs(c) > laws.most[j]:
            refuse(MOST, [j], abs(float(c)), float(laws.most[j]))
    least = LIMITS["JUMP_DEPENDENT"]
    acts = pushing(at.S, goal, laws.pushes, least, LIMITS["PUSH_ROUNDING"], int(LIMITS["MOST_PUSHING"]))
    for _ in range(2):  # the second corrects the rounding of the first
        found = None if acts is None else impulses(at.S, goal, acts, n, least)
        if found is None or acts is None:
            refuse(DEPENDENT, range(n), 0.0, 0.0)
        m += found
        move(at, found)
        at = columns()
        goal = -e * before.sum(axis=0) - at.c.sum(axis=0)
    work = m * (before + at.c) / 2  # exact as H is quadratic along L
    moved = (np.abs(m) * (np.abs(before) + np.abs(at.c))).sum() / 2
    if (gain := float(work.sum())) > LIMITS["LOSS_ROUNDING"] * moved:
        refuse(GAIN, None, gain, 0.0)
    return work


class Jumps:
    """Moves the states of an instance along the columns of its jumps."""

    def __init__(self, instance: Any, plan: EventPlan, guards: Guards):
        self.instance, self.plan, self.guards = instance, plan, guards

    def jump(self, t: float, p: Array, fired: list[int], rests: list[int]) -> tuple[Array, Array]:
        """Moves the states along L at the parameters p after the events; by component the energy they get and what is lost.

        Constraints hold after it.  What their impulses lose, where a mode has changed them, is booked with the first event.
        """
        instance, size = self.instance, self.instance.model.step.ncomp
        energy, lost = np.zeros(size), np.zeros(size)
        jump = self.plan.jump
        if jump is None:
            return energy, lost
        jumping = [i for i in fired if jump.of[i] >= 0]
        if not jumping and not jump.held:
            return energy, lost
        which, x = [int(jump.of[i]) for i in jumping], instance.x

        def columns() -> ImpulseColumns:
            return self.guards.columns(np.append(x, t), p).chosen(which)

        def move(at: ImpulseColumns, m: Array) -> None:
            x[jump.moved] += at.L @ m

        def refuse(reason: int, places: Sequence[int] | None, value: float, limit: float) -> NoReturn:
            self.refuse(t, reason, fired if places is None else [jumping[j] for j in places], value, limit)

        laws = Laws(np.array([i in rests for i in jumping], bool), jump.most[which], jump.pushes[which] > 0)
        work = struck(columns, move, laws, refuse)
        energy[jump.component] = work.sum(axis=1)
        np.add.at(lost, self.plan.owner[[*jumping, *[fired[0]] * (work.shape[1] - len(which))]], -work.sum(axis=0))
        instance.set_x(t, x)
        return energy, lost

    def refuse(self, t: float, reason: int, fired: list[int], value: float = 0.0, limit: float = 0.0) -> NoReturn:
        names = [self.plan.names[i] for i in fired]
        raise EventRefused(self.instance.model.name, t, reason, names, value, limit)
