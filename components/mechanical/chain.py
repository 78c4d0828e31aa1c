"""A chain of rigid links that hangs from a support."""

from __future__ import annotations

from typing import Any

from phfmu import PHDAE
from phfmu.components.mechanical.multibody import Multibody


def chain(
    n: int = 10,
    *,
    dim: int = 3,
    length: float = 1.0,
    mass: float = 1.0,
    last: float = 2.0,
    damping: float = 0.0,
    bending: float = 0.0,
    speed: float = 1.0,
    port: bool = False,
) -> PHDAE:
    """n point masses on rigid massless links, released straight and horizontal from a support at the origin.

        H = sum m_i (|v_i|^2/2 + g z_i) + bending/2 sum (|q_i+2 - q_i|^2 - (2 length)^2)^2,
        0 = (|q_i+1 - q_i|^2 - length^2)/2,   dampers on the relative velocity of neighbours

    Arguments:   n links;  dim 2 or 3, gravity along the last axis;  length [m];  mass [kg] of the first particle, growing
                 to `last` [1] times it at the last;  damping [N.s/m];  bending [N/m3];  speed [m/s] across the links at the start
                 (second axis), growing along the chain;  port: force given at the last particle, `tip`
    States:      q [m], v [m/s] (n dim each);  multipliers lambda [N/m] (n)
    Parameters:  m [kg] (n); bending, damping where given
    """
    if n < 1 or dim not in (2, 3):
        raise ValueError(f"chain: n = {n}, dim = {dim}; it needs at least one link and 2 or 3 dimensions")
    body = Multibody("chain", dim, description=f"chain of {n} rigid links")
    body.gravity([0.0] * (dim - 1) + [-9.81])
    points: list[Any] = [body.support([0.0] * dim)]
    for i in range(n):
        q = [(i + 1) * length] + [0.0] * (dim - 1)
        v = [0.0, speed * (i + 1) / n] + [0.0] * (dim - 2)
        points.append(body.particle(mass * (1.0 + (last - 1.0) * i / max(n - 1, 1)), q, v))
    for a, b in zip(points, points[1:], strict=False):
        body.bar(a, b)
    if bending:
        k = body.parameter("bending", bending, unit="N/m3", min=0.0, description="springs between next but one points")
        for a, b in zip(points, points[2:], strict=False):
            body.quartic_spring(a, b, k.sx, 2 * length)
    if damping:
        c = body.parameter("damping", damping, unit="N.s/m", description="dampers between neighbours")
        for a, b in zip(points, points[1:], strict=False):
            body.damper(a, b, c)
    if port:
        body.port("tip", points[-1])
    return body.build()
