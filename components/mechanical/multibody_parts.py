"""Parts of a multibody system: masses, points, springs, dampers and constraints, as plain data."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca

from phfmu import Variable

Scalar = Callable[[ca.SX], ca.SX]


@dataclass(frozen=True)
class PointMass:
    """A mass [kg], its start q [m] with velocity v [m/s], and whether gravity acts on it."""

    mass: float
    q: tuple[float, ...]
    v: tuple[float, ...]
    weight: bool = True


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


Point = Particle | Support | MovingSupport | DrivenPoint
Places = Callable[[Point], ca.SX]


@dataclass(frozen=True)
class Spring:
    """An elastic bond with the energy potential(s) of s = |b - a|^2."""

    a: Point
    b: Point
    potential: Scalar


@dataclass(frozen=True)
class Damper:
    """A force value(s) times the relative velocity of its ends, or times its part along the line between them."""

    a: Point
    b: Point
    value: Scalar
    axial: bool

    def matrix(self, d: ca.SX, ends: int) -> ca.SX:
        """R on the velocities of its 1 or 2 moving ends, for the difference d of their positions."""
        s = ca.sumsqr(d)
        one = ca.mtimes(d, d.T) / s if self.axial else ca.SX.eye(d.numel())
        signs = ca.DM([[1.0, -1.0], [-1.0, 1.0]])[:ends, :ends]
        return self.value(s) * ca.kron(signs, one)


@dataclass(frozen=True)
class Constraint:
    """g(positions, time) = 0; `points` that it is known to touch; `drive`: where its work is booked if it moves."""

    g: Callable[[Places], ca.SX]
    label: str
    points: tuple[Point, ...] = ()
    drive: str = ""


@dataclass
class Parts:
    """The parts of a system in `dim` dimensions, in the order they were added; `Declaration` makes its equations of them."""

    name: str
    dim: int
    description: str = ""
    masses: list[PointMass] = field(default_factory=list)
    parameters: list[Variable] = field(default_factory=list)
    driven: list[DrivenPoint] = field(default_factory=list)
    springs: list[Spring] = field(default_factory=list)
    potentials: list[Callable[[Places], ca.SX]] = field(default_factory=list)
    dampers: list[Damper] = field(default_factory=list)
    bars: list[Constraint] = field(default_factory=list)
    constraints: list[Constraint] = field(default_factory=list)
    #: name, the particle it acts on, the one it reacts on
    ports: list[tuple[str, Particle, Particle | None]] = field(default_factory=list)
    gravity: tuple[float, ...] | None = None

    def rows(self, particle: Particle) -> slice:
        """The rows of a particle in the stacked positions."""
        return slice(particle.number * self.dim, (particle.number + 1) * self.dim)
