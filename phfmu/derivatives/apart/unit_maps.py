"""The step of a member that is a unit, as a map with the derivatives that the unit tells.

Units of this package tell directional derivatives of a communication step by the states at its start, parameters and inputs,
and of values now by what is there now (manifest, `Derivatives`):

    dx1, dtold_step, dy = step along (dx0, dtheta, du),      dtold_now = instant along (dx1, dtheta, du_end),

one call for each state, each name derived by and each input that the interface feeds.  They are asked for right after a step, as
the unit knows its last one only, and kept.  Energies through ports follow from E = h sum_i b_i u_i^T y_i.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from phfmu.derivatives.apart.member_maps import StepDerivatives, Wiring
from phfmu.derivatives.by import IndependentVariables, ScalarData
from phfmu.fmu.export.variables import FMUError
from phfmu.gradients.quadrature import nodes
from phfmu.network.couplings.compiled.master_pattern import ShareTables
from phfmu.network.members.fmu_member import FMUMember
from phfmu.signals import Quantity, end_name, port_energy

Array = NDArray[np.float64]


@dataclass(frozen=True)
class UnitStepDerivatives:
    """Steps that a unit has taken: their lengths (n), and derivatives of each by [x0 | names | unknowns that reach it], as of
    `StepDerivatives`."""

    h: Array
    x: Array
    told: Array
    outputs: Array
    #: S before and after each (n x 2 x kicks x kicks), and its derivatives (.. x columns)
    S: Array
    dS: Array

    def some(self, which: slice) -> UnitStepDerivatives:
        """Some of them."""
        return UnitStepDerivatives(*(getattr(self, f.name)[which] for f in fields(self)))

    @staticmethod
    def joined(steps: list[UnitStepDerivatives]) -> UnitStepDerivatives:
        """One after the other."""
        return UnitStepDerivatives(
            *(np.concatenate([getattr(s, f.name) for s in steps]) for f in fields(UnitStepDerivatives))
        )


@dataclass(frozen=True)
class UnitInstants:
    """Derivatives of a unit's outputs (n x instants x nu x columns) at instants at which it was asked for them."""

    y: Array

    def some(self, which: slice) -> UnitInstants:
        """Those of some steps."""
        return UnitInstants(self.y[which])

    @staticmethod
    def joined(steps: list[UnitInstants]) -> UnitInstants:
        return UnitInstants(np.concatenate([s.y for s in steps]))


@dataclass(frozen=True)
class _Point:
    """At one instant S (kicks x kicks), outputs y with impulses (kicks), and their derivatives by [states | names]."""

    S: Array
    dS: Array
    y: Array
    dy: Array

    def along(self, X: Array, given: int) -> tuple[Array, Array]:
        """Derivatives of S and y by columns that the states there follow by X (nx x columns); those of names stand before
        column `given`."""
        nx = len(X)

        def of(D: Array) -> Array:
            found = D[..., :nx] @ X
            found[..., nx:given] += D[..., nx:]
            return found

        return of(self.dS), of(self.dy)

    def works(self, s: Array, ds: Array, dS: Array, dy: Array, side: float) -> Array:
        """Derivatives of the works s (y + side S s/2) of impulses s, whose outputs y are those before (side 1) or after (-1)."""
        mean = self.y + side * self.S @ s / 2
        turned = np.einsum("ijc,j->ic", dS, s) + self.S @ ds
        return ds * mean[:, None] + s[:, None] * (dy + side * turned / 2)


def why_not(m: FMUMember) -> str:
    """The capability that a unit lacks for derivatives of runs through it; "" for nothing."""
    face = m.unit.interface
    if not face.derivatives:
        return "it tells no directional derivatives (providesDirectionalDerivative(s) is not true)"
    if m.unit.estimated:
        return (
            "its directional derivatives are of outputs by inputs at a communication point, not of states, which may be hidden, "
            "over a step"
        )
    if not face.derived:
        return (
            "its manifest lists no derivatives by states (Derivatives): it was exported before they were told, has state "
            "events, or is a network"
        )
    if m.taken or m.sent:
        return (
            f"it exchanges signals at nodes ({', '.join([*m.taken, *m.sent][:3])}), through which they are not followed"
        )
    return ""


def scalars_of(m: FMUMember) -> tuple[list[str], list[str], list[str]]:
    """Scalars that it can be derived by: parameters and signals, inputs of ports, states."""
    return _parameters(m), [*m.unit.inputs], [*m.unit.interface.derived["states"]]


def _parameters(m: FMUMember) -> list[str]:
    variables = m.unit.interface.variables
    return [*(n for n, v in variables.items() if v.causality == "parameter"), *m.unit.other_inputs]


class UnitMaps:
    """A unit whose steps have `part` in the interface, derived by names of its own; as `MemberMaps`.

    Errors: ValueError with the words of the unit, where it refuses a derivative.
    """

    def __init__(self, member: FMUMember, part: ShareTables, by: IndependentVariables):
        self.member, self.part, self.by, self.unit = member, part, by, member.unit
        wiring, face = Wiring.of(part, part.k), self.unit.interface
        self.feed, self.left, self.kicks = wiring.feed, wiring.left, wiring.kicks
        self.states, self._of_step, self._now = (list(face.derived[n]) for n in ("states", "ofStep", "now"))
        self.nx, self.names, self.reached = len(self.states), len(by.names), len(part.col)
        self.moves = slice(self.nx + self.names, self.nx + self.names)
        self.given = self.moves.stop
        #: no signals are exchanged within its steps
        self.wired: list[int] = []
        self.polynomial = np.zeros((0, self.reached))
        rule = nodes(part.k)
        self._c, self._b = rule.value(1.0) if part.k > 1 else np.ones(1), rule.b
        self._sign_in, self._sign_out = self.unit.input_sign, member.unit._values.output_sign
        n, m, nu = len(self._of_step), len(self._now), part.nu
        self.of_step = {"y_step": slice(0, n), "energy": slice(n, n + nu), "dissipated": slice(n + nu, n + nu)}
        self.of_instant = {"y_end": slice(n + nu, n + nu + m)}
        self.told = n + nu + m
        ports = self.unit.ports
        self._outputs = [n for p in ports for n in p.outputs]
        means = [n for p in ports for n in p.step_outputs]
        at_nodes = [
            p.node_outputs[j][i] for i in range(part.k) for p in ports for j in range(len(p.inputs)) if p.node_outputs
        ]
        #: what a mean is of, now
        self._ends_of = dict(zip(means, self._outputs, strict=True))
        self._ends_of |= {n: end for n in self._of_step if (end := end_name(n)) in self._now}
        self._at_nodes = means if part.held else at_nodes
        fed = np.flatnonzero(self.feed.any(axis=1))
        inputs = [
            p.node_inputs[j][i] for i in range(part.k) for p in ports for j in range(len(p.inputs)) if p.node_inputs
        ]
        every = [n for p in ports for n in p.inputs]
        self._fed, self._fed_names = fed, [(every if part.held else inputs)[i] for i in fed]
        self._fed_end = np.flatnonzero(self._end_of(self.feed).any(axis=1))
        self._fed_end_names = [every[i] for i in self._fed_end]
        #: of impulses, places among the pairs, names at start and end, and S as pairs of places with its names
        self._pairs = list(self.unit.at_nodes.kicked) if part.kicks else []
        impulses = [names for p in ports for names in p.impulses]
        self._impulse_names = [[names[side] for names in impulses] for side in (0, 1)] if part.kicks else [[], []]
        self._lower = [(i, j, f"{face.jump}[{i + 1},{j + 1}]") for i in range(part.kicks) for j in range(i + 1)]
        #: H is quadratic along impulses, so that their works follow from outputs before or after them
        self._quadratic = all(p.impulse != "end" for p in ports)
        self._before: _Point | None = None
        parameters = _parameters(member)
        self._directions = [parameters[i] for i in by.directions.parameters] + [every[i] for i in by.directions.inputs]
        #: of each direction that is an input, by how much the unit's value follows that of the network
        self._is_input = [None] * len(by.directions.parameters) + list(by.directions.inputs)

    def _end_of(self, u: Array) -> Array:
        """Inputs at the end of a step (nu x ..) of those at its nodes (k nu x ..)."""
        return np.einsum("k,ku...->u...", self._c, u.reshape(len(self._c), self.part.nu, *u.shape[1:]))

    # -- the start ---------------------------------------------------------------------------------------------------------

    def start(self, values: Mapping[str, float]) -> tuple[Array, Array]:
        """Back to the start with other values of the unit's own names: its states (nx) and inputs (nu)."""
        u = self.member.start_inputs()
        for i, n in enumerate(self.unit.inputs):
            if n in values:
                u[i] = values[n] * self._sign_in[i]
        own = {n: v for n, v in values.items() if n not in self.unit.inputs}
        self.member.restart(own, u)
        return self.state(), u

    def state(self) -> Array:
        """The present states (nx)."""
        return self.unit.get(self.states)

    @property
    def quantities(self) -> list[Quantity]:
        """The place of the derivatives of each column of the member; a block of none for those that have none."""
        found, energies = list[Quantity](), {}
        start = 0
        for p in self.unit.ports:
            if self._quadratic or not p.impulses or not self.part.kicks:
                energies[port_energy(p.name)] = (start, len(p.inputs))
            start += len(p.inputs)
        lists = {"x": self.states, "y_step": self._of_step, "y_end": self._now}
        place = {n: (block, i, 1) for block, names in lists.items() for i, n in enumerate(names)}
        place |= {n: ("energy", i, count) for n, (i, count) in energies.items()}
        for n in self.member.names:
            block, first, count = place.get(n, ("", 0, 1))
            found.append(Quantity(n, "local", block, first, count))
        return found

    @property
    def known(self) -> ScalarData:
        """Start values, sizes and units of what it can be derived by."""
        variables = self.unit.interface.variables
        own = [n for n, v in variables.items() if v.causality in ("parameter", "input")] + self.states
        start = {n: self.unit._starts.get(n, variables[n].start or 0.0) for n in own}
        return ScalarData(
            start,
            {n: variables[n].nominal for n in self.states},
            {},
            {n: variables[n].unit for n in own},
        )

    @property
    def told_now(self) -> list[str]:
        """Names of what `now` tells."""
        return self._now

    @property
    def constraints(self) -> list[int]:
        """Places of hidden constraints among these."""
        return [i for i, n in enumerate(self._now) if n.startswith("constraint.")]

    def as_means(self, block: dict[str, Array]) -> dict[str, Array]:
        """Means at the start, which are the values of its instant, of the blocks now (1 x entries x names)."""
        width, now = block["y_end"].shape[2], block["y_end"]
        means = np.full((1, len(self._of_step), width), np.nan)
        for i, n in enumerate(self._of_step):
            if (end := self._ends_of.get(n)) is not None:
                means[:, i] = now[:, self._now.index(end)]
        return {"y_step": means}

    def sums(self, width: int) -> dict[str, Array]:
        """Derivatives of energies since the start, at the start."""
        return {"energy": np.zeros((self.part.nu, width)), "dissipated": np.zeros((0, width))}

    def with_sums(self, blocks: dict[str, Array], sums: dict[str, Array]) -> dict[str, Array]:
        """The blocks with energies since the start."""
        return blocks | sums

    # -- derivatives -------------------------------------------------------------------------------------------------------

    def _asked(self, unknowns: Sequence[str], knowns: Sequence[str]) -> Array:
        try:
            return self.unit.derivatives(unknowns, knowns)
        except FMUError as error:
            raise ValueError(f"the unit '{self.member.name}' tells no derivative: {error}") from error

    def _along(self, unknowns: Sequence[str], fed: Sequence[str], signs: Array) -> tuple[Array, Array, Array]:
        """By states, by the names derived by, and by the inputs fed, of signs into the unit."""
        found = self._asked(unknowns, [*self.states, *self._directions, *fed])
        nx, stop = self.nx, self.nx + len(self._directions)
        return found[:, :nx], self.by.spread(found[:, nx:stop]), found[:, stop:] / signs

    def stepped(self, z: Array, given: Array, before: Array, t: float, h: float) -> UnitStepDerivatives:
        """The step that was taken last; z: the unknowns that reach it, `given`: its inputs from outside at nodes (k nu)."""
        del before, t
        part, nx, nu = self.part, self.nx, self.part.nu
        kicks = self._sign_in[self._pairs]
        signs = np.concatenate([np.tile(self._sign_in, part.k)[self._fed], kicks, kicks])
        rows = [*self.states, *self._of_step, *self._at_nodes]
        by_x, by_names, by_z = self._along(rows, [*self._fed_names, *sum(self._impulse_names, [])], signs)
        through = np.concatenate([self.feed[self._fed], *self.kicks])
        J = np.concatenate([by_x, by_names, by_z @ through], axis=1)
        n = len(self._of_step)
        X, told, y = J[:nx], J[nx : nx + n], J[nx + n :] * np.tile(self._sign_out, part.k)[:, None]
        energies = self._energies(y, given + self.feed @ z, h)
        ends, now = self._end(X)
        at_end = np.zeros((nu, J.shape[1]))
        at_end[self._pairs] = now[self._pairs]
        start = np.eye(nx, J.shape[1])
        points = [self._before, self._at_point()] if part.kicks else []
        found = [p.along(m, self.given) for p, m in zip(points, (start, X), strict=False)]
        for side, (p, (dS, dy)) in enumerate(zip(points, found, strict=True)):
            energies[self._pairs] += p.works(
                self.kicks[side] @ z, self._with(self.kicks[side]), dS, dy, (1.0, -1.0)[side]
            )
        n_kicks, C = part.kicks, J.shape[1]
        S = np.array([p.S for p in points]).reshape(1, len(points), n_kicks, n_kicks)
        dS = np.array([own for own, _ in found]).reshape(1, len(points), n_kicks, n_kicks, C)
        outputs = np.concatenate([y, at_end])
        return UnitStepDerivatives(
            np.array([h]), X[None], np.concatenate([told, energies, ends])[None], outputs[None], S, dS
        )

    def _with(self, rows: Array) -> Array:
        """Rows by the unknowns that reach it, by all columns."""
        return np.concatenate([np.zeros((len(rows), self.given)), rows], axis=1)

    def ready(self) -> None:
        """Before a step: what its impulses are derived by."""
        if self.part.kicks:
            self._before = self._at_point()

    def _at_point(self) -> _Point:
        """The jumps of impulses now, and the outputs that they change."""
        n, at = self.part.kicks, [self._outputs[i] for i in self._pairs]
        own, names, _ = self._along([*(name for _, _, name in self._lower), *at], [], np.zeros(0))
        found, dS = np.concatenate([own, names], axis=1), np.zeros((n, n, self.given))
        for (i, j, _), row in zip(self._lower, found, strict=False):
            dS[i, j] = dS[j, i] = row
        sign = self._sign_out[self._pairs]
        y = self.unit.end_output()[self._pairs]
        return _Point(self.unit.at_nodes.jump(), dS, y, found[len(self._lower) :] * sign[:, None])

    def _energies(self, y: Array, u: Array, h: float) -> Array:
        """Derivatives of the energies through the pairs (nu x columns) in a step of length h."""
        k, nu = self.part.k, self.part.nu
        now = self.member.output() if self.part.held else self.unit.node_output()
        du = np.zeros((k * nu, y.shape[1]))
        du[:, self.given :] = self.feed
        for name, i in zip(self.by.columns, self._is_input, strict=True):
            if i is not None:
                du[i::nu, self.nx + name] += self._sign_in[i]
        power = y * u[:, None] + np.ravel(now)[:, None] * du
        return h * np.einsum("k,kuc->uc", self._b, power.reshape(k, nu, -1))

    def _end(self, X: Array | None = None) -> tuple[Array, Array]:
        """Derivatives of values now, by the columns of the step that led here, or where X is None by [x | names | inputs now];
        and of the outputs among them."""
        fed = self._fed_end_names if X is not None else list(self.unit.inputs)
        signs = self._sign_in[self._fed_end] if X is not None else self._sign_in
        by_x, by_names, by_u = self._along(self._now, fed, signs)
        if X is None:
            found = np.concatenate([by_x, by_names, by_u], axis=1)
        else:
            found = by_x @ X
            found[:, self.nx : self.given] += by_names
            found[:, self.given :] += by_u @ self._end_of(self.feed)[self._fed_end]
        return found, found[[self._now.index(n) for n in self._outputs]] * self._sign_out[:, None]

    def at(self, steps: UnitStepDerivatives, v: Array, acts: Array) -> StepDerivatives:
        """Derivatives of steps; acts: 1 of the names that still act, 0 of those that were set."""
        n = len(steps.h)
        C = self.given + self.reached
        scale = np.concatenate([np.ones(self.nx), acts, np.ones(self.reached)])
        before = after = np.zeros((n, v.shape[2], 0, C))
        if self.part.kicks:
            before, after = (np.einsum("nijc,nvj->nvic", steps.dS[:, i] * scale, v[:, i]) for i in (0, 1))
        return StepDerivatives(
            steps.x * scale, steps.told * scale, steps.outputs * scale, before, after, np.zeros((n, self.told, 0))
        )

    def jumps(self, steps: UnitStepDerivatives) -> tuple[Array, Array]:
        """S (n x kicks x kicks) before and after steps."""
        return steps.S[:, 0], steps.S[:, 1]

    def looked(self) -> Array:
        """The member at the present instant, of which `looks` makes what `presented` takes: derivatives of outputs by [states
        there | names | unknowns there]."""
        X = np.eye(self.nx, self.given + self.reached)
        return self._end(X)[1]

    def looks(self, found: Sequence[Array]) -> UnitInstants:
        """Instants of one step."""
        return UnitInstants(np.array(found)[None])

    def presented(self, at: UnitInstants, steps: UnitStepDerivatives, acts: Array) -> Array:
        """Derivatives (n x instants x nu x columns) of the outputs at instants by [states there | names | unknowns there]."""
        del steps
        return at.y * np.concatenate([np.ones(self.nx), acts, np.ones(self.reached)])

    def now(self) -> tuple[Array, Array]:
        """Derivatives of what is told at the present instant, and of outputs, by [states | names | inputs now]."""
        return self._end()
