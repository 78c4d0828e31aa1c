"""The mechanisms of the comparison as numbers, each written down a second time beside the library's declaration."""

from __future__ import annotations

from math import asin, cos, sin

import casadi as ca
import numpy as np

from phfmu.studies.bench.mechanisms.assembly import (
    GROUND,
    Array,
    BodyJoint,
    BodySpring,
    RigidBody,
    RigidBodySystem,
    at_rest,
    turned,
    vector,
)
from phfmu.studies.bench.mechanisms.lagrange import Lagrange

Z = vector(0.0, 0.0, 1.0)
DOWN = vector(0.0, 0.0, -9.81)


def chain() -> RigidBodySystem:
    """Four boxes of 1 x 0.1 x 0.2 m, from 1.0 to 1.3 kg, on balls and hinges in turn, stretched along x, spinning as one body."""
    spin, boxes, links = vector(1.0, 0.0, 2.0), list[RigidBody](), list[BodyJoint]()
    for i in range(4):
        mass, centre = 1.0 + 0.1 * i, vector(i + 0.5, 0.0, 0.0)
        inertia = mass / 12 * np.diag((0.01 + 0.04, 1.0 + 0.04, 1.0 + 0.01))
        boxes.append(RigidBody(mass, centre, inertia, np.cross(spin, centre), spin))
        links.append(
            BodyJoint(("spherical", "revolute")[i % 2], i - 1, i, vector(float(i), 0.0, 0.0), vector(0.0, 1.0, 0.0))
        )
    return RigidBodySystem(DOWN, tuple(boxes), tuple(links), tuple((i, b.centre) for i, b in enumerate(boxes)))


def slider_crank() -> RigidBodySystem:
    """Crank, rod and piston as the library has them: lengths 0.3 and 0.8 m, crank at 0.5 rad with 10 rad/s."""
    r, l, angle, speed = 0.3, 0.8, 0.5, 10.0
    other = -asin(r * sin(angle) / l)
    big = vector(r * cos(angle), r * sin(angle), 0.0)
    small = big + l * vector(cos(other), sin(other), 0.0)
    swing = -speed * r * cos(angle) / (l * cos(other))
    at_big = speed * np.cross(Z, big)
    at_small = at_big + swing * np.cross(Z, small - big)
    crank = RigidBody(1.0, big / 2, _plane(1.0 * r**2 / 12), at_big / 2, speed * Z)
    rod = RigidBody(0.5, (big + small) / 2, _plane(0.5 * l**2 / 12), (at_big + at_small) / 2, swing * Z)
    piston = RigidBody(0.8, small, _plane(0.8 * (0.1 * r) ** 2), at_small, 0 * Z)
    links = (
        BodyJoint("revolute", GROUND, 0, 0 * Z, Z, damping=0.01),
        BodyJoint("revolute", 0, 1, big, Z),
        BodyJoint("prismatic", GROUND, 2, small, vector(1.0, 0.0, 0.0)),
        BodyJoint("revolute", 1, 2, small, Z),
    )
    bodies = (crank, rod, piston)
    points = tuple((i, b.centre) for i, b in enumerate(bodies))
    return RigidBodySystem(vector(0.0, -9.81, 0.0), bodies, links, points, planar=True)


def bricard() -> RigidBodySystem:
    """Five thin rods of 1 m and 1 kg along edges of a cube, on six hinges, from rest."""
    corners = np.array(((0, 0, 0), (1, 0, 0), (1, -1, 0), (1, -1, 1), (0, -1, 1), (0, 0, 1)), float)
    axes = np.array(((0, 1, 0), (0, 0, 1), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 0, 0)), float)
    rods = []
    for a, b in zip(corners, corners[1:], strict=False):
        along = b - a
        rods.append(at_rest(1.0, (a + b) / 2, (np.eye(3) - np.outer(along, along)) / 12))
    links = [BodyJoint("revolute", i - 1, i, corners[i], axes[i]) for i in range(5)]
    links.append(BodyJoint("revolute", 4, GROUND, corners[5], axes[5], spare=True))
    points = tuple((i, corners[i + 1]) for i in range(4))
    return RigidBodySystem(vector(0.0, -9.81, 0.0), tuple(rods), tuple(links), points)


def andrews() -> RigidBodySystem:
    """Andrews' squeezer at its published start; bodies crank, rod, rocker, link 4, arm 5, link 6, arm 7."""
    beta, theta, gamma = -0.0617138900142764496, 0.0, 0.455279819163070380
    phi, delta = 0.222668390165885885, 0.487364979543842550
    omega, epsilon = -0.222668390165885885, 1.23054744454982120
    a, b = vector(-0.06934, -0.00227, 0.0), vector(-0.03635, 0.03273, 0.0)
    spring = vector(0.014, 0.072, 0.0)
    # a place along an arm at the angle that it has in the world; angles of links count from their arms
    crank, rod, rocker = (lambda x, y, q=q: turned(Z, q) @ vector(x, y, 0.0) for q in (beta, beta + theta, gamma))
    arm5, link4 = (lambda x, y, q=q: turned(Z, q) @ vector(x, y, 0.0) for q in (delta, delta + phi))
    arm7, link6 = (lambda x, y, q=q: turned(Z, q) @ vector(x, y, 0.0) for q in (epsilon, epsilon + omega))
    k2, k4, k6 = crank(0.007, 0.0), a + arm5(0.04, 0.0), a + arm7(0.0, -0.04)
    f = k2 + rod(-0.028, 0.0)
    bodies = (
        at_rest(0.04325, crank(0.00092, 0.0), _plane(2.194e-6)),
        at_rest(0.00365, k2 + rod(-0.0115, 0.0), _plane(4.410e-7)),
        at_rest(0.02373, b + rocker(0.01043, -0.01874), _plane(5.255e-6)),
        at_rest(0.07050, a + arm5(0.02308, 0.00916), _plane(1.169e-5)),
        at_rest(0.00706, k4 + link4(0.0, -0.00579), _plane(5.667e-7)),
        at_rest(0.05498, a + arm7(0.00449, -0.01228), _plane(1.912e-5)),
        at_rest(0.00706, k6 + link6(0.00579, 0.0), _plane(5.667e-7)),
    )
    links = (
        BodyJoint("revolute", GROUND, 0, 0 * Z, Z, torque=0.033),
        BodyJoint("revolute", 0, 1, k2, Z),
        BodyJoint("revolute", GROUND, 2, b, Z),
        BodyJoint("revolute", GROUND, 3, a, Z),
        BodyJoint("revolute", 3, 4, k4, Z),
        BodyJoint("revolute", GROUND, 5, a, Z),
        BodyJoint("revolute", 5, 6, k6, Z),
        *(BodyJoint("revolute", 1, i, f, Z) for i in (2, 4, 6)),
    )
    strut = BodySpring(2, GROUND, b + rocker(0.02, -0.018), spring, 4530.0, 0.07785)
    points = tuple((i, b.centre) for i, b in enumerate(bodies))
    return RigidBodySystem(0 * Z, bodies, links, points, (strut,), planar=True)


#: links of the arm as its file has them: mass, centre along z, moments; joint before it: place, pitch, axis
UR5 = (
    (3.7, 0.0, (0.010267495893, 0.010267495893, 0.00666), (0.0, 0.0, 0.089159), 0.0, (0.0, 0.0, 1.0)),
    (8.393, 0.28, (0.22689067591, 0.22689067591, 0.0151074), (0.0, 0.13585, 0.0), np.pi / 2, (0.0, 1.0, 0.0)),
    (2.275, 0.25, (0.049443313556, 0.049443313556, 0.004095), (0.0, -0.1197, 0.425), 0.0, (0.0, 1.0, 0.0)),
    (1.219, 0.0, (0.111172755531, 0.111172755531, 0.21942), (0.0, 0.0, 0.39225), np.pi / 2, (0.0, 1.0, 0.0)),
    (1.219, 0.0, (0.111172755531, 0.111172755531, 0.21942), (0.0, 0.093, 0.0), 0.0, (0.0, 0.0, 1.0)),
    (0.1879, 0.0, (0.0171364731454, 0.0171364731454, 0.033822), (0.0, 0.0, 0.09465), 0.0, (0.0, 1.0, 0.0)),
)
POSE = (0.3, -1.2, 1.0, -0.8, -1.2, 0.4)


def ur5() -> RigidBodySystem:
    """The arm UR5 in the pose of the library, falling from rest without friction or torques."""
    place, turn, bodies, links = np.zeros(3), np.eye(3), list[RigidBody](), list[BodyJoint]()
    for i, ((mass, z, moments, at, pitch, axis), angle) in enumerate(zip(UR5, POSE, strict=True)):
        place, turn = place + turn @ at, turn @ turned((0.0, 1.0, 0.0), pitch)
        links.append(BodyJoint("revolute", i - 1, i, place, turn @ np.array(axis)))
        turn = turn @ turned(axis, angle)
        bodies.append(at_rest(mass, place + turn @ (0.0, 0.0, z), turn @ np.diag(moments) @ turn.T))
    flange = place + turn @ (0.0, 0.0823, 0.0)
    return RigidBodySystem(DOWN, tuple(bodies), tuple(links), ((2, bodies[2].centre), (5, flange)))


def pendulum() -> RigidBodySystem:
    """A point mass of 1 kg on a massless bar of 1 m, from the horizontal: as one body about its support."""
    bob = at_rest(1.0, vector(-1.0, 0.0, 0.0), np.zeros((3, 3)))
    link = BodyJoint("revolute", GROUND, 0, 0 * Z, Z)
    return RigidBodySystem(vector(0.0, -9.81, 0.0), (bob,), (link,), ((0, bob.centre),), planar=True)


def four_bar(n: int = 2) -> RigidBodySystem:
    """n windows of rods of 1 m and 1 kg, upright cranks whose upper ends move with 1 m/s."""
    spin, x, y, m = -Z, vector(1.0, 0.0, 0.0), vector(0.0, 1.0, 0.0), 1.0 / 12
    cranks = [RigidBody(1.0, i * x + y / 2, _plane(m), x / 2, spin) for i in range(n + 1)]
    couplers = [RigidBody(1.0, (i + 0.5) * x + y, _plane(m), x, 0 * Z) for i in range(n)]
    links = [BodyJoint("revolute", GROUND, i, i * x, Z) for i in range(n + 1)]
    links += [BodyJoint("revolute", i, n + 1 + i, i * x + y, Z) for i in range(n)]
    links += [BodyJoint("revolute", i + 1, n + 1 + i, (i + 1) * x + y, Z) for i in range(n)]
    return RigidBodySystem(vector(0.0, -9.81, 0.0), (*cranks, *couplers), tuple(links), ((0, y),), planar=True)


def _plane(moment: float) -> Array:
    """The inertia of a body that moves in the plane; the moments about axes in it do no work there."""
    return np.diag((moment, moment, moment))


def car_axis(epsilon: float = 1e-2) -> Lagrange:
    """The published equations in the positions of the two bodies, the wheels given by the road; no rigid bodies."""
    m, t, p, v = 0.5 * epsilon**2 * 10.0, ca.SX.sym("t"), ca.SX.sym("p", 4), ca.SX.sym("v", 4)
    y = 0.1 * ca.sin(10.0 * t)
    wheel, left, right = ca.vertcat(ca.sqrt(1 - y**2), y), p[:2], p[2:]
    stretch = ((ca.norm_2(left) - 0.5) ** 2, (ca.norm_2(right - wheel) - 0.5) ** 2)
    potential = 0.5 * sum(stretch, ca.SX(0)) + m * (left[1] + right[1])
    rows = ca.vertcat(ca.dot(left, wheel), ca.sumsqr(right - left) - 1.0)
    starts = vector(0.0, 0.5, 1.0, 0.5), vector(-0.5, 0.0, -0.5, 0.0)
    return Lagrange(t, p, v, 0.5 * m * ca.sumsqr(v), potential, ca.SX.zeros(4), rows, p, *starts)


def parallel_cranks(n: int = 2) -> Lagrange:
    """The angle of all cranks of n four-bar windows from the vertical, which pass their flat positions like one pendulum."""
    p, v, t = ca.SX.sym("p", 1), ca.SX.sym("v", 1), ca.SX.sym("t")
    kinetic = 0.5 * ((n + 1) / 3 + n) * v**2
    potential = 9.81 * ((n + 1) / 2 + n) * ca.cos(p)
    upper = ca.vertcat(ca.sin(p), ca.cos(p), 0)
    return Lagrange(t, p, v, kinetic, potential, ca.SX.zeros(1), ca.SX(0, 1), upper, vector(0.0), vector(1.0))
