"""The solves of a step in Python: attempts, halving, the ledger of each part, the new state; twin of runtime/{step,ledger}.c."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from phfmu.discretise.model import Model
from phfmu.engine.reference import rest
from phfmu.engine.reference.attempts import Attempts
from phfmu.engine.reference.chain import Tangents, step_along
from phfmu.engine.reference.evaluate import Array, Evaluator, carried, inputs_at
from phfmu.engine.reference.newton import Outcome, StepNewton
from phfmu.engine.reference.sensitivity import derivative
from phfmu.engine.reference.state import State
from phfmu.outcome.limits import LIMITS
from phfmu.outcome.status import Status, StepFailure, attempts

DEPTH = int(LIMITS["DEPTH"])


class Solves:
    """Takes a state over a communication step, in as many solves as it needs."""

    def __init__(self, model: Model):
        self.model = model
        self._step = Evaluator(model.step)
        self._newton = StepNewton(self._step)
        self._begun = self._most = 0.0  # of the iterations: at the start of the internal step, at most in all

    def take(self, s: State, t: float, h: float, parts: int) -> tuple[Array, Array, Array]:
        """`parts` equal internal steps over [t, t + h]: means of the pair outputs and of the algebraic variables, node outputs.

        StepFailure leaves the state half-way.
        """
        plan = self.model.step
        y, a, nodes_y = np.zeros(plan.nq), np.zeros(plan.na), np.zeros((plan.k, plan.nq))
        self._most = s.counts["iterations"] + LIMITS["MOST_ITERATIONS"] + parts * LIMITS["MORE_ITERATIONS"]
        for i in range(parts):
            self._begun = s.counts["iterations"]
            pieces = self._advance(s, t, h, i / parts, 1.0 / parts, 0)
            s.halved += len(pieces) > 1
            for y_part, a_part, start, weight in pieces:
                y += weight * (plan.weights @ y_part)
                a += weight * a_part
                nodes_y += self._projected(y_part, start, weight)
        return y, a, nodes_y

    def _advance(
        self, s: State, t: float, h: float, start: float, part: float, depth: int
    ) -> list[tuple[Array, Array, float, float]]:
        """The part [start, start + part] of the step [t, t + h]: (node outputs, mean algebraics, start, part) per solve."""
        s.x[-1] = t + h * start
        u = inputs_at(self.model, s.u, start + part * self.model.nodes)
        outcome = self._solve(s, h * part, u)
        energies = self._weigh(s, outcome, h * part, u) if outcome.status is Status.OK else {}
        if outcome.status is Status.OK:
            s.path.append((start, part, t + h * start, h * part))
            return [(*self._accept(s, outcome, h * part, energies), start, part)]
        spent = int(s.counts["iterations"] - self._begun)
        if depth == DEPTH or self._left(s) <= 0:
            name = self.model.row_names[outcome.row] if outcome.row >= 0 else ""
            raise StepFailure(
                outcome.status, self.model.name, t + h * start, h * part, equation=name, residual=outcome.residual,
                floor=outcome.floor, update=outcome.update, iterations=outcome.iterations, spent=spent,
                tried=attempts(h * part, spent),
            )  # fmt: skip
        s.counts["substeps"] += 1
        first = self._advance(s, t, h, start, part / 2, depth + 1)
        return first + self._advance(s, t, h, start + part / 2, part / 2, depth + 1)

    def _left(self, s: State) -> int:
        """Newton iterations the present internal step may still take."""
        most = min(self._begun + LIMITS["MOST_ITERATIONS"], self._most)
        return int(most) - s.counts["iterations"]

    def _solve(self, s: State, h: float, u: Array) -> Outcome:
        """Unknowns of a step of length h; constraints at rest that turn out not to be redundant come back."""
        evaluator = self._step
        evaluator.rests = s.rests.copy()
        s.counts["solves"] += 1
        while True:
            outcome = self._attempted(s, h, u)
            called = rest.called(evaluator)
            if outcome.status is not Status.OK or not called.any():
                break
            evaluator.rests &= ~called
        if outcome.status is Status.OK:
            s.counts["woken"] += int(np.sum(s.rests & ~evaluator.rests))
            s.change_rest(evaluator.rests, s.x[-1] + h)
        return outcome

    def _attempted(self, s: State, h: float, u: Array) -> Outcome:
        x = carried(self.model, s)
        attempts = Attempts(
            self._newton, s.w, s.h_last, lambda length: (x, np.append(u, length), s.p, length), self._left(s)
        )
        outcome = attempts.solve(h)
        for name in ("iterations", "restarts", "line_searches"):
            s.counts[name] += getattr(attempts, name)
        return outcome

    def _weigh(self, s: State, outcome: Outcome, h: float, u: Array) -> dict[str, Array]:
        """Energies and node outputs of a solved part; the outcome fails if they, or the sums they go into, overflow."""
        plan = self.model.step
        fixed = (carried(self.model, s), np.append(u, h), s.p, h)
        with np.errstate(over="ignore", invalid="ignore"):
            w = rest.evaluated(self._newton, s.rests, outcome.w, fixed)
            stored, moved, lost, numerical = self._step.ledger(fixed[0], s.p)
            y_nodes = self._step.R[plan.nw : plan.nw + plan.nq * plan.k].reshape(plan.k, plan.nq)
            u_nodes = self._step.Y[plan.pair_src].reshape(plan.k, plan.nq)
            pairs = h * plan.weights @ (y_nodes * u_nodes)
            np.add.at(pairs, plan.work_pair, self._step.R[plan.work_row])
            part = {"stored": stored, "dissipated": h * lost, "numerical": numerical, "moved": moved, "pairs": pairs}
            part |= {"supplied": np.bincount(plan.pair_owner, pairs, plan.ncomp), "y": y_nodes.copy(), "w": w}
            sums = (s.x[:-1], s.energy, s.supplied, s.dissipated, s.residual, *part.values())
            if not all((np.abs(v) <= LIMITS["LARGEST"]).all() for v in sums):
                outcome.status, outcome.row = Status.NOT_FINITE, -1
        return part

    def _accept(self, s: State, outcome: Outcome, h: float, part: dict[str, Array]) -> tuple[Array, Array]:
        """Book the ledger at the converged unknowns and move the state; node outputs and mean algebraic variables."""
        plan = self.model.step
        for name, row in s.last.items():
            row += part[name]
        s.w, s.h_last = outcome.w.copy(), h
        change = np.bincount(plan.update_x, plan.update_c * outcome.w[plan.update_w], plan.nx) + s.carry
        total = s.x[:-1] + change
        s.carry = change - (total - s.x[:-1])
        s.x[:-1] = total
        a = np.bincount(plan.mean_a, plan.mean_c * h**plan.mean_pow * self._step.Y[plan.mean_w], plan.na)
        if plan.carries:
            s.a = a
        if s.rests.any():
            self._exchange(s, h)
        return part["y"], a

    def _exchange(self, s: State, h: float) -> None:
        """Another constraint rests where one has lost its share."""
        found = rest.exchange(self._newton, s.w, h)
        if found is not None:
            s.change_rest(found, s.x[-1] + h)
            s.counts["exchanged"] += 1

    def _projected(self, y: Array, start: float, part: float) -> Array:
        """Outputs y (k x nq) at the nodes of a part of the step, as outputs at the nodes of the whole step.

        y_i = part sum_m (b_m / b_i) l_i(start + part c_m) y_m is conjugate to inputs u(t) = sum_i l_i(t) u_i.
        """
        plan = self.model.step
        if part == 1.0 or plan.k == 1:
            return part * y
        basis = np.array([self.model.scheme.nodes.value(start + part * float(c)) for c in self.model.nodes])
        return part * (basis * plan.weights[:, None] / plan.weights).T @ y

    def along(self, s: State, du: Array, dx: Array) -> tuple[Array, Array] | None:
        """Directional derivatives of the last step, see `step_along`; None where it has none."""
        if not s.path or s.halved > LIMITS["KEPT_HALVED"]:
            return None
        return step_along(
            self._tangents,
            self._newton,
            s,
            lambda start, part: inputs_at(self.model, s.u_old, start + part * self.model.nodes),
            du,
            dx,
        )

    @cached_property
    def _tangents(self) -> Tangents:
        return Tangents(self._step)

    def sensitivity(self, s: State) -> Array | None:
        """d(mean external outputs)/d(held inputs) of the last step (nu x nu); None where it has none."""
        plan = self.model.step
        if len(s.path) == 1:
            return derivative(self._newton, s.rests, s.w, (s.x_old, np.append(s.u_old, s.h_last), s.p, s.h_last))
        du = np.repeat(np.eye(plan.nu)[:, None, :], plan.k, axis=1)
        found = self.along(s, du, np.zeros((plan.nu, len(s.x_old))))
        return None if found is None else np.einsum("k,jki->ij", plan.weights, found[0])
