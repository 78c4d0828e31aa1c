"""The Schur stepper of a holonomic model: the tables of its fast solver beside the plan, where its conditions hold.

    q' = v + M^-1 Dg^T mu,   M v' = f(q, q', u) - DV(q) - Dg^T lambda - (v^T D2g)^T mu,   Dg q' = 0 at the nodes, Dg v = 0

with constant diagonal M, quadratic g, and V a sum of quadratic terms and of phi(C(q)) with quadratic C.  The iteration
is described in docs/internals/native-engine.md.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass
from typing import Any, TypeVar

import casadi as ca
import numpy as np

from phfmu.declare.energy import EnergyKind
from phfmu.declare.expressions.operations import degree, piecewise
from phfmu.declare.variable import ValueKind
from phfmu.gradients.quadrature import nodes
from phfmu.plan.differences import StackedFunction
from phfmu.plan.layout import Layout
from phfmu.plan.plan import Floats, Ints, Plan
from phfmu.plan.unknown import ALGEBRAIC, COSTATE, INCREMENT
from phfmu.schemes.constraints import inertia
from phfmu.schemes.constraints.constraints import VELOCITY_LEVEL
from phfmu.schemes.scheme import Scheme
from phfmu.schur import lanes
from phfmu.schur.elimination import Elimination, FactorPattern, eliminate, factor_pattern, updates
from phfmu.schur.lane_groups import Instances, LaneGroup, Tiles, tiled
from phfmu.schur.lanes import Lanes, NoLanes
from phfmu.terms.located import Constant, Row
from phfmu.terms.rank import ConstraintsAtStart
from phfmu.terms.term import CONSTRAINT, ENERGY, FLOW, MASS, OBSERVABLE, EnergyForm, Term
from phfmu.terms.velocities import velocity_of

Made = TypeVar("Made")

#: a factor of all rows with no more updates than this per row is never the larger part of a step
FEW = 200
#: products of an update of it beside one of the sparse LU, by k: a real mode, and for k = 3 a complex one too
MODES = {1: 1.0, 3: 5.0}
#: it is taken more than once a step, between sweeps: it pays where it costs no more than this share of the sparse LU
SHARE = 0.25


@dataclass(frozen=True)
class SchurStepper:
    """Tables of the solver; degree of freedom d has the states position[d] and velocity[d].

    Coordinates are differences of the degrees of freedom point_plus - point_minus (index ndof: nothing).  Rows are
    constraints, then strains; those of row r are row_ptr[r] .. row_ptr[r + 1], further ones belong to forces.
    `load`: constant entries (kind 0: times an input, 1: times a velocity) of the force on load_dof.
    w_position, w_velocity (dof x k), w_lambda (constraint x k), w_mu: places among the unknowns of the plan; `costate`
    (dof x k): Y index of z_v, the only part of Z that dissipation and outputs read in such a model.
    `light`: degrees of freedom without mass, `light_place`: elimination position of the row that each has in `hard`.
    `hard`: elimination of the constraints, `soft`: of all rows, None where Newton's method is better.
    `extended`: A with the row b below it (k+1 x k);  `multiplier`: inverse of [A, -1; b^T, 0];  `spectrum`, `modes`,
    `to_modes`: A^-2 in real block-diagonal form.
    """

    k: int
    groups: tuple[LaneGroup, ...]
    tile: Tiles
    nconstraint: int
    nstrain: int
    position: Ints
    velocity: Ints
    nominal: Floats
    w_position: Ints
    w_velocity: Ints
    costate: Ints
    w_lambda: Ints
    w_mu: Ints
    row_ptr: Ints
    point_plus: Ints
    point_minus: Ints
    load_dof: Ints
    load_kind: Ints
    load_source: Ints
    load_value: Floats
    light: Ints
    light_place: Ints
    hard: Elimination
    soft: Elimination | None
    extended: Floats
    multiplier: Floats
    spectrum: Floats
    modes: Floats
    to_modes: Floats

    @property
    def ndof(self) -> int:
        return len(self.position)


class _Unfit(Exception):
    """The model is not of the form the Schur stepper solves."""


def find_stepper(layout: Layout, scheme: Scheme, plan: Plan) -> SchurStepper | None:
    """The Schur stepper's tables of a step plan, or None where its conditions do not hold."""
    if not scheme.two_level or scheme.gradient != "per-term" or layout.k not in MODES or not layout.terms.na:
        return None
    try:
        return _Builder(layout, plan).build()
    except (_Unfit, NoLanes):
        return None


def _require(condition: bool) -> None:
    if not condition:
        raise _Unfit


class _Builder:
    """Collects the instances of one model; every method raises _Unfit or NoLanes for a term the Schur stepper cannot take."""

    def __init__(self, layout: Layout, plan: Plan):
        self.layout, self.terms, self.plan = layout, layout.terms, plan
        t = self.terms
        constraint = t.of(CONSTRAINT)
        velocity = velocity_of(t)
        self.position = sorted(velocity)
        self.velocity = [velocity[q] for q in self.position]
        self.resting = t.found(ConstraintsAtStart).resting
        _require(sorted(self.position + self.velocity) == list(range(t.n1)))
        _require(sorted(x.rows[0].index for x in constraint) == list(range(t.na)))
        _require(layout.roles() <= {INCREMENT, COSTATE, ALGEBRAIC, VELOCITY_LEVEL})
        _require(not t.solved_costates() and not t.bound and all(p.port.source is None for p in t.pairs))
        _require(len(t.pairs) == t.nu)
        self.dof = {q: d for d, q in enumerate(self.position)}
        self.dof_v = {v: d for d, v in enumerate(self.velocity)}
        self.groups: dict[tuple[str, ...], Instances] = {}
        self.kinetic: set[int] = set()
        self.load: list[tuple[int, int, int, float]] = []
        self.known: dict[tuple, Any] = {}
        self.start = [s for v in t.model.parameters for s in v.start]

    def build(self) -> SchurStepper:
        for constant in self.terms.constants:
            self._constant(constant)
        for term in self.terms.terms:
            self._add_term(term)
        _require(self.kinetic == set(self.velocity))
        return self._tables()

    # -- terms ------------------------------------------------------------------------------------------------------

    def _add_term(self, term: Term) -> None:
        if term.kind is MASS:
            self._mass(term)
        elif term.kind is ENERGY:
            self._energy(term)
        elif term.kind is FLOW:
            self._flow(term)
        elif term.kind is CONSTRAINT:
            self._constraint(term)
        else:
            _require(term.kind is OBSERVABLE)

    def _constant(self, c: Constant) -> None:
        balance, row = c.row.kind is Row.BALANCE, c.row.index
        if c.row.kind is Row.OUTPUT or balance and row in self.dof:
            return
        _require(balance and row in self.dof_v)
        dof, costate = self.dof_v[row], c.source.kind is ValueKind.COSTATE
        if c.source.kind is ValueKind.INPUT:
            self.load.append((dof, 0, c.source.index, c.value))
        elif costate and c.source.index in self.dof_v:
            self.load.append((dof, 1, self.dof_v[c.source.index], c.value))
        else:
            _require(costate and c.source.index == self.position[dof] and c.value == -1.0)

    def _mass(self, term: Term) -> None:
        row, m, p = term.rows[0].index, term.data["m"], term.symbols(ValueKind.PARAMETER)
        _require(row in self.dof_v and not self._once("depends", term, lambda: self._depends(m, term, ValueKind.STATE)))
        if inertia.is_light(term):
            if not self._once("none", term, lambda: lanes.no_mass(term)):
                self._add(self._once("mass", term, lambda: lanes.mass(term)), term, o=[self.dof_v[row]])
            return
        value = self._once("value", term, lambda: StackedFunction(ca.Function("m", [p], [ca.densify(m)])))
        _require(bool(value([np.array([self.start[i] for i in term.indices(ValueKind.PARAMETER)], float)])[0] > 0))
        self._add(self._once("mass", term, lambda: lanes.mass(term)), term, o=[self.dof_v[row]])

    def _energy(self, term: Term) -> None:
        states = term.indices(ValueKind.STATE)
        kind = term.form_of(EnergyForm).kind
        if all(x in self.dof_v for x in states):
            kinetic = kind is EnergyKind.QUADRATIC and self._once("kinetic", term, lambda: self._is_kinetic(term))
            _require(kinetic and self.kinetic.isdisjoint(states))
            self.kinetic |= set(states)
            return
        _require(all(x in self.dof for x in states))
        dofs = [self.dof[x] for x in states]
        if kind is EnergyKind.QUADRATIC:
            return self._add(self._once("potential", term, lambda: lanes.potential(term)), term, x=dofs, o=dofs)
        _require(kind is EnergyKind.STRAIN)
        _require(
            not self._once("piecewise", term, lambda: piecewise(term.data["phi"], term.local[ValueKind.INVARIANT]))
        )
        self._add(self._once("strain", term, lambda: lanes.strain(term, self.layout.k)), term, x=dofs)

    def _is_kinetic(self, term: Term) -> bool:
        """True if the costates of a term are the velocities themselves, z_v = v."""
        x = term.local[ValueKind.STATE]
        defect = ca.gradient(term.data["H"], x) * term.data["scale"] - x
        f = ca.Function("f", [x, term.symbols(ValueKind.PARAMETER)], [defect])
        rng = np.random.default_rng(1)
        values = [rng.uniform(0.5, 2.0, f.numel_in(i)) for i in range(2)]
        return bool(np.max(np.abs(np.asarray(f(*values)))) <= 1e-13)

    def _flow(self, term: Term) -> None:
        outputs = [j for j, r in enumerate(term.rows) if r.kind is not Row.OUTPUT]
        _require(all(z in self.dof_v for z in term.indices(ValueKind.COSTATE)))
        if not outputs:
            return
        _require(all(term.rows[j].kind is Row.BALANCE and term.rows[j].index in self.dof_v for j in outputs))
        _require(term.local.keys() <= {ValueKind.STATE, ValueKind.COSTATE, ValueKind.INPUT, ValueKind.PARAMETER})
        _require(all(x in self.dof for x in term.indices(ValueKind.STATE)))
        self._add(
            self._once(("flow", *outputs), term, lambda: lanes.flow(term, outputs)), term,
            x=[self.dof[x] for x in term.indices(ValueKind.STATE)], z=[self.dof_v[z] for z in term.indices(ValueKind.COSTATE)],
            u=list(term.indices(ValueKind.INPUT)), o=[self.dof_v[term.rows[j].index] for j in outputs],
        )  # fmt: skip

    def _constraint(self, term: Term) -> None:
        if term.rows[0].index in self.resting:
            return
        _require(term.local.keys() <= {ValueKind.STATE, ValueKind.PARAMETER})
        _require(self._once("degree", term, lambda: degree(term.data["g"], term.local[ValueKind.STATE])) in (1, 2))
        known = self._once("constraint", term, lambda: lanes.constraint(term))
        self._add(known, term, x=[self.dof[x] for x in term.index[ValueKind.STATE]], multiplier=term.rows[0].index)

    def _depends(self, expr: ca.SX, term: Term, kind: ValueKind) -> bool:
        return kind in term.local and ca.depends_on(expr, term.local[kind])

    def _once(self, what: Hashable, term: Term, make: Callable[[], Made]) -> Made:
        """Kernels and properties follow from the key of a term: they are made once per kind."""
        key = what, term.key
        if key not in self.known:
            self.known[key] = make()
        return self.known[key]

    def _add(self, made: Lanes, term: Term, *, x=(), z=(), u=(), o=(), multiplier: int = -1) -> None:
        g = self.groups.setdefault(tuple(k.name for k in made.kernels), Instances(made.kernels))
        ends = (made.x.globally(x), made.z.globally(z), made.o.globally(o))
        g.add(*ends, list(u), list(term.indices(ValueKind.PARAMETER)), multiplier)

    # -- tables -----------------------------------------------------------------------------------------------------

    def _tables(self) -> SchurStepper:
        layout, nd, k, ndof = self.layout, nodes(self.layout.k), self.layout.k, len(self.position)
        groups, kinds, points, ends, multipliers = self._groups()
        light = sorted(self.dof_v[v] for v in inertia.light(self.terms))
        rows = [
            [(d, j, sign) for j in range(*span) for d, sign in zip(points[j], (1.0, -1.0), strict=True) if d < ndof]
            for span in zip(ends, ends[1:], strict=False)
        ]
        m = len(multipliers)
        bordered = np.block([[nd.a, -np.ones((k, 1))], [nd.b, np.zeros((1, 1))]])
        spectrum, modes, to_modes = lanes.spectrum(k)
        nominal = layout.nominals()
        self.load.sort()
        load = np.array([(d, kind, s) for d, kind, s, _ in self.load], np.int32).reshape(-1, 3)
        hard = eliminate(rows[:m], light, ends[-1])
        place = {r: i for i, r in enumerate(hard.order.tolist())}
        tiled_groups, tile = tiled(groups, kinds, ndof, load[:, 0])
        return SchurStepper(
            k=k, groups=tiled_groups, tile=tile, nconstraint=m, nstrain=len(rows) - m,
            position=_ints(self.position), velocity=_ints(self.velocity),
            nominal=np.array([nominal[layout.at(INCREMENT, v)] for v in self.velocity]),
            w_position=_ints(layout.at(INCREMENT, q, i) for q in self.position for i in range(k)),
            w_velocity=_ints(layout.at(INCREMENT, v, i) for v in self.velocity for i in range(k)),
            costate=_ints(layout.costate(v, i) for v in self.velocity for i in range(k)),
            w_lambda=_ints(layout.at(ALGEBRAIC, a, i) for a in multipliers for i in range(k)),
            w_mu=_ints(layout.at(VELOCITY_LEVEL, a) for a in multipliers),
            row_ptr=_ints(ends), point_plus=_ints(p for p, _ in points), point_minus=_ints(q for _, q in points),
            load_dof=load[:, 0].copy(), load_kind=load[:, 1].copy(), load_source=load[:, 2].copy(),
            load_value=np.array([v for *_, v in self.load], float),
            light=_ints(light), light_place=_ints(place[m + i] for i in range(len(light))),
            hard=hard, soft=None if light else self._soft(rows), extended=np.vstack([nd.a, nd.b]),
            multiplier=np.linalg.inv(bordered), spectrum=spectrum, modes=modes, to_modes=to_modes,
        )  # fmt: skip

    def _soft(self, rows: list[list[tuple[int, int, float]]]) -> Elimination | None:
        """The elimination of all rows where it is cheap beside the factor of the Newton matrix."""
        soft = FactorPattern(rows)
        if soft.updates > FEW * len(rows):
            nw, a = self.plan.nw, self.plan.matrix
            matrix = ca.Sparsity.triplet(nw, nw, a.row.tolist(), a.col.tolist())
            newton = updates(np.array(factor_pattern(matrix + matrix.T, self.plan.order.tolist()).colind()))
            if MODES[self.layout.k] * soft.updates > SHARE * newton:
                return None
        return soft.elimination()

    def _groups(self) -> tuple[list[LaneGroup], list[Instances], list[tuple[int, int]], list[int], list[int]]:
        """Groups, their instances; the coordinates; where those of each row end; the multiplier of each constraint."""
        out: list[LaneGroup] = []
        kinds: list[Instances] = []
        points: list[tuple[int, int]] = []
        ends, multipliers, ndof = [0], [], len(self.position)
        order = ("constraint", "strain", "mass", "load", "force")
        for _, g in sorted(self.groups.items(), key=lambda item: (order.index(item[1].kernels[0].kind), item[0])):
            g.sort()
            found = g.groups(len(ends) - 1, len(points), ndof)
            out, kinds = out + found, kinds + [g] * len(found)
            for plus, minus in g.x:
                points += [(p, m if m >= 0 else ndof) for p, m in zip(plus, minus, strict=True)]
                if g.kernels[0].kind in ("constraint", "strain"):
                    ends.append(len(points))
            multipliers += [a for a in g.multiplier if a >= 0]
        return out, kinds, points, ends, multipliers


def _ints(values: Iterable[int]) -> Ints:
    return np.array(list(values), np.int32)
