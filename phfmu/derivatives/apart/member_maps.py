"""The step of a member as a map, and its derivatives: of its states, of what it tells, and of its rows of the interface.

    (x0, theta, z)  ->  (x1, told, rows),

theta being the parameters and inputs of its own that a run is derived by, z the unknowns of the interface that reach it: values
at the nodes of its junctions, impulses at start and end.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.derivatives.apart.kicks import KickSlopes
from phfmu.derivatives.by import IndependentVariables, ScalarData
from phfmu.derivatives.plan_function import PlanFunction, PlanPoint, PlanRows
from phfmu.derivatives.tangents import (
    OF_INSTANT,
    OF_STEP,
    TakenSteps,
    in_parts,
    places,
    told_of_instant,
    told_of_step,
    weights_at_end,
    with_sums,
)
from phfmu.network.couplings.compiled.master_pattern import ShareTables
from phfmu.network.members.engine_member import EngineMember
from phfmu.schemes.constraints.impulses import POINTS
from phfmu.signals import Quantity, quantities

Array = NDArray[np.float64]

#: time and length, by start and length of a step: where it begins, and at its end
OF_STEPS, OF_ENDS = np.eye(2), np.array([[1.0, 1.0], [0.0, 0.0]])
#: of `TakenSteps` what there is for each step
ROWS = ("t", "h", "before", "after", "w", "u", "a_end")


@dataclass(frozen=True)
class MemberSteps:
    """Steps that a member has taken, its impulses at their starts and ends (n x 2 x kicks), its inputs at their ends (n x nu)."""

    taken: TakenSteps
    impulses: Array
    ends: Array

    @property
    def h(self) -> Array:
        """Their lengths (n)."""
        return self.taken.h

    def some(self, which: slice) -> MemberSteps:
        """Some of them."""
        t = self.taken
        rows = {n: getattr(t, n)[which] for n in ROWS}
        return MemberSteps(TakenSteps(**rows, p=t.p), self.impulses[which], self.ends[which])

    @staticmethod
    def joined(steps: list[MemberSteps]) -> MemberSteps:
        """One after the other, under the same parameters."""
        parts = [s.taken for s in steps]
        rows = {n: np.concatenate([getattr(p, n) for p in parts]) for n in ROWS}
        impulses, ends = (np.concatenate([getattr(s, n) for s in steps]) for n in ("impulses", "ends"))
        return MemberSteps(TakenSteps(**rows, p=parts[0].p), impulses, ends)


@dataclass(frozen=True)
class Instants:
    """Instants within steps at which a member was asked for its outputs: times (n x instants), its states, inputs and algebraic
    variables there (n x instants x ..)."""

    t: Array
    x: Array
    u: Array
    a: Array

    def some(self, which: slice) -> Instants:
        """Those of some steps."""
        return Instants(self.t[which], self.x[which], self.u[which], self.a[which])

    @staticmethod
    def joined(steps: list[Instants]) -> Instants:
        return Instants(*(np.concatenate([getattr(s, n) for s in steps]) for n in ("t", "x", "u", "a")))


@dataclass(frozen=True)
class Wiring:
    """The part of a member in the interface as matrices: inputs at the k nodes of its steps by the unknowns that reach it
    (`feed`, k nu x unknowns), impulses at start and end by these (`kicks`, 2 x kicks x unknowns), rows of the interface by
    outputs at nodes and at the end (`left`, rows x k nu + nu)."""

    feed: Array
    kicks: Array
    left: Array

    @staticmethod
    def of(part: ShareTables, k: int) -> Wiring:
        """k: nodes of the member's steps, of which one that takes held values tells one."""
        reached, n, kicked = len(part.col), len(part.inputs), len(part.kicked)
        feed, kicks = np.zeros((part.k * part.nu, reached)), np.zeros((2, part.kicks, reached))
        for i, c, value in zip(part.right_direction, part.right_col, part.right, strict=True):
            if i < n:
                feed[part.inputs[i], c] += value
            else:
                side, place = divmod(int(i) - n, kicked)
                kicks[side, part.kicked[place], c] += value
        left = np.zeros((len(part.row), part.k * part.nu + part.nu))
        np.add.at(left, (part.left_row, part.left_output), part.left)
        return Wiring(np.tile(feed, (k, 1)) if part.held else feed, kicks, left)


@dataclass(frozen=True)
class StepDerivatives:
    """Per step the derivatives by [x0 | names | moves | unknowns that reach it]: of x1, of what is told, of outputs at nodes and
    the end (k nu + nu), and of S0 v before and S1 v after the step (vectors x kicks).  `passed`: derivatives of what is told by
    the signals that are passed on at the end (told x signals)."""

    x: Array
    told: Array
    outputs: Array
    before: Array
    after: Array
    passed: Array


class MemberMaps:
    """A member whose steps have `part` in the interface, derived by names of its own.

    wired: inputs that signals are passed on to at the ends of steps, where they leave their polynomials
    moves: there are derivatives by the start and the length of steps, too, which move where state events happen
    """

    def __init__(
        self,
        member: EngineMember,
        part: ShareTables,
        by: IndependentVariables,
        wired: Sequence[int] = (),
        moves: bool = False,
    ):
        self.member, self.part, self.by, self.wired = member, part, by, list(wired)
        model, d = member.model, by.directions
        plan = model.step
        self.nx, self.names, self.reached = plan.nx, len(by.names), len(part.col)
        #: columns of derivatives by start and length of a step, then by the unknowns of the interface
        self.moves = slice(self.nx + self.names, self.nx + self.names + 2 * moves)
        self.given = self.moves.stop
        wiring = Wiring.of(part, plan.k)
        self._feed, self.kicks, self.left = wiring.feed, wiring.kicks, wiring.left
        self._nodes = np.flatnonzero(self._feed.any(axis=1)).tolist()
        last = weights_at_end(model)
        #: of the inputs at the end of a step (nu x unknowns)
        self._last, self._feed_end = last, np.einsum("k,kuz->uz", last, self._feed.reshape(plan.k, plan.nu, -1))
        self._fed_end = np.flatnonzero(self._feed_end.any(axis=1)).tolist()
        #: those of `wired`, as if they were on their polynomials
        self.polynomial = self._feed_end[self.wired]
        self._feed_end[self.wired] = 0.0
        self._step = PlanFunction(plan, _told, d, moves, self._nodes)
        self._instant = PlanFunction(model.instant, told_of_instant, d, moves, self._fed_end)
        self._U = np.zeros((plan.nx, plan.nw))
        np.add.at(self._U, (plan.update_x, plan.update_w), plan.update_c)
        self.of_step = places(OF_STEP, (plan.na, plan.nq, plan.nq, plan.ncomp))
        instant, start = model.instant, self.of_step["dissipated"].stop
        sizes = (instant.na, instant.nq, instant.nobs, instant.ncomp)
        self.of_instant = {n: slice(s.start + start, s.stop + start) for n, s in places(OF_INSTANT, sizes).items()}
        #: how much is told of a step and at its end
        self.told = self.of_instant["H"].stop

    @cached_property
    def slopes(self) -> KickSlopes:
        """Derivatives of the member's impulses, made when they are first asked for."""
        return KickSlopes(self.member.model.declaration, self.by.directions.parameters, 1 + POINTS)

    # -- the start ---------------------------------------------------------------------------------------------------------

    def start(self, values: Mapping[str, float]) -> tuple[Array, Array]:
        """Back to the start with other values of the member's own names: states as given (nx) and inputs (nu)."""
        m, d = self.member, self.member.model.declaration
        p, x, u = m.model.p0.copy(), m.model.x0.copy(), m.start_inputs()
        kinds = ((d.parameters, p), (d.states, x))
        for names, to in (*(([n for v in vs for n in v.names()], to) for vs, to in kinds), (m.input_names, u)):
            for i, n in enumerate(names):
                to[i] = values.get(n, to[i])
        m.instance.reset()
        m.instance.set_parameters(p)
        m.set_input(u)
        m.instance.set_x(m.model.t0, x)
        m.instance.initialise()
        return x, u

    def state(self) -> Array:
        """The present states (nx)."""
        return self.member.instance.x[: self.nx].copy()

    @property
    def quantities(self) -> list[Quantity]:
        """The quantity in each column of the member."""
        known = {q.name: q for q in quantities(self.member.model)}
        return [known[n] for n in self.member.names]

    @property
    def known(self) -> ScalarData:
        """Start values, sizes, limits and units of what it can be derived by."""
        return ScalarData.of(self.member.model)

    def as_means(self, block: dict[str, Array]) -> dict[str, Array]:
        """Means at the start, which are the values of its instant, of the blocks now."""
        return {"a": block["a_end"], "y_step": block["y_end"]}

    def sums(self, width: int) -> dict[str, Array]:
        """Derivatives of energies since the start, at the start."""
        plan = self.member.model.step
        return {"energy": np.zeros((plan.nq, width)), "dissipated": np.zeros((plan.ncomp, width))}

    def with_sums(self, blocks: dict[str, Array], sums: dict[str, Array]) -> dict[str, Array]:
        """The blocks with energies since the start."""
        return with_sums(self.member.model.step, blocks, sums)

    # -- steps ---------------------------------------------------------------------------------------------------------

    def stepped(self, z: Array, given: Array, before: Array, t: float, h: float) -> MemberSteps:
        """The step that was taken last, from t and the states `before`; z: the unknowns that reach it, `given`: its inputs from
        outside at the nodes of the interface (k nu).  ValueError where it was taken in parts."""
        i, k = self.member.instance, self.member.model.step.k
        if i.solves != 1:
            raise in_parts(self.member.model, t, h)
        own = np.tile(given, k) if self.part.held else given
        u = own + self._feed @ z
        end = self._last @ u.reshape(len(self._last), -1)
        end[self.wired] = i.held_input[self.wired]
        row = i.x[: self.nx], i.unknowns, u, i.signal("a_end"), end
        after, w, u, a_end, end = (np.array(v, float)[None] for v in row)
        taken = TakenSteps(np.array([t]), np.array([h]), before[None], after, w, u, i.parameters.copy(), a_end)
        return MemberSteps(taken, (self.kicks @ z)[None], end)

    def ready(self) -> None:
        """Before a step: nothing, its states there are kept."""

    def jumps(self, steps: MemberSteps) -> tuple[Array, Array]:
        """S (n x kicks x kicks) before and after steps."""
        t = steps.taken
        p = np.broadcast_to(t.p, (len(t.t), len(t.p)))
        return self.slopes.jump(t.before, p), self.slopes.jump(t.after, p)

    # -- derivatives -----------------------------------------------------------------------------------------------------

    def at(self, steps: MemberSteps, v: Array, acts: Array) -> StepDerivatives:
        """Derivatives of steps; v: vectors that S is applied to, before and after each (n x 2 x vectors x kicks); acts: 1 of the
        names that still act, 0 of those that were set."""
        t, n, kicks = steps.taken, len(steps.taken.t), self.part.kicks
        p = np.broadcast_to(t.p, (n, len(t.p)))
        C = self.given + self.reached
        x, works = t.before, np.zeros((n, kicks, C))
        X = np.zeros((n, self.nx, C))
        X[:, np.arange(self.nx), np.arange(self.nx)] = 1.0
        if kicks:
            x, X, works = self._kicked(x, X, p, steps.impulses[:, 0], self.kicks[0], acts)
        found = self._step.response(PlanPoint(np.column_stack([x, t.t]), t.w, t.u, p, t.h))
        W, told = (self._along(f, X, self._feed[self._nodes], acts, OF_STEPS) for f in (found.w, found.told))
        X = X + self._U @ W
        if kicks:
            star = x + t.w @ self._U.T
            _, X, more = self._kicked(star, X, p, steps.impulses[:, 1], self.kicks[1], acts)
            told[:, self.of_step["energy"].start + np.array(self.slopes.pairs, int)] += works + more
        ends, by_signals = self._at_ends(steps, p, X, acts)
        stop = self.of_step["dissipated"].stop
        told, nodes = told[:, :stop], told[:, stop:]
        outputs = np.zeros((n, self.left.shape[1], C))
        outputs[:, : self.part.k * self.part.nu] = self._outputs(told, nodes)
        before = after = np.zeros((n, v.shape[2], kicks, C))
        if kicks:
            start = np.zeros_like(X)
            start[:, np.arange(self.nx), np.arange(self.nx)] = 1.0
            _, before = self._jumps(t.before, p, v[:, 0], start, acts)
            y, after = self._jumps(t.after, p, v[:, 1], X, acts)
            outputs[:, self.part.k * self.part.nu + np.array(self.slopes.pairs, int)] = y
        passed = np.concatenate([np.zeros((n, stop, len(self.wired))), by_signals], axis=1)
        return StepDerivatives(X, np.concatenate([told, ends], axis=1), outputs, before, after, passed)

    def looked(self) -> tuple[Array, ...]:
        """The member at the present instant, of which `looks` makes what `presented` takes."""
        i = self.member.instance
        return tuple(np.array(v, float) for v in (i.time, i.x[: self.nx], i.held_input, i.signal("a_end")))

    def looks(self, found: Sequence[tuple[Array, ...]]) -> Instants:
        """Instants of one step."""
        return Instants(*(np.array(v)[None] for v in zip(*found, strict=True)))

    def now(self) -> tuple[Array, Array]:
        """Derivatives of what is told at the present instant, and of outputs, by [states | names | inputs there]."""
        i, nx, nu = self.member.instance, self.nx, self.part.nu
        point = i.x[None, :nx], i.held_input[None], i.parameters, i.signal("a_end")[None]
        found = self._instant.at_instants(np.array([i.time]), *point)[0]
        first = nx + self.by.directions.n
        by_u = np.zeros((len(found), nu))
        by_u[:, self._fed_end] = found[:, first : first + len(self._fed_end)]
        told = np.concatenate([found[:, :nx], self.by.spread(found[:, nx:first]), by_u], axis=1)
        start = self.of_instant["y_end"].start - self.of_step["dissipated"].stop
        return told, told[start : start + nu]

    def presented(self, at: Instants, steps: MemberSteps, acts: Array) -> Array:
        """Derivatives (n x instants x nu x columns) of the outputs at instants by [states there | names | unknowns there]."""
        n, count = at.t.shape
        x, u, a = (v.reshape(n * count, -1) for v in (at.x, at.u, at.a))
        found = self._instant.at_instants(at.t.ravel(), x, u, steps.taken.p, a)
        first = self.of_instant["y_end"].start - self.of_step["dissipated"].stop
        found = found[:, first : first + self.part.nu]
        C = self.given + self.reached
        along = self._along(found, np.eye(self.nx, C)[None], self._feed_end[self._fed_end], acts, OF_ENDS)
        return along.reshape(n, count, self.part.nu, C)

    def at_instant(self, at: Instants, p: Array, acts: Array, S: Array, moved: Array, u: Array) -> tuple[Array, Array]:
        """Tangents of what is told at one instant: what follows from those of the states (nx x all), of the time (all) and of the
        inputs (nu x all), and what follows from the names of the member."""
        found = self._instant.at_instants(at.t[0], at.x[0], at.u[0], p, at.a[0])[0]
        first = self.nx + self.by.directions.n
        own = found[:, : self.nx] @ S
        own += found[:, first : first + len(self._fed_end)] @ u[self._fed_end]
        own += np.outer(found[:, first + len(self._fed_end)], moved)
        return own, self.by.spread(found[:, self.nx : first]) * acts

    def _along(self, found: Array, X: Array, feed: Array, acts: Array, moved: Array) -> Array:
        """By [x0 | names | moves | unknowns] of what has derivatives by states, directions, fed inputs, and where steps move by
        time and length, which these have `moved` (2 x 2)."""
        nx, first = self.nx, self.nx + self.by.directions.n
        out = found[:, :, :nx] @ X
        out[:, :, nx : nx + self.names] += self.by.spread(found[:, :, nx:first]) * acts
        out[:, :, self.given :] += found[:, :, first : first + len(feed)] @ feed
        if self.given > self.moves.start:
            out[:, :, self.moves] += found[:, :, first + len(feed) :] @ moved
        return out

    def _kicked(self, x: Array, X: Array, p: Array, s: Array, to: Array, acts: Array) -> tuple[Array, Array, Array]:
        """States, their derivatives, and those of the works, after impulses s that the unknowns have `to`."""
        f, states = self.slopes, self.slopes.states
        moved, by = f.kick(x, p, s)
        along = self._by_parameters(by[:, :, : -f.n], X, acts)
        along[:, :, self.given :] += by[:, :, -f.n :] @ to
        x, X = x.copy(), X.copy()
        x[:, states] += moved
        X[:, states] += along[:, : len(states)]
        return x, X, along[:, len(states) :]

    def _by_parameters(self, by: Array, X: Array, acts: Array) -> Array:
        """By [x0 | names | unknowns] of what has derivatives by states and parameters."""
        n, rows = by.shape[:2]
        own = np.concatenate([by[:, :, self.nx :], np.zeros((n, rows, len(self.by.directions.inputs)))], axis=2)
        out = by[:, :, : self.nx] @ X
        out[:, :, self.nx : self.nx + self.names] += self.by.spread(own) * acts
        return out

    def _jumps(self, x: Array, p: Array, v: Array, X: Array, acts: Array) -> tuple[Array, Array]:
        y, held = self.slopes.end(x, p, v)
        n = len(x)
        return self._by_parameters(y, X, acts), self._by_parameters(held.reshape(n, -1, y.shape[2]), X, acts).reshape(
            *held.shape[:3], -1
        )

    def _outputs(self, told: Array, nodes: Array) -> Array:
        """Outputs as the interface reads them: at nodes, or their means."""
        if not self.part.held:
            return nodes
        first = self.of_step["y_step"].start
        return told[:, first : first + self.part.nu]

    def _at_ends(self, steps: MemberSteps, p: Array, X: Array, acts: Array) -> tuple[Array, Array]:
        """Derivatives of what is told at the ends of steps, and those by the signals that are passed on there."""
        t = steps.taken
        found = self._instant.at_instants(t.t + t.h, t.after, steps.ends, p, t.a_end)
        first = self.nx + self.by.directions.n
        signals = found[:, :, [first + self._fed_end.index(i) for i in self.wired]]
        return self._along(found, X, self._feed_end[self._fed_end], acts, OF_ENDS), signals


def _told(rows: PlanRows) -> ca.SX:
    return ca.vertcat(told_of_step(rows), rows.outputs_at_nodes)
