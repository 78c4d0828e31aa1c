"""From bodies and joints to particles, constraints and rates: centres of mass and directors, with their parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from phfmu import PHDAE, Variable
from phfmu.components.mechanical.multibody.body import MechanismBody, Spring
from phfmu.components.mechanical.multibody.builder import Multibody
from phfmu.components.mechanical.multibody.bushing import Bushing, BushingEquations
from phfmu.components.mechanical.multibody.contact import ContactPair, add_contact
from phfmu.components.mechanical.multibody.coordinate import JointCoordinate
from phfmu.components.mechanical.multibody.gear import Gear
from phfmu.components.mechanical.multibody.joint import KinematicJoint, SymbolicSide
from phfmu.components.mechanical.multibody.parts import LinearCombination, Particle

if TYPE_CHECKING:
    from phfmu.components.mechanical.multibody.declaration import Declaration

#: the quarter turn, which gives the second director in the plane
QUARTER = ca.DM([[0.0, -1.0], [1.0, 0.0]])
AXES = {"x": 0, "y": 1, "z": 2}
#: the shortest edge of a box, and the radius of a rod, beside its longest edge or its length, in pictures
THIN, ROD = 0.04, 0.02
#: radius of what joins the ends of a distance in pictures, beside its length
ROPE = 0.006


@dataclass(frozen=True)
class ObservedQuantity:
    """A point of a body [m, in its frame], or the coordinate of a joint, under a name of its own."""

    name: str
    of: MechanismBody | KinematicJoint
    place: np.ndarray
    description: str


@dataclass
class MechanismParts:
    """Bodies, joints, springs, bushings and contacts of a mechanism in the order they were added.

    gravity [m/s2] has three entries.
    """

    name: str
    planar: bool
    gravity: np.ndarray
    description: str
    bodies: list[MechanismBody] = field(default_factory=list)
    joints: list[KinematicJoint] = field(default_factory=list)
    springs: list[Spring] = field(default_factory=list)
    bushings: list[Bushing] = field(default_factory=list)
    contacts: list[ContactPair] = field(default_factory=list)
    gears: list[Gear] = field(default_factory=list)
    observed: list[ObservedQuantity] = field(default_factory=list)


class MechanismEquations:
    """The particles of each body, and what joints, springs and observables are made of."""

    def __init__(self, mechanism: MechanismParts, observe: bool):
        self.given, self.observe = mechanism, observe
        self.dim = 2 if mechanism.planar else 3
        self.made = Multibody(mechanism.name, self.dim, mechanism.description)
        if np.any(mechanism.gravity):
            self.made.gravity(mechanism.gravity[: self.dim].tolist())
        self.particles: dict[int, list[Particle]] = {}
        self.rho: dict[int, ca.SX] = {}
        self.coordinates: dict[str, list[JointCoordinate]] = {}

    def phdae(self) -> PHDAE:
        for body in self.given.bodies:
            self._body(body)
        for joint in self.given.joints:
            self._joint(joint)
        for spring in self.given.springs:
            self._spring(spring)
        for bushing in self.given.bushings:
            self._bushing(bushing)
        for pair in self.given.contacts:
            add_contact(self, pair)
        for gear in self.given.gears:
            self._gear(gear)
        for observed in self.given.observed:
            self._observe(observed)
        return self.made.build()

    def _observe(self, observed: ObservedQuantity) -> None:
        of = observed.of
        if isinstance(of, KinematicJoint):
            coordinate = self.coordinates[of.name][0]
            self.made.observable(observed.name, coordinate.unit, coordinate.value, observed.description)
        else:
            place, text = (
                of.principal(observed.place)[: self.dim],
                f"{observed.name} on {of.name}, along its principal axes",
            )
            at = self.made.parameter(f"{observed.name}.at_body", place, self.dim, unit="m", description=text)
            point = self.point(of, at.sx)
            self.made.observable(observed.name, "m", lambda d: d.at(point), observed.description)

    # -- bodies -----------------------------------------------------------------------------------------------------

    def _body(self, body: MechanismBody) -> None:
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
        self._solid(body)
        if self.observe:
            self._observe_body(body)

    def point(self, body: MechanismBody | None, place: Any) -> LinearCombination:
        """A point of a body, or of the ground: `place` [m] from the centre of mass along the principal axes."""
        if body is None:
            return LinearCombination((), place)
        return LinearCombination(((self.particles[id(body)][0], 1.0), *self.direction(body, place).terms))

    def direction(self, body: MechanismBody | None, along: Any) -> LinearCombination:
        """A direction of a body, by its principal axes, or of the ground."""
        if body is None:
            return LinearCombination((), along)
        along, directors = ca.SX(along), self.particles[id(body)][1:]
        if not directors:
            return LinearCombination(())
        if self.given.planar:
            turned = (along[0] * ca.DM.eye(2) + along[1] * QUARTER) / self.rho[id(body)]
            return LinearCombination(((directors[0], turned),))
        return LinearCombination(tuple((d, along[i] / self.rho[id(body)]) for i, d in enumerate(directors)))

    def _solid(self, body: MechanismBody) -> None:
        """The box (rod, ball) with the mass and the moments of inertia of a body, along its principal axes, for pictures.

        e_i = m a_i^2/12    for an edge a_i and the Euler moment e_i
        """
        centre, *directors = self.particles[id(body)]
        if not directors or not body.mass:
            return
        edges = np.sqrt(12.0 * np.maximum(body.moments, 0.0) / body.mass)
        longest = float(edges.max())
        if len(directors) == 1 and not body.planar:
            half = self._along(body, 0.5 * longest), self._along(body, -0.5 * longest)
            self.made.solid("rod", *half, size=(ROD * longest,), label=body.name)
            return
        size = tuple(float(a) for a in np.maximum(edges, THIN * longest))
        axes = directors if len(directors) == 3 else [directors[0], self.direction(body, [0.0, 1.0])]
        self.made.solid("box", centre, size=size, axes=axes, label=body.name)

    def _along(self, body: MechanismBody, distance: float) -> LinearCombination:
        """The point at a distance from the centre of a rod [m]."""
        towards = self.direction(body, [distance, 0.0, 0.0])
        return LinearCombination(((self.particles[id(body)][0], 1.0), *towards.terms))

    def _observe_body(self, body: MechanismBody) -> None:
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

    def _energy(self, body: MechanismBody, d: Declaration) -> ca.SX:
        particles = self.particles[id(body)]
        kinetic = sum(
            (0.5 * d.m.sx[p.number] * ca.sumsqr(d.speed(p)) for p in particles),
            ca.SX(0),
        )
        gravity = ca.DM(self.given.gravity[: self.dim])
        return kinetic - d.m.sx[particles[0].number] * ca.dot(gravity, d.at(particles[0]))

    # -- joints -----------------------------------------------------------------------------------------------------

    def _joint(self, joint: KinematicJoint) -> None:
        m, name, kind = self.made, joint.name, joint.equations
        sides = JointSide(self, joint, "a"), JointSide(self, joint, "b")
        length = ca.SX(0)
        if joint.kind == "distance":
            length = m.parameter(f"{name}.length", joint.length, unit="m", positive=True, description=f"of {name}").sx
            ends = sides[0].point("p"), sides[1].point("p")
            m.solid("rod", *ends, size=(ROPE * joint.length,), label=name)
        position, axes = kind.rows(sides[0].symbols, sides[1].symbols, length)
        for i, (rows, suffix, unit) in enumerate(((position, "lambda", "N"), (axes, "lambda_axes", "N.m"))):
            if rows:
                m.constraint(
                    lambda at, i=i: ca.vertcat(*kind.rows(sides[0].seen(at), sides[1].seen(at), length)[i]),
                    name,
                    multiplier=(f"{name}.{suffix}", unit),
                )
        self.coordinates[name] = [
            JointCoordinate(self, joint, sides, coordinate, number)
            for number, coordinate in enumerate(kind.coordinates)
        ]
        for coordinate in self.coordinates[name]:
            coordinate.add()
        if self.observe:
            self._observe_wrench(joint, sides, position, axes)

    def _observe_wrench(
        self, joint: KinematicJoint, sides: tuple[JointSide, JointSide], position: list[ca.SX], axes: list[ca.SX]
    ) -> None:
        """Force at the point of the second body, and torque about it, -(dg/dp)^T lambda and -w x (dg/dw)^T lambda.

        What has the unit of its motor's port, whose name it would have, is NAME.reaction.
        """
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
                motor = joint.motor and unit == ("N.m" if joint.equations.coordinates[0].unit == "rad" else "N")
                label = f"{name}.reaction" if motor else f"{name}.{what}"
                self.made.observable(label, unit, lambda d, e=dense: placed(e, d), text)

    def _gear(self, gear: Gear) -> None:
        """s_b - ratio s_a stays as it is at the start, of the coordinates s of two joints."""
        a, b = (self.coordinates[joint.name][0].counted for joint in (gear.a, gear.b))
        text = f"rate of {gear.b.name} by that of {gear.a.name}"
        unit = gear.b.equations.coordinates[0].unit
        what, effort = ("torque", "N.m") if unit == "rad" else ("force", "N")
        ratio = self.made.parameter(f"{gear.name}.gear_ratio", gear.ratio, unit=gear.unit, description=text).sx
        start = self.made.parameter(
            f"{gear.name}.gear_start", gear.start(), unit=unit, description=f"of {gear.name}"
        ).sx
        self.made.constraint(
            lambda at: b(at) - ratio * a(at) - start, gear.name, multiplier=(f"{gear.name}.lambda", effort)
        )
        if self.observe:
            text = f"{what} of {gear.name} on {gear.b.name}"
            self.made.observable(f"{gear.name}.{what}", effort, lambda d: -d.multiplier[f"{gear.name}.lambda"].sx, text)

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

    def _bushing(self, bushing: Bushing) -> None:
        one, other = JointSide(self, bushing, "a"), JointSide(self, bushing, "b")
        bodies = [body for body in (bushing.a, bushing.b) if body is not None]
        points = [p for body in bodies for p in self.particles[id(body)]]
        principal = [self.direction(bushing.b, column) for column in ca.horzsplit(ca.DM.eye(self.dim))]
        BushingEquations(self.made, bushing, (one.seen, other.seen), principal, points).add(self.observe)


class JointSide:
    """Point and axes of a joint or bushing on one of its bodies; each becomes a parameter when it is first used."""

    def __init__(self, equations: MechanismEquations, joint: KinematicJoint | Bushing, side: str):
        self.equations, self.joint, self.side = equations, joint, side
        self.body: MechanismBody | None = getattr(joint, side)
        self.points: dict[str, LinearCombination] = {}
        self.symbols = SymbolicSide(*(ca.SX.sym(f"{which}_{side}", equations.dim) for which in "pxyz"))

    def point(self, which: str) -> LinearCombination:
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

    def seen(self, of: Callable[[Any], ca.SX]) -> LazySide:
        """Positions, or velocities, of its point and axes."""
        return LazySide(self, of)


class LazySide:
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


def _angle(d: ca.SX) -> ca.SX:
    return ca.atan2(d[1], d[0])


def _spin(d: ca.SX, rate: ca.SX) -> ca.SX:
    """d x d' in the plane."""
    return d[0] * rate[1] - d[1] * rate[0]
