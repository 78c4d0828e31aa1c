"""A spinning disc on a massless stem: a heavy top in directors, with a singular mass matrix."""

from __future__ import annotations

from math import cos, sin

import casadi as ca

from phfmu import PHDAE
from phfmu.components.mechanical.multibody import Multibody


def heavy_top(
    mass: float = 15.0,
    radius: float = 0.5,
    stem: float = 1.0,
    *,
    spin: float = 40.0,
    tilt: float = 1.0,
    precession: float = 0.0,
) -> PHDAE:
    """A thin disc (mass, radius) at the end of a stem from the origin, in natural coordinates.

    Points:  1 the centre c, 2..4 the directors d_1, d_2, d_3 (orthonormal, d_3 along the stem), with masses
             m, E, E, 0 and E = m radius^2/4: M is singular, the constraints fix d_3.

        H = m |c'|^2/2 + E (|d_1'|^2 + |d_2'|^2)/2 + m g c_z,   c = stem d_3,   d_i . d_j = delta_ij

    Arguments:   mass [kg], radius and stem [m];  spin [rad/s] about d_3;  tilt [rad] from the vertical;
                 precession [rad/s] about the vertical
    States:      q, v (12 each);  multipliers lambda (9)
    Source:      P. Betsch, P. Steinmann, Int. J. Numer. Meth. Engng. 50 (2001), for rigid bodies in directors
    """
    body = Multibody("heavy_top", description="spinning disc on a stem, directors, singular mass matrix")
    body.gravity((0.0, 0.0, -9.81))
    axes = ((cos(tilt), 0.0, -sin(tilt)), (0.0, 1.0, 0.0), (sin(tilt), 0.0, cos(tilt)))
    omega = tuple(spin * axes[2][i] + (precession if i == 2 else 0.0) for i in range(3))
    inertia = mass * radius**2 / 4
    centre = tuple(stem * x for x in axes[2])
    c = body.particle(mass, centre, _cross(omega, centre))
    d = [
        body.particle(e, a, _cross(omega, a), weight=False) for e, a in zip((inertia, inertia, 0.0), axes, strict=True)
    ]
    for i in range(3):
        body.constraint(lambda at, i=i: 0.5 * (ca.sumsqr(at(d[i])) - 1.0), f"length of director {i + 1}")
    for i, j in ((0, 1), (0, 2), (1, 2)):
        body.constraint(lambda at, i=i, j=j: ca.dot(at(d[i]), at(d[j])), f"directors {i + 1} and {j + 1} orthogonal")
    body.constraint(lambda at: at(c) - stem * at(d[2]), "centre on the stem")
    body.solid("cylinder", c, size=(radius, radius / 12), axes=d, label="disc")
    body.solid("rod", body.support((0.0, 0.0, 0.0)), c, size=(radius / 25,), label="stem")
    return body.build()


def _cross(a: tuple[float, ...], b: tuple[float, ...]) -> tuple[float, float, float]:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
