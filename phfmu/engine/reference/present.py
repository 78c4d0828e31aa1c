"""Values at the present time in Python: the solution of the instant system, kept until something changes."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from phfmu.discretise.model import Model
from phfmu.engine.reference import rest, rest_start
from phfmu.engine.reference.chain import Tangents, end_along
from phfmu.engine.reference.evaluate import Array, Evaluator, inputs_at
from phfmu.engine.reference.newton import Fixed, Outcome, StepNewton
from phfmu.engine.reference.sensitivity import derivative
from phfmu.engine.reference.state import State
from phfmu.outcome.status import Status, StepFailure


class PresentValues:
    """Algebraic variables, outputs, observables and energies of a state."""

    def __init__(self, model: Model):
        self.model = model
        self._newton = StepNewton(Evaluator(model.instant))

    def values(self, s: State) -> dict[str, Array]:
        """w, a, y, o, H; StepFailure where the instant system has no solution."""
        if s.end is None:
            s.end = self._solved(s)
        return s.end

    def _solved(self, s: State) -> dict[str, Array]:
        newton, plan = self._newton, self.model.instant
        self.choose_rests(s)
        newton.evaluator.rests = s.rests.copy()
        w, fixed = self._start(s)
        if plan.nw:
            outcome = self._attempted(w, fixed)
            if outcome.status is not Status.OK:
                name = self.model.instant_names[outcome.row] if outcome.row >= 0 else ""
                raise StepFailure(outcome.status, self.model.name, s.t, 0.0, equation=name,
                                  residual=outcome.residual, iterations=outcome.iterations)  # fmt: skip
            w = outcome.w
        a, r = rest.evaluated(newton, s.rests, w, fixed), newton.evaluator.R
        stored, *_ = newton.evaluator.ledger(s.x, s.p)
        if not np.isfinite(np.concatenate([r, stored])).all():
            raise StepFailure(Status.NOT_FINITE, self.model.name, s.t, 0.0)
        return {
            "w": w, "a": a[plan.mean_w], "y": r[plan.nw : plan.nw + plan.nq].copy(),
            "o": r[plan.nw + plan.nq :].copy(), "H": stored,
        }  # fmt: skip

    def _start(self, s: State) -> tuple[Array, Fixed]:
        """The start of the instant system, and its fixed values."""
        plan = self.model.instant
        w = np.zeros(plan.nw)
        w[plan.mean_w] = s.a[plan.mean_a]
        return w, self._fixed(s)

    def _fixed(self, s: State) -> Fixed:
        return s.x, np.append(inputs_at(self.model, s.u, np.array([s.theta])), 1.0), s.p, 1.0

    def choose_rests(self, s: State) -> None:
        """Choice of the constraints that rest at a state or with parameters that were set."""
        if s.placed and len(self.model.instant.hold):
            s.change_rest(rest_start.chosen(self._newton, *self._start(s)), s.x[-1])
        s.placed = False

    def _attempted(self, w: Array, fixed: Fixed) -> Outcome:
        """The solution of the instant system from w, with line search where it takes one."""
        outcome = Outcome(Status.NO_CONVERGENCE, w)
        for damped in (False, True):
            for bare, free in self._newton.ways:
                self._newton.bare = bare
                outcome = self._newton.attempt(self._newton.free(w) if free else w, fixed, damped)
                if outcome.status is Status.OK:
                    return outcome
        return outcome

    @cached_property
    def _tangents(self) -> Tangents:
        return Tangents(self._newton.evaluator)

    def along(self, s: State, du: Array, dx: Array) -> Array:
        """Changes of the external outputs at the end of a step (n x nu) along du (n x k x nu) and dx, those of the states."""
        w = self.values(s)["w"]
        self._newton.evaluator.rests = s.rests.copy()
        last = np.array([self.model.scheme.nodes.value(1.0)])
        return end_along(self._tangents, self._newton, w, self._fixed(s), (last @ du)[:, 0], dx)

    def sensitivity(self, s: State) -> Array:
        """d(external outputs)/d(inputs) at the present time (nu x nu)."""
        return derivative(self._newton, s.rests, self.values(s)["w"], self._fixed(s))
