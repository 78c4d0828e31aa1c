"""Jumps of the states where guards are zero, with their energies; the twin of runtime/events/event_jump.c."""

from __future__ import annotations

from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.event_failure import EventRefused
from phfmu.engine.guards import Guards
from phfmu.engine.limits import LIMITS
from phfmu.events.event_plan import EventPlan
from phfmu.events.impulse import impulses, pushing

Array = NDArray[Any]

DEPENDENT, MOST, GAIN, PILE, AGAIN, SLIDES, NO_MODE, SHARED = range(8)  # places in event_failure.REASONS


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
        which = [int(jump.of[i]) for i in jumping]
        x = instance.x
        at = self.guards.columns(np.append(x, t), p).chosen(which)
        n, before = len(which), at.c.copy()
        e = np.zeros(len(at.S))
        e[:n] = np.where([i in rests for i in jumping], 0.0, at.e)
        goal, m = -(1.0 + e) * at.c.sum(axis=0), np.zeros(len(e))
        for j, c in enumerate(at.c.sum(axis=0)[:n]):
            if abs(c) > jump.most[which[j]]:
                self.refuse(t, MOST, [jumping[j]], abs(float(c)), float(jump.most[which[j]]))
        least, pushes = LIMITS["JUMP_DEPENDENT"], jump.pushes[which] > 0
        acts = pushing(at.S, goal, pushes, least, LIMITS["PUSH_ROUNDING"], int(LIMITS["MOST_PUSHING"]))
        for _ in range(2):  # the second corrects the rounding of the first
            found = None if acts is None else impulses(at.S, goal, acts, n, least)
            if found is None or acts is None:
                self.refuse(t, DEPENDENT, jumping)
            m += found
            x[jump.moved] += at.L @ found
            at = self.guards.columns(np.append(x, t), p).chosen(which)
            goal = -e * before.sum(axis=0) - at.c.sum(axis=0)
        work = m * (before + at.c) / 2  # components x columns, exact as H is quadratic along L
        loss = -work.sum(axis=0)
        moved = (np.abs(m) * (np.abs(before) + np.abs(at.c))).sum() / 2
        if -loss.sum() > LIMITS["LOSS_ROUNDING"] * moved:
            self.refuse(t, GAIN, fired, float(-loss.sum()))
        energy[jump.component] = work.sum(axis=1)
        np.add.at(lost, self.plan.owner[[*jumping, *[fired[0]] * (len(e) - n)]], loss)
        instance.set_x(t, x)
        return energy, lost

    def refuse(self, t: float, reason: int, fired: list[int], value: float = 0.0, limit: float = 0.0) -> NoReturn:
        names = [self.plan.names[i] for i in fired]
        raise EventRefused(self.instance.model.name, t, reason, names, value, limit)
