"""The derivative of a state event: of the instant where a guard is zero, and of the jump of the states there.

A step from T_0 with the length h ends where g(x, T) = 0, T = T_0 + h, so that its length follows from where it begins,

    dh = -(g_x (dx at h fixed) + g_t dT_0 + g_p dp) / (g_x dx/dh + g_t),

of which the denominator is the rate of the guard over steps as they are taken.  A jump x+ = x + L m with S m = -(1 + e) c in the
columns that act has

    dx+ = dx + dL m + L dm,    S dm = -(1 + e) dc - de c - dS m.

Source: implicit function theorem on the step, that is saltation of the discrete flow (Hiskens, Pai, IEEE TCAS-I 47, 2000).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.derivatives.by import TangentDirections
from phfmu.derivatives.plan_function import PlanFunction, PlanPoint
from phfmu.discretise.model import Model
from phfmu.events.event_plan import EventPlan
from phfmu.events.impulse import factored, impulses, pushing
from phfmu.outcome.limits import LIMITS
from phfmu.outcome.status import NoDerivative
from phfmu.plan.plan import Group

Array = NDArray[np.float64]

#: a guard whose rate moves it over a step by less than so many times what counts as zero only touches it
GRAZES = 100.0
#: a contact closer than this part of its terms to changing sides has no derivative: it may act, or may not
EDGE = 1e-10
#: instants of events that coincide move together where their derivatives differ by no more than this part of them
TOGETHER = 1e-7


@dataclass(frozen=True)
class Slope:
    """Derivative at an instant of a number, or of m numbers, by the states there ([m x] nx), its time ([m]) and the directions
    ([m x] n)."""

    x: Array
    t: Any
    along: Array


@dataclass(frozen=True)
class JumpSlope(Slope):
    """The same of what a jump adds to the states `moved` (m)."""

    moved: NDArray[np.int32]


@dataclass(frozen=True)
class EventInstant:
    """The instant of an event: its time, states (nx), algebraic variables (na), inputs (nu), parameters (np)."""

    t: float
    x: Array
    a: Array
    u: Array
    p: Array


class EventMaps:
    """Derivatives of the guards and jumps of a model with state events, along `directions`."""

    def __init__(self, model: Model, plan: EventPlan, directions: TangentDirections):
        self._model, self._directions, self.plan = model, directions, plan
        self._functions: dict[int, Any] = {}
        self._algebraics: PlanFunction | None = None

    def after(self, p: Array, fired: Sequence[int], rests: Sequence[int]) -> Array:
        """Parameters after events, of which some come to rest."""
        found = p.copy()
        for settings, which in ((self.plan.sets, fired), (self.plan.rest, rests)):
            for i in which:
                found[settings.p[settings.of(i)]] = settings.value[settings.of(i)]
        return found

    def require_crossing(self, i: int, t: float, rate: float, h: float) -> None:
        """NoDerivative where guard i, of this rate over a step of length h, only touches zero."""
        if not abs(rate) * h > GRAZES * LIMITS["GUARD_ZERO"] * self.plan.nominal[i]:
            raise self._none(t, [i], "its guard touches zero without crossing it, so that the event may not happen")

    def require_together(self, t: float, fired: Sequence[int], slopes: Array, sizes: Array) -> None:
        """NoDerivative where guards that are zero at one instant have other derivatives of it (guards x names) and so may
        happen in another order; `sizes`: of the values that these are derived by."""
        scaled = slopes * sizes
        if np.ptp(scaled, axis=0).max(initial=0.0) > TOGETHER * np.abs(scaled).max(initial=0.0):
            raise self._none(t, fired, "they happen at one instant, and in an order that follows from the values")

    def _none(self, t: float, fired: Sequence[int], why: str) -> NoDerivative:
        names = " and ".join(self.plan.names[i] for i in fired)
        return NoDerivative(t, f"{self._model.name}: {names} at t = {t:.9g} s has no derivative: {why}")

    # -- guards ------------------------------------------------------------------------------------------------------

    def guard(self, i: int, at: EventInstant) -> Slope:
        """Derivative of guard i at an instant; algebraic variables follow from the states there."""
        group, row = next((g, int(j)) for g in self.plan.groups for j in np.flatnonzero(g.oi[:, 0] == i))
        _, slopes = self._at(group, row, at)
        by = slopes[0]
        xi, yi, pi = (getattr(group, n)[row] for n in ("xi", "yi", "pi"))
        nx, na = self._model.step.nx, self._model.step.na
        x, a, u, p = np.zeros(nx + 1), np.zeros(na), np.zeros(len(at.u)), np.zeros(len(at.p))
        np.add.at(x, xi, by[: len(xi)])
        own = by[len(xi) : len(xi) + len(yi)]
        np.add.at(a, yi[yi < na], own[yi < na])
        np.add.at(u, yi[yi >= na] - na, own[yi >= na])
        np.add.at(p, pi, by[len(xi) + len(yi) :])
        found = Slope(x[:nx], float(x[nx]), self._directions.of(p, u))
        return found if not a.any() else self._with_algebraics(found, a, at)

    def _with_algebraics(self, own: Slope, a: Array, at: EventInstant) -> Slope:
        """Derivatives with those through algebraic variables, whose own derivatives are given."""
        plan, d = self._model.instant, self._directions
        if self._algebraics is None:
            self._algebraics = PlanFunction(plan, lambda rows: rows.algebraics, d, moves=True)
        w = np.zeros((1, plan.nw))
        w[:, plan.mean_w] = at.a[plan.mean_a]
        point = PlanPoint(np.append(at.x, at.t)[None], w, at.u[None], at.p[None], np.ones(1))
        point = PlanPoint(point.x, self._algebraics.solved(point), point.u, point.p, point.h)
        more, n = a @ self._algebraics.response(point).told[0], plan.nx
        return Slope(own.x + more[:n], own.t + float(more[n + d.n]), own.along + more[n : n + d.n])

    def _at(self, group: Group, i: int, at: EventInstant) -> tuple[Array, Array]:
        """Results of instance i of a group at an instant, and their derivatives by its arguments x, y and p."""
        key = id(group.kernel)
        if key not in self._functions:
            given = group.kernel.function.sx_in()
            out = ca.densify(group.kernel.function.call(given)[0])
            slopes = ca.densify(ca.jacobian(out, ca.vertcat(*given)))
            self._functions[key] = ca.Function("event", given, [ca.SX(r) for r in ca.cse([out, slopes])])
        sources = np.append(at.x, at.t), np.concatenate([at.a, at.u]), at.p
        tables = group.xi[i], group.yi[i], group.pi[i]
        out, slopes = self._functions[key](*(s[t] for s, t in zip(sources, tables, strict=True)))
        return np.array(out).ravel(), np.array(slopes)

    # -- jumps -------------------------------------------------------------------------------------------------------

    def jumped(self, at: EventInstant, fired: Sequence[int], rests: Sequence[int]) -> Array:
        """The states (nx) after the jump of events."""
        found = self._jump(fired, rests, at)
        x = at.x.copy()
        if found is not None:
            x[found[0].moved] += found[1]
        return x

    def jump(self, fired: Sequence[int], rests: Sequence[int], at: EventInstant) -> JumpSlope | None:
        """Derivative of the jump of events, with the states before and the parameters after them; None: none of them moves."""
        found = self._jump(fired, rests, at)
        return None if found is None else found[0]

    def _jump(self, fired: Sequence[int], rests: Sequence[int], at: EventInstant) -> tuple[JumpSlope, Array] | None:
        """The same, with the jump of the states that move."""
        jump = self.plan.jump
        jumping = [] if jump is None else [i for i in fired if jump.of[i] >= 0]
        if jump is None or not (jumping or jump.held):
            return None
        out, slopes = self._at(jump.group, 0, at)
        n, m, width = jump.columns, len(jump.moved), slopes.shape[1]
        values, by = np.zeros(jump.size), np.zeros((jump.size, width))
        values[jump.group.oi[0]], by[jump.group.oi[0]] = out, slopes
        cuts = np.cumsum([len(jump.component) * n, m * n, n * n]).tolist()
        which = [*(int(jump.of[i]) for i in jumping), *range(jump.n, n)]
        c, L, S, e = np.split(values, cuts)
        dc, dL, dS, de = np.split(by, cuts)
        c, dc = c.reshape(-1, n).sum(axis=0)[which], dc.reshape(-1, n, width).sum(axis=0)[which]
        L, dL = L.reshape(n, m)[which], dL.reshape(n, m, width)[which]
        S, dS = S.reshape(n, n)[np.ix_(which, which)], dS.reshape(n, n, width)[np.ix_(which, which)]
        thrown, dthrown = np.zeros(len(which)), np.zeros((len(which), width))
        for j, i in enumerate(jumping):
            if i not in rests:
                thrown[j], dthrown[j] = e[jump.of[i]], de[jump.of[i]]
        goal = -(1.0 + thrown) * c
        acts = self._acting(S, goal, jump.pushes[which[: len(jumping)]] > 0, jumping, at.t)
        found = impulses(S, goal, acts, len(jumping), LIMITS["JUMP_DEPENDENT"])
        own = np.flatnonzero(acts)
        if found is None or not len(own):
            return None
        right = -(1.0 + thrown)[:, None] * dc - dthrown * c[:, None] - np.einsum("ijk,j->ik", dS, found)
        dm = np.linalg.solve(S[np.ix_(own, own)], right[own])
        moved = np.einsum("jik,j->ik", dL[own], found[own]) + L[own].T @ dm
        return self._placed(jump.moved, moved, jump.group), L[own].T @ found[own]

    def _acting(self, S: Array, goal: Array, pushes: NDArray[np.bool_], jumping: Sequence[int], t: float) -> Any:
        """Columns that act and do not depend on those before them; NoDerivative where a contact is at the edge of acting."""
        least, n = LIMITS["JUMP_DEPENDENT"], len(jumping)
        acts = pushing(S, goal, pushes, least, LIMITS["PUSH_ROUNDING"], int(LIMITS["MOST_PUSHING"]))
        assert acts is not None  # the jump was made
        m = impulses(S, goal, acts, n, least)
        assert m is not None
        terms = np.abs(S) @ np.abs(m) + np.abs(goal)
        left = np.abs(np.where(acts, S.diagonal() * m, S @ m - goal)) <= EDGE * terms
        if edge := [jumping[j] for j in np.flatnonzero(pushes & left[:n]).tolist()]:
            raise self._none(t, edge, "the contact is at the edge between pushing and not")
        factor = factored(S, acts, n, least)
        assert factor is not None
        return factor.diagonal() > 0.0

    def _placed(self, moved: Any, by: Array, group: Group) -> JumpSlope:
        """Derivatives by the arguments of a kernel as those by states, time and directions."""
        nx, m = self._model.step.nx, len(moved)
        x, p = np.zeros((m, nx + 1)), np.zeros((m, self._model.step.np))
        taken, given = group.xi[0], group.pi[0]
        np.add.at(x.T, taken, by[:, : len(taken)].T)
        np.add.at(p.T, given, by[:, by.shape[1] - len(given) :].T)
        along = self._directions.of(p, np.zeros((m, self._model.step.nu)))
        return JumpSlope(x[:, :nx], x[:, nx], along, np.asarray(moved, np.int32))
