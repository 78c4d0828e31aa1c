"""Kernels of the instant plan, whose rows are differentiated where `hidden` says so.

Rates of values in differentiated rows: where kernels of the instant plan find them, and what is reported undifferentiated.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from phfmu.declare.variable import ValueKind
from phfmu.plan.address import READ, Address, costate, costate_row, gradient, increment, row, source
from phfmu.plan.layout import Layout
from phfmu.plan.spec import Arguments, Result, Spec
from phfmu.plan.unknown import Role
from phfmu.schemes.constraints.velocities import force, velocity_costate, velocity_increment
from phfmu.terms.hidden import HiddenConstraints, rates
from phfmu.terms.located import Row
from phfmu.terms.term import CLOSED, CONSTRAINT, EMPTY, ENERGY, FLOW, JOINT, MASS, MASS_BLOCK, OBSERVABLE, SOURCE, Term
from phfmu.terms.velocities import velocity_of

#: the rate of an algebraic variable that a differentiated row contains; its row is the undifferentiated one that gives it
RATE = Role("rate of an algebraic variable")


def algebraic_rate(layout: Layout, term: Term, j: int, node: int) -> int:
    """The rate of the j-th algebraic variable that the term reads."""
    return layout.at(RATE, term.index[ValueKind.ALGEBRAIC][j], node)


def input_rate(layout: Layout, term: Term, j: int, node: int) -> int:
    """The rate of the algebraic variable that feeds the j-th input that the term reads."""
    return layout.at(RATE, layout.terms.bound[term.index[ValueKind.INPUT][j]], node)


def costate_rate(layout: Layout, term: Term, j: int, node: int) -> int:
    """The rate of the j-th costate that the term reads."""
    del node
    return layout.costate_rate(term.index[ValueKind.COSTATE][j])


def velocity_costate_rate(layout: Layout, term: Term, j: int, node: int) -> int:
    """The rate of the costate of the velocity that belongs to the term's j-th position."""
    del node
    return layout.costate_rate(velocity_of(layout.terms)[term.index[ValueKind.STATE][j]])


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


@dataclass(frozen=True)
class InstantKernels:
    """Kernels of the instant plan."""

    hidden: HiddenConstraints
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
        args, x = Arguments(term, 1), term.local[ValueKind.STATE]
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
        args, x = Arguments(term, 1), term.local[ValueKind.STATE]
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
        rate = ca.gradient(s, term.local[ValueKind.TIME]) if ValueKind.TIME in term.local else ca.SX(0)
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
        if ValueKind.STATE in local:
            drift += ca.jtimes(f, local[ValueKind.STATE], args.matrix(increment, local[ValueKind.STATE].numel()))
        if ValueKind.COSTATE in local:
            drift += ca.jtimes(f, local[ValueKind.COSTATE], args.matrix(costate_rate, local[ValueKind.COSTATE].numel()))
        if ValueKind.TIME in local:
            drift += ca.jacobian(f, local[ValueKind.TIME])
        place = {ValueKind.ALGEBRAIC: algebraic_rate, ValueKind.INPUT: input_rate}
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
        args, q, g = Arguments(term, 1), term.local[ValueKind.STATE], term.data["g"]
        n = q.numel()
        z, dz = args.matrix(velocity_costate, n), args.matrix(velocity_costate_rate, n)
        lam, r = args.matrix(force, 1), args.matrix(increment, n)
        grad, t = ca.gradient(g, q), term.local.get(ValueKind.TIME)
        moving = ca.SX(0) if t is None else ca.gradient(g, t)
        speed = ca.dot(grad, z) + moving
        rate = ca.dot(grad, dz) + ca.dot(ca.gradient(speed, q), r)
        rate += 0 if t is None else ca.gradient(speed, t)
        out: list[Result] = [(Address(velocity_increment, j), 0, grad[j] * lam) for j in range(n)]
        out += [(Address(row), 0, -rate), (Address(velocity_check), 0, speed), (Address(position_check), 0, g)]
        if t is not None:
            out.append((Address(row, 1), 0, lam * moving))
        return [Spec(1, args.x, args.p, args.y, out)]
