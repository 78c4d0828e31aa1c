"""From the parts of a multibody system to its declaration."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import casadi as ca

from phfmu import (
    PHDAE,
    TRANSLATIONAL,
    Block,
    Energy,
    Holonomic,
    Port,
    Variable,
    algebraic,
    block,
    drive,
    energy,
    parameter,
    skew,
    state,
    strain_energy,
    time,
)
from phfmu.components.mechanical.multibody_parts import (
    Constraint,
    DrivenPoint,
    MovingSupport,
    Particle,
    Parts,
    Places,
    Point,
    Support,
)


class Declaration:
    """The variables of one build and the terms on them."""

    def __init__(self, parts: Parts):
        self.parts, dim, masses = parts, parts.dim, parts.masses
        n = len(masses) * dim
        if not n:
            raise ValueError(f"{parts.name}: no particles")
        q, v = [x for m in masses for x in m.q], [x for m in masses for x in m.v]
        axes = [f"{i + 1}{axis}" for i in range(len(masses)) for axis in "xyz"[:dim]]
        self.q = state("q", n, unit="m", start=q, description="positions of the particles", elements=axes)
        self.v = state("v", n, unit="m/s", start=v, description="velocities of the particles", elements=axes)
        self.m = parameter("m", [m.mass for m in masses], len(masses), unit="kg", description="masses")
        damped = {p for d in parts.dampers for p in (d.a, d.b) if isinstance(p, DrivenPoint)}
        self.s = {
            p: state(f"{p.name}.q", dim, unit="m", start=p.q, description=f"position of {p.name}") for p in parts.driven
        }
        self.w = {p: algebraic(f"{p.name}.w", dim, unit="m/s", description=f"velocity of {p.name}") for p in damped}
        self.f = {p: algebraic(f"{p.name}.f", dim, unit="N", description=f"force on {p.name}") for p in damped}

    def at(self, point: Point) -> ca.SX:
        """Its position (dim x 1). Errors: ValueError for what is no point."""
        if not isinstance(point, Particle | Support | MovingSupport | DrivenPoint):
            raise ValueError(
                f"{self.parts.name}: at({point!r}): that is no point; give what particle(), support(), moving_support() or "
                "driven_point() returned"
            )
        if isinstance(point, Support):
            return ca.SX(ca.DM(list(point.position)))
        if isinstance(point, MovingSupport):
            return ca.vertcat(*map(ca.SX, point.position(time)))
        return self.s[point].sx if isinstance(point, DrivenPoint) else self.q[self.parts.rows(point)]

    def part(self, particle: Particle) -> Variable:
        """Its velocity."""
        return self.v.part(particle.number * self.parts.dim, self.parts.dim)

    def velocity(self, point: Point) -> Variable | None:
        """The variable a damper acts on, None for supports."""
        if isinstance(point, Particle):
            return self.part(point)
        return self.w[point] if isinstance(point, DrivenPoint) else None

    def phdae(self) -> PHDAE:
        parts = self.parts
        constraints, multipliers = self.constraints()
        structure = [skew(self.q, self.v, 1.0)]
        for p, w in self.w.items():
            structure += [skew(self.s[p], w, 1.0), skew(w, self.f[p], 1.0)]
        return PHDAE(
            parts.name,
            states=(self.q, self.v, *self.s.values()),
            algebraics=(*multipliers, *self.w.values(), *self.f.values()),
            parameters=(self.m, *parts.parameters),
            energies=tuple(self.energies()),
            E={self.v: ca.vertcat(*(s for s in ca.vertsplit(self.m.sx) for _ in range(parts.dim)))},
            structure=tuple(structure),
            dissipation=tuple(self.dissipation()),
            ports=tuple(self.ports()),
            constraints=constraints,
            description=parts.description,
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
        for made in parts.potentials:
            yield energy(self.of_positions("a potential", made))

    def dissipation(self) -> Iterator[Block]:
        for d in self.parts.dampers:
            ends = [v for v in map(self.velocity, (d.a, d.b)) if v is not None]
            if ends:
                yield block(ends, d.matrix(self.at(d.b) - self.at(d.a), len(ends)))

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

    def constraints(self) -> tuple[tuple[Holonomic, ...], tuple[Variable, ...]]:
        """Constraints and the multiplier variable they share by parts."""
        items = [(c, ca.SX(self.of_positions(c.label, c.g))) for c in (*self.parts.bars, *self.parts.constraints)]
        if not items:
            return (), ()
        total = sum(g.numel() for _, g in items)
        lam = algebraic("lambda", total, unit="N/m", description="multipliers")
        drives: dict[str, Port] = {}
        out, first = [], 0
        for c, g in items:
            port = None
            if ca.depends_on(g, time):
                name = self.drive_name(c, g)
                port = drives.setdefault(name, drive(name, description=f"work of the moving constraints of {name}"))
            out.append(Holonomic(lam.part(first, g.numel()), ca.vec(g), drive=port, label=c.label))
            first += g.numel()
        return tuple(out), (lam,)

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
