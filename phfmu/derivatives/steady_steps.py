"""Steady state of a scheme, which an operating point of the equations is a power of the step away from.

Steps of a balanced network turn with it, Phi_h(X(a) x) = X(a) Phi_h(x), since its energies do.  So they have a steady state of
their own, which one step turns by w h and leaves as it is,

    F(x, q) = 0,     X(-w h) (x + U q) = x,     (S x0 + c) . (x - x0) = 0,

q being the unknowns of the step, x + U q its end, X the turn with the generator S x + c.  The inputs and parameters are those of
the point.  w is an unknown where no source sets it: with torques and field voltages given, the steps have a frequency of their
own; then the last equation says which of all turned states is meant.  One sparse Newton iteration from the operating point x0,
with F and its derivatives from the kernels and tables of the plan.
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import block_diag, bmat, coo_array, csc_array, eye_array

from phfmu.declare.variable import time
from phfmu.derivatives.tangents import require_derived
from phfmu.discretise.model import Model, build_model
from phfmu.engine.reference.chain import Tangents
from phfmu.engine.reference.evaluate import Evaluator
from phfmu.operating.newton import solution
from phfmu.operating.point import NetworkPoint
from phfmu.operating.system import NoOperatingPoint
from phfmu.schemes.scheme import Scheme
from phfmu.signals import of_member

Array = NDArray[np.float64]

#: of a state per step: states that steps leave where they are, at limits or in loops without resistance, stay by this
STAYS = 1e-7
#: iterations at most; an update relative to sizes is rounding; one that is no smaller than the last below this is, too
ITERATIONS, REST, FLOOR = 30, 1e-13, 1e-8


def steady_steps(point: NetworkPoint, scheme: Scheme, step: float) -> NetworkPoint:
    """The point, moved to where steps of length `step` [s] of the composed network under `scheme` stay: `states` and `omega`.

    Voltages and powers move by a power of the step with the states; they are told as they were.
    NoOperatingPoint where the iteration does not end: the step is too long, or the point is not steady.  ValueError for schemes
    that carry more than the states from step to step, and for redundant constraints.
    """
    model = build_model(point.started().compose(), scheme)
    require_derived(model)
    return _SteadyIteration(point, model, step).found()


class _SteadyIteration:
    """Newton's iteration for the steady state of steps of a scheme, from an operating point."""

    def __init__(self, point: NetworkPoint, model: Model, step: float):
        self.point, self.model, self.h = point, model, step
        d, plan = model.declaration, model.step
        self.names = [n for v in d.states for n in v.names()]
        nominal = np.abs(np.concatenate([np.zeros(0), *(np.atleast_1d(v.nominal) for v in d.states)]))
        self.size = np.maximum(np.abs(model.x0), np.where(nominal == 0, 1.0, nominal))
        self.free = not any(p.source is not None and ca.depends_on(ca.SX(p.source), time) for p in d.ports)
        self._U = coo_array((plan.update_c, (plan.update_x, plan.update_w)), shape=(plan.nx, plan.nw)).tocsc()
        self._evaluator = Evaluator(plan)
        self._tangents = Tangents(self._evaluator)
        at = {n: i for i, n in enumerate(self.names)}
        self._members = [
            (point._equations[name], [at[of_member(name, n)] for v in member.states for n in v.names()])
            for name, member in point.network.declared.items()
        ]

    def _generated(self, x: Array) -> Array:
        """S x + c."""
        found = np.zeros_like(x)
        for e, own in self._members:
            found[own] = e.S @ x[own] + e.c
        return found

    def _turn(self, angle: float) -> tuple[csc_array, Array]:
        """A and b of the turn A x + b by an angle [rad]."""
        blocks, order, b = [], [], np.zeros(len(self.names))
        for e, own in self._members:
            A, b[own] = e.turn(angle)
            blocks.append(A)
            order += own
        to = coo_array((np.ones(len(order)), (order, np.arange(len(order)))), shape=(len(order), len(order)))
        return csc_array(to @ block_diag(blocks, "csc") @ to.T), b

    def _at(self, x: Array, q: Array, u: Array, p: Array) -> tuple[Array, csc_array, csc_array]:
        """F and its derivatives by the unknowns and the states, of the step from t = 0."""
        plan, e, start = self.model.step, self._evaluator, np.append(x, 0.0)
        F = e.residual(start, np.concatenate([q, u, [self.h]]), p, self.h)[: plan.nw].copy()
        F_q = csc_array((e.matrix(self.h), plan.matrix.row, plan.colptr), shape=(plan.nw, plan.nw))
        return F, F_q, self._tangents.by_states(start, p, self.h)

    def _step(self, x: Array, u: Array, p: Array) -> Array:
        """Unknowns of the step from x, by Newton's method from a rest with the algebraic variables of the start."""
        plan = self.model.step
        q, size = np.zeros(plan.nw), np.where(plan.nominal == 0, 1.0, np.abs(plan.nominal))
        own = plan.mean_w < plan.nw
        q[plan.mean_w[own]] = self.model.a0[plan.mean_a[own]]
        for _ in range(ITERATIONS):
            F, F_q, _ = self._at(x, q, u, p)
            move = solution(F_q, F)
            q -= move
            if np.abs(move / size).max(initial=0.0) <= FLOOR:
                break
        return q

    def found(self) -> NetworkPoint:
        """The point of the steps."""
        plan, h, x0 = self.model.step, self.h, self.model.x0
        u, p = np.tile(self.model.u0[: plan.nu], plan.k), self.model.p0
        x, q, w = x0.copy(), self._step(x0, u, p), self.point.omega
        along = self._generated(x0) / self.size**2
        sizes = np.concatenate([np.maximum(np.abs(q), np.abs(plan.nominal)), self.size, [w] * self.free])
        sizes[sizes == 0] = 1.0
        before = np.inf
        for _ in range(ITERATIONS):
            F, F_q, F_x = self._at(x, q, u, p)
            A, b = self._turn(-w * h)
            back = A @ (x + self._U @ q) + b
            rows = [[F_q, F_x], [A @ self._U, A - (1.0 + STAYS) * eye_array(len(x))]]
            right = [F, back - x]
            if self.free:
                rows = [[*rows[0], None], [*rows[1], csc_array(-h * self._generated(back)[:, None])]]
                rows.append([None, csc_array(along[None]), None])
                right.append(np.array([along @ (x - x0)]))
            try:
                move = solution(csc_array(bmat(rows)), np.concatenate(right))
            except RuntimeError:
                break
            q, x = q - move[: len(q)], x - move[len(q) : len(q) + len(x)]
            w -= move[-1] if self.free else 0.0
            update = float(np.abs(move / sizes).max())
            if update <= REST or (update <= FLOOR and update >= before):
                return replace(self.point, states=dict(zip(self.names, x.tolist(), strict=True)), omega=float(w))
            if not np.isfinite(update) or update > 1e3:
                break
            before = update
        raise NoOperatingPoint(
            f"{self.point.network.name}: steps of {h:g} s of {self.model.scheme.name}, order {self.model.scheme.order} find no "
            f"steady state near the operating point (last update {before:.3g} of the sizes); take shorter steps"
        )
