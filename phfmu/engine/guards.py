"""Guards and jumps of a model at an instant, in Python."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.evaluate import TABLES, Stage
from phfmu.events.event_plan import EventPlan
from phfmu.events.impulse import Columns
from phfmu.plan.plan import Group

Array = NDArray[Any]


class Guards:
    """Values of the guards and columns of the jumps; x = [states | t], y = [a | u]."""

    def __init__(self, plan: EventPlan):
        self.plan = plan
        self._guards = _stage(plan.groups)
        self._jump = None if plan.jump is None else _stage((plan.jump.group,))

    def values(self, x: Array, y: Array, p: Array) -> Array:
        """All guards (n)."""
        return self._guards.sums(1.0, self.plan.n, x, y, p)

    def columns(self, x: Array, p: Array) -> Columns:
        """The columns of all jumps and constraints."""
        jump = self.plan.jump
        assert jump is not None and self._jump is not None
        n, c, m = jump.columns, len(jump.component), len(jump.moved)
        found = self._jump.sums(1.0, jump.size, x, np.zeros(0), p)
        y, L, S, e = np.split(found, np.cumsum([c * n, m * n, n * n]))
        return Columns(L.reshape(n, m).T, y.reshape(c, n), S.reshape(n, n), e)


def _stage(groups: tuple[Group, ...]) -> Stage:
    return Stage(groups, [g.kernel.function for g in groups], TABLES)
