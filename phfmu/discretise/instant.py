"""The instant plan: outputs, observables, energies and algebraic variables at one instant.

Given x, t and u:  algebraic rows that contain algebraic variables are solved as they are (index 1); rows that contain
states only are differentiated once (index 2: Kirchhoff at bare nodes, holonomic constraints) and solved together with
x1' from E11 x1' = [(J - R) z + B u]_1.  The undifferentiated rows are reported as checks of a consistent state.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from phfmu.declare.error import DeclarationError
from phfmu.declare.value import Value
from phfmu.plan.address import (
    READ,
    Address,
    costate,
    costate_row,
    gradient,
    increment,
    row,
    source,
)
from phfmu.plan.arguments import Arguments
from phfmu.plan.layout import Layout
from phfmu.plan.plan import Plan
from phfmu.plan.planner import Maps, make_plan
from phfmu.plan.spec import Result, Spec
from phfmu.plan.unknown import ALGEBRAIC, COSTATE, INCREMENT, Role, of_algebraics, of_states
from phfmu.schemes.scheme import node_holds
from phfmu.schemes.velocities import force, velocity_costate, velocity_increment
from phfmu.terms.hidden import Check, Hidden, rates, variable_at
from phfmu.terms.located import Row, ValueAt
from phfmu.terms.term import (
    CLOSED,
    CONSTRAINT,
    EMPTY,
    ENERGY,
    FLOW,
    JOINT,
    MASS,
    MASS_BLOCK,
    OBSERVABLE,
    SOURCE,
    Term,
    Terms,
)
from phfmu.terms.velocities import velocity_of

#: the rate of an algebraic variable that a differentiated row contains; its row is the undifferentiated one that gives it
RATE = Role("rate of an algebraic variable")


def algebraic_rate(layout: Layout, term: Term, j: int, node: int) -> int:
    """The rate of the j-th algebraic variable that the term reads."""
    return layout.at(RATE, term.index[Value.ALGEBRAIC][j], node)


def input_rate(layout: Layout, term: Term, j: int, node: int) -> int:
    """The rate of the algebraic variable that feeds the j-th input that the term reads."""
    return layout.at(RATE, layout.terms.bound[term.index[Value.INPUT][j]], node)


def costate_rate(layout: Layout, term: Term, j: int, node: int) -> int:
    """The rate of the j-th costate that the term reads."""
    del node
    return layout.costate_rate(term.index[Value.COSTATE][j])


def velocity_costate_rate(layout: Layout, term: Term, j: int, node: int) -> int:
    """The rate of the costate of the velocity that belongs to the term's j-th position."""
    del node
    return layout.costate_rate(velocity_of(layout.terms)[term.index[Value.STATE][j]])


def gradient_rate(layout: Layout, term: Term, j: int, node: int) -> int:
    """Slot of the rate of the costate of the term's j-th state."""
    del node
    return layout.rate_slot(term.rows[j].index)


def source_rate(layout: Layout, term: Term, j: int, node: int) -> int:
    """Slot of the rate of a source."""
    del j, node
    return layout.source_rate_slot(term.rows[0].index)


def velocity_check(layout: Layout, term: Term, j: int, node: int) -> int:
    """The reported term's j-th row, undifferentiated."""
    del node
    return layout.report(("velocity", term.rows[j].index))


def position_check(layout: Layout, term: Term, j: int, node: int) -> int:
    """The reported constraint g."""
    del node
    return layout.report(("position", term.rows[j].index))


def instant_plan(terms: Terms, rests: bool = True) -> tuple[Plan, list[Check], Layout]:
    """The instant plan, its checks (reported as the last observables), and where its unknowns are.

    `rests`: redundant constraints may rest.
    """
    hidden, solved = terms.found(Hidden), terms.solved_costates()
    if hidden.rows and solved:
        raise DeclarationError(
            terms.model.name,
            "constraints together with a non-diagonal or state-dependent E are not supported yet",
            "use coordinates with a diagonal E",
            "descriptor",
        )
    unknowns = of_states(terms, INCREMENT, "rate of", range(terms.n1)) if hidden.rows else []
    unknowns += of_states(terms, COSTATE, "costate of", solved)
    unknowns += of_algebraics(terms, ALGEBRAIC, "equation of", range(terms.na))
    unknowns += of_algebraics(terms, RATE, "rate of", sorted(hidden.solved_by.values()))
    position = {t.rows[0].index for t in terms.of(CONSTRAINT)}
    levels = (("velocity", hidden.checks), ("position", sorted(position)))
    checks = [Check(terms.algebraic_names[a], level, a) for level, which in levels for a in which]
    reports = [*range(len(terms.observable_names)), *((c.level, c.row) for c in checks)]
    layout = Layout(terms, 1, unknowns, reports, rates=bool(hidden.rows))
    rule = _Instant(hidden, terms.bound)
    cache: dict[tuple, list[Spec]] = {}
    work = []
    for term in terms.terms:
        key = (term.key, tuple((hidden.differentiates(r), r.index in hidden.solved_by) for r in term.rows))
        if key not in cache:
            cache[key] = rule.specs(term)
        work.append((term, cache[key]))
    mean = [(i, layout.at(ALGEBRAIC, i), 1.0, 0) for i in range(terms.na)]
    guess = [[(w, 1.0, 0)] for w in range(layout.nw)]
    maps = Maps([], mean, guess, np.ones(1), np.full(1, 0.5))
    hold = node_holds(layout) if rests else None
    return make_plan(layout, work, _constants(layout, hidden), maps, hold), checks, layout


@dataclass(frozen=True)
class _Instant:
    """Kernels of the instant plan."""

    hidden: Hidden
    bound: dict[int, int]

    @property
    def rate(self) -> bool:
        """True if x1' is among the unknowns."""
        return bool(self.hidden.rows)

    def specs(self, term: Term) -> list[Spec]:
        build = {
            ENERGY: self._energy,
            JOINT: self._energy,
            CLOSED: self._closed,
            MASS: self._mass,
            MASS_BLOCK: self._mass_block,
            SOURCE: self._source,
            FLOW: self._flow,
            OBSERVABLE: self._observable,
            CONSTRAINT: self._constraint,
        }[term.kind]
        return build(term)

    def _energy(self, term: Term) -> list[Spec]:
        args, x = Arguments(term, 1), term.local[Value.STATE]
        w = term.data["z"] if "z" in term.data else ca.gradient(term.data["H"], x) * term.data["scale"]
        return [self._costates(args, x, w, term.data["H"])]

    def _costates(self, args: Arguments, x: ca.SX, w: ca.SX, h: ca.SX) -> Spec:
        rows = range(x.numel())
        out: list[Result] = [(Address(gradient, j), 0, w[j]) for j in rows]
        if self.rate:
            dw = ca.jtimes(w, x, args.matrix(increment, x.numel()))
            out += [(Address(gradient_rate, j), 0, dw[j]) for j in rows]
        return Spec(0, args.x, args.p, args.y, out, stored=h)

    def _closed(self, term: Term) -> list[Spec]:
        args, x = Arguments(term, 1), term.local[Value.STATE]
        specs = [self._costates(args, x, term.data["z"], term.data["H"])]
        if self.rate:
            args = Arguments(term, 1)
            e = ca.mtimes(term.data["E"], args.matrix(increment, x.numel()))
            specs.append(Spec(1, args.x, args.p, args.y, [(Address(row, j), 0, e[j]) for j in range(x.numel())]))
        return specs

    def _mass(self, term: Term) -> list[Spec]:
        if not self.rate:
            return []
        args = Arguments(term, 1)
        r = args.matrix(increment, 1)
        return [Spec(1, EMPTY, args.p, args.y, [(Address(row), 0, term.data["m"] * r)])]

    def _mass_block(self, term: Term) -> list[Spec]:
        args, n = Arguments(term, 1), len(term.rows)
        z = args.matrix(costate, n)
        back = ca.mtimes(term.data["E"].T, z)
        return [Spec(1, args.x, args.p, args.y, [(Address(costate_row, j), 0, back[j]) for j in range(n)])]

    def _source(self, term: Term) -> list[Spec]:
        args, s = Arguments(term, 1), term.data["s"]
        rate = ca.gradient(s, term.local[Value.TIME]) if Value.TIME in term.local else ca.SX(0)
        out: list[Result] = [(Address(source), 0, s)]
        if self.rate:
            out.append((Address(source_rate), 0, rate))
        return [Spec(0, args.x, args.p, args.y, out)]

    def _flow(self, term: Term) -> list[Spec]:
        args, local, f = Arguments(term, 1), term.local, term.data["f"]
        chosen = [j for j, r in enumerate(term.rows) if self.hidden.differentiates(r)]
        made = {k: args.matrix(place, local[k].numel()) for k, place in READ.items() if k in local}
        drift = self._drift(term, args, chosen) if chosen else ca.SX(f.numel(), 1)
        f, drift = ca.substitute([f, drift], [local[k] for k in made], list(made.values()))
        out: list[Result] = []
        for j, r in enumerate(term.rows):
            if r.kind is Row.BALANCE and not self.rate:
                continue
            value = f[j] if r.kind is Row.OUTPUT else -(drift[j] if j in chosen else f[j])
            out.append((Address(row, j), 0, value))
            if j in chosen and r.index in self.hidden.solved_by:
                out.append((Address(self._original, j), 0, -f[j]))
            elif j in chosen:
                out.append((Address(velocity_check, j), 0, f[j]))
        return [Spec(1, args.x, args.p, args.y, out)] if out else []

    def _drift(self, term: Term, args: Arguments, chosen: list[int]) -> ca.SX:
        """df/dt along x1', the costate rates and the rates of algebraic variables; held inputs have none."""
        local, f = term.local, term.data["f"]
        drift = ca.SX(f.numel(), 1)
        if Value.STATE in local:
            drift += ca.jtimes(f, local[Value.STATE], args.matrix(increment, local[Value.STATE].numel()))
        if Value.COSTATE in local:
            drift += ca.jtimes(f, local[Value.COSTATE], args.matrix(costate_rate, local[Value.COSTATE].numel()))
        if Value.TIME in local:
            drift += ca.jacobian(f, local[Value.TIME])
        place = {Value.ALGEBRAIC: algebraic_rate, Value.INPUT: input_rate}
        for at in rates(term, chosen, self.bound):
            drift += ca.jacobian(f, local[at.kind][at.index]) * args.symbol(place[at.kind], at.index)
        return drift

    def _original(self, layout: Layout, term: Term, j: int, node: int) -> int:
        """The undifferentiated form of the term's j-th row, which gives a variable."""
        return layout.at(RATE, self.hidden.solved_by[term.rows[j].index], node)

    def _observable(self, term: Term) -> list[Spec]:
        args, local, f = Arguments(term, 1), term.local, term.data["f"]
        made = {k: args.matrix(place, local[k].numel()) for k, place in READ.items() if k in local}
        (f,) = ca.substitute([f], [local[k] for k in made], list(made.values()))
        return [Spec(1, args.x, args.p, args.y, [(Address(row, j), 0, f[j]) for j in range(f.numel())])]

    def _constraint(self, term: Term) -> list[Spec]:
        args, q, g = Arguments(term, 1), term.local[Value.STATE], term.data["g"]
        n = q.numel()
        z, dz = args.matrix(velocity_costate, n), args.matrix(velocity_costate_rate, n)
        lam, r = args.matrix(force, 1), args.matrix(increment, n)
        grad, t = ca.gradient(g, q), term.local.get(Value.TIME)
        moving = ca.SX(0) if t is None else ca.gradient(g, t)
        speed = ca.dot(grad, z) + moving
        rate = ca.dot(grad, dz) + ca.dot(ca.gradient(speed, q), r)
        rate += 0 if t is None else ca.gradient(speed, t)
        out: list[Result] = [(Address(velocity_increment, j), 0, grad[j] * lam) for j in range(n)]
        out += [(Address(row), 0, -rate), (Address(velocity_check), 0, speed), (Address(position_check), 0, g)]
        if t is not None:
            out.append((Address(row, 1), 0, lam * moving))
        return [Spec(1, args.x, args.p, args.y, out)]


def _constants(layout: Layout, hidden: Hidden) -> list[tuple[int, int, float, int]]:
    terms, out = layout.terms, []
    other = terms.with_descriptor()
    if hidden.rows:
        out += [(w, w, 1.0, 0) for w in (layout.at(INCREMENT, i) for i in range(terms.n1) if i not in other)]
    out += [(layout.at(COSTATE, i), layout.nv + layout.slot(i, 0), -1.0, 0) for i in terms.solved_costates()]
    for c in terms.constants:
        if c.row.kind is Row.BALANCE and not hidden.rows:
            continue
        source, r = layout.value(c.source), c.row.index
        if hidden.differentiates(c.row):
            if r in hidden.solved_by:
                out.append((layout.at(RATE, hidden.solved_by[r]), source, -c.value, 0))
            else:
                out.append((layout.report(("velocity", r)), source, c.value, 0))
            rate = _rate(layout, c.source)
            if rate is not None:
                out.append((layout.row(c.row), rate, -c.value, 0))
        else:
            out.append((layout.row(c.row), source, c.value if c.row.kind is Row.OUTPUT else -c.value, 0))
    return out


def _rate(layout: Layout, value: ValueAt) -> int | None:
    """Y index of the time derivative of a value in a differentiated row; held inputs have none."""
    variable = variable_at(value, layout.terms.bound)
    if variable is not None:
        return layout.at(RATE, variable)
    if value.kind is Value.COSTATE:
        return layout.costate_rate(value.index)
    return layout.nv + layout.source_rate_slot(value.index) if value.index in layout.sources else None
