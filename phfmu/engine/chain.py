"""The sensitivity of a step of several internal steps: their linearisations, chained through the states.

For one internal step R(x, w, u) = 0 with outputs y(x, w, u) and x+ = x + U w,

    dw = -A^-1 (R_x X + R_u),   dy = y_x X + y_w dw + y_u,   X+ = X + U dw,   X = dx/du, zero at the start.

The internal steps are solved again from the state at the start of the step; the readable twin of runtime/chain.c.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.attempts import Attempts
from phfmu.engine.evaluate import Buffered, Evaluator
from phfmu.engine.limits import LIMITS
from phfmu.engine.newton import Newton
from phfmu.engine.state import State
from phfmu.engine.status import Status
from phfmu.plan.tangent import differentiated, tangent

Array = NDArray[np.float64]


class Tangents:
    """Directional derivatives of all rows of a plan at the point its evaluator has seen last."""

    def __init__(self, evaluator: Evaluator):
        self.evaluator = evaluator
        plan, chosen = evaluator.plan, {id(k) for k in differentiated(evaluator.plan)}
        self._work = []
        for g in plan.groups:
            k = g.kernel
            if id(k) in chosen:
                self._work.append((g, Buffered(tangent(k), g.n, [k.nx, k.ny, k.np, k.nx, k.ny], [k.no])))

    def along(self, x: Array, p: Array, h: float, dx: Array, dv: Array) -> Array:
        """dR along dx and dv = [dw | du | dh]; rows at rest are 0."""
        evaluator, plan = self.evaluator, self.evaluator.plan
        dy = np.concatenate([dv, np.zeros(plan.nz)])
        r = np.zeros(plan.nrow)
        for stage in (0, 1):
            for g, work in self._work:
                if g.stage != stage:
                    continue
                sources = ((x, g.xi), (evaluator.Y, g.yi), (p, g.pi), (dx, g.xi), (dy, g.yi))
                for array, (source, index) in zip(work.arg, sources, strict=True):
                    if index.size:
                        np.take(source, index, out=array)
                work.call()
                target = r if stage else dy[plan.nv :]
                np.add.at(target, g.oi.ravel(), (work.res[0] * h**g.power).ravel())
            if stage == 0:
                np.add.at(r, plan.const_row, plan.const_val * h**plan.const_pow * dy[plan.const_src])
        r[plan.hold.of(evaluator.rests)] = 0.0
        return r


def chained(newton: Newton, s: State, inputs: Callable[[float, float], Array]) -> Array | None:
    """d(mean external outputs)/d(held inputs) of the last step (nu x nu); None if a part cannot be solved again.

    `inputs`: those of the step at the nodes of its part [start, start + length].
    """
    plan, parts, h = newton.plan, s.parts, s.h_last
    nw, nu, nx = plan.nw, plan.nu, plan.nx
    tangents = Tangents(newton.evaluator)
    newton.evaluator.rests = s.rests.copy()
    x, w, h_last = s.x_old.copy(), s.w, s.h_last
    dx, total = np.zeros((nu, len(x))), np.zeros((nu, nu))
    for i in range(parts):
        x[nx] = s.x_old[nx] + i * h
        u = inputs(i / parts, 1 / parts)

        def fixed(length: float, u: Array = u) -> tuple[Array, Array, Array, float]:
            return x, np.append(u, length), s.p, length

        outcome = Attempts(newton, w, h_last, fixed, int(LIMITS["MOST_ITERATIONS"])).solve(h)
        if outcome.status is not Status.OK:
            return None
        w, h_last = outcome.w, h
        newton.residual(w, fixed(h))
        if nw and not newton.factor(h):
            return None
        for j in range(nu):
            dv = np.zeros(plan.nv)
            dv[nw : nw + nu * plan.k].reshape(plan.k, nu)[:, j] = 1.0
            r = tangents.along(x, s.p, h, dx[j], dv)
            dv[:nw] = newton.refined(r[:nw], h) if nw else 0.0
            r = tangents.along(x, s.p, h, dx[j], dv)
            total[:, j] += plan.weights @ r[nw : nw + plan.nq * plan.k].reshape(plan.k, -1)[:, :nu] / parts
            _advance(newton, dx[j], dv[:nw], h)
        _advance(newton, x, w, h)
    return total


def _advance(newton: Newton, x: Array, w: Array, h: float) -> None:
    """x, or a direction of it, to the end of an internal step."""
    plan = newton.plan
    np.add.at(x, plan.update_x, plan.update_c * w[plan.update_w])
    if plan.carries:
        x[plan.nx + 1 :] = np.bincount(plan.mean_a, plan.mean_c * h**plan.mean_pow * w[plan.mean_w], plan.na)
