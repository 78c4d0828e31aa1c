"""Newton's method of a plan in Python: the readable twin of runtime/newton.c, with the same attempts and tests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.evaluate import Evaluator
from phfmu.engine.status import Status

Array = NDArray[np.float64]

TOLERANCE = 1e-9  # scaled update after which one polish reaches round-off
FLOOR = 1e-6  # an update below this that no longer shrinks is the rounding floor
ITERATIONS = 30
DELTA = 1e-10  # on multiplier diagonals of the factor only: minimum-norm multipliers for redundant rows
SMALLEST = 1.0 / 64.0  # line search


@dataclass
class Outcome:
    """Result of one attempt: status, unknowns, iterations, worst scaled residual and its row, last update norm."""

    status: Status
    w: Array
    iterations: int = 0
    residual: float = 0.0
    row: int = -1
    update: float = 0.0


class Newton:
    """Solves R[0:nw](w) = 0 for one plan."""

    def __init__(self, evaluator: Evaluator):
        self.evaluator = evaluator
        self.plan = evaluator.plan
        self._lu = None
        self._scale = np.ones(self.plan.nw)

    def residual(self, w: Array, fixed: tuple[Array, Array, Array, float]) -> Array:
        """Rows [0, nw) at w; `fixed` = (x, [u | h], p, h)."""
        x, tail, p, h = fixed
        return self.evaluator.residual(x, np.concatenate([w, tail]), p, h)[: self.plan.nw]

    def factor(self, h: float) -> bool:
        """Factor the row-scaled matrix at the current slots; False if singular."""
        from scipy.sparse import csc_matrix
        from scipy.sparse.linalg import splu

        plan = self.plan
        a = self.evaluator.products(plan.matrix, h)
        biggest = np.zeros(plan.nw)
        np.maximum.at(biggest, plan.matrix.row, np.abs(a))
        if not np.isfinite(biggest).all():
            return False
        self._scale = 1.0 / np.where(biggest > 0, biggest, 1.0)
        a = a * self._scale[plan.matrix.row]
        a[plan.regularised] += DELTA
        try:
            self._lu = splu(csc_matrix((a, plan.matrix.row, plan.colptr), shape=(plan.nw, plan.nw)))
        except RuntimeError:
            return False
        return True

    def solve(self, r: Array) -> Array:
        """The Newton correction -A^-1 r with the last factor."""
        assert self._lu is not None
        return -self._lu.solve(self._scale * r)

    def attempt(self, w: Array, fixed: tuple[Array, Array, Array, float], damped: bool) -> Outcome:
        """Iterate from w until rounding, then polish once with the old factor."""
        plan, h = self.plan, fixed[3]
        w, last = w.copy(), np.inf
        out = Outcome(Status.NO_CONVERGENCE, w)
        r = self.residual(w, fixed)
        for i in range(ITERATIONS):
            out.iterations = i + 1
            if not np.isfinite(r).all():
                return self._failed(out, Status.NOT_FINITE, r)
            if not self.factor(h):
                return self._failed(out, Status.SINGULAR, r)
            dw = self.solve(r)
            if not np.isfinite(dw).all():
                return self._failed(out, Status.NOT_FINITE, r)
            found = self._searched(w, dw, r, fixed) if damped else (w + dw, None, dw)
            if found is None:
                return self._failed(out, Status.NO_CONVERGENCE, r)
            w, r, dw = found
            out.w, out.update = w, float(np.max(np.abs(dw) / (plan.nominal + np.abs(w)), initial=0.0))
            if r is None:
                r = self.residual(w, fixed)
            if out.update <= TOLERANCE or (out.update <= FLOOR and out.update > 0.5 * last):
                if not np.isfinite(r).all():
                    return self._failed(out, Status.NOT_FINITE, r)
                out.w = w + self.solve(r)
                out.status = Status.OK
                return out
            last = out.update
        return self._failed(out, Status.NO_CONVERGENCE, r)

    def _searched(self, w: Array, dw: Array, r: Array, fixed: tuple) -> tuple[Array, Array | None, Array] | None:
        """The longest of the steps 1, 1/2, .. 1/64 that reduces the scaled residual; None if none does."""
        base = np.linalg.norm(self._scale * r)
        step = 1.0
        while step >= SMALLEST:
            trial = w + step * dw
            r_trial = self.residual(trial, fixed).copy()
            size = np.linalg.norm(self._scale * r_trial)
            if size < base:
                return trial, r_trial, step * dw
            step /= 2
        return None

    def _failed(self, out: Outcome, status: Status, r: Array) -> Outcome:
        scaled = np.abs(self._scale * r)
        out.status = status
        out.row = int(np.argmax(np.where(np.isfinite(scaled), scaled, np.inf))) if scaled.size else -1
        out.residual = float(scaled[out.row]) if scaled.size else 0.0
        return out
