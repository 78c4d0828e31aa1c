"""The interface of couplings: how the junction unknowns of a step are found.

A coupling is a class that says what it keeps, and how the unknowns move: `started` before a step, `moved` after a trial that is
not accepted.  Those of `compiled/solvers.py` have that in C (`runtime/`).  Loops, trials, records and books are those of the
compiled master.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from numpy.typing import NDArray

from phfmu.network.interface.coupled_members import CoupledMembers
from phfmu.outcome.status import StepFailure

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
    """Junction unknowns xi of the last step (means), and at its end (None: the same).

    `h`: length of the last step, or of the last part of one that was taken in parts; 0 where the next step is no continuation.
    `memory`: what the solver goes on from, of its own kind.
    """

    xi: Array
    at_end: Array | None = None
    h: float = 0.0
    memory: Any = None

    @property
    def end(self) -> Array:
        """Junction unknowns at the end of the step."""
        return self.xi if self.at_end is None else self.at_end


class Unconverged(StepFailure):
    """An iteration that was given up; the members are at the start of the step."""


class Coupling(Protocol):
    """A way to find the junction unknowns of a step.

    `order`: the most that it keeps, whatever the order of the members;  `repeats`: whether it takes a step more than once, for
    which members must save their states;  `closes`: whether junctions create no energy, by its own account.
    """

    order: int
    repeats: bool
    closes: bool


@runtime_checkable
class Starts(Protocol):
    """A coupling with a rule for where a step starts from; without it that is where the step before ended."""

    def started(self, joined: CoupledMembers, xi: Array, r: Array) -> Array:
        """Junction unknowns of the first trial; xi, r: those of the step before and the rows that it left, r = P^T Y + C xi."""
        ...


@runtime_checkable
class InTurn(Protocol):
    """A coupling whose members step one after the other, each with what the others give at that instant (`runtime/in_turn.c`)."""

    repeats: bool

    def groups(self, joined: CoupledMembers) -> list[list[int]]:
        """Places of members among all: those that step at once, in the order in which they step; each of them once in a sweep.
        Further sweeps, of a coupling that repeats steps, take all members from where the step began."""
        ...


def solves_rows(coupling: Any) -> bool:
    """Whether a coupling, or a class of them, solves the rows of the junctions, by steps that it takes more than once.

    Those in turn fill no rows, whether they take a step once or in several sweeps; junctions make energy under them.
    """
    return bool(coupling.repeats) and not isinstance(coupling, InTurn)


@runtime_checkable
class Moves(Protocol):
    """A coupling that repeats steps; without it the first trial is the step.

    It iterates, at most `iterations` times a step, or takes each step `sweeps` times, the last of which is the step.
    """

    def moved(self, joined: CoupledMembers, xi: Array, r: Array) -> Array:
        """Junction unknowns of the next trial; xi, r: those of the last one and the rows that it left; members are at its end."""
        ...
