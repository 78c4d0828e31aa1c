"""Parts of a multibody system: masses, points, springs, dampers and constraints, as plain data."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import casadi as ca

from phfmu import Domain, ShapeKind, Variable

Given = Literal["effort", "flow"]

Scalar = Callable[[ca.SX], ca.SX]


@dataclass(frozen=True)
class PointMass:
    """A mass [kg], its start q [m] with velocity v [m/s], and whether gravity acts on it; `called` in pictures."""

    mass: float
    q: tuple[float, ...]
    v: tuple[float, ...]
    weight: bool = True
    called: str = ""


@dataclass(frozen=True)
class Particle:
    """A handle: the number of the mass (from 0)."""

    number: int


@dataclass(frozen=True)
class Support:
    """A fixed point in space."""

    position: tuple[float, ...]


@dataclass(frozen=True)
class MovingSupport:
    """A point led along position(t) [m]; the work of its constraints is booked at the port `name`."""

    name: str
    position: Callable[[ca.SX], Sequence[Any]]


@dataclass(frozen=True)
class DrivenPoint:
    """A point without mass whose velocity is the input of the port `name`; its start q."""

    name: str
    q: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class LinearCombination:
    """A point or vector fixed + sum W_i q_i of particles: of a rigid body, say, c + r_1 d_1 + r_2 d_2 + r_3 d_3.

    terms: (particle, weight W_i [1]), a number or an expression of parameters, or a dim x dim matrix of them
    fixed: a constant part (dim) [m], a column of numbers or parameters; None: there is none
    """

    terms: tuple[tuple[Particle, Any], ...]
    fixed: Any = None


Point = Particle | Support | MovingSupport | DrivenPoint | LinearCombination
Places = Callable[[Point], ca.SX]
#: rate(at, speed) of positions and velocities of points, linear in the velocities
Rate = Callable[[Places, Places], ca.SX]


@dataclass(frozen=True)
class ElasticBond:
    """An elastic bond with the energy potential(s) of s = |b - a|^2."""

    a: Point
    b: Point
    potential: Scalar


@dataclass(frozen=True)
class Strain:
    """The energy potential(c) of c = invariant(positions), of degree two at most."""

    invariant: Callable[[Places], ca.SX]
    potential: Scalar


@dataclass(frozen=True)
class Damper:
    """A force value(s) times the relative velocity of its ends, or times its part along the line between them."""

    a: Point
    b: Point
    value: Scalar
    axial: bool

    def factors(self, d: ca.SX, form: ca.SX) -> tuple[ca.SX, ca.SX]:
        """W and G of R = G^T W G for the velocity form v of b beside a, and the difference d of their positions.

        G is the form, or along the line between them the row d^T form, whose W is the value over |d|^2.
        """
        s = ca.sumsqr(d)
        if self.axial:
            return self.value(s) / s, ca.mtimes(d.T, form)
        return self.value(s) * ca.SX.eye(d.numel()), form


@dataclass(frozen=True)
class Constraint:
    """g(positions, time) = 0; `points` that it is known to touch; `drive`: where its work is booked if it moves.

    multiplier: name and unit of its own multipliers, none: it shares `lambda`;  kept: see `Holonomic`
    """

    g: Callable[[Places], ca.SX]
    label: str
    points: tuple[Point, ...] = ()
    drive: str = ""
    multiplier: tuple[str, str] | None = None
    kept: bool = False


@dataclass(frozen=True)
class RatePort:
    """A port at the rate J(q) v of `points`: its input acts as force J^T u, or, with the flow given, it is J v = u."""

    name: str
    domain: Domain
    given: Given
    points: tuple[Point, ...]
    rate: Rate
    description: str


@dataclass(frozen=True)
class RateDamper:
    """The dissipation |rate|^2 value of the rate J(q) v of `points`.

    value: a number, a parameter, or value(d) as of `PositionObservable`
    """

    points: tuple[Point, ...]
    rate: Rate
    value: Any


@dataclass(frozen=True)
class RateIntegral:
    """A state s with s' = J(q) v, the rate of `points`, from `start`; it may have an energy(s) [J]."""

    name: str
    unit: str
    start: float
    points: tuple[Point, ...]
    rate: Rate
    energy: Scalar | None


@dataclass(frozen=True)
class HardContact:
    """A hard contact 0 <= gap: where it closes, the rate of the gap jumps from c to -restitution c.

    gap: of a declaration, made of positions and of integrals of rates;  restitution: a parameter
    nominal, unit: of the gap
    """

    name: str
    gap: Callable[[Any], ca.SX]
    restitution: Variable
    nominal: float
    unit: str


@dataclass(frozen=True)
class PositionObservable:
    """An observable of positions, velocities and `multiplier(label)` of constraints."""

    name: str
    unit: str
    of: Callable[[Any], ca.SX]
    description: str


@dataclass(frozen=True)
class Solid:
    """A part of the picture alone: kind, points and lengths [m] as `phfmu.ShapeKind` has them, turned with directors."""

    kind: ShapeKind
    points: tuple[Point, ...]
    axes: tuple[Point, ...]
    size: tuple[float, ...]
    label: str


@dataclass
class ParticleSystem:
    """The parts of a system in `dim` dimensions, in the order they were added; `Declaration` makes its equations of them."""

    name: str
    dim: int
    description: str = ""
    masses: list[PointMass] = field(default_factory=list)
    parameters: list[Variable] = field(default_factory=list)
    driven: list[DrivenPoint] = field(default_factory=list)
    springs: list[ElasticBond] = field(default_factory=list)
    strains: list[Strain] = field(default_factory=list)
    potentials: list[Callable[[Places], ca.SX]] = field(default_factory=list)
    dampers: list[Damper] = field(default_factory=list)
    bars: list[Constraint] = field(default_factory=list)
    constraints: list[Constraint] = field(default_factory=list)
    rate_ports: list[RatePort] = field(default_factory=list)
    rate_dampers: list[RateDamper] = field(default_factory=list)
    integrals: list[RateIntegral] = field(default_factory=list)
    contacts: list[HardContact] = field(default_factory=list)
    reported: list[PositionObservable] = field(default_factory=list)
    #: name, the particle it acts on, the one it reacts on
    ports: list[tuple[str, Particle, Particle | None]] = field(default_factory=list)
    gravity: tuple[float, ...] | None = None
    solids: list[Solid] = field(default_factory=list)

    def rows(self, particle: Particle) -> slice:
        """The rows of a particle in the stacked positions."""
        return slice(particle.number * self.dim, (particle.number + 1) * self.dim)
