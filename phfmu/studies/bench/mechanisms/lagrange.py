"""Lagrange's equations in the coordinates of joints: the independent reference, and the form that IDA is given.

    M(p) v' = f(p, v, t) - G(p, t)^T lambda,   p' = v,   0 = g(p, t)

p are angles and distances of the tree of joints, Euler parameters of balls (which are of length one); g closes loops.  Only
CasADi's derivatives are shared with the package's own declarations, which have centres of mass and directors for coordinates.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.studies.bench.mechanisms.assembly import GROUND, BodyJoint, RigidBodySystem, cross_matrix
from phfmu.studies.bench.precision.array_function import compiled_expression

Array = NDArray[np.float64]
#: relative tolerances of the reference; the distance of its solutions is its uncertainty
TOLERANCES = (1e-12, 1e-13)


@dataclass(frozen=True, eq=False)
class Lagrange:
    """A system as CasADi expressions in p, v (n) and t; force: what is not from the potential; points (3 a point, or 2)."""

    t: ca.SX
    p: ca.SX
    v: ca.SX
    kinetic: ca.SX
    potential: ca.SX
    force: ca.SX
    g: ca.SX
    points: ca.SX
    p0: Array
    v0: Array

    @property
    def n(self) -> int:
        return self.p.numel()

    @cached_property
    def mass(self) -> ca.SX:
        return ca.hessian(self.kinetic, self.v)[0]

    @cached_property
    def right(self) -> ca.SX:
        """f of M v' = f - G^T lambda."""
        momentum = ca.gradient(self.kinetic, self.v)
        turned = ca.jtimes(momentum, self.p, self.v) + ca.jacobian(momentum, self.t)
        return ca.gradient(self.kinetic - self.potential, self.p) + self.force - turned

    @cached_property
    def slope(self) -> ca.SX:
        """G."""
        return ca.jacobian(self.g, self.p)

    @cached_property
    def velocity_row(self) -> ca.SX:
        """dg/dt."""
        return self.slope @ self.v + ca.jacobian(self.g, self.t)

    @cached_property
    def accelerations(self) -> Callable[[float, Array, Array], tuple[Array, Array]]:
        """(t, p, v) -> v' and lambda, by least squares where rows are redundant."""
        row, n, m, redundant = self.velocity_row, self.n, self.g.numel(), self.redundant
        drift = ca.jtimes(row, self.p, self.v) + ca.jacobian(row, self.t)
        matrix = ca.vertcat(ca.horzcat(self.mass, self.slope.T), ca.horzcat(self.slope, ca.SX(m, m)))
        sides = ca.horzcat(matrix, ca.vertcat(self.right, -drift))
        f = compiled_expression("rates", [self.t, self.p, self.v], sides)

        def solved(t: float, p: Array, v: Array) -> tuple[Array, Array]:
            made = f(t, p, v).reshape(n + m, n + m + 1, order="F")
            a, b = made[:, :-1], made[:, -1]
            found: Array = np.linalg.lstsq(a, b, rcond=1e-9)[0] if redundant else np.linalg.solve(a, b)  # type: ignore[assignment]
            return found[:n], found[n:]

        return solved

    def solve(self, times: Sequence[float], rtol: float) -> Array:
        """The points at the times, by DOP853."""
        from scipy.integrate import solve_ivp

        def rate(t: float, y: Array) -> Array:
            p, v = np.split(y, 2)
            return np.append(v, self.accelerations(t, p, v)[0])

        s = solve_ivp(
            rate, (0.0, max(times)), np.append(self.p0, self.v0), "DOP853", sorted(times), rtol=rtol, atol=1e-2 * rtol
        )
        if not s.success:
            raise RuntimeError(s.message)
        return np.array([self.place(t, y[: self.n]) for t, y in zip(s.t, s.y.T, strict=True)])

    @cached_property
    def redundant(self) -> bool:
        """True where the rows of G at the start depend on each other."""
        slope = np.array(ca.Function("G", [self.t, self.p], [self.slope])(0.0, self.p0))
        return bool(slope.size) and int(np.linalg.matrix_rank(slope, 1e-9)) < len(slope)

    @cached_property
    def place(self) -> Callable[[float, Array], Array]:
        """(t, p) -> points, flat."""
        return compiled_expression("places", [self.t, self.p], self.points)

    def reference(self, times: Sequence[float]) -> tuple[Array, float]:
        """The points at the times, and their distance from the solution at the tolerance before."""
        coarse, fine = (self.solve(times, rtol) for rtol in TOLERANCES)
        return fine, float(np.abs(fine - coarse).max())


@dataclass(frozen=True, eq=False)
class _Pose:
    """Rotation from the pose of the start, and a point x of the start now: turn (x - origin) + place."""

    turn: ca.SX
    origin: Array
    place: ca.SX

    def at(self, x: Array) -> ca.SX:
        return self.turn @ ca.SX(ca.DM(x - self.origin)) + self.place


class _JointTree:
    """Poses of the bodies as functions of joint coordinates, 0 at the start; balls have Euler parameters (1, 0, 0, 0) there."""

    def __init__(self, assembly: RigidBodySystem):
        self.poses = {GROUND: _Pose(ca.SX.eye(3), np.zeros(3), ca.SX.zeros(3))}
        self.coordinates, self.starts, self.rates = list[ca.SX](), list[float](), list[float]()
        self.lengths, self.assembly = list[ca.SX](), assembly
        self.work, self.lost, self.angles = ca.SX(0), ca.SX(0), dict[int, ca.SX]()
        waiting = list(assembly.tree)
        while waiting:
            link = next(x for x in waiting if x.a in self.poses)
            waiting.remove(link)
            self.poses[link.b] = self._moved(self.poses[link.a], link)

    def _new(self, n: int, start: Sequence[float], rate: Sequence[float]) -> ca.SX:
        p = ca.SX.sym(f"p{len(self.coordinates)}", n)
        self.coordinates.append(p)
        self.starts += start
        self.rates += rate
        return p

    def _moved(self, before: _Pose, link: BodyJoint) -> _Pose:
        at, rate = before.at(link.at), self.assembly.rate(link)
        if link.kind == "prismatic":
            s = self._new(1, [0.0], [float(link.axis @ rate)])
            return _Pose(before.turn, link.at, at + before.turn @ ca.SX(ca.DM(link.axis)) * s)
        if link.kind == "revolute":
            a = self._new(1, [0.0], [float(link.axis @ rate)])
            self.angles[link.b] = a
            return _Pose(before.turn @ _about(link.axis, a), link.at, at)
        e = self._new(4, [1.0, 0.0, 0.0, 0.0], [0.0, *(rate / 2)])
        self.lengths.append((ca.sumsqr(e) - 1) / 2)
        return _Pose(before.turn @ _of_parameters(e), link.at, at)


def lagrange_of(assembly: RigidBodySystem) -> Lagrange:
    """Lagrange's equations of bodies and links."""
    tree = _JointTree(assembly)
    p, t = ca.vertcat(*tree.coordinates), ca.SX.sym("t")
    v = ca.SX.sym("v", p.numel())
    kinetic, potential = ca.SX(0), ca.SX(0)
    for i, b in enumerate(assembly.bodies):
        pose = tree.poses[i]
        centre = pose.at(b.centre)
        spin = pose.turn.T @ ca.reshape(ca.jtimes(ca.vec(pose.turn), p, v), 3, 3)
        w = ca.vertcat(spin[2, 1], spin[0, 2], spin[1, 0])
        kinetic += 0.5 * b.mass * ca.sumsqr(ca.jtimes(centre, p, v)) + 0.5 * w.T @ ca.SX(ca.DM(b.inertia)) @ w
        potential -= b.mass * ca.dot(ca.SX(ca.DM(assembly.gravity)), centre)
    force = ca.SX.zeros(p.numel())
    for s in assembly.struts:
        d = ca.norm_2(tree.poses[s.b].at(s.at_b) - tree.poses[s.a].at(s.at_a))
        potential += 0.5 * s.stiffness * (d - s.length) ** 2
    for link in assembly.tree:
        if link.torque or link.damping:
            a = tree.angles[link.b]
            force += ca.gradient(a, p) * (link.torque - link.damping * ca.jtimes(a, p, v))
    rows = [*tree.lengths, *(r for link in assembly.loops for r in _closing(assembly, tree, link))]
    g = ca.vertcat(*rows) if rows else ca.SX(0, 1)
    points = ca.vertcat(*(tree.poses[i].at(x) for i, x in assembly.points))
    return Lagrange(t, p, v, kinetic, potential, force, g, points, np.array(tree.starts), np.array(tree.rates))


def _closing(assembly: RigidBodySystem, tree: _JointTree, link: BodyJoint) -> list[ca.SX]:
    """Rows of a hinge or ball that closes a loop; in the plane only those in it."""
    if link.kind == "prismatic":
        raise ValueError("a loop is closed by a hinge or a ball; let the slider be in the tree")
    a, b = tree.poses[link.a], tree.poses[link.b]
    d = ca.vertsplit(b.at(link.at) - a.at(link.at))
    if assembly.planar:
        return d[:2]
    if link.kind == "spherical":
        return d
    across = np.linalg.svd(link.axis[None])[2][1:]
    z = b.turn @ ca.SX(ca.DM(link.axis))
    return [*d, *(ca.dot(a.turn @ ca.SX(ca.DM(x)), z) for x in across)]


def _about(axis: Array, angle: ca.SX) -> ca.SX:
    k = ca.SX(ca.DM(cross_matrix(axis)))
    return ca.SX.eye(3) + ca.sin(angle) * k + (1 - ca.cos(angle)) * k @ k


def _of_parameters(e: ca.SX) -> ca.SX:
    """The rotation of Euler parameters; of those that are not of length one it is a multiple, which their row forbids."""
    a, u = e[0], e[1:]
    return (a**2 - ca.sumsqr(u)) * ca.SX.eye(3) + 2 * u @ u.T + 2 * a * ca.skew(u)
