"""Jacobi coupling: all members step at once, with each other's outputs at the start of the step."""

from __future__ import annotations

from phfmu.network.couplings.coupling import Solution, Step
from phfmu.network.couplings.explicit import ORDER, stepped
from phfmu.network.interface.instant import Instant
from phfmu.network.interface.joined import Joined


class Jacobi:
    """Every member once, under values of time t.  Cheap and in parallel, but it makes energy: the step must be small."""

    order, repeats, closes = ORDER, False, False

    def __init__(self) -> None:
        self._instant = Instant()

    def groups(self, joined: Joined) -> list[list[int]]:
        """All step at once."""
        return [[*range(len(joined.members))]]

    def solve(self, joined: Joined, last: Solution, step: Step) -> Solution:
        """ValueError where no output gives a junction unknown."""
        return stepped(joined, self._instant, last, step, self.groups(joined))
