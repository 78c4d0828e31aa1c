"""Newton coupling: an interface Newton iteration on the step maps of the members.

With Y(U) the step-conjugate outputs of a trial step, held inputs U = P xi + U_free, the junction rows of `Joined` are

    r(xi) = P^T Y(P xi + U_free) + C xi = 0,     dr/dxi = P^T G P + C,

with G = dY/dU of each member's step (implicit function theorem, or finite differences with rollback).  sym(G) > 0 makes
the matrix regular.  Whatever the iteration leaves is booked at the junctions: sum of h U^T Y over joined ports.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.status import Status
from phfmu.network.couplings.coupling import Solution, Step, Unconverged
from phfmu.network.couplings.joined import Joined

Array = NDArray[Any]

# the words are those of the engines' Newton, of which this is the outer one
ENERGY = 1e-14  # accepted interface energy relative to the energy in play
ROUNDING = 1e-13  # scaled residual that counts as solved
STAGNATION = 1e-9  # a scaled residual below this that stays is rounding, if the energy is
SHRINKING = 0.5  # a scaled residual that shrinks to more than this part of the last hardly shrinks: it stalls
STALLING = 0.3  # the same within the energy budget
STALLED = 10.0  # times the accepted energy is accepted where it stalls
STALLS = 3  # times that rows stalled within the energy budget, with a matrix taken after the first, when what is left is rounding
FLOOR = 16.0  # units of rounding in a row that cannot be told from zero
ITERATIONS = 30

NEWTON = "interface Newton"


@dataclass(frozen=True)
class Trial:
    """Junction unknowns, the outputs Y of the members under them, and the rows r that these leave."""

    xi: Array
    y: Array
    r: Array

    def scaled(self, joined: Joined) -> Array:
        """|r| relative to the terms of its rows."""
        return np.abs(self.r) / joined.row_sizes(self.xi, self.y)


@dataclass(frozen=True)
class Worst:
    """The junction row that misses most: its name, the value of its unknown, what is left of it."""

    name: str
    value: float
    residual: float


class Newton:
    """One value per junction unknown and step, held: the whole is of order 2, whatever the order of the members is."""

    name, order, repeats, closes = "newton", 2, True, True

    def solve(self, joined: Joined, last: Solution, step: Step) -> Solution:
        """StepFailure (no convergence, singular, not finite) names the worst junction row."""
        xi, history, gain = last.xi.copy(), [], np.zeros_like(joined.face.C)
        best = np.inf, xi
        for i in range(ITERATIONS):
            if i > 0:
                joined.restore(step.states)
            trial = trial_of(joined, xi, step)
            if not np.isfinite(trial.r).all():
                raise failed(Status.NOT_FINITE, joined, step, trial, history)
            history.append(float(np.max(trial.scaled(joined), initial=0.0)))
            best = min(best, (history[-1], xi), key=itemgetter(0))
            if accepted_by := accepted(joined, trial, step.h, history, gain):
                return Solution(xi, trial.y, i + 1, accepted_by)
            G = [m.sensitivity(step.t, step.h, s) for m, s in zip(joined.members, step.states, strict=True)]
            matrix = joined.matrix(G)
            gain = np.abs(matrix)
            try:
                xi = xi + update(matrix, trial.r)
            except np.linalg.LinAlgError:
                raise failed(Status.SINGULAR, joined, step, trial, history) from None
            if not np.isfinite(xi).all():
                raise failed(Status.NOT_FINITE, joined, step, trial, history)
        joined.restore(step.states)
        kept = trial_of(joined, best[1], step)
        raise failed(Status.NO_CONVERGENCE, joined, step, trial, history).of(Solution(kept.xi, kept.y, ITERATIONS))


def trial_of(joined: Joined, xi: Array, step: Step) -> Trial:
    """One step of all members under xi, from where they are."""
    y = joined.trial(xi, step.t, step.h)
    return Trial(xi, y, joined.rows(xi, y))


def update(matrix: Array, r: Array) -> Array:
    """dxi of matrix dxi = -r with rows scaled by their largest entries; LinAlgError if it is singular."""
    scale = 1.0 / np.maximum(np.abs(matrix).max(axis=1), 1e-300)
    return np.linalg.solve(matrix * scale[:, None], -r * scale)


def accepted(joined: Joined, trial: Trial, h: float, history: list[float], gain: Array) -> str:
    """energy: interface energy below budget, every row at rounding; rounding floor: rows stopped shrinking.

    Rows of stiff members that hardly act stop at what a relative change of xi by eps makes of them.
    """
    xi, r = np.abs(trial.xi), np.abs(trial.r)
    energy = h * float(xi @ r)
    through = h * float(np.abs(joined.inputs(trial.xi)) @ np.abs(trial.y))
    in_play = max(float(np.abs(joined.energies()).sum()), through)
    stalled = len(history) > 2 and history[-1] > SHRINKING * history[-2]
    if stalled and (r <= FLOOR * np.finfo(float).eps * (gain @ xi)).all():
        return "rounding floor"
    if energy > ENERGY * in_play and not (stalled and energy <= STALLED * ENERGY * in_play):
        return ""
    if history[-1] <= ROUNDING:
        return "energy"
    if stalled and history[-1] <= STAGNATION:
        return "rounding floor"
    return "rounding floor" if energy <= ENERGY * in_play and stalls(history) >= STALLS else ""


def stalls(history: list[float]) -> int:
    """How often the scaled residual hardly shrank, after the first two trials; halving is what rounding in members can do."""
    return sum(new > STALLING * old for old, new in pairwise(history[1:]))


def failed(
    status: Status, joined: Joined, step: Step, trial: Trial, history: list[float], how: str = NEWTON
) -> Unconverged:
    """The error of an iteration whose last trial is this one."""
    scaled = np.nan_to_num(trial.scaled(joined), nan=np.inf)
    worst = int(np.argmax(scaled))
    found = Worst(joined.face.names[worst], float(trial.xi[worst]), float(abs(trial.r[worst])))
    return failure(status, joined, step, found, history, how)


def failure(
    status: Status, joined: Joined, step: Step, worst: Worst, history: list[float], how: str = NEWTON
) -> Unconverged:
    """The error of an interface iteration; history: largest scaled residual of each trial."""
    last = ", ".join(f"{v:.3g}" for v in history[-3:])
    return Unconverged(
        status, joined.network.name, step.t, step.h,
        equation=f"junction row of {worst.name} = {worst.value:.6g}",
        residual=worst.residual, iterations=len(history),
        tried=f"{how} (last scaled residuals {last}); all members are back at t", joined=True, history=history,
        composable=joined.network.composable,
    )  # fmt: skip
