"""Contacts of a mechanism without friction: balls and corners on planes, balls on balls; hard, or giving way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import casadi as ca
import numpy as np

from phfmu.components.mechanical.multibody.body import MechanismBody
from phfmu.components.mechanical.multibody.builder import Multibody
from phfmu.components.mechanical.multibody.parts import LinearCombination, Particle


@dataclass(frozen=True)
class Compliance:
    """The force F = k s (s/s0)^(n-1) (1 + d s') of an indentation s, after Hunt and Crossley; n = 1.5 of elastic balls (Hertz).

    stiffness k [N/m, N.m/rad] of the secant at the indentation `depth` s0 [m, rad];  damping d [s/m, s/rad]
    skin: thickness [m, rad] of what gives way on hard ground, which slow bodies come to rest on and fast ones go through, to be
          thrown back; 0: there is no hard ground below
    Source: K. H. Hunt, F. R. E. Crossley, J. Appl. Mech. 42 (1975).
    """

    stiffness: float
    exponent: float = 1.0
    damping: float = 0.0
    depth: float = 1e-3
    skin: float = 0.0

    def require(self, what: str) -> None:
        """ValueError for numbers that make no contact."""
        least = min(self.damping, self.skin)
        if not (self.stiffness > 0 and self.exponent >= 1 and least >= 0 and self.depth > 0):
            raise ValueError(
                f"{what}: stiffness {self.stiffness:g} and depth {self.depth:g} must be positive, exponent {self.exponent:g} at "
                f"least 1, damping {self.damping:g} and skin {self.skin:g} not negative"
            )

    def parameters(self, m: Multibody, name: str, angular: bool) -> tuple[ca.SX, ca.SX]:
        """k and d as parameters NAME.stiffness and NAME.damping."""
        units = ("N.m/rad", "s/rad") if angular else ("N/m", "s/m")
        given = (("stiffness", self.stiffness), ("damping", self.damping))
        k, d = (
            m.parameter(f"{name}.{what}", value, unit=unit, min=0.0, description=f"of {name}")
            for (what, value), unit in zip(given, units, strict=True)
        )
        return k.sx, d.sx

    def energy(self, k: ca.SX, gap: ca.SX) -> ca.SX:
        """Stored at a gap [J]."""
        n = self.exponent
        return k * self.depth**2 / (n + 1) * (self._indented(gap) / self.depth) ** (n + 1)

    def friction(self, k: ca.SX, d: ca.SX, gap: ca.SX) -> ca.SX:
        """Force by rate at a gap [N.s/m, N.m.s/rad]."""
        return k * d * self.depth * (self._indented(gap) / self.depth) ** self.exponent

    def _indented(self, gap: ca.SX) -> ca.SX:
        return ca.fmax(0, self.skin - gap)


def is_hard(compliance: Compliance | None) -> bool:
    """A contact has hard ground, which throws back."""
    return compliance is None or compliance.skin > 0


@dataclass(frozen=True)
class Limits:
    """The coordinate of a joint stays within [lower, upper] [rad, m]; either may be infinite.

    restitution: of hard ends;  compliance: of ends that give way
    """

    lower: float
    upper: float
    restitution: float = 0.0
    compliance: Compliance | None = None

    def require(self, what: str) -> None:
        """ValueError for numbers that are no limits."""
        if not self.lower < self.upper or not self.ends or not 0 <= self.restitution <= 1:
            raise ValueError(
                f"{what}: limits {self.lower:g} and {self.upper:g} with restitution {self.restitution:g}: expected lower < "
                "upper, one of them finite, and a restitution within 0 and 1"
            )
        if self.compliance is not None:
            self.compliance.require(f"{what}: limits")

    @property
    def hard(self) -> bool:
        return is_hard(self.compliance)

    @property
    def middle(self) -> float:
        return 0.5 * (self.lower + self.upper)

    @property
    def ends(self) -> list[tuple[str, float, float]]:
        """Name, value, and the sign with which the coordinate leaves it, of the ends that there are."""
        both = (("lower", self.lower, 1.0), ("upper", self.upper, -1.0))
        return [(name, value, sign) for name, value, sign in both if np.isfinite(value)]


@dataclass(frozen=True)
class ContactPair:
    """A ball, or a point, of b that stays on its side of a plane of a, or off a ball of a; None is the ground.

    at_a, at_b [m]: a point of the plane, or the centre of the ball of a, and the centre of that of b, in their frames
    normal: of the plane, in the frame of a, towards b; None: a has a ball;  radius, radius_a [m]: of the balls
    restitution: of a hard contact;  compliance: of one that gives way
    """

    name: str
    a: MechanismBody | None
    b: MechanismBody | None
    at_a: np.ndarray
    at_b: np.ndarray
    normal: np.ndarray | None
    radius: float
    radius_a: float
    restitution: float
    compliance: Compliance | None

    def __post_init__(self) -> None:
        what, n = f"contact '{self.name}'", self.normal
        if not (self.radius >= 0 and self.radius_a >= 0 and 0 <= self.restitution <= 1):
            raise ValueError(
                f"{what}: radii {self.radius_a:g} m and {self.radius:g} m must not be negative, restitution "
                f"{self.restitution:g} within 0 and 1"
            )
        if n is None and not self.reach > 0:
            raise ValueError(f"{what}: two points do not meet; give the radius of a ball, or the normal of a plane")
        if n is not None and (self.radius_a or not np.linalg.norm(n) > 0):
            raise ValueError(f"{what}: a plane has a normal that is not zero, got {n.tolist()}, and no radius_a")
        if self.compliance is not None:
            self.compliance.require(what)
        for body, place in ((self.a, self.at_a), (self.b, self.at_b)):
            if body is not None and np.max(np.abs(body.principal(place)[body.directors :]), initial=0.0) > 1e-12:
                raise ValueError(
                    f"{what}: body '{body.name}' is a rod or a point mass and has no point {place.tolist()}"
                )

    @property
    def reach(self) -> float:
        """Radii of both balls [m]."""
        return self.radius + self.radius_a

    @property
    def direction(self) -> np.ndarray:
        """The normal of the plane with length 1, in the frame of a."""
        assert self.normal is not None
        return self.normal / np.linalg.norm(self.normal)

    def require_apart(self, mechanism: str) -> None:
        """ValueError for a hard contact that overlaps at the start."""
        if is_hard(self.compliance) and self.gap() < -1e-12:
            raise ValueError(
                f"{mechanism}: contact '{self.name}' overlaps by {-self.gap():.6g} m at the start; move its bodies apart, or "
                "give it a compliance"
            )

    def gap(self) -> float:
        """At the start [m]."""
        p, q = (at if body is None else body.at(at) for body, at in ((self.a, self.at_a), (self.b, self.at_b)))
        if self.normal is None:
            return float(np.linalg.norm(q - p)) - self.reach
        n = self.direction if self.a is None else self.a.rotation @ self.direction
        return float(n @ (q - p)) - self.reach


class MechanismParticles(Protocol):
    """Bodies of a mechanism as particles, and points and directions of them; `observe`: whether gaps are told."""

    made: Multibody
    dim: int
    observe: bool
    particles: dict[int, list[Particle]]

    def point(self, body: MechanismBody | None, place: Any) -> LinearCombination: ...
    def direction(self, body: MechanismBody | None, along: Any) -> LinearCombination: ...


def add_contact(equations: MechanismParticles, pair: ContactPair) -> None:
    """The event, or energy and friction, of a pair, and its observable NAME.gap."""
    m, name, dim = equations.made, pair.name, equations.dim

    def vector(label: str, unit: str, value: np.ndarray, text: str) -> ca.SX:
        return m.parameter(f"{name}.{label}", value[:dim], dim, unit=unit, description=f"{text} of {name}").sx

    ends: list[LinearCombination] = []
    for side, body, at in (("a", pair.a, pair.at_a), ("b", pair.b, pair.at_b)):
        local = at if body is None else body.principal(at)
        ends.append(equations.point(body, vector(f"at_{side}", "m", local, "place")))
    radius = m.parameter(f"{name}.radius", pair.reach, unit="m", min=0.0, description=f"radii of {name}, added").sx
    points = [p for body in (pair.a, pair.b) if body is not None for p in equations.particles[id(body)]]
    if pair.normal is None:

        def invariant(at: Any) -> ca.SX:
            return ca.sumsqr(at(ends[1]) - at(ends[0]))

        def gap(c: ca.SX) -> ca.SX:
            return ca.sqrt(c) - radius

        def rate(at: Any, speed: Any) -> ca.SX:
            d = at(ends[1]) - at(ends[0])
            return ca.dot(d, speed(ends[1]) - speed(ends[0])) / ca.norm_2(d)

    else:
        along = pair.direction if pair.a is None else pair.a.axes.T @ pair.direction
        normal = equations.direction(pair.a, vector("normal", "1", along, "normal of the plane"))

        def invariant(at: Any) -> ca.SX:
            return ca.dot(at(normal), at(ends[1]) - at(ends[0]))

        def gap(c: ca.SX) -> ca.SX:
            return c - radius

        def rate(at: Any, speed: Any) -> ca.SX:
            turned = 0 if pair.a is None else ca.dot(speed(normal), at(ends[1]) - at(ends[0]))
            return ca.dot(at(normal), speed(ends[1]) - speed(ends[0])) + turned

    law = pair.compliance
    if is_hard(law):
        m.contact(name, lambda d: gap(invariant(d.at)), pair.restitution)
    if law is not None:
        k, damping = law.parameters(m, name, False)
        m.strain(invariant, lambda c: law.energy(k, gap(c)))
        m.rate_damper(points, rate, lambda d: law.friction(k, damping, gap(invariant(d.at))))
    if equations.observe:
        m.observable(f"{name}.gap", "m", lambda d: gap(invariant(d.at)), f"distance at {name}")
