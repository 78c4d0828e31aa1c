"""Solids of a mechanism for pictures: each body as the box of its mass and inertia, each joint and spring where it holds."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from phfmu.components.mechanical.multibody.body import Body
from phfmu.components.mechanical.multibody.builder import Multibody
from phfmu.components.mechanical.multibody.parts import Particle, Point

#: the shortest edge of a box, and the radius of a rod, beside its longest edge or its length
THIN, ROD = 0.04, 0.02


class Placed(Protocol):
    """Bodies of a mechanism as particles: the centre of mass and the directors of each, and points of them."""

    made: Multibody
    particles: dict[int, list[Particle]]

    def direction(self, body: Body | None, along: Any) -> Any: ...


def add_solid(placed: Placed, body: Body) -> None:
    """The box (rod, ball) with the mass and the moments of inertia of a body, along its principal axes.

    e_i = m a_i^2/12    for an edge a_i and the Euler moment e_i
    """
    centre, *directors = placed.particles[id(body)]
    if not directors or not body.mass:
        return
    edges = np.sqrt(12.0 * np.maximum(body.moments, 0.0) / body.mass)
    longest = float(edges.max())
    if len(directors) == 1 and not body.planar:
        half = _along(placed, body, centre, 0.5 * longest), _along(placed, body, centre, -0.5 * longest)
        placed.made.solid("rod", *half, size=(ROD * longest,), label=body.name)
        return
    size = tuple(float(a) for a in np.maximum(edges, THIN * longest))
    axes = directors if len(directors) == 3 else [directors[0], placed.direction(body, [0.0, 1.0])]
    placed.made.solid("box", centre, size=size, axes=axes, label=body.name)


def _along(placed: Placed, body: Body, centre: Particle, distance: float) -> Point:
    """The point at a distance from the centre of a rod [m]."""
    towards = placed.direction(body, [distance, 0.0, 0.0])
    return type(towards)(((centre, 1.0), *towards.terms))
