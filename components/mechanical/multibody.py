"""A builder for particle systems with springs, dampers, bars, gravity, supports, constraints and ports.

q' = v,   M v' = -DV(q) - R(q) v - Dg(q)^T lambda + B u,   0 = Dg(q) v,   H = 1/2 v^T M v + V(q)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca

from phfmu import (
    PHDAE,
    TRANSLATIONAL,
    Block,
    Holonomic,
    Port,
    Variable,
    algebraic,
    block,
    energy,
    parameter,
    skew,
    state,
    strain_energy,
)

Potential = Callable[[ca.SX], ca.SX]


@dataclass(frozen=True)
class Particle:
    """A handle: the particle's number (from 0)."""

    number: int


@dataclass(frozen=True)
class Support:
    """A fixed point in space."""

    position: tuple[float, ...]


Point = Particle | Support


@dataclass(frozen=True)
class _Spring:
    a: Point
    b: Point
    potential: Potential


@dataclass(frozen=True)
class _Damper:
    a: Point
    b: Point
    value: Callable[[ca.SX], ca.SX]


@dataclass
class Multibody:
    """Particles in `dim` = 1, 2 or 3 dimensions; add parts, then `build()` the declaration.

    Springs and dampers may depend on parameters made by `parameter`.  Errors: ValueError names the part and the numbers.
    """

    name: str
    dim: int = 3
    description: str = ""
    _mass: list[float] = field(default_factory=list)
    _q: list[float] = field(default_factory=list)
    _v: list[float] = field(default_factory=list)
    _parameters: list[Variable] = field(default_factory=list)
    _springs: list[_Spring] = field(default_factory=list)
    _dampers: list[_Damper] = field(default_factory=list)
    _bars: list[tuple[Point, Point, float]] = field(default_factory=list)
    _constraints: list[Callable[[Callable[[Point], ca.SX]], ca.SX]] = field(default_factory=list)
    _ports: list[tuple[str, Particle]] = field(default_factory=list)
    _gravity: tuple[float, ...] | None = None

    def particle(self, mass: float, q: Sequence[float], v: Sequence[float] | None = None) -> Particle:
        """A point mass [kg] at q [m] with velocity v [m/s] (default: at rest)."""
        velocity = [0.0] * self.dim if v is None else list(v)
        if len(q) != self.dim or len(velocity) != self.dim:
            raise ValueError(f"{self.name}: particle {len(self._mass) + 1}: q and v need {self.dim} entries")
        if not mass > 0:
            raise ValueError(f"{self.name}: particle {len(self._mass) + 1}: mass {mass} kg must be positive")
        self._mass.append(float(mass))
        self._q += map(float, q)
        self._v += velocity
        return Particle(len(self._mass) - 1)

    def support(self, position: Sequence[float]) -> Support:
        """A fixed point."""
        if len(position) != self.dim:
            raise ValueError(f"{self.name}: a support needs {self.dim} coordinates, got {len(position)}")
        return Support(tuple(map(float, position)))

    def parameter(self, name: str, value: Any, *, unit: str = "1", description: str = "") -> Variable:
        """A parameter that springs and dampers may use."""
        made = parameter(name, value, unit=unit, description=description)
        self._parameters.append(made)
        return made

    def spring(self, a: Point, b: Point, potential: Potential) -> None:
        """An elastic bond with energy potential(s) of the squared distance s = |b - a|^2 [m2]."""
        self._springs.append(_Spring(a, b, potential))

    def linear_spring(self, a: Point, b: Point, k: Any, length: float) -> None:
        """1/2 k (|b - a| - length)^2 with k in N/m."""
        self.spring(a, b, lambda s: 0.5 * k * (ca.sqrt(s) - length) ** 2)

    def quartic_spring(self, a: Point, b: Point, k: Any, length: float = 1.0) -> None:
        """1/2 k (|b - a|^2 - length^2)^2 with k in N/m3."""
        self.spring(a, b, lambda s: 0.5 * k * (s - length**2) ** 2)

    def damper(self, a: Point, b: Point, value: Callable[[ca.SX], ca.SX]) -> None:
        """A damper on the full relative velocity with coefficient value(s) [N.s/m] of the squared distance s."""
        self._dampers.append(_Damper(a, b, value))

    def bar(self, a: Point, b: Point, length: float | None = None) -> None:
        """A massless rigid bar, g = (|b - a|^2 - length^2)/2; length defaults to the distance at the start."""
        distance = length
        if distance is None:
            d = [y - x for x, y in zip(self._start(a), self._start(b), strict=True)]
            distance = sum(x * x for x in d) ** 0.5
        self._bars.append((a, b, float(distance)))

    def constraint(self, g: Callable[[Callable[[Point], ca.SX]], ca.SX]) -> None:
        """A holonomic constraint g = 0; `g` gets a function that maps a point to its position."""
        self._constraints.append(g)

    def gravity(self, acceleration: Sequence[float]) -> None:
        """A uniform field [m/s2]."""
        if len(acceleration) != self.dim:
            raise ValueError(f"{self.name}: gravity needs {self.dim} entries, got {len(acceleration)}")
        self._gravity = tuple(map(float, acceleration))

    def port(self, name: str, particle: Particle) -> None:
        """A port at a particle: force given, velocity out (`dim` scalar pairs)."""
        self._ports.append((name, particle))

    def build(self) -> PHDAE:
        """The declaration, with states q and v, multipliers lambda in the order bars, constraints."""
        n = len(self._mass) * self.dim
        if not n:
            raise ValueError(f"{self.name}: no particles")
        q = state("q", n, unit="m", start=self._q, description="positions of the particles")
        v = state("v", n, unit="m/s", start=self._v, description="velocities of the particles")
        m = parameter("m", self._mass, len(self._mass), unit="kg", description="masses")

        def at(point: Point) -> ca.SX:
            if isinstance(point, Support):
                return ca.SX(ca.DM(list(point.position)))
            return q[self._rows(point)]

        g = [0.5 * (ca.sumsqr(at(b) - at(a)) - length**2) for a, b, length in self._bars]
        g += [made(at) for made in self._constraints]
        lam = algebraic("lambda", len(g), unit="N/m", description="multipliers, step means") if g else None
        return PHDAE(
            self.name,
            states=(q, v),
            algebraics=() if lam is None else (lam,),
            parameters=(m, *self._parameters),
            energies=tuple(self._energies(q, v, m, at)),
            E={v: ca.vertcat(*(m[i] for i in range(len(self._mass)) for _ in range(self.dim)))},
            structure=(skew(q, v, 1.0),),
            dissipation=tuple(self._dissipation(v, at)),
            ports=tuple(self._port(name, p, v) for name, p in self._ports),
            constraints=() if lam is None else (Holonomic(lam, ca.vertcat(*g)),),
            description=self.description,
        )

    # -- parts ------------------------------------------------------------------------------------------------------

    def _rows(self, p: Particle) -> list[int]:
        return list(range(p.number * self.dim, (p.number + 1) * self.dim))

    def _start(self, point: Point) -> Sequence[float]:
        return point.position if isinstance(point, Support) else [self._q[i] for i in self._rows(point)]

    def _energies(self, q: Variable, v: Variable, m: Variable, at: Callable[[Point], ca.SX]):
        for i in range(len(self._mass)):
            p = Particle(i)
            yield energy(0.5 * m[i] * ca.sumsqr(v[self._rows(p)]))
            if self._gravity is not None:
                yield energy(-m[i] * ca.dot(ca.DM(list(self._gravity)), at(p)))
        for s in self._springs:
            yield strain_energy(ca.sumsqr(at(s.b) - at(s.a)), s.potential)

    def _dissipation(self, v: Variable, at: Callable[[Point], ca.SX]) -> list[Block]:
        blocks, one = [], ca.SX.eye(self.dim)
        for d in self._dampers:
            value = d.value(ca.sumsqr(at(d.b) - at(d.a)))
            ends = [p for p in (d.a, d.b) if isinstance(p, Particle)]
            signs = ca.DM([[1.0, -1.0], [-1.0, 1.0]])[: len(ends), : len(ends)]
            parts = [v.part(p.number * self.dim, self.dim) for p in ends]
            blocks.append(block(parts, value * ca.kron(signs, one)))
        return blocks

    def _port(self, name: str, p: Particle, v: Variable) -> Port:
        on = {v.part(p.number * self.dim, self.dim): ca.SX.eye(self.dim)}
        return Port(name, TRANSLATIONAL, "effort", on, self.dim, description=f"force on particle {p.number + 1}")
