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

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import isqrt
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.derivatives.by import IndependentVariables, start_tangents_by
from phfmu.derivatives.event_maps import EventInstant, EventMaps, Slope
from phfmu.derivatives.plan_function import PlanFunction, PlanPoint, PlanRows
from phfmu.discretise.model import Model
from phfmu.plan.plan import Plan
from phfmu.signals import Quantity

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TakenSteps:
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
    ) -> TakenSteps:
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
        return TakenSteps(
            t, np.full(n, h), states, x, r["unknowns"], given.reshape(n, -1), instance.parameters.copy(), a_end
        )


def weights_at_end(model: Model) -> Array:
    """Weights (k) of the inputs at the nodes of a step in those at its end: their polynomial."""
    return np.array(model.scheme.nodes.value(1.0)) if model.step.k > 1 else np.ones(1)


def in_parts(model: Model, t: float, h: float) -> ValueError:
    """A step was taken in parts."""
    return ValueError(
        f"{model.name}: the step at t = {t:.9g} s was taken in parts, of which derivatives know the last one only; take shorter "
        f"steps than --step {h:g}"
    )


#: what is told of a step and at an instant, by the block of a row, each one after the other
TOLD_OF_STEP: dict[str, Callable[[PlanRows], ca.SX]] = {
    "a": lambda rows: rows.algebraics,
    "y_step": lambda rows: rows.outputs,
    "energy": lambda rows: rows.work,
    "dissipated": lambda rows: rows.h * rows.energies(1),
}
TOLD_OF_INSTANT: dict[str, Callable[[PlanRows], ca.SX]] = {
    "a_end": lambda rows: rows.algebraics,
    "y_end": lambda rows: rows.outputs,
    "observables": lambda rows: rows.reported,
    "H": lambda rows: rows.energies(0),
}
#: up to so many states products of the matrices of steps cost less than a call for each
FEW = 24
OF_STEP, OF_INSTANT = tuple(TOLD_OF_STEP), tuple(TOLD_OF_INSTANT)
#: blocks of a row that follow from others: those of means are told at the instant of the start
NEEDED = {"a": {"a", "a_end"}, "y_step": {"y_step", "y_end"}, "supplied": {"energy"}}


class RunTangents:
    """The tangents of a run of `model`, from its start on; ValueError names what has none.

    `blocks`: the blocks of rows whose derivatives are told beside those of the states; default: all
    """

    def __init__(self, model: Model, by: IndependentVariables, blocks: Iterable[str] | None = None):
        require_derived(model)
        self.model, self.by = model, by
        self._plans: dict[int, tuple[PlanFunction, PlanFunction]] = {}
        wanted = {*OF_STEP, *OF_INSTANT} if blocks is None else {n for b in blocks for n in NEEDED.get(b, {b})}
        self._told_of_step, self._told_of_instant = (
            {name: told for name, told in every.items() if name in wanted} for every in (TOLD_OF_STEP, TOLD_OF_INSTANT)
        )
        step = model.step
        sizes = dict(zip(OF_STEP, (step.na, step.nq, step.nq, step.ncomp), strict=True))
        self._of_step = places(list(self._told_of_step), [sizes[name] for name in self._told_of_step])
        self.enter(model, None if model.events is None else EventMaps(model, model.events, by.directions))
        self.reset()

    def enter(self, model: Model, events: EventMaps | None) -> None:
        """Steps are those of `model` from now on, a mode of ideal switches; `events`: where instants move."""
        if id(model) not in self._plans:
            about = self.by.directions, events is not None
            self._plans[id(model)] = (
                PlanFunction(model.step, partial(_told, self._told_of_step), *about),
                PlanFunction(model.instant, partial(_told, self._told_of_instant), *about),
            )
        (self._step, self._instant), self.model, self.events = self._plans[id(model)], model, events
        step, instant = model.step, model.instant
        self._U = np.zeros((step.nx, step.nw))
        np.add.at(self._U, (step.update_x, step.update_w), step.update_c)
        sizes = dict(zip(OF_INSTANT, (instant.na, instant.nq, instant.nobs, instant.ncomp), strict=True))
        self._of_instant = places(list(self._told_of_instant), [sizes[name] for name in self._told_of_instant])

    def reset(self) -> None:
        """Before the start."""
        step, n = self.model.step, len(self.by.names)
        #: which directions still act: a parameter that an event has set does no longer
        self._acts = np.ones(n)
        self.S = np.zeros((step.nx, n))
        #: of the present time, which moves at events, and of the sizes of what it follows from
        self.T, self._sizes = np.zeros(n), np.ones(n)
        sizes = {"energy": step.nq, "dissipated": step.ncomp}
        self._sums = {name: np.zeros((size, n)) for name, size in sizes.items() if name in self._of_step}

    def kept(self) -> tuple[Any, ...]:
        """The present tangents, which `back` restores."""
        return self.S, self.T, dict(self._sums)

    def back(self, kept: tuple[Any, ...]) -> None:
        """Restores the tangents that `kept` told."""
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
        blocks |= {of: found[at] for of, at in (("a", "a_end"), ("y_step", "y_end")) if at in found}
        return with_sums(self.model.step, blocks, {n: s[None] for n, s in self._sums.items()})

    def jump(self, before: EventInstant, fired: Sequence[int], rests: Sequence[int]) -> None:
        """The states jump at events, of which some come to rest: the states `before` them with the parameters after them."""
        assert self.events is not None
        jump = self.events.jump(fired, rests, before)
        if jump is not None:
            along = self.by.spread(jump.along) * self._acts
            self.S[jump.moved] += jump.x @ self.S + np.outer(jump.t, self.T) + along

    def entered(self, entry: Slope) -> None:
        """The states go onto the constraints of a mode."""
        self.S = entry.x @ self.S + np.outer(entry.t, self.T) + self.by.spread(entry.along) * self._acts

    def at(self, i: EventInstant) -> dict[str, Array]:
        """Blocks of the row after an event."""
        return self._at_once(i.t, i.x, i.u, i.p, i.a)

    def over(self, steps: TakenSteps, landed: Sequence[int] = (), grid: float = 0.0) -> dict[str, Array]:
        """Blocks of the rows at the ends of steps that go on from those before: name -> (n x entries x names).

        landed: guards that are zero at the end of the last one;  grid: length of the steps that do not end on events
        """
        model, n, nx = self.model, len(steps.t), self.model.step.nx
        x, ahead = np.column_stack([steps.before, steps.t]), nx + self.by.directions.n
        p = np.broadcast_to(steps.p, (n, len(steps.p)))
        found = self._step.response(PlanPoint(x, steps.w, steps.u, p, steps.h))
        own = self.by.spread(found.w[:, :, nx:ahead]) * self._acts
        told = self.by.spread(found.told[:, :, nx:ahead]) * self._acts
        if self.T.any():  # the first one begins at an instant that moves, and ends at one that does not
            own[0] += np.outer(found.w[0, :, ahead] - found.w[0, :, ahead + 1], self.T)
            told[0] += np.outer(found.told[0, :, ahead] - found.told[0, :, ahead + 1], self.T)
        before = _followed(self.S, np.matmul(self._U, found.w[:, :, :nx]), np.matmul(self._U, own))
        rows, T = np.matmul(found.told[:, :, :nx], before[:-1]) + told, np.zeros((n, len(self.by.names)))
        if landed:
            h = found.w[-1, :, ahead + 1]
            T[-1] = self._landed(landed, steps, grid, before[-1], self._U @ h)
            before[-1] += np.outer(self._U @ h, T[-1])
            rows[-1] += np.outer(found.told[-1, :, ahead + 1], T[-1])
        S, self.S, self.T = before[1:], before[-1].copy(), T[-1]
        blocks = {name: rows[:, place] for name, place in self._of_step.items()}
        nu = model.step.nu
        u = steps.u.reshape(n, model.step.k, nu)
        last = weights_at_end(model)
        ends = np.einsum("k,nku->nu", last, u) if nu else np.zeros((n, 0))
        blocks |= self._at_instants((steps.t + steps.h, steps.after, ends, steps.p, steps.a_end), S, T) | {
            "x": S,
            "t": T[:, None],
        }
        sums = {}
        for name, start in self._sums.items():
            sums[name] = start + np.cumsum(blocks.pop(name), axis=0)
            self._sums[name] = sums[name][-1]
        return with_sums(self.model.step, blocks, sums)

    def _landed(self, guards: Sequence[int], steps: TakenSteps, grid: float, S: Array, rate: Array) -> Array:
        """Tangent (names) of the end of the last step, where guards are zero: tangents of the states for a given length, and
        their rates by it.  NoDerivative."""
        assert self.events is not None
        t, h = float(steps.t[-1]), float(steps.h[-1])
        nu = self.model.step.nu  # inputs are held
        at = EventInstant(t + h, steps.after[-1], steps.a_end[-1], steps.u[-1, steps.u.shape[1] - nu :], steps.p)
        found = []
        for i in guards:
            g = self.events.guard(i, at)
            own = float(g.x @ rate) + g.t
            self.events.require_crossing(i, at.t, own, grid)
            found.append(-(g.x @ S + self.by.spread(g.along) * self._acts) / own)
        self.events.require_together(at.t, guards, np.array(found), self._sizes)
        return found[0]

    def _at_instants(self, point: tuple[Array, Array, Array, Array, Array], S: Array, T: Array) -> dict[str, Array]:
        """Blocks at instants (t, x, u, p, algebraic variables) with tangents S (n x nx x names) of the states, T of the times."""
        if not self._of_instant:
            return {}
        found = self._instant.at_instants(*point)
        nx, ahead = self.model.instant.nx, self.model.instant.nx + self.by.directions.n
        rows = np.matmul(found[:, :, :nx], S) + self.by.spread(found[:, :, nx:ahead]) * self._acts
        if T.any():
            rows += found[:, :, ahead, None] * T[:, None, :]
        return {name: rows[:, place] for name, place in self._of_instant.items()}


def with_sums(plan: Plan, blocks: dict[str, Array], sums: dict[str, Array]) -> dict[str, Array]:
    """The blocks with energies since the start: through pairs, lost, and supplied by component."""
    n, _, width = blocks["x"].shape
    nothing = {name: np.zeros((n, plan.ncomp, width)) for name in ("residual", "gap")}
    if "energy" not in sums:
        return blocks | sums | nothing
    supplied = np.zeros((n, plan.ncomp, width))
    for pair, owner in enumerate(plan.pair_owner):
        supplied[:, owner] += sums["energy"][:, pair]
    return blocks | sums | {"supplied": supplied} | nothing


def of_quantities(quantities: Sequence[Quantity], blocks: dict[str, Array], by: IndependentVariables) -> Array:
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


def _followed(S: Array, A: Array, B: Array) -> Array:
    """S_0 .. S_n with S_(i+1) = S_i + A_i S_i + B_i (n + 1 x nx x names).

    For few states the steps go in stretches side by side, from unknown starts, which are put in afterwards.
    """
    n, nx, width = B.shape
    found = np.empty((n + 1, nx, width))
    found[0] = S
    m = isqrt(n) if nx <= FEW else 1
    sides = n // m if m > 1 else 0
    if sides:
        A_of, B_of = (a[: sides * m].reshape(sides, m, nx, -1) for a in (A, B))
        # of each stretch: [dS_i/dS_start - 1 | S_i from a start at 0]
        moved = np.zeros((sides, m + 1, nx, nx + width))
        for i in range(m):
            moved[:, i + 1] = moved[:, i] + np.matmul(A_of[:, i], moved[:, i])
            moved[:, i + 1, :, :nx] += A_of[:, i]
            moved[:, i + 1, :, nx:] += B_of[:, i]
        starts = np.empty((sides, 1, nx, width))
        for j in range(sides):
            starts[j, 0] = S
            S = S + moved[j, m, :, :nx] @ S + moved[j, m, :, nx:]
        ends = starts + np.matmul(moved[:, 1:, :, :nx], starts) + moved[:, 1:, :, nx:]
        found[1 : sides * m + 1] = ends.reshape(-1, nx, width)
    for i in range(sides * m, n):
        found[i + 1] = found[i] + A[i] @ found[i] + B[i]
    return found


def _told(what: Mapping[str, Callable[[PlanRows], ca.SX]], rows: PlanRows) -> ca.SX:
    return ca.vertcat(ca.SX(0, 1), *(told(rows) for told in what.values()))


def told_of_step(rows: PlanRows) -> ca.SX:
    """All blocks that are told of a step."""
    return _told(TOLD_OF_STEP, rows)


def told_of_instant(rows: PlanRows) -> ca.SX:
    """All blocks that are told at an instant."""
    return _told(TOLD_OF_INSTANT, rows)


def places(names: Sequence[str], sizes: Sequence[int]) -> dict[str, slice]:
    """Slices of blocks of these sizes, one after the other."""
    found, start = {}, 0
    for name, size in zip(names, sizes, strict=True):
        found[name] = slice(start, start + size)
        start += size
    return found
