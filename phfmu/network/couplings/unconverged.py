"""Policies where a coupling gives up its iteration: refuse the step, halve it, or keep the best trial and tell.

`Halving` and `Accepting` are couplings around another one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from phfmu.network.couplings.acceptance import HALVED, KEPT
from phfmu.network.couplings.coupling import Coupling, Solution, Step, Unconverged
from phfmu.network.couplings.works import Works, works
from phfmu.network.interface.joined import Joined
from phfmu.outcome.status import Status, StepFailure

HALVINGS = 10  # times that a step is halved


class Accepting:
    """Keeps the trial that left the least; what it leaves is booked at the junctions, which then count as loose."""

    closes = False

    def __init__(self, inner: Coupling):
        self.inner, self.order, self.repeats = inner, inner.order, inner.repeats

    def solve(self, joined: Joined, last: Solution, step: Step) -> Solution:
        """StepFailure where not even a trial is finite."""
        try:
            return self.inner.solve(joined, last, step)
        except Unconverged as failure:
            if failure.best is None:
                raise
            return replace(failure.best, accepted_by=KEPT)


class Halving:
    """Takes a step that does not converge in halves, and these again; members exchange new values in each."""

    def __init__(self, inner: Coupling):
        self.inner, self.order, self.repeats, self.closes = inner, inner.order, inner.repeats, inner.closes

    def solve(self, joined: Joined, last: Solution, step: Step) -> Solution:
        """StepFailure of a part that is h / 2^10 long."""
        return self._part(joined, last, step, HALVINGS)

    def _part(self, joined: Joined, last: Solution, step: Step, left: int) -> Solution:
        try:
            return self.inner.solve(joined, last, step)
        except StepFailure as failure:
            if left == 0 or failure.status not in (Status.NO_CONVERGENCE, Status.NOT_FINITE):
                failure.tried += f"; the step was halved {HALVINGS - left} times" if left < HALVINGS else ""
                raise
        joined.restore(step.states)
        h = step.h / 2
        one = self._part(joined, last, Step(step.t, h, step.states), left - 1)
        joined.finish()
        book = added(joined.ledger() | {"works": works(joined, one, h)}, one.earlier)
        happened = (*one.happened, *joined.happened())
        two = self._part(joined, one, Step(step.t + h, h, joined.states()), left - 1)
        trials, book = one.iterations + two.iterations, added(book, two.earlier)
        happened = (*happened, *two.happened)
        return replace(two, iterations=trials, accepted_by=HALVED, earlier=book, h=two.h or h, happened=happened)


def plain(coupling: Coupling) -> Coupling:
    """The coupling itself, without what is done where it gives up."""
    return coupling.inner if isinstance(coupling, Halving | Accepting) else coupling


def booked(joined: Joined, parts: Works, last: Solution, h: float) -> dict[str, Any]:
    """The bookings of members and junctions in a step of length h, with what `last` took of it before."""
    book = joined.ledger()
    if not parts.keys:
        return added(book, last.earlier)
    book = added(book | {"works": works(joined, last, h)}, last.earlier)
    return book | {"works": parts.grouped(book["works"])}


def added(book: dict[str, Any], other: dict[str, Any] | None) -> dict[str, Any]:
    """Two ledgers as one."""
    return book if other is None else {key: np.asarray(book[key]) + other[key] for key in book}


#: by the names users know
POLICIES: dict[str, Callable[[Coupling], Coupling]] = {"raise": lambda c: c, "halve": Halving, "accept": Accepting}
