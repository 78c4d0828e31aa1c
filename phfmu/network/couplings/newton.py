"""Newton coupling: an interface Newton iteration on the step maps of the members.

With Y(U) the step-conjugate outputs of a trial step, held inputs U = P xi + U_free, the junction rows of `Joined` are

    r(xi) = P^T Y(P xi + U_free) + C xi = 0,     dr/dxi = P^T G P + C,

with G = dY/dU of each member's step (implicit function theorem, or finite differences with rollback).  sym(G) > 0 makes
the matrix regular.  Whatever the iteration leaves is booked at the junctions: sum of h U^T Y over joined ports.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.network.couplings.acceptance import FLOOR, ITERATIONS, Progress
from phfmu.network.couplings.coupling import Solution, Step, Unconverged
from phfmu.network.interface.joined import Joined
from phfmu.network.interface.matrices import update
from phfmu.outcome.status import Status

Array = NDArray[Any]

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

    order, repeats, closes = 2, True, True

    def solve(self, joined: Joined, last: Solution, step: Step) -> Solution:
        """StepFailure (no convergence, singular, not finite) names the worst junction row."""
        xi, matrix, progress = last.xi.copy(), None, Progress(held=True)
        best = np.inf, xi
        for i in range(ITERATIONS):
            if i > 0:
                joined.restore(step.states)
            trial = trial_of(joined, xi, step)
            if not np.isfinite(trial.r).all():
                raise failed(Status.NOT_FINITE, joined, step, trial, progress.history)
            progress.note(float(np.max(trial.scaled(joined), initial=0.0)))
            best = min(best, (progress.history[-1], xi), key=itemgetter(0))
            told = energies(joined, trial, step.h) if progress.decides else (np.inf, 0.0)
            if accepted_by := progress.accepted(partial(_at_floor, trial, matrix), *told):
                return Solution(xi, trial.y, i + 1, accepted_by)
            G = [m.sensitivity(step.t, step.h, s) for m, s in zip(joined.members, step.states, strict=True)]
            matrix, progress.matrices = joined.matrix(G), progress.matrices + 1
            try:
                xi = xi + update(matrix, trial.r)
            except np.linalg.LinAlgError:
                raise failed(Status.SINGULAR, joined, step, trial, progress.history) from None
            if not np.isfinite(xi).all():
                raise failed(Status.NOT_FINITE, joined, step, trial, progress.history)
        joined.restore(step.states)
        kept = trial_of(joined, best[1], step)
        given_up = failed(Status.NO_CONVERGENCE, joined, step, trial, progress.history)
        raise given_up.of(Solution(kept.xi, kept.y, ITERATIONS))


def trial_of(joined: Joined, xi: Array, step: Step) -> Trial:
    """One step of all members under xi, from where they are."""
    y = joined.trial(xi, step.t, step.h)
    return Trial(xi, y, joined.rows(xi, y))


def energies(joined: Joined, trial: Trial, h: float) -> tuple[float, float]:
    """Energy that the rows leave, and energy in play [J]."""
    left = h * float(np.abs(trial.xi) @ np.abs(trial.r))
    through = h * float(np.abs(joined.inputs(trial.xi)) @ np.abs(trial.y))
    return left, max(float(np.abs(joined.energies()).sum()), through)


def _at_floor(trial: Trial, matrix: Any) -> bool:
    """Whether rows are what a relative change of the unknowns by eps makes of them."""
    size = abs(matrix) @ np.abs(trial.xi)
    return bool((np.abs(trial.r) <= FLOOR * np.finfo(float).eps * size).all())


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
