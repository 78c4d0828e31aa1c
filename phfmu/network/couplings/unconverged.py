"""Policies where a coupling gives up its iteration: refuse the step, halve it, or keep the best trial and tell.

`HalvingPolicy` and `AcceptingPolicy` say so of a coupling, which is `inner`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from phfmu.network.couplings.acceptance import HALVED
from phfmu.network.couplings.coupling import Coupling, Solution
from phfmu.outcome.status import Status, StepFailure
from phfmu.outcome.steps import Steps

HALVINGS = 10  # times that a step is halved

#: takes a step (t, h) that goes on from a solution
Take = Callable[[Solution, float, float], tuple[Steps, Solution]]


class AcceptingPolicy:
    """Keeps the trial that left the least; what it leaves is booked at the junctions, which then count as loose."""

    closes = False

    def __init__(self, inner: Coupling):
        self.inner, self.order, self.repeats = inner, inner.order, inner.repeats


class HalvingPolicy:
    """Takes a step that does not converge in halves, and these again; members exchange new values in each."""

    def __init__(self, inner: Coupling):
        self.inner, self.order, self.repeats, self.closes = inner, inner.order, inner.repeats, inner.closes


def in_halves(
    take: Take, finish: Callable[[], None], last: Solution, t: float, h: float, left: int = HALVINGS
) -> tuple[Steps, Solution]:
    """A step by `take`, which leaves all members where they are when it fails; else its halves, booked as one step.

    `finish`: ends the first half for good.  Raises StepFailure of a part that is h / 2^10 long.
    """
    try:
        return take(last, t, h)
    except StepFailure as failure:
        if left == 0 or failure.status not in (Status.NO_CONVERGENCE, Status.NOT_FINITE):
            failure.tried += f"; the step was halved {HALVINGS - left} times" if left < HALVINGS else ""
            raise
    one, last = in_halves(take, finish, last, t, h / 2, left - 1)
    finish()
    two, last = in_halves(take, finish, last, t + h / 2, h / 2, left - 1)
    return _as_one(one, two), last


#: fields of `Steps` that add up
_ADDED = ("stored", "dissipated", "supplied", "pairs", "numerical", "moved", "iterations", "works", "exchanged")


def _as_one(one: Steps, two: Steps) -> Steps:
    """The record of a step of two parts."""
    both = ((n, getattr(one, n), getattr(two, n)) for n in _ADDED)
    sums = {n: a + b for n, a, b in both if a is not None and b is not None}
    return replace(two, **sums, accepted_by=np.array([HALVED]), events=(*one.events, *two.events))


def plain(coupling: Coupling) -> Coupling:
    """The coupling itself, without what is done where it gives up."""
    return coupling.inner if isinstance(coupling, HalvingPolicy | AcceptingPolicy) else coupling


#: by the names users know
POLICIES: dict[str, Callable[[Coupling], Coupling]] = {
    "raise": lambda c: c,
    "halve": HalvingPolicy,
    "accept": AcceptingPolicy,
}
