"""Elliptic Fekete points: charges on a sphere that drift to where they are farthest apart."""

from __future__ import annotations

from math import cos, pi, sin

import casadi as ca

from phfmu import PHDAE
from phfmu.components.mechanical.multibody import Multibody

#: rings of the start: (points, latitude, longitude of the ring)
_RINGS = (
    (3, 3 * pi / 8, pi / 13),
    (7, pi / 8, pi / 29),
    (6, -2 * pi / 15, pi / 7),
    (4, -3 * pi / 10, pi / 17),
)


def fekete(*, adhesion: float = 0.5) -> PHDAE:
    """Twenty particles on the unit sphere that repel each other, with adhesion: index 3, every pair interacts.

        H = sum 1/2 m |v_i|^2 - 1/2 sum_{i<j} c log |q_i - q_j|^2,   m v_i' = -DV_i - alpha v_i - lambda_i q_i,
        0 = (|q_i|^2 - 1)/2

    States:      q, v (60 each);  multipliers lambda (20)
    Parameters:  c [J], alpha [N.s/m], m [kg]
    Source:      F. Mazzia, C. Magherini, Test Set for IVP Solvers, release 2.4 (2008), problem "Fekete"
    """
    body = Multibody("fekete", description="20 charges on a sphere, every pair interacts (index 2)")
    charge = body.parameter("c", 1.0, unit="J", description="strength of the repulsion")
    alpha = body.parameter("alpha", adhesion, unit="N.s/m", description="adhesion")
    centre = body.support((0.0, 0.0, 0.0))
    points = []
    for n, beta, shift in _RINGS:
        for i in range(1, n + 1):
            a = 2 * pi * i / n + shift
            points.append(body.particle(1.0, (cos(a) * cos(beta), sin(a) * cos(beta), sin(beta))))
    for p in points:
        body.bar(centre, p)
        body.damper(centre, p, alpha)
    for i, a in enumerate(points):
        for b in points[:i]:
            body.spring(a, b, lambda s: -0.5 * charge.sx * ca.log(s))
    return body.build()
