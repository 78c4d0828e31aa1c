"""Jumps of the states where guards are zero, with their energies; the twin of runtime/events/event_jump.c."""

from __future__ import annotations

from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.event_failure import EventRefused
from phfmu.engine.guards import Guards
from phfmu.engine.limits import LIMITS
from phfmu.events.event_plan import EventPlan
from phfmu.events.impulse import impulses

Array = NDArray[Any]

DEPENDENT, MOST, GAIN, PILE, AGAIN = range(5)  # places in event_failure.REASONS


class Jumps:
    """Moves the states of an instance along the columns of its jumps."""

    def __init__(self, instance: Any, plan: EventPlan, guards: Guards):
        self.instance, self.plan, self.guards = instance, plan, guards

    def jump(self, t: float, fired: list[int], rests: list[int]) -> tuple[Array, Array]:
        """Moves the states along L; by component the energy they get and what is lost."""
        instance, n = self.instance, self.instance.model.step.ncomp
        energy, lost = np.zeros(n), np.zeros(n)
        jump = self.plan.jump
        if jump is None or not fired:
            return energy, lost
        which = [int(jump.of[i]) for i in fired]
        x, p = instance.x, instance.parameters
        at = self.guards.columns(np.append(x, t), p).chosen(which)
        e = np.where([i in rests for i in fired], 0.0, at.e)
        before, goal, m = at.c.copy(), -(1.0 + e) * at.c.sum(axis=0), np.zeros(len(which))
        for j, c in enumerate(at.c.sum(axis=0)):
            if abs(c) > jump.most[which[j]]:
                self.refuse(t, MOST, [fired[j]], abs(float(c)), float(jump.most[which[j]]))
        for _ in range(2):  # the second corrects the rounding of the first
            found = impulses(at.S, goal, LIMITS["JUMP_DEPENDENT"])
            if found is None:
                self.refuse(t, DEPENDENT, fired)
            m += found
            x[jump.moved] += at.L @ found
            at = self.guards.columns(np.append(x, t), p).chosen(which)
            goal = -e * before.sum(axis=0) - at.c.sum(axis=0)
        work = m * (before + at.c) / 2  # components x jumps, exact as H is quadratic along L
        loss = -work.sum(axis=0)
        if -loss.sum() > LIMITS["LOSS_ROUNDING"] * np.abs(work).sum():
            self.refuse(t, GAIN, fired, float(-loss.sum()))
        energy[jump.component] = work.sum(axis=1)
        np.add.at(lost, jump.owner[which], loss)
        instance.set_x(t, x)
        return energy, lost

    def refuse(self, t: float, reason: int, fired: list[int], value: float = 0.0, limit: float = 0.0) -> NoReturn:
        names = [self.plan.names[i] for i in fired]
        raise EventRefused(self.instance.model.name, t, reason, names, value, limit)
