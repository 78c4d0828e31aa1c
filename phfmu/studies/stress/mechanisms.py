"""Mechanisms with more constraints than degrees of freedom need: frames, doubled bars, hinges, Bricard's linkage."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp

from phfmu import PHDAE
from phfmu.components.mechanical.multibody import Multibody, Particle, Point

G = 9.81


def frame() -> PHDAE:
    """Four particles in the plane on all six bars between them, thrown and spinning."""
    body = Multibody("frame", 2)
    places = np.array([(0.0, 0.0), (1.0, 0.0), (1.1, 0.9), (-0.1, 1.0)])
    p = [body.particle(1.0 + 0.3 * i, q, (0.4 - 3.0 * q[1], 0.2 + 3.0 * q[0])) for i, q in enumerate(places)]
    for i in range(4):
        for j in range(i):
            body.bar(p[j], p[i])
    return body.build()


def doubled() -> PHDAE:
    """A chain of three links, each bar twice."""
    body = Multibody("doubled")
    body.gravity((0.0, 0.0, -G))
    points = [body.support((0, 0, 0))]
    points += [body.particle(1.0 + i, (i + 1.0, 0, 0), (0, 0.5 * i, 0)) for i in range(3)]
    for a, b in zip(points, points[1:], strict=False):
        body.bar(a, b)
        body.bar(a, b)
    return body.build()


def hinge() -> PHDAE:
    """A triangular door on two pins: each pin fixes all coordinates, so the bar between them is one too many."""
    body = Multibody("hinge")
    body.gravity((0.0, 0.0, -G))
    ends = [(0.0, 0.0, 0.0), (0.0, 0.6, 0.8)]
    pins = [body.particle(1.0, q) for q in ends]
    corner = body.particle(2.0, (1.0, 0.3, 0.4))
    for p in pins:
        body.bar(p, corner)
    body.bar(pins[0], pins[1])
    for p, q in zip(pins, ends, strict=True):
        body.constraint(lambda at, p=p, q=q: at(p) - ca.DM(q), "pin")
    return body.build()


def bricard() -> tuple[PHDAE, list[Particle]]:
    """Bricard's mechanism (benchmark A03 of the IFToMM library): five uniform rods of 1 m and 1 kg, six hinges.

    A rod is 1/6 kg at either end and 2/3 kg in its middle, which has its inertia; a hinge is a point and a second one
    without mass on its axis.  Returns the declaration and the hinges' points P1 .. P4.
    """
    corners = [(0, 0, 0), (1, 0, 0), (1, -1, 0), (1, -1, 1), (0, -1, 1), (0, 0, 1)]
    axes = [(0, 1, 0), (0, 0, 1), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 0, 0)]
    body = Multibody("bricard")
    body.gravity((0.0, -G, 0.0))
    tips = [tuple(np.add(c, a).astype(float)) for c, a in zip(corners, axes, strict=True)]
    moving = range(1, 5)
    hinges = {j: body.particle(1.0 / 3.0, corners[j]) for j in moving}
    points: dict[int, Point] = {**hinges, **{j: body.support(corners[j]) for j in (0, 5)}}
    ends: dict[int, Point] = {j: body.particle(0.0, tips[j]) for j in moving}
    ends |= {j: body.support(tips[j]) for j in (0, 5)}
    halves = (np.add(a, b) / 2 for a, b in zip(corners, corners[1:], strict=False))
    middles = [body.particle(2.0 / 3.0, half.tolist()) for half in halves]
    for j in moving:
        body.bar(points[j], ends[j])
    for j in range(5):
        for a in (points[j], ends[j]):
            for b in (points[j + 1], ends[j + 1]):
                body.bar(a, b)
    for j, m in enumerate(middles):
        body.constraint(lambda at, j=j, m=m: at(m) - 0.5 * (at(points[j]) + at(points[j + 1])), "middle")
    return body.build(), list(hinges.values())


@cache
def bricard_reference(time: float) -> np.ndarray:
    """Positions of P1 .. P4 (flat): index reduction, least squares for redundant rows, DOP853."""
    declaration, _ = bricard()
    q, v, g = declaration.states[0].sx, declaration.states[1].sx, ca.vertcat(*(c.g for c in declaration.constraints))
    jac = ca.jacobian(g, q)
    n, m = q.numel(), g.numel()
    mass = np.repeat(declaration.parameters[0].start, 3)
    rates = ca.Function("r", [q, v], [jac, ca.jtimes(jac @ v, q, v)])
    force = np.where(np.arange(n) % 3 == 1, -G * mass, 0.0)

    def slope(_: float, x: np.ndarray) -> np.ndarray:
        j, drift = (np.array(a) for a in rates(x[:n], x[n:]))
        matrix = np.block([[np.diag(mass), j.T], [j, np.zeros((m, m))]])
        return np.append(x[n:], np.linalg.lstsq(matrix, np.append(force, -drift), rcond=1e-8)[0][:n])

    start = np.append(declaration.states[0].start, np.zeros(n))
    return solve_ivp(slope, (0.0, time), start, "DOP853", rtol=1e-12, atol=1e-13).y[:12, -1]
