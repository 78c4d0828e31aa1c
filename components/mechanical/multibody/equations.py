"""From bodies and joints to particles, constraints and rates: centres of mass and directors, with their parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import pi
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from phfmu import PHDAE, ROTATIONAL, TRANSLATIONAL, Variable
from phfmu.components.mechanical.multibody.body import Body, Spring
from phfmu.components.mechanical.multibody.builder import Multibody
from phfmu.components.mechanical.multibody.contact import ContactPair, Limits, add_contact
from phfmu.components.mechanical.multibody.joint import Coordinate, Joint, Side, Symbols, coordinates, rate
from phfmu.components.mechanical.multibody.parts import Combined, Particle, Rate
from phfmu.components.mechanical.multibody.solids import add_solid

if TYPE_CHECKING:
    from phfmu.components.mechanical.multibody.declaration import Declaration

#: the quarter turn, which gives the second director in the plane
QUARTER = ca.DM([[0.0, -1.0], [1.0, 0.0]])
AXES = {"x": 0, "y": 1, "z": 2}


@dataclass(frozen=True)
class Observed:
    """A point of a body [m, in its frame], or the coordinate of a joint, under a name of its own."""

    name: str
    of: Body | Joint
    place: np.ndarray
    description: str


@dataclass
class MechanismParts:
    """Bodies, joints, springs and contacts of a mechanism in the order they were added; gravity [m/s2] has three entries."""

    name: str
    planar: bool
    gravity: np.ndarray
    description: str
    bodies: list[Body] = field(default_factory=list)
    joints: list[Joint] = field(default_factory=list)
    springs: list[Spring] = field(default_factory=list)
    contacts: list[ContactPair] = field(default_factory=list)
    observed: list[Observed] = field(default_factory=list)


class Equations:
    """The particles of each body, and what joints, springs and observables are made of."""

    def __init__(self, mechanism: MechanismParts, observe: bool):
        self.given, self.observe = mechanism, observe
        self.dim = 2 if mechanism.planar else 3
        self.made = Multibody(mechanism.name, self.dim, mechanism.description)
        if np.any(mechanism.gravity):
            self.made.gravity(mechanism.gravity[: self.dim].tolist())
        self.particles: dict[int, list[Particle]] = {}
        self.rho: dict[int, ca.SX] = {}
        self.sides: dict[str, tuple[JointSide, JointSide]] = {}
        #: ends of the coordinates of joints with limits
        self.marks: dict[str, list[ca.SX]] = {}

    def phdae(self) -> PHDAE:
        for body in self.given.bodies:
            self._body(body)
        for joint in self.given.joints:
            self._joint(joint)
        for spring in self.given.springs:
            self._spring(spring)
        for pair in self.given.contacts:
            add_contact(self, pair)
        for observed in self.given.observed:
            self._observe(observed)
        return self.made.build()

    def _observe(self, observed: Observed) -> None:
        of = observed.of
        if isinstance(of, Joint):
            coordinate = of.equations.coordinates[0]
            sides = self.sides[of.name]
            self.made.observable(
                observed.name, coordinate.unit, lambda d: self._value(of, sides, coordinate, d), observed.description
            )
        else:
            place, text = (
                of.principal(observed.place)[: self.dim],
                f"{observed.name} on {of.name}, along its principal axes",
            )
            at = self.made.parameter(f"{observed.name}.at_body", place, self.dim, unit="m", description=text)
            point = self.point(of, at.sx)
            self.made.observable(observed.name, "m", lambda d: d.at(point), observed.description)

    # -- bodies -----------------------------------------------------------------------------------------------------

    def _body(self, body: Body) -> None:
        n, kept = self.dim, min(body.directors, 1) if self.given.planar else body.directors
        unit, spin = body.rotation @ body.axes, body.angular_velocity
        particles = [
            self.made.particle(body.mass, body.centre[:n].tolist(), body.velocity[:n].tolist(), name=body.name)
        ]
        for i in range(kept):
            d = body.rho * unit[:, i]
            mass, name = body.moments[i] / body.rho**2, f"{body.name}.d{i + 1}"
            particles.append(
                self.made.particle(mass, d[:n].tolist(), np.cross(spin, d)[:n].tolist(), weight=False, name=name)
            )
        self.particles[id(body)] = particles
        if kept:
            made = self.made.parameter(
                f"{body.name}.rho", body.rho, unit="m", positive=True, description=f"gyration length of {body.name}"
            )
            self.rho[id(body)] = made.sx
            self.made.constraint(
                lambda at: _rigid([at(d) for d in particles[1:]], made.sx),
                f"rigid {body.name}",
                multiplier=(f"{body.name}.rigid", "N/m"),
                kept=True,
            )
        add_solid(self, body)
        if self.observe:
            self._observe_body(body)

    def point(self, body: Body | None, place: Any) -> Combined:
        """A point of a body, or of the ground: `place` [m] from the centre of mass along the principal axes."""
        if body is None:
            return Combined((), place)
        return Combined(((self.particles[id(body)][0], 1.0), *self.direction(body, place).terms))

    def direction(self, body: Body | None, along: Any) -> Combined:
        """A direction of a body, by its principal axes, or of the ground."""
        if body is None:
            return Combined((), along)
        along, directors = ca.SX(along), self.particles[id(body)][1:]
        if not directors:
            return Combined(())
        if self.given.planar:
            turned = (along[0] * ca.DM.eye(2) + along[1] * QUARTER) / self.rho[id(body)]
            return Combined(((directors[0], turned),))
        return Combined(tuple((d, along[i] / self.rho[id(body)]) for i, d in enumerate(directors)))

    def _observe_body(self, body: Body) -> None:
        name, m = body.name, self.made
        centre, directors = self.particles[id(body)][0], self.particles[id(body)][1:]
        m.observable(f"{name}.position", "m", lambda d: d.at(centre), f"centre of mass of {name}")
        m.observable(
            f"{name}.momentum", "kg.m/s", lambda d: d.m.sx[centre.number] * d.speed(centre), f"momentum of {name}"
        )
        m.observable(f"{name}.energy", "J", lambda d: self._energy(body, d), f"kinetic and potential energy of {name}")
        if not directors:
            return
        rho = self.rho[id(body)]
        if self.given.planar:
            turn = directors[0]
            m.observable(f"{name}.angle", "rad", lambda d: _angle(d.at(turn)), f"angle of {name} from the x axis")
            m.observable(
                f"{name}.angular_velocity", "rad/s", lambda d: _spin(d.at(turn), d.speed(turn)) / rho**2, f"of {name}"
            )
        elif len(directors) == 1:
            m.observable(f"{name}.direction", "1", lambda d: d.at(directors[0]) / rho, f"direction of {name}")
        else:
            axes = ca.DM(body.axes.T)
            m.observable(
                f"{name}.rotation",
                "1",
                lambda d: ca.vec(ca.mtimes(ca.horzcat(*(d.at(x) for x in directors)) / rho, axes)),
                f"rotation matrix of {name}, by columns",
            )
            m.observable(
                f"{name}.angular_velocity",
                "rad/s",
                lambda d: sum((ca.cross(d.at(x), d.speed(x)) for x in directors), ca.SX(3, 1)) / (2 * rho**2),
                f"angular velocity of {name} in the axes of the world",
            )

    def _energy(self, body: Body, d: Declaration) -> ca.SX:
        particles = self.particles[id(body)]
        kinetic = sum(
            (0.5 * d.m.sx[p.number] * ca.sumsqr(d.speed(p)) for p in particles),
            ca.SX(0),
        )
        gravity = ca.DM(self.given.gravity[: self.dim])
        return kinetic - d.m.sx[particles[0].number] * ca.dot(gravity, d.at(particles[0]))

    # -- joints -----------------------------------------------------------------------------------------------------

    def _joint(self, joint: Joint) -> None:
        m, name, kind = self.made, joint.name, joint.equations
        sides = self.sides[name] = JointSide(self, joint, "a"), JointSide(self, joint, "b")
        length = ca.SX(0)
        if joint.kind == "distance":
            length = m.parameter(f"{name}.length", joint.length, unit="m", positive=True, description=f"of {name}").sx
        position, axes = kind.rows(sides[0].symbols, sides[1].symbols, length)
        for i, (rows, suffix, unit) in enumerate(((position, "lambda", "N"), (axes, "lambda_axes", "N.m"))):
            if rows:
                m.constraint(
                    lambda at, i=i: ca.vertcat(*kind.rows(sides[0].seen(at), sides[1].seen(at), length)[i]),
                    name,
                    multiplier=(f"{name}.{suffix}", unit),
                )
        for number, coordinate in enumerate(kind.coordinates):
            self._coordinate(joint, sides, coordinate, number)
        if self.observe:
            self._observe_wrench(joint, sides, position, axes)

    def _observe_wrench(
        self, joint: Joint, sides: tuple[JointSide, JointSide], position: list[ca.SX], axes: list[ca.SX]
    ) -> None:
        """Force at the point of the second body, and torque about it, -(dg/dp)^T lambda and -w x (dg/dw)^T lambda."""
        name, b = joint.name, sides[1].symbols
        multipliers = {
            f"{name}.{suffix}": ca.SX.sym(suffix, ca.vertcat(*rows).numel())
            for rows, suffix in ((position, "lambda"), (axes, "lambda_axes"))
            if rows
        }
        g, lam = ca.vertcat(*position, *axes), ca.vertcat(*multipliers.values())
        force = -ca.mtimes(ca.jacobian(g, b.p).T, lam)
        torque = ca.SX(3 if self.dim == 3 else 1, 1)
        for w in (b.x, b.y, b.z):
            push = -ca.mtimes(ca.jacobian(g, w).T, lam)
            torque += ca.cross(w, push) if self.dim == 3 else _spin(w, push)

        def placed(expr: ca.SX, d: Declaration) -> ca.SX:
            pairs = [
                (x, d.at(s.point(c)))
                for s in sides
                for c, x in zip("pxyz", s.symbols, strict=True)
                if ca.depends_on(expr, x)
            ]
            pairs += [(x, d.multiplier[label].sx) for label, x in multipliers.items()]
            return ca.substitute([expr], [x for x, _ in pairs], [value for _, value in pairs])[0]

        for what, unit, expr in (("force", "N", force), ("torque", "N.m", torque)):
            if expr.nnz() and not expr.is_zero():
                text, dense = f"{what} of {name} on its second body", ca.densify(expr)
                self.made.observable(f"{name}.{what}", unit, lambda d, e=dense: placed(e, d), text)

    def _coordinate(
        self, joint: Joint, sides: tuple[JointSide, JointSide], coordinate: Coordinate, number: int
    ) -> None:
        """Damper, spring, motor and observables of a coordinate."""
        m, name = self.made, joint.name
        angular = coordinate.unit == "rad"
        points = [p for body in (joint.a, joint.b) if body is not None for p in self.particles[id(body)]]

        def form(at: Any, speed: Any) -> ca.SX:
            a, b = sides
            return coordinate.rate(a.seen(at), b.seen(at), a.seen(speed), b.seen(speed))

        if joint.damping:
            unit = "N.m.s/rad" if angular else "N.s/m"
            d = m.parameter(f"{name}.damping", joint.damping, unit=unit, min=0.0, description=f"friction of {name}")
            m.rate_damper(points, form, d)
        if joint.motor:
            domain = ROTATIONAL if angular else TRANSLATIONAL
            m.rate_port(name, domain, "effort" if joint.motor == "effort" else "flow", points, form, f"motor of {name}")
        if self._only_directors_known(joint):
            return
        if joint.armature:
            self._armature(joint, sides, coordinate, angular)
        limits, unit = joint.limits, coordinate.unit
        if limits is not None:
            self.marks[name] = [
                m.parameter(f"{name}.{which}_limit", end, unit=unit, description=f"{which} end of {name}").sx
                for which, end, _ in limits.ends
            ]
        if limits is not None and limits.hard:
            self._hard_limits(joint, sides, coordinate, limits)
        stored = [
            e for e in (self._spring_energy(joint, angular), self._stops(joint, sides, coordinate, points, form)) if e
        ]
        energy = (lambda s: sum((e(s) for e in stored), ca.SX(0))) if stored else None
        if angular and joint.counted:
            start = float(coordinates(joint)[number]) if joint.start is None else joint.start
            m.rate_integral(f"{name}.turned", points, form, unit=unit, start=start, energy=energy)
        elif energy is not None:
            m.strain(lambda at: _length(coordinate, sides[0].seen(at), sides[1].seen(at)), energy)
        if self.observe:
            label = name if len(joint.equations.coordinates) == 1 else f"{name}.{coordinate.name}"
            m.observable(f"{label}.rate", f"{coordinate.unit}/s", lambda d: form(d.at, d.speed), f"rate of {name}")
            m.observable(
                f"{name}.{coordinate.name}",
                coordinate.unit,
                lambda d: self._value(joint, sides, coordinate, d),
                f"of {name}",
            )

    def _hard_limits(
        self, joint: Joint, sides: tuple[JointSide, JointSide], coordinate: Coordinate, limits: Limits
    ) -> None:
        """The ends of a coordinate as contacts."""
        for (which, _, sign), mark in zip(limits.ends, self.marks[joint.name], strict=True):

            def gap(d: Declaration, mark: ca.SX = mark, sign: float = sign) -> ca.SX:
                return sign * (self._limited(joint, sides, coordinate, limits, d) - mark)

            self.made.contact(f"{joint.name}.{which}", gap, limits.restitution, unit=coordinate.unit)

    def _stops(
        self,
        joint: Joint,
        sides: tuple[JointSide, JointSide],
        coordinate: Coordinate,
        points: list[Particle],
        form: Rate,
    ) -> Callable[[ca.SX], ca.SX] | None:
        """The energy of ends that give way, of the coordinate, and their friction; None: there are none."""
        limits, m, name = joint.limits, self.made, joint.name
        if limits is None or limits.compliance is None:
            return None
        law, angular = limits.compliance, coordinate.unit == "rad"
        k, friction = law.parameters(m, f"{name}.stop", angular)
        marks = [(at, sign) for (_, _, sign), at in zip(limits.ends, self.marks[name], strict=True)]

        def friction_at(d: Declaration) -> ca.SX:
            value = self._limited(joint, sides, coordinate, limits, d)
            return sum((law.friction(k, friction, x * (value - at)) for at, x in marks), ca.SX(0))

        m.rate_damper(points, form, friction_at)
        return lambda s: sum((law.energy(k, x * (s - at)) for at, x in marks), ca.SX(0))

    def _limited(
        self,
        joint: Joint,
        sides: tuple[JointSide, JointSide],
        coordinate: Coordinate,
        limits: Limits,
        d: Declaration,
    ) -> ca.SX:
        """The coordinate; an angle that counts no turns within pi of the middle between its ends."""
        a, b = (s.seen(d.at) for s in sides)
        if coordinate.unit != "rad":
            return _length(coordinate, a, b)
        return d.integral[f"{joint.name}.turned"].sx if joint.counted else _angle_near(limits.middle, a, b)

    def _armature(
        self, joint: Joint, sides: tuple[JointSide, JointSide], coordinate: Coordinate, angular: bool
    ) -> None:
        """A particle that moves with the coordinate: u = L (cos, sin) of an angle, T = a |u'|^2/(2 L^2), or u = (s, 0)."""
        value, speed = float(coordinates(joint)[0]), rate(joint)
        size = next(body.rho for body in (joint.b, joint.a) if body is not None) if angular else 1.0
        zero = [0.0] * (self.dim - 2)
        c, s = size * np.cos(value), size * np.sin(value)
        start = (
            ([c, s, *zero], [-s * speed, c * speed, *zero]) if angular else ([value, 0.0, *zero], [speed, 0.0, *zero])
        )
        rotor = self.made.particle(joint.armature / size**2, *start, weight=False, name=f"{joint.name}.rotor")

        def g(at: Any) -> ca.SX:
            a, b, rest = sides[0].seen(at), sides[1].seen(at), ca.SX(self.dim - 2, 1)
            if angular:
                return at(rotor) - ca.vertcat(size * ca.dot(a.x, b.x), size * ca.dot(a.y, b.x), rest)
            return at(rotor) - ca.vertcat(_length(coordinate, a, b), 0, rest)

        self.made.constraint(g, f"rotor of {joint.name}", multiplier=(f"{joint.name}.rotor", "N"), kept=True)

    def _only_directors_known(self, joint: Joint) -> bool:
        """A joint with a rod or point mass has no coordinate that could be told."""
        return any(body is not None and body.directors < 3 for body in (joint.a, joint.b))

    def _spring_energy(self, joint: Joint, angular: bool) -> Callable[[ca.SX], ca.SX] | None:
        if not joint.stiffness:
            return None
        unit = "N.m/rad" if angular else "N/m"
        k = self.made.parameter(
            f"{joint.name}.stiffness", joint.stiffness, unit=unit, min=0.0, description="of its spring"
        )
        zero = self.made.parameter(f"{joint.name}.neutral", joint.neutral, unit="rad" if angular else "m")
        return lambda s: 0.5 * k.sx * (s - zero.sx) ** 2

    def _value(self, joint: Joint, sides: tuple[JointSide, JointSide], coordinate: Coordinate, d: Declaration) -> ca.SX:
        a, b = (s.seen(d.at) for s in sides)
        if coordinate.unit != "rad":
            return _length(coordinate, a, b)
        angle = _angle_near(0.0, a, b)
        if not joint.counted:
            return angle
        turned = d.integral[f"{joint.name}.turned"]
        return angle + 2 * pi * ca.floor((turned - angle) / (2 * pi) + 0.5)

    def _spring(self, spring: Spring) -> None:
        m, name = self.made, spring.name
        ends = []
        for side, (body, place) in (("a", spring.a), ("b", spring.b)):
            local = place if body is None else body.principal(place)
            at = m.parameter(f"{name}.at_{side}", local[: self.dim], self.dim, unit="m", description=f"end of {name}")
            ends.append(self.point(body, at.sx))
        k = m.parameter(f"{name}.stiffness", spring.stiffness, unit="N/m", min=0.0, description=f"of {name}")
        length = m.parameter(f"{name}.length", spring.length, unit="m", min=0.0, description=f"of {name}, unloaded")
        m.linear_spring(ends[0], ends[1], k.sx, length.sx)
        if spring.damping:
            d = m.parameter(f"{name}.damping", spring.damping, unit="N.s/m", min=0.0, description=f"of {name}")
            m.damper(ends[0], ends[1], d, axial=True)
        if self.observe:
            m.observable(
                f"{name}.distance", "m", lambda d: ca.norm_2(d.at(ends[1]) - d.at(ends[0])), f"length of {name}"
            )


class JointSide:
    """Point and axes of a joint on one of its bodies; each becomes a parameter when it is first used."""

    def __init__(self, equations: Equations, joint: Joint, side: str):
        self.equations, self.joint, self.side = equations, joint, side
        self.body: Body | None = getattr(joint, side)
        self.points: dict[str, Combined] = {}
        self.symbols = Symbols(*(ca.SX.sym(f"{which}_{side}", equations.dim) for which in "pxyz"))

    def point(self, which: str) -> Combined:
        """The point "p", or the axis "x", "y", "z"."""
        if which not in self.points:
            at, frame = getattr(self.joint, f"at_{self.side}"), getattr(self.joint, f"frame_{self.side}")
            vector = at if which == "p" else frame[:, AXES[which]]
            if self.body is not None:
                vector = self.body.principal(vector) if which == "p" else self.body.axes.T @ vector
            made = self._parameter(which, vector)
            self.points[which] = (self.equations.point if which == "p" else self.equations.direction)(
                self.body, made.sx
            )
        return self.points[which]

    def _parameter(self, which: str, vector: np.ndarray) -> Variable:
        n, name = self.equations.dim, self.joint.name
        where = (
            "the ground" if self.body is None else f"{self.body.name}, from its centre of mass along its principal axes"
        )
        label, unit = ("at", "m") if which == "p" else (f"{which}_axis", "1")
        return self.equations.made.parameter(
            f"{name}.{label}_{self.side}", vector[:n], n, unit=unit, description=f"of {name} on {where}"
        )

    def seen(self, of: Callable[[Any], ca.SX]) -> Seen:
        """Positions, or velocities, of its point and axes."""
        return Seen(self, of)


class Seen:
    """A side whose point and axes are made when they are asked for."""

    def __init__(self, side: JointSide, of: Callable[[Any], ca.SX]):
        self._side, self._of = side, of

    @property
    def p(self) -> ca.SX:
        return self._of(self._side.point("p"))

    @property
    def x(self) -> ca.SX:
        return self._of(self._side.point("x"))

    @property
    def y(self) -> ca.SX:
        return self._of(self._side.point("y"))

    @property
    def z(self) -> ca.SX:
        return self._of(self._side.point("z"))


def _rigid(directors: list[ca.SX], rho: ca.SX) -> ca.SX:
    """Directors have the gyration length and are orthogonal [m2]."""
    rows = [0.5 * (ca.sumsqr(d) - rho**2) for d in directors]
    rows += [ca.dot(directors[i], directors[j]) for i, j in ((0, 1), (1, 2), (2, 0)) if len(directors) == 3]
    return ca.vertcat(*rows)


def _length(coordinate: Coordinate, a: Side, b: Side) -> ca.SX:
    """Displacement of the second body along the axis of a sliding coordinate."""
    along = {"length": a.x if a.p.numel() == 2 else a.z}.get(coordinate.name)
    return ca.dot(getattr(a, coordinate.name) if along is None else along, b.p - a.p)


def _angle_near(middle: float, a: Side, b: Side) -> ca.SX:
    """The angle from the x axis of a to that of b about z, within pi of `middle` [rad]."""
    s, c = ca.dot(a.y, b.x), ca.dot(a.x, b.x)
    if not middle:
        return ca.atan2(s, c)
    return middle + ca.atan2(s * np.cos(middle) - c * np.sin(middle), c * np.cos(middle) + s * np.sin(middle))


def _angle(d: ca.SX) -> ca.SX:
    return ca.atan2(d[1], d[0])


def _spin(d: ca.SX, rate: ca.SX) -> ca.SX:
    """d x d' in the plane."""
    return d[0] * rate[1] - d[1] * rate[0]
