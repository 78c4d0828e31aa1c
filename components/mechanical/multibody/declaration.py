"""From the parts of a multibody system to its declaration."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import casadi as ca

from phfmu import (
    PHDAE,
    TRANSLATIONAL,
    Block,
    Energy,
    Guard,
    Holonomic,
    Jump,
    Observable,
    Port,
    StateEvent,
    Variable,
    algebraic,
    block,
    drive,
    energy,
    observable,
    parameter,
    skew,
    state,
    strain_energy,
    time,
)
from phfmu.components.mechanical.multibody.parts import (
    Constraint,
    DrivenPoint,
    LinearCombination,
    MovingSupport,
    Particle,
    ParticleSystem,
    Places,
    Point,
    Rate,
    Support,
)
from phfmu.components.mechanical.multibody.shapes import shapes


class Declaration:
    """The variables of one build and the terms on them."""

    def __init__(self, parts: ParticleSystem):
        self.parts, dim, masses = parts, parts.dim, parts.masses
        n = len(masses) * dim
        if not n:
            raise ValueError(f"{parts.name}: no particles")
        q, v = [x for m in masses for x in m.q], [x for m in masses for x in m.v]
        called = [f"{m.called}." if m.called else str(i + 1) for i, m in enumerate(masses)]
        axes = [f"{name}{axis}" for name in called for axis in "xyz"[:dim]]
        self.q = state("q", n, unit="m", start=q, description="positions of the particles", elements=axes)
        self.v = state("v", n, unit="m/s", start=v, description="velocities of the particles", elements=axes)
        self.m = parameter("m", [m.mass for m in masses], len(masses), unit="kg", description="masses")
        #: multiplier of each constraint, by its label
        self.multiplier: dict[str, Variable] = {}
        damped = {p for d in parts.dampers for p in (d.a, d.b) if isinstance(p, DrivenPoint)}
        self.s = {
            p: state(f"{p.name}.q", dim, unit="m", start=p.q, description=f"position of {p.name}") for p in parts.driven
        }
        self.w = {p: algebraic(f"{p.name}.w", dim, unit="m/s", description=f"velocity of {p.name}") for p in damped}
        self.f = {p: algebraic(f"{p.name}.f", dim, unit="N", description=f"force on {p.name}") for p in damped}
        self.integral = {i.name: state(i.name, unit=i.unit, start=i.start) for i in parts.integrals}
        self.driven = {
            p.name: algebraic(f"{p.name}.drive", unit=p.domain.effort_unit, description=f"drives {p.name}")
            for p in parts.rate_ports
            if p.given == "flow"
        }

    def at(self, point: Point) -> ca.SX:
        """Its position (dim x 1).  Raises ValueError for another object than a point."""
        if not isinstance(point, Particle | Support | MovingSupport | DrivenPoint | LinearCombination):
            raise ValueError(
                f"{self.parts.name}: at({point!r}): that is no point; give what particle(), support(), moving_support() or "
                "driven_point() returned"
            )
        if isinstance(point, Support):
            return ca.SX(ca.DM(list(point.position)))
        if isinstance(point, MovingSupport):
            return ca.vertcat(*map(ca.SX, point.position(time)))
        if isinstance(point, LinearCombination):
            fixed = 0 if point.fixed is None else point.fixed
            return _weighted(point, self.parts.dim, self.at) + fixed
        return self.s[point].sx if isinstance(point, DrivenPoint) else self.q[self.parts.rows(point)]

    def speed(self, point: Point) -> ca.SX:
        """Its velocity (dim x 1), zero for supports."""
        if isinstance(point, LinearCombination):
            return _weighted(point, self.parts.dim, self.speed)
        if isinstance(point, Particle):
            return self.v[self.parts.rows(point)]
        return self.w[point].sx if isinstance(point, DrivenPoint) else ca.SX(self.parts.dim, 1)

    def part(self, particle: Particle) -> Variable:
        """Its velocity."""
        return self.v.part(particle.number * self.parts.dim, self.parts.dim)

    def velocities(self, points: Iterable[Point]) -> list[Variable]:
        """The variables that the velocities of points are made of, each once; none for supports."""
        particles = dict.fromkeys(p for x in points for p in _particles(x))
        return [self.part(p) if isinstance(p, Particle) else self.w[p] for p in particles]

    def linear_form(self, points: Sequence[Point], rate: Rate) -> tuple[list[Variable], ca.SX]:
        """The velocities and J(q) of rate = J v."""
        on = self.velocities(points)
        if not on:
            return on, ca.SX(self.parts.dim, 0)
        return on, ca.jacobian(rate(self.at, self.speed), ca.vertcat(*(v.sx for v in on)))

    def phdae(self) -> PHDAE:
        parts = self.parts
        constraints, multipliers = self.constraints()
        structure = [skew(self.q, self.v, 1.0)]
        for p, w in self.w.items():
            structure += [skew(self.s[p], w, 1.0), skew(w, self.f[p], 1.0)]
        structure += self.rates()
        energies, dissipation = tuple(self.energies()), tuple(self.dissipation())
        ports, observables, events = tuple(self.ports()), tuple(self.observables()), tuple(self.events())
        return PHDAE(
            parts.name,
            states=(self.q, self.v, *self.s.values(), *self.integral.values()),
            algebraics=(*multipliers, *self.w.values(), *self.f.values(), *self.driven.values()),
            parameters=(self.m, *parts.parameters),  # some are made by the expressions above
            energies=energies,
            E={self.v: ca.vertcat(*(s for s in ca.vertsplit(self.m.sx) for _ in range(parts.dim)))},
            structure=tuple(structure),
            dissipation=dissipation,
            ports=ports,
            constraints=constraints,
            state_events=events,
            observables=observables,
            description=parts.description,
            shapes=shapes(self),
        )

    def energies(self) -> Iterator[Energy]:
        parts = self.parts
        for i, m in enumerate(ca.vertsplit(self.m.sx)):
            p = Particle(i)
            yield energy(0.5 * m * ca.sumsqr(self.v[parts.rows(p)]))
            if parts.gravity is not None and parts.masses[i].weight:
                yield energy(-m * ca.dot(ca.DM(list(parts.gravity)), self.at(p)))
        for s in parts.springs:
            yield strain_energy(ca.sumsqr(self.at(s.b) - self.at(s.a)), s.potential)
        for s in parts.strains:
            yield strain_energy(s.invariant(self.at), s.potential)
        for made in parts.potentials:
            yield energy(self.of_positions("a potential", made))
        for i, angle in zip(parts.integrals, self.integral.values(), strict=True):
            if i.energy is not None:
                yield energy(i.energy(angle.sx))

    def rates(self) -> Iterator[Block]:
        """Structure of what integrates a rate, and of the forces that keep one."""
        for i, angle in zip(self.parts.integrals, self.integral.values(), strict=True):
            for v, column in self.columns(i.points, i.rate):
                yield skew(angle, v, column.T)
        for p in self.parts.rate_ports:
            if p.given == "flow":
                for v, column in self.columns(p.points, p.rate):
                    yield skew(v, self.driven[p.name], column)

    def columns(self, points: Sequence[Point], rate: Rate) -> Iterator[tuple[Variable, ca.SX]]:
        """Velocity and its rows of J^T, where they are not zero."""
        on, form = self.linear_form(points, rate)
        first = 0
        for v in on:
            column = form[:, first : first + v.n].T
            first += v.n
            if column.nnz():
                yield v, ca.densify(column)

    def dissipation(self) -> Iterator[Block]:
        for d in self.parts.dampers:
            on, form = self.linear_form((d.a, d.b), lambda _, speed, d=d: speed(d.b) - speed(d.a))
            if on:
                value, factor = d.factors(self.at(d.b) - self.at(d.a), form)
                yield block(on, value, factor=factor)
        for r in self.parts.rate_dampers:
            columns = list(self.columns(r.points, r.rate))
            value: Any = r.value(self) if callable(r.value) else getattr(r.value, "sx", r.value)
            yield block([v for v, _ in columns], value, factor=ca.vertcat(*(c for _, c in columns)).T)

    def events(self) -> Iterator[StateEvent]:
        """Contacts: where a gap closes, an impulse along its gradient turns its rate round."""
        for c in self.parts.contacts:
            gap = c.gap(self)
            column = ca.jacobian(gap, self.q.sx).T
            for i, angle in zip(self.parts.integrals, self.integral.values(), strict=True):
                if ca.depends_on(gap, angle.sx):
                    column += ca.jacobian(gap, angle.sx) * ca.jacobian(i.rate(self.at, self.speed), self.v.sx).T
            jump = Jump({self.v: ca.densify(column)}, c.restitution.sx, law="unilateral")
            yield StateEvent(Guard(c.name, gap, -1, c.nominal, c.unit), jump=jump)

    def ports(self) -> Iterator[Port]:
        dim = self.parts.dim
        one = ca.SX.eye(dim)
        for name, p, base in self.parts.ports:
            on = {self.part(p): one} | ({} if base is None else {self.part(base): -one})
            whom = f"particle {p.number + 1}" + ("" if base is None else f", reaction on particle {base.number + 1}")
            yield Port(name, TRANSLATIONAL, "effort", on, dim, description=f"force on {whom}")
        for p in self.parts.driven:
            on = {self.f.get(p, self.s[p]): one}
            yield Port(p.name, TRANSLATIONAL, "flow", on, dim, description=f"velocity of the driven point {p.name}")
        for p in self.parts.rate_ports:
            on = {self.driven[p.name]: 1.0} if p.given == "flow" else dict(self.columns(p.points, p.rate))
            yield Port(p.name, p.domain, p.given, on, description=p.description)

    def observables(self) -> Iterator[Observable]:
        for r in self.parts.reported:
            yield observable(r.name, r.of(self), unit=r.unit, description=r.description)

    def constraints(self) -> tuple[tuple[Holonomic, ...], tuple[Variable, ...]]:
        """Constraints and the multiplier variable they share by parts."""
        items = [(c, ca.SX(self.of_positions(c.label, c.g))) for c in (*self.parts.bars, *self.parts.constraints)]
        if not items:
            return (), ()
        shared = sum(g.numel() for c, g in items if c.multiplier is None)
        lam = algebraic("lambda", shared, unit="N/m", description="multipliers") if shared else None
        variables = [lam] if lam else []
        drives: dict[str, Port] = {}
        out, first = [], 0
        for c, g in items:
            port = None
            if ca.depends_on(g, time):
                name = self.drive_name(c, g)
                port = drives.setdefault(name, drive(name, description=f"work of the moving constraints of {name}"))
            if c.multiplier is not None:
                name, unit = c.multiplier
                own = algebraic(name, g.numel(), unit=unit, description=f"multipliers of {c.label}")
                variables.append(own)
            else:
                assert lam is not None
                own = lam.part(first, g.numel())
                first += g.numel()
            self.multiplier[own.name if c.multiplier else c.label] = own
            out.append(Holonomic(own, ca.vec(g), drive=port, label=c.label, kept=c.kept))
        return tuple(out), tuple(variables)

    def of_positions(self, label: str, made: Callable[[Places], Any]) -> Any:
        """A function of positions, made; ValueError says how positions are indexed where CasADi refuses what it does."""
        try:
            return made(self.at)
        except RuntimeError as error:
            axes = ", ".join(f"[{i}] is {axis}" for i, axis in enumerate("xyz"[: self.parts.dim]))
            raise ValueError(
                f"{self.parts.name}: {label}: {str(error).splitlines()[-1]}; at(point) is a column of {self.parts.dim} "
                f"entries that count from 0: {axes}"
            ) from error

    def drive_name(self, c: Constraint, g: ca.SX) -> str:
        """The component that the work of a moving constraint is booked at."""
        touched: dict[str, None] = {}

        def seen(point: Point) -> ca.SX:
            if isinstance(point, MovingSupport):
                touched[point.name] = None
            return self.at(point)

        c.g(seen)
        if not c.drive and len(touched) > 1:
            raise ValueError(
                f"{self.parts.name}: {c.label} touches the moving supports {', '.join(touched)}, whose work cannot be told "
                "apart; give them one name, or name the constraint's drive"
            )
        return c.drive or next(iter(touched), "drive")


def _particles(point: Point) -> tuple[Particle | DrivenPoint, ...]:
    """The particles that move a point."""
    if isinstance(point, LinearCombination):
        return tuple(p for p, _ in point.terms)
    return (point,) if isinstance(point, Particle | DrivenPoint) else ()


def _weighted(point: LinearCombination, dim: int, of: Callable[[Point], ca.SX]) -> ca.SX:
    total = ca.SX(dim, 1)
    for particle, weight in point.terms:
        total += ca.mtimes(ca.SX(weight), of(particle)) if ca.SX(weight).numel() > 1 else weight * of(particle)
    return total
