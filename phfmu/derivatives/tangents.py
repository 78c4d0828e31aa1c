"""Tangents of a run: derivatives of all rows by parameters, start values and held inputs, along with the steps.

The state has the tangents S = dx/dtheta (nx x directions).  A step x1 = x0 + U w with F(x0, w, u, p, h) = 0 moves them to

    S1 = S0 + U dw,     dw = W_x S0 + W_theta,

and what is told of the step or at its end follows from them as the values do.  Instants of state events move too: steps that end
or begin there have derivatives by their length and start besides, and rows there are told with the instant (`event_maps.py`).
The derivative is that of the solution of F, to the accuracy to which steps are solved.  Where hidden constraints hold at the
start (currents that sum to zero, lengths), a parameter that is in them moves the start as `phfmu run --project` would.

Source: implicit function theorem on the step; docs/understand/derivatives.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.derivatives.by import By, start_tangents_by
from phfmu.derivatives.event_maps import EventMaps, Instant, Slope
from phfmu.derivatives.plan_function import PlanFunction, Point, Rows
from phfmu.discretise.model import Model
from phfmu.signals import Quantity

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Taken:
    """Steps that were taken: start times (n) and lengths (n), states before (n x nx) and after, unknowns, inputs (n x k nu),
    parameters, algebraic variables at their ends (n x na)."""

    t: Array
    h: Array
    before: Array
    after: Array
    w: Array
    u: Array
    p: Array
    a_end: Array

    @staticmethod
    def recorded(
        model: Model, instance: Any, r: dict[str, Array], t: Array, h: float, before: Array, u: Array
    ) -> Taken:
        """Steps from the times t and the state `before` under inputs u (nu held, n x nu, or n x k x nu), of which `instance` has
        recorded signals, unknowns and counts.  ValueError for one that was taken in parts.
        """
        if (divided := np.flatnonzero(r["counts"][:, 1] > 1)).size:
            raise in_parts(model, float(t[divided[0]]), h)
        n, layout = len(t), instance.layout
        x, a_end = (r["signals"][:, layout[block]] for block in ("x", "a_end"))
        given = np.broadcast_to(u, (n, model.step.nu)) if u.ndim == 1 else u
        given = np.repeat(given[:, None], model.step.k, axis=1) if given.ndim == 2 else given
        states = np.vstack([before[None], x[:-1]])
        return Taken(
            t, np.full(n, h), states, x, r["unknowns"], given.reshape(n, -1), instance.parameters.copy(), a_end
        )


def in_parts(model: Model, t: float, h: float) -> ValueError:
    """A step was taken in parts."""
    return ValueError(
        f"{model.name}: the step at t = {t:.9g} s was taken in parts, of which derivatives know the last one only; take shorter "
        f"steps than --step {h:g}"
    )


#: what is told of a step and at an instant, by the block of a row, each one after the other
OF_STEP, OF_INSTANT = ("a", "y_step", "energy", "dissipated"), ("a_end", "y_end", "observables", "H")


class Tangents:
    """The tangents of a run of `model`, from its start on; ValueError names what has none."""

    def __init__(self, model: Model, by: By):
        require_derived(model)
        self.model, self.by = model, by
        self._plans: dict[int, tuple[PlanFunction, PlanFunction]] = {}
        step = model.step
        self._of_step = places(OF_STEP, (step.na, step.nq, step.nq, step.ncomp))
        self.enter(model, None if model.events is None else EventMaps(model, model.events, by.directions))
        self.reset()

    def enter(self, model: Model, events: EventMaps | None) -> None:
        """Steps are those of `model` from now on, a mode of ideal switches; `events`: where instants move."""
        if id(model) not in self._plans:
            about = self.by.directions, events is not None
            self._plans[id(model)] = (
                PlanFunction(model.step, told_of_step, *about),
                PlanFunction(model.instant, told_of_instant, *about),
            )
        (self._step, self._instant), self.model, self.events = self._plans[id(model)], model, events
        step, instant = model.step, model.instant
        self._U = np.zeros((step.nx, step.nw))
        np.add.at(self._U, (step.update_x, step.update_w), step.update_c)
        self._of_instant = places(OF_INSTANT, (instant.na, instant.nq, instant.nobs, instant.ncomp))

    def reset(self) -> None:
        """Before the start."""
        step, n = self.model.step, len(self.by.names)
        #: which directions still act: a parameter that an event has set does no longer
        self._acts = np.ones(n)
        self.S = np.zeros((step.nx, n))
        #: of the present time, which moves at events, and of the sizes of what it follows from
        self.T, self._sizes = np.zeros(n), np.ones(n)
        self._sums = {"energy": np.zeros((step.nq, n)), "dissipated": np.zeros((step.ncomp, n))}

    def kept(self) -> tuple[Any, ...]:
        """Where they are, which `back` goes back to."""
        return self.S, self.T, dict(self._sums)

    def back(self, kept: tuple[Any, ...]) -> None:
        """To where they were."""
        self.S, self.T, sums = kept
        self._sums = dict(sums)

    def cut(self, names: Sequence[str]) -> None:
        """Values of parameters or inputs that are set from now on do not follow those of the start."""
        for own in (n for name in names for n in self.by.among(name)):
            i = self.by.names.index(own)
            if i in self.by.columns:
                self._acts[i] = 0.0

    def at_start(self, t: float, given: Array, x: Array, u: Array, p: Array, a_end: Array) -> dict[str, Array]:
        """Blocks of the first row: name -> (1 x entries x names); `given`: states, of which x is the projection."""
        self.S = start_tangents_by(self.model, self.by, given, x, p, t)
        self._sizes = self.by.sizes(x, u, p)
        return self._at_once(t, x, u, p, a_end)

    def _at_once(self, t: float, x: Array, u: Array, p: Array, a_end: Array) -> dict[str, Array]:
        """Blocks of a row of which all values are those at its instant."""
        found = self._at_instants((np.array([t]), x[None], u[None], p, a_end[None]), self.S[None], self.T[None])
        blocks = {"x": self.S[None].copy(), "t": self.T[None, None].copy(), **found}
        blocks |= {"a": found["a_end"], "y_step": found["y_end"]}
        return self._with_sums(blocks, {n: s[None] for n, s in self._sums.items()})

    def jump(self, before: Instant, fired: Sequence[int], rests: Sequence[int]) -> None:
        """The states jump at events, of which some come to rest: the states `before` them with the parameters after them."""
        assert self.events is not None
        jump = self.events.jump(fired, rests, before)
        if jump is not None:
            along = self.by.spread(jump.along) * self._acts
            self.S[jump.moved] += jump.x @ self.S + np.outer(jump.t, self.T) + along

    def entered(self, entry: Slope) -> None:
        """The states go onto the constraints of a mode."""
        self.S = entry.x @ self.S + np.outer(entry.t, self.T) + self.by.spread(entry.along) * self._acts

    def at(self, i: Instant) -> dict[str, Array]:
        """Blocks of the row after an event."""
        return self._at_once(i.t, i.x, i.u, i.p, i.a)

    def over(self, steps: Taken, landed: Sequence[int] = (), grid: float = 0.0) -> dict[str, Array]:
        """Blocks of the rows at the ends of steps that go on from those before: name -> (n x entries x names).

        landed: guards that are zero at the end of the last one;  grid: length of the steps that do not end on events
        """
        model, n, nx = self.model, len(steps.t), self.model.step.nx
        x, ahead = np.column_stack([steps.before, steps.t]), nx + self.by.directions.n
        p = np.broadcast_to(steps.p, (n, len(steps.p)))
        found = self._step.response(Point(x, steps.w, steps.u, p, steps.h))
        own = self.by.spread(found.w[:, :, nx:ahead]) * self._acts
        told = self.by.spread(found.told[:, :, nx:ahead]) * self._acts
        S, rows = np.zeros((n, nx, len(self.by.names))), np.zeros((n, *told.shape[1:]))
        T = np.zeros((n, len(self.by.names)))
        for i in range(n):
            rows[i] = found.told[i, :, :nx] @ self.S + told[i]
            w = found.w[i, :, :nx] @ self.S + own[i]
            if self.T.any():  # it begins at an instant that moves, and ends at one that does not
                w += np.outer(found.w[i, :, ahead] - found.w[i, :, ahead + 1], self.T)
                rows[i] += np.outer(found.told[i, :, ahead] - found.told[i, :, ahead + 1], self.T)
            if landed and i == n - 1:
                h = found.w[i, :, ahead + 1]
                T[i] = self._landed(landed, steps, grid, self.S + self._U @ w, self._U @ h)
                w += np.outer(h, T[i])
                rows[i] += np.outer(found.told[i, :, ahead + 1], T[i])
            self.S, self.T = self.S + self._U @ w, T[i]
            S[i] = self.S
        blocks = {name: rows[:, place] for name, place in self._of_step.items()}
        nu = model.step.nu
        u = steps.u.reshape(n, model.step.k, nu)
        last = np.array(model.scheme.nodes.value(1.0)) if model.step.k > 1 else np.ones(1)
        ends = np.einsum("k,nku->nu", last, u) if nu else np.zeros((n, 0))
        blocks |= self._at_instants((steps.t + steps.h, steps.after, ends, steps.p, steps.a_end), S, T) | {
            "x": S,
            "t": T[:, None],
        }
        sums = {}
        for name, start in self._sums.items():
            sums[name] = start + np.cumsum(blocks.pop(name), axis=0)
            self._sums[name] = sums[name][-1]
        return self._with_sums(blocks, sums)

    def _landed(self, guards: Sequence[int], steps: Taken, grid: float, S: Array, rate: Array) -> Array:
        """Tangent (names) of the end of the last step, where guards are zero: tangents of the states for a given length, and
        their rates by it.  NoDerivative."""
        assert self.events is not None
        t, h = float(steps.t[-1]), float(steps.h[-1])
        nu = self.model.step.nu  # inputs are held
        at = Instant(t + h, steps.after[-1], steps.a_end[-1], steps.u[-1, steps.u.shape[1] - nu :], steps.p)
        found = []
        for i in guards:
            g = self.events.guard(i, at)
            own = float(g.x @ rate) + g.t
            self.events.require_crossing(i, at.t, own, grid)
            found.append(-(g.x @ S + self.by.spread(g.along) * self._acts) / own)
        self.events.require_together(at.t, guards, np.array(found), self._sizes)
        return found[0]

    def _with_sums(self, blocks: dict[str, Array], sums: dict[str, Array]) -> dict[str, Array]:
        """Energies since the start: through pairs, lost, and supplied by component."""
        plan, (n, _, width) = self.model.step, sums["energy"].shape
        supplied = np.zeros((n, plan.ncomp, width))
        for pair, owner in enumerate(plan.pair_owner):
            supplied[:, owner] += sums["energy"][:, pair]
        nothing = {name: np.zeros((n, plan.ncomp, width)) for name in ("residual", "gap")}
        return blocks | sums | {"supplied": supplied} | nothing

    def _at_instants(self, point: tuple[Array, Array, Array, Array, Array], S: Array, T: Array) -> dict[str, Array]:
        """Blocks at instants (t, x, u, p, algebraic variables) with tangents S (n x nx x names) of the states, T of the times."""
        t, x, u, p, a = point
        plan, n = self.model.instant, len(t)
        w = np.zeros((n, plan.nw))
        w[:, plan.mean_w] = a[:, plan.mean_a]
        at = Point(np.column_stack([x, t]), w, u, np.broadcast_to(p, (n, len(p))), np.ones(n))
        at = Point(at.x, self._instant.solved(at), at.u, at.p, at.h)
        found = self._instant.response(at).told
        nx, ahead = plan.nx, plan.nx + self.by.directions.n
        rows = np.matmul(found[:, :, :nx], S) + self.by.spread(found[:, :, nx:ahead]) * self._acts
        if T.any():
            rows += found[:, :, ahead, None] * T[:, None, :]
        return {name: rows[:, place] for name, place in self._of_instant.items()}


def of_quantities(quantities: Sequence[Quantity], blocks: dict[str, Array], by: By) -> Array:
    """Derivatives of quantities (n x quantities x names) from those of the blocks."""
    n, width = len(blocks["x"]), len(by.names)
    found = np.zeros((n, len(quantities), width))
    for i, q in enumerate(quantities):
        if q.block in blocks:
            found[:, i] = blocks[q.block][:, q.first : q.first + q.count].sum(axis=1)
        elif q.block == "input" and q.name in by.names:
            found[:, i, by.names.index(q.name)] = 1.0
    return found


def require_smooth(model: Model) -> None:
    """ValueError for what steps by themselves, which no event interrupts, have no tangents of."""
    d = model.declaration
    if d.state_events or model.modes is not None:
        names = ", ".join(e.guard.name for e in d.state_events[:3]) or "ideal switches"
        raise ValueError(
            f"{d.name} has state events ({names}), which end steps; runs are derived through them, steps by themselves are of "
            "models without them"
        )
    require_derived(model)


def require_derived(model: Model) -> None:
    """ValueError for what runs have no tangents of."""
    d = model.declaration
    if model.step.carries:
        raise ValueError(
            f"{d.name}: scheme {model.scheme.name} has no derivatives here; take --scheme collocated or two-level"
        )
    if model.step.hold.rests.any():
        raise ValueError(
            f"{d.name} has redundant constraints ({', '.join(model.hold_names[:3])}), whose multipliers are not unique; "
            "remove them for derivatives (phfmu check names them)"
        )


def told_of_step(rows: Rows) -> ca.SX:
    return ca.vertcat(rows.algebraics, rows.outputs, rows.work, rows.h * rows.energies(1))


def told_of_instant(rows: Rows) -> ca.SX:
    return ca.vertcat(rows.algebraics, rows.outputs, rows.reported, rows.energies(0))


def places(names: Sequence[str], sizes: Sequence[int]) -> dict[str, slice]:
    """Where blocks of these sizes are, one after the other."""
    found, start = {}, 0
    for name, size in zip(names, sizes, strict=True):
        found[name] = slice(start, start + size)
        start += size
    return found
