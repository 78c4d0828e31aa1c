"""The interface of couplings: a coupling finds the junction unknowns of one step; `Coupled` does all else.

A coupling is one file with one class; `newton.py` is one.  It is given the members with the equations of their junctions
(`Joined`), what it found for the step before, and the step; it leaves every member at the end of the step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from numpy.typing import NDArray

from phfmu.network.interface.joined import Joined
from phfmu.outcome.status import StepFailure
from phfmu.outcome.steps import StepEvent

Array = NDArray[Any]


@dataclass(frozen=True)
class Step:
    """From t by h; `states`: of the members at t, to which they may be brought back as often as it takes.

    Where the coupling does not repeat steps, that of a member that cannot save it is None.
    """

    t: float
    h: float
    states: list[Any]


@dataclass(frozen=True)
class AllSteps:
    """solve: takes a step (t, h) of all members, True if in one part;  save, restore: of where all are."""

    solve: Callable[[float, float], bool]
    save: Callable[[], Any]
    restore: Callable[[Any], None]


@dataclass(frozen=True)
class Solution:
    """Junction unknowns xi of a step and outputs y of the members under them; trials; by which test they were accepted.

    `h`: of the last part of a step that was taken in parts, `earlier`: the ledger of those before it, `happened`: what did there.
    `works`: energy of each unknown at its junction [J], None where that is h xi r.
    """

    xi: Array
    y: Array
    iterations: int = 0
    accepted_by: str = ""
    earlier: dict[str, Array] | None = None
    h: float = 0.0
    works: Array | None = None
    happened: tuple[StepEvent, ...] = ()


class Unconverged(StepFailure):
    """An iteration that was given up.

    `best`: the trial that left the least, if all were finite; the members are at the end of the step under it.
    """

    best: Solution | None = None

    def of(self, best: Solution) -> Unconverged:
        self.best = best
        return self


class Coupling(Protocol):
    """Finds the junction unknowns of a step.

    `order`: the most that it keeps, whatever the order of the members;  `repeats`: whether it takes a step more than once, for
    which members must save their states;  `closes`: whether junctions create no energy, by its own account.
    """

    order: int
    repeats: bool
    closes: bool

    def solve(self, joined: Joined, last: Solution, step: Step) -> Solution:
        """One step from step.t, where the members are; they end at step.t + step.h under the returned unknowns.

        `last`: of the step before, at the start its unknowns are the start values.  Unconverged: its best trial may be
        kept.  Any other StepFailure: the members may be anywhere, who calls brings them back.
        """
        ...
