"""The shapes of a multibody system: its particles, bars, springs, supports and solids, with z up against gravity."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import Any, Protocol

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu import Place, Shape, ShapeKind, Tension, Variable
from phfmu.components.mechanical.multibody.parts import (
    LinearCombination,
    MovingSupport,
    Particle,
    ParticleSystem,
    Point,
    Solid,
    Support,
)

Floats = NDArray[np.float64]


class PictureSource(Protocol):
    """A declaration in the making: its parts, and the positions `q` of its particles."""

    parts: ParticleSystem
    q: Variable


def shapes(built: PictureSource) -> tuple[Shape, ...]:
    """Balls for the masses, rods for the bars, springs, pins for the supports that these end at, and the solids asked for.

    Masses that gravity does not act on are directors of bodies, and no points of space; those that a solid stands for have no
    ball.
    """
    parts, space = built.parts, _Space(built)
    heaviest = max((m.mass for m in parts.masses), default=0.0)
    shown = {s.label for s in parts.solids}, {s.points[0] for s in parts.solids if isinstance(s.points[0], Particle)}
    balls = (
        Shape(
            ShapeKind.BALL,
            (space.place(Particle(i)),),
            m.called or f"particle {i + 1}",
            scale=float(np.cbrt(m.mass / heaviest)) if m.mass > 0.0 else 0.4,
        )
        for i, m in enumerate(parts.masses)
        if m.weight and m.called not in shown[0] and Particle(i) not in shown[1]
    )
    solids = (Shape(s.kind, tuple(map(space.place, s.points)), s.label, s.size, space.axes(s)) for s in parts.solids)
    attached = [*(p for b in parts.bars for p in b.points), *(p for s in parts.springs for p in (s.a, s.b))]
    ends = dict.fromkeys(p for p in attached if isinstance(p, Support))
    pins = (Shape(ShapeKind.PIN, (space.place(p),), "support") for p in ends)
    return (*balls, *solids, *_lines(parts, space), *pins)


def _lines(parts: ParticleSystem, space: _Space) -> Iterator[Shape]:
    """Bars with their tension, multiplier times length, and springs; not those of points that are led by a function of time."""
    for i, bar in enumerate(parts.bars):
        if not any(isinstance(p, MovingSupport) for p in bar.points):
            ends = tuple(map(space.place, bar.points))
            yield Shape(ShapeKind.ROD, ends, bar.label, tension=Tension(f"lambda[{i + 1}]", space.length(ends)))
    for i, spring in enumerate(parts.springs):
        yield Shape(ShapeKind.SPRING, (space.place(spring.a), space.place(spring.b)), f"spring {i + 1}")


class _Space:
    """The axes of a system in the space of a picture, where the plane of two dimensions stands upright."""

    def __init__(self, built: PictureSource):
        self._built, self._dim, gravity = built, built.parts.dim, built.parts.gravity
        into = np.eye(3)[:, [0, 2] if self._dim == 2 else list(range(self._dim))]
        down = np.zeros(3) if gravity is None else into @ np.array(gravity)
        self._map = _turned(-down) @ into
        self._start = dict(zip(built.q.names(), built.q.start, strict=True))

    def length(self, ends: tuple[Place, ...]) -> float:
        """The distance of two places of particles and supports at the start, m."""
        a, b = (np.array(p.offset) + sum(self._start.get(n, 0.0) * np.array(d) for n, d in p.terms) for p in ends)
        return float(np.linalg.norm(b - a))

    def axes(self, solid: Solid) -> tuple[Place, ...]:
        """Its directors; in the plane, where two are given, the third is normal to it."""
        found = tuple(map(self.place, solid.axes))
        return (*found, Place(_vector(np.cross(self._map[:, 0], self._map[:, 1])))) if len(found) == 2 else found

    def place(self, point: Point) -> Place:
        """A point that no function of time leads."""
        if isinstance(point, Support):
            return Place(_vector(self._map @ np.array(point.position)))
        if isinstance(point, LinearCombination):
            return self._combined(point)
        names = (
            self._entries(point)
            if isinstance(point, Particle)
            else [f"{point.name}.q[{i + 1}]" for i in range(self._dim)]
        )
        return Place(terms=tuple((s, _vector(self._map[:, i])) for i, s in enumerate(names)))

    def _entries(self, particle: Particle) -> list[str]:
        """The names of its coordinates."""
        return [f"q[{particle.number * self._dim + i + 1}]" for i in range(self._dim)]

    def _combined(self, point: LinearCombination) -> Place:
        """The linear form of a point, with the parameters of its weights at their starts."""
        slope: dict[str, Floats] = {}
        for particle, weight in point.terms:
            value = self._number(weight)
            matrix = self._map @ (value * np.eye(self._dim) if value.size == 1 else value)
            for name, direction in zip(self._entries(particle), matrix.T, strict=True):
                slope[name] = slope.get(name, 0.0) + direction
        terms = tuple((name, _vector(d)) for name, d in slope.items() if np.any(d))
        offset = np.zeros(3) if point.fixed is None else self._map @ self._number(point.fixed).ravel()
        return Place(_vector(offset), terms)

    def _number(self, expr: Any) -> Floats:
        """The value of an expression of parameters, with these at their starts."""
        known = ca.SX(expr)
        symbols = ca.symvar(known)
        values = [self._parameters[s.element_hash()] for s in symbols]
        return np.array(ca.evalf(ca.substitute(known, ca.vertcat(*symbols), ca.vertcat(*values)) if symbols else known))

    @cached_property
    def _parameters(self) -> dict[int, float]:
        """The start of each scalar parameter, by its symbol."""
        return {
            s.element_hash(): start
            for p in self._built.parts.parameters
            for s, start in zip(ca.vertsplit(p.sx), p.start, strict=True)
        }


def _turned(up: Floats) -> Floats:
    """The rotation that takes `up` to the third axis by the shortest way; none for no direction."""
    length = float(np.linalg.norm(up))
    if length == 0.0:
        return np.eye(3)
    x, y, z = up / length
    if z < -1.0 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    across = np.array([[0.0, 0.0, -x], [0.0, 0.0, -y], [x, y, 0.0]])
    return np.eye(3) + across + across @ across / (1.0 + z)


def _vector(v: Floats) -> tuple[float, float, float]:
    x, y, z = (float(c) for c in v)
    return x, y, z
