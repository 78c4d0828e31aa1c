"""Anderson coupling: interface fixed point with least-squares acceleration (IQN-ILS), for members without sensitivities.

With the junction rows r(xi) of held inputs, f(xi) = -M^-1 r(xi) is the residual of the fixed point xi + f. From differences X of
earlier xi and F of f, of this step and of the steps before,

    xi <- xi + f - (X + F) c,     c = argmin |S (f - F c)|.

M = C where junctions join an output to each input, which makes the fixed point that of Jacobi's iteration; where they do not
(rigid links, bare nodes), M is the matrix of a Newton step, taken once. S scales each unknown by its size.

Source: Degroote, Bathe, Vierendeels, Comput. Struct. 87 (2009) 793; columns whose new share is rounding are dropped.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.network.couplings.acceptance import RULES, Progress
from phfmu.network.couplings.coupling import Solution, Step
from phfmu.network.couplings.newton import energies, failed, trial_of
from phfmu.network.interface.hidden import hidden_part
from phfmu.network.interface.joined import Joined
from phfmu.network.interface.matrices import assembled, update
from phfmu.outcome.limits import defined
from phfmu.outcome.status import Status

Array = NDArray[Any]

_NUMBERS = defined(RULES.parent / "anderson.h")

#: differences kept;  part of f that is taken while there are none and M is C;  part of a column that is rounding
WINDOW, FIRST, DROPPED = int(_NUMBERS["ANDERSON_WINDOW"]), _NUMBERS["ANDERSON_FIRST"], _NUMBERS["ANDERSON_DROPPED"]
ITERATIONS = int(_NUMBERS["ANDERSON_ITERATIONS"])
HOW = "interface iteration with Anderson's acceleration"


@dataclass(frozen=True)
class Memory:
    """Differences X, F (n x columns, newest first), sizes of the unknowns (n), M and whether it is C."""

    X: Array
    F: Array
    size: Array
    M: Any
    plain: bool

    def with_pair(self, x: Array, f: Array) -> Memory:
        """One more difference of xi and of its f."""
        most = min(WINDOW, len(x))
        X, F = (np.column_stack([new, old])[:, :most] for new, old in ((x, self.X), (f, self.F)))
        return replace(self, X=X, F=F)

    def moved(self, xi: Array, f: Array) -> Array:
        """The next xi."""
        F = self.F / self.size[:, None]
        kept: list[int] = []
        for j in range(F.shape[1]):
            R = np.asarray(np.linalg.qr(F[:, [*kept, j]], mode="r"))
            if abs(R[-1, -1]) > DROPPED * np.linalg.norm(F[:, j]):
                kept.append(j)
        if not kept:
            return xi + (FIRST if self.plain else 1.0) * f
        c = np.linalg.lstsq(F[:, kept], f / self.size, rcond=None)[0]
        return xi + f - (self.X + self.F)[:, kept] @ c


@dataclass(frozen=True)
class Remembered(Solution):
    """A solution with what the next step may use."""

    memory: Memory | None = None


class Anderson:
    """One value per junction unknown and step, held, as with `Newton`; members need no sensitivities."""

    order, repeats, closes = 2, True, True

    def solve(self, joined: Joined, last: Solution, step: Step) -> Solution:
        """StepFailure (no convergence, singular, not finite) names the worst junction row."""
        xi, progress = last.xi, Progress(held=True)
        memory = last.memory if isinstance(last, Remembered) else None
        best, before = (np.inf, xi), None
        for i in range(ITERATIONS):
            if i > 0:
                joined.restore(step.states)
            trial = trial_of(joined, xi, step)
            if not np.isfinite(trial.r).all():
                raise failed(Status.NOT_FINITE, joined, step, trial, progress.history, HOW)
            progress.note(float(np.max(trial.scaled(joined), initial=0.0)))
            best = min(best, (progress.history[-1], xi), key=itemgetter(0))
            if accepted_by := progress.accepted(_never, *energies(joined, trial, step.h)):
                return Remembered(xi, trial.y, i + 1, accepted_by, memory=memory)
            memory = _begun(joined, step) if memory is None else memory
            try:
                f = update(memory.M, trial.r)
            except np.linalg.LinAlgError:
                raise failed(Status.SINGULAR, joined, step, trial, progress.history, HOW) from None
            memory = replace(memory, size=np.maximum(memory.size, np.abs(xi)))
            if before is not None:
                memory = memory.with_pair(xi - before[0], f - before[1])
            before, xi = (xi, f), memory.moved(xi, f)
        joined.restore(step.states)
        kept = trial_of(joined, best[1], step)
        given_up = failed(Status.NO_CONVERGENCE, joined, step, kept, progress.history, HOW)
        raise given_up.of(Remembered(kept.xi, kept.y, ITERATIONS, memory=memory))


def _never() -> bool:
    """Without sensitivities it is not known what a change of the unknowns makes of a row."""
    return False


def _begun(joined: Joined, step: Step) -> Memory:
    """M, after the first trial of a run."""
    face = joined.face
    M = assembled(joined.C, ())
    plain = hidden_part(M, face.nominal).nnz == 0
    if not plain:
        parts = zip(joined.members, step.states, strict=True)
        M = joined.matrix([m.sensitivity(step.t, step.h, s) for m, s in parts])
    none = np.zeros((len(face.names), 0))
    return Memory(none, none, first_sizes(joined), M, plain)


def first_sizes(joined: Joined) -> Array:
    """Sizes of the unknowns before the first trial."""
    return np.maximum(1e-6 * joined.face.nominal, 1e-300)
