"""Jumps of the states where guards are zero, with their energies, which several members may share.

Jumps of one model happen in compiled code (runtime/events/event_jump.c); those that junctions share between members, units among
them, are solved for here, by the same laws.
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

Array = NDArray[Any]


class JumpColumns:
    """The columns of all jumps and constraints of a model, from its states, time and parameters."""

    def __init__(self, plan: EventPlan):
        assert plan.jump is not None
        self._jump, group = plan.jump, plan.jump.group
        self._stage = Stage((group,), [group.kernel.function], TABLES)

    def at(self, x: Array, p: Array) -> ImpulseColumns:
        """x = [states | t]."""
        jump = self._jump
        n, c, m = jump.columns, len(jump.component), len(jump.moved)
        found = self._stage.sums(1.0, jump.size, x, np.zeros(0), p)
        y, L, S, e = np.split(found, np.cumsum([c * n, m * n, n * n]))
        return ImpulseColumns(L.reshape(n, m).T, y.reshape(c, n), S.reshape(n, n), e)


DEPENDENT, MOST, GAIN = range(3)  # places in event_failure.REASONS


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
