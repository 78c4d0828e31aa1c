"""The attempts at one step: where Newton's method starts, and with what safeguards; the twin of runtime/attempts.c."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from phfmu.engine.reference.newton import Array, Fixed, Outcome, StepNewton
from phfmu.outcome.limits import LIMITS
from phfmu.outcome.status import Status


@dataclass
class Attempts:
    """Attempts at one step, from the unknowns `last` of the step h_last before (0: none).

    `fixed`: what is fixed in a step of given length;  `most`: iterations after which no attempt begins;  after `solve`,
    `iterations` spent, and whether it took a restart or a line search.
    """

    newton: StepNewton
    last: Array
    h_last: float
    fixed: Callable[[float], Fixed]
    most: int
    iterations: int = 0
    restarts: int = 0
    line_searches: int = 0
    outcome: Outcome = field(init=False)

    def solve(self, h: float) -> Outcome:
        """Solve from the last step, from rest, from shorter steps, then from the first two with line search."""
        starts = [True] if self.h_last == 0 else [False, True]
        self.outcome = outcome = Outcome(Status.NO_CONVERGENCE, self.last)
        for damped in (False, True):
            for rest in starts:
                outcome = self._attempt(h, rest, damped)
                if outcome.status is Status.OK:
                    self.restarts, self.line_searches = int(rest and len(starts) == 2), int(damped)
                    return outcome
            if not damped:
                outcome = self._grow(h)
                if outcome.status is Status.OK:
                    self.restarts = 1
                    return outcome
        return outcome

    def _grow(self, h: float) -> Outcome:
        """Solve from the solution of a shorter step, h/2, h/4 or h/8, by doubling.

        It stays on the branch that starts at h = 0, and it enters the small region of convergence where a light mass
        moves fast on the curve that stiff springs and bars leave it.
        """
        part, outcome = 1.0, Outcome(Status.NO_CONVERGENCE, self.last)
        while outcome.status is not Status.OK and part > LIMITS["SHORTEST"]:
            part /= 2
            outcome = self._attempt(part * h, self.h_last == 0)
        while outcome.status is Status.OK and part < 1.0:
            part *= 2
            outcome = self._newton(self._scaled(outcome.w, 2.0), part * h)
        return outcome

    def _attempt(self, h: float, rest: bool, damped: bool = False) -> Outcome:
        """Solve from the last step or from rest; where there were enough iterations, return the last attempt's failure."""
        for bare, free in self.newton.ways:
            self.newton.bare = bare
            if self.iterations >= self.most:
                return replace(self.outcome, status=Status.NO_CONVERGENCE)
            start = self._start(h, rest)
            if self._newton(self.newton.free(start) if free else start, h, damped).status is Status.OK:
                break
        return self.outcome

    def _newton(self, w: Array, h: float, damped: bool = False) -> Outcome:
        self.outcome = self.newton.attempt(w, self.fixed(h), damped)
        self.iterations += self.outcome.iterations
        return self.outcome

    def _start(self, h: float, rest: bool) -> Array:
        """Increments zero and algebraic values as they were, or the last step carried over to the step size h."""
        if rest:
            return np.where(self.newton.plan.increments == 1, 0.0, self.last)
        return self._scaled(self.last, h / self.h_last)

    def _scaled(self, w: Array, ratio: float) -> Array:
        """The solution w of a step as a guess for one `ratio` times as long."""
        plan = self.newton.plan
        return np.add.reduceat(plan.guess_val * ratio**plan.guess_pow * w[plan.guess_idx], plan.guess_ptr[:-1])
