"""Rigid bodies, joints and springs as numbers in the pose of the start: what the models of other programs are made from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
#: the index of the ground in place of a body's
GROUND = -1


@dataclass(frozen=True, eq=False)
class RigidBody:
    """A body at the start: mass [kg], centre of mass [m], inertia (3 x 3) about it [kg.m2], velocity of the centre and angular
    velocity, all in the axes of the world."""

    mass: float
    centre: Array
    inertia: Array
    velocity: Array
    spin: Array


@dataclass(frozen=True, eq=False)
class BodyJoint:
    """A joint of the bodies a and b at a point [m] with an axis, both of the world at the start.

    kind: revolute, spherical or prismatic;  damping [N.m.s/rad] of a revolute one;  torque [N.m] of a motor on b, about the axis
    spare: one of its rows follows from those of the others, of which programs that want independent rows leave out a direction
    """

    kind: str
    a: int
    b: int
    at: Array
    axis: Array
    damping: float = 0.0
    torque: float = 0.0
    spare: bool = False


@dataclass(frozen=True, eq=False)
class BodySpring:
    """A spring between points of the bodies a and b, given in the world at the start [m]."""

    a: int
    b: int
    at_a: Array
    at_b: Array
    stiffness: float
    length: float


@dataclass(frozen=True, eq=False)
class RigidBodySystem:
    """Bodies and links in an order in which each link of the tree brings a new body; all other links close loops.

    points: (body, place in the world at the start [m]), whose places at the end are compared
    """

    gravity: Array
    bodies: tuple[RigidBody, ...]
    links: tuple[BodyJoint, ...]
    points: tuple[tuple[int, Array], ...]
    struts: tuple[BodySpring, ...] = ()
    planar: bool = False

    @property
    def tree(self) -> tuple[BodyJoint, ...]:
        """The links by which the bodies hang on the ground, in the order of the bodies."""
        return tuple(self._split()[0])

    @property
    def loops(self) -> tuple[BodyJoint, ...]:
        return tuple(self._split()[1])

    def _split(self) -> tuple[list[BodyJoint], list[BodyJoint]]:
        tree, loops, known = list[BodyJoint](), list[BodyJoint](), {GROUND}
        for link in self.links:
            (loops if link.b in known else tree).append(link)
            known.add(link.b)
        return sorted(tree, key=lambda link: link.b), loops

    def rate(self, link: BodyJoint) -> Array:
        """The velocity of b against a in a link at the start: of turning [rad/s], of a prismatic link of sliding [m/s]."""
        (va, wa), (vb, wb) = (self._motion(i, link.at) for i in (link.a, link.b))
        return vb - va if link.kind == "prismatic" else wb - wa

    def _motion(self, i: int, at: Array) -> tuple[Array, Array]:
        if i == GROUND:
            return np.zeros(3), np.zeros(3)
        b = self.bodies[i]
        return b.velocity + np.cross(b.spin, at - b.centre), b.spin


def vector(*values: float) -> Array:
    return np.array(values, float)


def turned(axis: Sequence[float] | Array, angle: float) -> Array:
    """The rotation by an angle [rad] about a unit vector."""
    k = cross_matrix(axis)
    return np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * k @ k


def cross_matrix(x: Sequence[float] | Array) -> Array:
    """K with K y = x cross y."""
    return np.array([[0.0, -x[2], x[1]], [x[2], 0.0, -x[0]], [-x[1], x[0], 0.0]])


def at_rest(mass: float, centre: Array, inertia: Array) -> RigidBody:
    return RigidBody(mass, centre, inertia, np.zeros(3), np.zeros(3))


def frame_along(axis: Array) -> Array:
    """A frame with the axis for z."""
    first = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = np.cross(first, axis)
    x /= np.linalg.norm(x)
    return np.column_stack((x, np.cross(axis, x), axis))
