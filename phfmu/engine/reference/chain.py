"""Directional derivatives of a step: the linearisations of its internal steps and substeps, chained through the states.

With R(x, w, u) = 0, outputs y(x, w, u) and x+ = x + U w of one of them, X the direction of its old states and V that of
its inputs,

    dw = -A^-1 (R_x X + R_u V),   dy = y_x X + y_w dw + y_u V,   X+ = X + U dw.

Inputs u_i at the nodes c_i of the communication step reach a part [s, s + l] of it by their polynomial, its outputs go back by
the adjoint, so that h sum_i b_i u_i . y_i is the energy supplied, whatever the parts:

    u_m = sum_i l_i(s + l c_m) u_i,   y_i = l sum_m (b_m / b_i) l_i(s + l c_m) y_m.

Several parts are solved again, from the state and the unknowns at the start of the step; the readable twin of runtime/chain.c.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.reference.attempts import Attempts
from phfmu.engine.reference.evaluate import TABLES, Evaluator, Stage
from phfmu.engine.reference.newton import Fixed, StepNewton
from phfmu.engine.reference.state import State
from phfmu.outcome.limits import LIMITS
from phfmu.outcome.status import Status
from phfmu.plan.planner import derivative_slots
from phfmu.plan.tangent import differentiated, tangent

if TYPE_CHECKING:
    from scipy.sparse import csc_array

Array = NDArray[np.float64]


class Tangents:
    """Directional derivatives of all rows of a plan at the point its evaluator has seen last."""

    def __init__(self, evaluator: Evaluator):
        self.evaluator = evaluator
        plan, chosen = evaluator.plan, {id(k) for k in differentiated(evaluator.plan)}
        self._groups = [[g for g in plan.groups if g.stage == stage and id(g.kernel) in chosen] for stage in (0, 1)]
        self._stages = [Stage(gs, [tangent(g.kernel) for g in gs], (*TABLES, "xi", "yi")) for gs in self._groups]

    def along(self, x: Array, p: Array, h: float, dx: Array, dv: Array) -> Array:
        """dR along dx and dv = [dw | du | dh]; rows at rest are 0."""
        evaluator, plan = self.evaluator, self.evaluator.plan
        dy = np.concatenate([dv, np.zeros(plan.nz)])
        dy[plan.nv :] += self._stages[0].sums(h, plan.nz, x, evaluator.Y, p, dx, dy)
        constant = plan.const_val * h**plan.const_pow * dy[plan.const_src]
        r: Array = np.bincount(plan.const_row, constant, plan.nrow).astype(float)
        r += self._stages[1].sums(h, plan.nrow, x, evaluator.Y, p, dx, dy)
        r[plan.hold.of(evaluator.rests)] = 0.0
        return r

    def by_states(self, x: Array, p: Array, h: float) -> csc_array:
        """dF/dx of the residual by the old states (nw x nx), those of kernels taken one after another.

        Through Z of stage 0 it is the product R_x + R_Z Z_x, R_Z being what the kernels of stage 1 have put into V.
        """
        from scipy.sparse import coo_array, csc_array

        evaluator, plan = self.evaluator, self.evaluator.plan
        by_x = []
        for stage, groups, size in zip(self._stages, self._groups, (plan.nz, plan.nrow), strict=True):
            found = [(np.zeros(0), np.zeros(0, np.int32), np.zeros(0, np.int32))]
            stage.take(x, evaluator.Y, p, np.zeros_like(x), np.zeros_like(evaluator.Y))
            for g, kernel in zip(groups, stage.kernels, strict=True):
                direction, out = kernel.arg[3], kernel.res[0]
                for j in range(g.xi.shape[1]):
                    direction[:] = np.arange(direction.shape[1]) == j
                    kernel.call()
                    column = np.broadcast_to(g.xi[:, j : j + 1], g.oi.shape)
                    found.append(((out * h ** g.power.astype(float)).ravel(), g.oi.ravel(), column.ravel()))
            values, rows, columns = (np.concatenate(parts) for parts in zip(*found, strict=True))
            by_x.append(csc_array(coo_array((values, (rows, columns)), shape=(size, plan.nx + 1))))
        constant = plan.const_row, plan.const_src, np.zeros_like(plan.const_row), plan.const_pow  # V[0] = 1
        both = zip(derivative_slots(plan.groups, 1), constant, strict=True)
        row, column, slot, power = (np.concatenate(parts) for parts in both)
        values = evaluator.V[slot] * h ** power.astype(float)
        values[len(values) - len(plan.const_val) :] *= plan.const_val
        via = column >= plan.nv
        R_z = coo_array((values[via], (row[via], column[via] - plan.nv)), shape=(plan.nrow, plan.nz))
        whole = csc_array(by_x[1] + csc_array(R_z) @ by_x[0])
        return csc_array(whole[: plan.nw, : plan.nx])

    def follow(self, newton: StepNewton, x: Array, p: Array, h: float, dx: Array, dv: Array) -> Array:
        """dR along dx and the inputs of dv, with the unknowns, which go into dv, following."""
        nw = newton.plan.nw
        if nw:
            dv[:nw] = newton.refined(self.along(x, p, h, dx, dv)[:nw], h)
        return self.along(x, p, h, dx, dv)


def step_along(
    tangents: Tangents, newton: StepNewton, s: State, inputs: Callable[[float, float], Array], du: Array, dx: Array
) -> tuple[Array, Array] | None:
    """Changes of the outputs at the nodes (n x k x nu) and of the states at the end along n directions of the last step.

    `du` (n x k x nu): of its node inputs;  `dx` (n x len(x)): of the states at its start.  `inputs`: those of the step at the
    nodes of its part [start, start + length].  None if a part cannot be solved again.
    """
    plan, k, nu = newton.plan, newton.plan.k, newton.plan.nu
    newton.evaluator.rests = s.rests.copy()
    x, w, h_last = s.x_old.copy(), s.w if len(s.path) == 1 else s.w_old, s.h_old
    dx, dy = dx.copy(), np.zeros(du.shape)
    for start, part, time, h in s.path:
        x[plan.nx] = time
        u = inputs(start, part)

        def fixed(length: float, u: Array = u) -> Fixed:
            return x, np.append(u, length), s.p, length

        if len(s.path) > 1:
            outcome = Attempts(newton, w, h_last, fixed, int(LIMITS["MOST_ITERATIONS"])).solve(h)
            if outcome.status is not Status.OK:
                return None
            w, h_last = outcome.w, h
        newton.residual(w, fixed(h))
        if plan.nw and not newton.factor(h):
            return None
        basis = _basis(plan.nodes, start + part * plan.nodes)
        back = part * (basis * plan.weights[:, None] / plan.weights).T
        for j in range(len(du)):
            dv = np.zeros(plan.nv)
            dv[plan.nw : plan.nw + k * nu] = (basis @ du[j]).ravel()
            r = tangents.follow(newton, x, s.p, h, dx[j], dv)
            dy[j] += back @ r[plan.nw : plan.nw + plan.nq * k].reshape(k, -1)[:, :nu]
            _advance(newton, dx[j], dv[: plan.nw], h)
        _advance(newton, x, w, h)
    return dy, dx


def end_along(tangents: Tangents, newton: StepNewton, w: Array, fixed: Fixed, du: Array, dx: Array) -> Array:
    """Changes of the outputs at one instant (n x nu) along n directions of its inputs (n x nu) and states, at its solution w."""
    plan, (x, _, p, h) = newton.plan, fixed
    newton.residual(w, fixed)
    dy = np.zeros(du.shape)
    if plan.nw:
        newton.factor(h)
    for j in range(len(du)):
        dv = np.zeros(plan.nv)
        dv[plan.nw : plan.nw + plan.nu] = du[j]
        dy[j] = tangents.follow(newton, x, p, h, dx[j], dv)[plan.nw : plan.nw + plan.nu]
    return dy


def _basis(nodes: Array, at: Array) -> Array:
    """Lagrange polynomials of the nodes at some places (places x k)."""
    k = len(nodes)
    out = np.ones((len(at), k))
    for i in range(k):
        for m in range(k):
            if m != i:
                out[:, i] *= (at - nodes[m]) / (nodes[i] - nodes[m])
    return out


def _advance(newton: StepNewton, x: Array, w: Array, h: float) -> None:
    """x, or a direction of it, to the end of an internal step."""
    plan = newton.plan
    np.add.at(x, plan.update_x, plan.update_c * w[plan.update_w])
    if plan.carries:
        x[plan.nx + 1 :] = np.bincount(plan.mean_a, plan.mean_c * h**plan.mean_pow * w[plan.mean_w], plan.na)
