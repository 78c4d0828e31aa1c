"""Coordinates of joints with all that they carry: damper, spring, motor, rotor, limits, the count of turns."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from math import pi
from typing import TYPE_CHECKING, Any, Protocol

import casadi as ca
import numpy as np

from phfmu import ROTATIONAL, TRANSLATIONAL
from phfmu.components.mechanical.multibody.body import MechanismBody
from phfmu.components.mechanical.multibody.contact import MechanismParticles
from phfmu.components.mechanical.multibody.joint import Coordinate, KinematicJoint, Side, coordinates, rate

if TYPE_CHECKING:
    from phfmu.components.mechanical.multibody.declaration import Declaration


class SideProvider(Protocol):
    """Point and axes of a joint on one of its bodies."""

    def seen(self, of: Callable[[Any], ca.SX]) -> Side: ...


class JointCoordinate:
    """The coordinate `number` of a joint between two sides."""

    def __init__(
        self,
        mechanism: MechanismParticles,
        joint: KinematicJoint,
        sides: tuple[SideProvider, SideProvider],
        coordinate: Coordinate,
        number: int,
    ):
        self.mechanism, self.joint, self.sides, self.coordinate = mechanism, joint, sides, coordinate
        self.unit, self.angular = coordinate.unit, coordinate.unit == "rad"
        self._number = number
        bodies: list[MechanismBody] = [body for body in (joint.a, joint.b) if body is not None]
        #: what its rate is made of
        self.points = [p for body in bodies for p in mechanism.particles[id(body)]]
        self._directions = all(body.directors == 3 for body in bodies)

    def add(self) -> None:
        """Its parts and observables; a joint with a rod or a point mass has no coordinate that could be told."""
        m, joint, name = self.mechanism.made, self.joint, self.joint.name
        if joint.damping:
            unit = "N.m.s/rad" if self.angular else "N.s/m"
            d = m.parameter(f"{name}.damping", joint.damping, unit=unit, min=0.0, description=f"friction of {name}")
            m.rate_damper(self.points, self.rate, d)
        if joint.motor:
            domain = ROTATIONAL if self.angular else TRANSLATIONAL
            given = "effort" if joint.motor == "effort" else "flow"
            m.rate_port(name, domain, given, self.points, self.rate, f"motor of {name}")
        if not self._directions:
            return
        if joint.armature:
            self._armature()
        stored = [*self._spring(), *self._limits()]
        energy = (lambda s: sum((e(s) for e in stored), ca.SX(0))) if stored else None
        if self.angular and joint.counted:
            m.rate_integral(
                f"{name}.turned",
                self.points,
                self.rate,
                unit=self.unit,
                start=joint.begins(self._number),
                energy=energy,
            )
        elif energy is not None:
            m.strain(lambda at: self._length(*self._seen(at)), energy)
        if self.mechanism.observe:
            label = name if len(joint.equations.coordinates) == 1 else f"{name}.{self.coordinate.name}"
            m.observable(f"{label}.rate", f"{self.unit}/s", lambda d: self.rate(d.at, d.speed), f"rate of {name}")
            m.observable(f"{name}.{self.coordinate.name}", self.unit, self.value, f"of {name}")

    def rate(self, at: Any, speed: Any) -> ca.SX:
        """Its rate, linear in velocities."""
        return self.coordinate.rate(*self._seen(at), *self._seen(speed))

    def value(self, d: Declaration) -> ca.SX:
        """The coordinate, an angle with the turns that are counted."""
        a, b = self._seen(d.at)
        if not self.angular:
            return self._length(a, b)
        angle = _angle(0.0, a, b)
        if not self.joint.counted:
            return angle
        turned = d.integral[f"{self.joint.name}.turned"]
        return angle + 2 * pi * ca.floor((turned - angle) / (2 * pi) + 0.5)

    @cached_property
    def counted(self) -> Callable[[Any], ca.SX]:
        """The coordinate s of positions, an angle a with all its turns.

        It is told by a particle without mass at (L s, 0), of an angle with sin(s - a) = 0 and L the length of a radian.
        """
        m, joint, name, zero = self.mechanism.made, self.joint, self.joint.name, [0.0] * (self.mechanism.dim - 1)
        size: Any = 1.0
        if self.angular:
            text = f"length of a radian in the coordinate of {name}"
            size = m.parameter(f"{name}.radian", 1.0, unit="m", positive=True, description=text).sx
        start = joint.begins(self._number)
        made = m.particle(0.0, [start, *zero], [rate(joint), *zero], weight=False, name=f"{name}.counter")

        def g(at: Any) -> ca.SX:
            (a, b), s = self._seen(at), at(made)
            if self.angular:
                first = ca.sin(s[0] / size) * ca.dot(a.x, b.x) - ca.cos(s[0] / size) * ca.dot(a.y, b.x)
            else:
                first = s[0] - self._length(a, b)
            return ca.vertcat(first, s[1:])

        m.constraint(g, f"counter of {name}", multiplier=(f"{name}.counter", "N"), kept=True)
        return lambda at: at(made)[0] / size

    # -- parts ------------------------------------------------------------------------------------------------------

    def _seen(self, of: Any) -> tuple[Side, Side]:
        a, b = self.sides
        return a.seen(of), b.seen(of)

    def _armature(self) -> None:
        """A particle that moves with the coordinate: u = L (cos, sin) of an angle, T = a |u'|^2/(2 L^2), or u = (s, 0)."""
        joint, dim = self.joint, self.mechanism.dim
        value, speed = float(coordinates(joint)[0]), rate(joint)
        size = next(body.rho for body in (joint.b, joint.a) if body is not None) if self.angular else 1.0
        zero = [0.0] * (dim - 2)
        c, s = size * np.cos(value), size * np.sin(value)
        start = (
            ([c, s, *zero], [-s * speed, c * speed, *zero])
            if self.angular
            else ([value, 0.0, *zero], [speed, 0.0, *zero])
        )
        m = self.mechanism.made
        rotor = m.particle(joint.armature / size**2, *start, weight=False, name=f"{joint.name}.rotor")

        def g(at: Any) -> ca.SX:
            (a, b), rest = self._seen(at), ca.SX(dim - 2, 1)
            if self.angular:
                return at(rotor) - ca.vertcat(size * ca.dot(a.x, b.x), size * ca.dot(a.y, b.x), rest)
            return at(rotor) - ca.vertcat(self._length(a, b), 0, rest)

        m.constraint(g, f"rotor of {joint.name}", multiplier=(f"{joint.name}.rotor", "N"), kept=True)

    def _spring(self) -> list[Callable[[ca.SX], ca.SX]]:
        """The energy of its spring, of the coordinate, if it has one."""
        joint, m = self.joint, self.mechanism.made
        if not joint.stiffness:
            return []
        unit = "N.m/rad" if self.angular else "N/m"
        k = m.parameter(f"{joint.name}.stiffness", joint.stiffness, unit=unit, min=0.0, description="of its spring")
        zero = m.parameter(f"{joint.name}.neutral", joint.neutral, unit=self.unit)
        return [lambda s: 0.5 * k.sx * (s - zero.sx) ** 2]

    def _limits(self) -> list[Callable[[ca.SX], ca.SX]]:
        """Its ends: hard ones as contacts; the energy of those that give way, of the coordinate, with their friction."""
        limits, m, name = self.joint.limits, self.mechanism.made, self.joint.name
        if limits is None:
            return []
        ends: list[tuple[str, float, ca.SX]] = []
        for which, end, sign in limits.ends:
            text = f"{which} end of {name}"
            ends.append((which, sign, m.parameter(f"{name}.{which}_limit", end, unit=self.unit, description=text).sx))
        for which, sign, end in ends if limits.hard else ():
            m.contact(
                f"{name}.{which}", lambda d, x=sign, end=end: x * (self._within(limits.middle, d) - end), limits.restitution,
                unit=self.unit,
            )  # fmt: skip
        if limits.compliance is None:
            return []
        law = limits.compliance
        k, friction = law.parameters(m, f"{name}.stop", self.angular)

        def friction_at(d: Declaration) -> ca.SX:
            s = self._within(limits.middle, d)
            return sum((law.friction(k, friction, x * (s - end)) for _, x, end in ends), ca.SX(0))

        m.rate_damper(self.points, self.rate, friction_at)
        return [lambda s: sum((law.energy(k, x * (s - end)) for _, x, end in ends), ca.SX(0))]

    def _within(self, middle: float, d: Declaration) -> ca.SX:
        """The coordinate; an angle that counts no turns within pi of `middle`."""
        if not self.angular:
            return self._length(*self._seen(d.at))
        return d.integral[f"{self.joint.name}.turned"].sx if self.joint.counted else _angle(middle, *self._seen(d.at))

    def _length(self, a: Side, b: Side) -> ca.SX:
        """Displacement of the second body along the axis of a sliding coordinate."""
        name = self.coordinate.name
        along = getattr(a, name) if name != "length" else a.x if self.mechanism.dim == 2 else a.z
        return ca.dot(along, b.p - a.p)


def _angle(middle: float, a: Side, b: Side) -> ca.SX:
    """The angle from the x axis of a to that of b about z, within pi of `middle` [rad]."""
    s, c = ca.dot(a.y, b.x), ca.dot(a.x, b.x)
    if not middle:
        return ca.atan2(s, c)
    return middle + ca.atan2(s * np.cos(middle) - c * np.sin(middle), c * np.cos(middle) + s * np.sin(middle))
