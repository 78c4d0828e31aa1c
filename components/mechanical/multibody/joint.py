"""Kinds of joints: their equations between a frame of each body, and the rates of their coordinates.

A joint sits at a point p of each body, with axes x, y, z there; z is the axis of the joint.  r = p_b - p_a.  All equations are
of degree 1 or 2 in points and axes, so that the schemes keep them exactly.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Literal, NamedTuple, Protocol

import casadi as ca
import numpy as np

from phfmu.components.mechanical.multibody.body import MechanismBody, rotation_about
from phfmu.components.mechanical.multibody.contact import Limits

Rows = Callable[["Side", "Side", ca.SX], tuple[list[ca.SX], list[ca.SX]]]


class Side(Protocol):
    """Point and axes of a joint on one of its bodies (or their velocities)."""

    @property
    def p(self) -> ca.SX: ...
    @property
    def x(self) -> ca.SX: ...
    @property
    def y(self) -> ca.SX: ...
    @property
    def z(self) -> ca.SX: ...


class SymbolicSide(NamedTuple):
    """A side of symbols."""

    p: ca.SX
    x: ca.SX
    y: ca.SX
    z: ca.SX


@dataclass(frozen=True)
class Coordinate:
    """A coordinate of a joint: its unit, and its rate from both sides and their velocities, linear in these."""

    name: str
    unit: str
    rate: Callable[[Side, Side, Side, Side], ca.SX]


@dataclass(frozen=True)
class JointKind:
    """rows: equations of position [m] and of axes [1];  coordinates: what is left free, in the order of `motion`.

    tree: can a body be placed by it
    """

    rows: Rows
    coordinates: tuple[Coordinate, ...] = ()
    tree: bool = True


def _angle_rate(a: Side, b: Side, da: Side, db: Side) -> ca.SX:
    """Relative rotation about the common axis z."""
    return ca.dot(b.y, db.x) - ca.dot(a.y, da.x)


def _along(axis: Literal["x", "y", "z"]) -> Callable[[Side, Side, Side, Side], ca.SX]:
    """Velocity of the point of b in the frame of a."""

    def rate(a: Side, b: Side, da: Side, db: Side) -> ca.SX:
        r, dr = b.p - a.p, db.p - da.p
        return ca.dot(getattr(a, axis), dr) + ca.dot(getattr(da, axis), r)

    return rate


ANGLE = Coordinate("angle", "rad", _angle_rate)
LENGTH = Coordinate("length", "m", _along("z"))


def _dots(*pairs: tuple[ca.SX, ca.SX]) -> list[ca.SX]:
    return [ca.dot(u, w) for u, w in pairs]


SPATIAL: dict[str, JointKind] = {
    "fixed": JointKind(lambda a, b, _: ([b.p - a.p], _dots((a.x, b.y), (a.y, b.z), (a.z, b.x)))),
    "revolute": JointKind(lambda a, b, _: ([b.p - a.p], _dots((a.x, b.z), (a.y, b.z))), (ANGLE,)),
    "prismatic": JointKind(
        lambda a, b, _: (
            _dots((b.p - a.p, a.x), (b.p - a.p, a.y)),
            _dots((a.x, b.y), (a.y, b.z), (a.z, b.x)),
        ),
        (LENGTH,),
    ),
    "cylindrical": JointKind(
        lambda a, b, _: (_dots((b.p - a.p, a.x), (b.p - a.p, a.y)), _dots((a.x, b.z), (a.y, b.z))), (ANGLE, LENGTH)
    ),
    "spherical": JointKind(lambda a, b, _: ([b.p - a.p], [])),
    "universal": JointKind(lambda a, b, _: ([b.p - a.p], _dots((a.z, b.x)))),
    "planar": JointKind(
        lambda a, b, _: (_dots((b.p - a.p, a.z)), _dots((a.x, b.z), (a.y, b.z))),
        (Coordinate("x", "m", _along("x")), Coordinate("y", "m", _along("y")), ANGLE),
    ),
    "point_on_line": JointKind(lambda a, b, _: (_dots((b.p - a.p, a.x), (b.p - a.p, a.y)), []), (LENGTH,), tree=False),
    "distance": JointKind(lambda a, b, length: ([0.5 * (ca.sumsqr(b.p - a.p) / length - length)], []), tree=False),
}

#: in the plane z is the direction of travel of a slider and x across it
PLANAR: dict[str, JointKind] = {
    "fixed": JointKind(lambda a, b, _: ([b.p - a.p], _dots((a.x, b.y)))),
    "revolute": JointKind(lambda a, b, _: ([b.p - a.p], []), (ANGLE,)),
    "prismatic": JointKind(
        lambda a, b, _: (_dots((b.p - a.p, a.y)), _dots((a.x, b.y))), (Coordinate("length", "m", _along("x")),)
    ),
    "point_on_line": JointKind(
        lambda a, b, _: (_dots((b.p - a.p, a.y)), []), (Coordinate("length", "m", _along("x")),), tree=False
    ),
    "distance": SPATIAL["distance"],
}  # fmt: skip


@dataclass(eq=False)
class KinematicJoint:
    """A joint between the bodies a and b (None: the ground), made by `Mechanism.joint`.

    at_a, at_b [m], frame_a, frame_b (columns x, y, z): in the frames of the bodies;  length [m]: of a distance
    damping, stiffness, neutral: per coordinate rate and coordinate;  motor: "" or what is given, "effort" or "flow"
    armature: inertia of a rotor [kg.m2] or mass [kg] that moves with the coordinate;  limits: of the coordinate
    """

    kind: str
    name: str
    a: MechanismBody | None
    b: MechanismBody | None
    at_a: np.ndarray
    at_b: np.ndarray
    frame_a: np.ndarray
    frame_b: np.ndarray
    planar: bool
    length: float = 0.0
    damping: float = 0.0
    stiffness: float = 0.0
    neutral: float = 0.0
    motor: str = ""
    counted: bool = False
    armature: float = 0.0
    limits: Limits | None = None
    #: the coordinate at the start where it counts turns
    start: float | None = None

    @property
    def equations(self) -> JointKind:
        return (PLANAR if self.planar else SPATIAL)[self.kind]

    @property
    def ends(self) -> str:
        """Its bodies, in words."""
        return " and ".join("the ground" if body is None else f"'{body.name}'" for body in (self.a, self.b))

    def world(self, body: MechanismBody | None, at: np.ndarray, frame: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Point and axes at the start, in the world."""
        return (at, frame) if body is None else (body.at(at), body.rotation @ frame)

    def sides(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Points and axes of both bodies at the start, in the world: p_a, axes of a, p_b, axes of b."""
        return *self.world(self.a, self.at_a, self.frame_a), *self.world(self.b, self.at_b, self.frame_b)

    def gap(self) -> np.ndarray:
        """Its equations at the start [m, rad]."""
        return np.array(rows_at(self.kind, self.planar)(*self.sides(), self.length or 1.0)[0]).ravel()

    def begins(self, number: int) -> float:
        """A coordinate at the start, with the turns of one that counts them."""
        return float(coordinates(self)[number]) if self.start is None else self.start

    def require_apart(self, mechanism: str) -> None:
        """ValueError where its coordinate is beyond a hard limit at the start."""
        if self.limits is None or not self.limits.hard:
            return
        value = self.begins(0)
        for which, end, sign in self.limits.ends:
            if sign * (value - end) < -1e-12:
                raise ValueError(
                    f"{mechanism}: joint '{self.name}' starts at {value:.6g}, beyond its {which} limit {end:.6g}; assemble it "
                    "within its limits"
                )

    def slopes(self) -> list[np.ndarray]:
        """Derivatives of the equations at the start with respect to p and axes of a, then of b."""
        return [np.array(m) for m in rows_at(self.kind, self.planar)(*self.sides(), self.length or 1.0)[1:]]


@cache
def rows_at(kind: str, planar: bool) -> ca.Function:
    """The equations of a kind of points and axes in space, and their derivatives."""
    symbols = [ca.SX.sym("p_a", 3), ca.SX.sym("F_a", 3, 3), ca.SX.sym("p_b", 3), ca.SX.sym("F_b", 3, 3), ca.SX.sym("L")]
    n = 2 if planar else 3
    a, b = (SymbolicSide(p[:n], *(frame[:n, i] for i in range(3))) for p, frame in (symbols[:2], symbols[2:4]))
    position, axes = (PLANAR if planar else SPATIAL)[kind].rows(a, b, symbols[4])
    g = ca.vertcat(*position, *axes)
    return ca.Function(kind, symbols, [g, *(ca.jacobian(g, ca.vec(s)) for s in symbols[:4])])


def motion(joint: KinematicJoint, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Displacement and rotation of the frame of b in that of a, for the coordinates q of a joint that places bodies."""
    turn, shift = np.eye(3), np.zeros(3)
    match joint.kind:
        case "revolute":
            turn = rotation_about((0, 0, 1), q[0])
        case "prismatic":
            shift[0 if joint.planar else 2] = q[0]
        case "cylindrical":
            turn, shift[2] = rotation_about((0, 0, 1), q[0]), q[1]
        case "planar":
            turn, shift[:2] = rotation_about((0, 0, 1), q[2]), q[:2]
        case "universal":
            turn = rotation_about((0, 0, 1), q[0]) @ rotation_about((1, 0, 0), q[1])
        case "spherical" if np.linalg.norm(q) > 0:
            turn = rotation_about(q, float(np.linalg.norm(q)))
    return shift, turn


def directions(joint: KinematicJoint) -> tuple[np.ndarray, np.ndarray]:
    """Velocity of the point of b and angular velocity of b, seen from a, per rate of each coordinate (3 x n each)."""
    _, a, _, b = joint.sides()
    n = SIZES[joint.kind]
    move, turn = np.zeros((3, n)), np.zeros((3, n))
    match joint.kind:
        case "revolute":
            turn[:, 0] = a[:, 2]
        case "prismatic":
            move[:, 0] = a[:, 0 if joint.planar else 2]
        case "cylindrical":
            turn[:, 0], move[:, 1] = a[:, 2], a[:, 2]
        case "planar":
            move[:, 0], move[:, 1], turn[:, 2] = a[:, 0], a[:, 1], a[:, 2]
        case "universal":
            turn[:, 0], turn[:, 1] = a[:, 2], b[:, 0]
        case "spherical":
            turn[:] = a
    return move, turn


#: coordinates that place a body
SIZES = {"fixed": 0, "revolute": 1, "prismatic": 1, "cylindrical": 2, "planar": 3, "universal": 2, "spherical": 3}


def coordinates(joint: KinematicJoint) -> np.ndarray:
    """The coordinates nearest to the poses at the start."""
    pa, a, pb, b = joint.sides()
    shift, turn = a.T @ (pb - pa), a.T @ b
    about_z = float(np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1]))
    match joint.kind:
        case "revolute":
            return np.array([about_z])
        case "prismatic":
            return np.array([shift[0 if joint.planar else 2]])
        case "cylindrical":
            return np.array([about_z, shift[2]])
        case "planar":
            return np.array([*shift[:2], about_z])
        case "universal":
            first = float(np.arctan2(turn[1, 0], turn[0, 0]))
            return np.array([first, float(np.arctan2(turn[2, 1], turn[2, 2]))])
        case "spherical":
            from scipy.spatial.transform import Rotation

            return Rotation.from_matrix(turn).as_rotvec()
    return np.zeros(0)


def rate(joint: KinematicJoint) -> float:
    """The rate of the coordinate of a joint with one, at the start."""
    move, turn = (m[:, 0] for m in directions(joint))
    _, _, at, _ = joint.sides()
    total = 0.0
    for body, sign in ((joint.a, -1.0), (joint.b, 1.0)):
        if body is not None:
            velocity = body.velocity + np.cross(body.angular_velocity, at - body.centre)
            total += sign * float(move @ velocity + turn @ body.angular_velocity)
    return total


def known_kind(kind: str, planar: bool) -> JointKind:
    """The kind; ValueError lists those there are."""
    there = PLANAR if planar else SPATIAL
    if kind not in there:
        where = "in the plane" if planar else "in space"
        raise ValueError(f"no joint '{kind}' {where}; there are: {', '.join(there)}")
    return there[kind]


def finite(what: str, values: Sequence[float] | np.ndarray, n: int) -> np.ndarray:
    """n finite numbers; ValueError else."""
    found = np.asarray(values, float).ravel()
    if found.shape != (n,) or not np.all(np.isfinite(found)):
        raise ValueError(f"{what} needs {n} finite numbers, got {np.asarray(values).tolist()!r}")
    return found
