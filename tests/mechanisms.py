"""Mechanisms with redundant constraints, or whose constraints lose rank, for tests and the references beside them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp

from phfmu import PHDAE
from phfmu.components.mechanical.multibody import Multibody, Particle

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
    body.bar(*pins)
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
    points = {j: body.particle(1.0 / 3.0, corners[j]) for j in moving}
    ends = {j: body.particle(0.0, tips[j]) for j in moving}
    middles = [body.particle(2.0 / 3.0, np.add(corners[j], corners[j + 1]) / 2) for j in range(5)]
    for j in (0, 5):
        points[j], ends[j] = body.support(corners[j]), body.support(tips[j])
    for j in moving:
        body.bar(points[j], ends[j])
    for j in range(5):
        for a in (points[j], ends[j]):
            for b in (points[j + 1], ends[j + 1]):
                body.bar(a, b)
    for j, m in enumerate(middles):
        body.constraint(lambda at, j=j, m=m: at(m) - 0.5 * (at(points[j]) + at(points[j + 1])), "middle")
    return body.build(), [points[j] for j in moving]


def hung(scales: Sequence[float]) -> PHDAE:
    """A load that swings on one bar, declared once for each scale of the constraint."""
    body = Multibody("hung", 2)
    body.gravity((0.0, -G))
    load = body.particle(3.0, (1.0, 0.0))
    for i, scale in enumerate(scales):
        body.constraint(lambda at, s=scale: 0.5 * s * (ca.sumsqr(at(load)) - 1.0), f"bar {i + 1}")
    return body.build()


def windows(n: int, angle: float = 0.0, pull: float = 0.0) -> PHDAE:
    """n + 1 parallel cranks of 1 m with 1 kg at their ends, joined by bars: flat, with a loss of rank, twice a turn.

    `pull`: a spring on the first crank [N/m].
    """
    body = Multibody("windows", 2)
    body.gravity((0.0, -G))
    arm, speed = (np.sin(angle), np.cos(angle)), (np.cos(angle), -np.sin(angle))
    ends = [body.particle(1.0, (i + arm[0], arm[1]), speed) for i in range(n + 1)]
    for i, end in enumerate(ends):
        body.bar(body.support((float(i), 0.0)), end)
        if i:
            body.bar(ends[i - 1], end)
    if pull:
        body.linear_spring(body.support((0.0, 2.0)), ends[0], pull, 1.0)
    return body.build()


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
