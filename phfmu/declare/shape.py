"""Shapes of a declaration: the solids and lines that a picture of its motion shows, as linear forms of signals.

A shape holds no equations: a run writes it beside its table, and `phfmu view` draws it there from the columns alone.
Space is right-handed, in m, with z up.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

Vector = tuple[float, float, float]


class ShapeKind(StrEnum):
    """The forms of a shape, and the lengths in m that `size` lists for each; without them the picture chooses."""

    BALL = "ball"  # radius
    BOX = "box"  # edges along the three axes
    CYLINDER = "cylinder"  # radius, length along the third axis
    ROD = "rod"  # radius; between two points
    SPRING = "spring"  # radius of the coil; between two points
    PIN = "pin"  # edge of a mark of a fixed point


#: those that reach from a first point to a second one
LINES = (ShapeKind.ROD, ShapeKind.SPRING)


@dataclass(frozen=True)
class Place:
    """A point or vector of space, offset + sum_i direction_i s_i, with scalar signals s_i by name (`q[1]`)."""

    offset: Vector = (0.0, 0.0, 0.0)
    terms: tuple[tuple[str, Vector], ...] = ()

    def prefixed(self, prefix: str) -> Place:
        """The same of a member of that name."""
        return replace(self, terms=tuple((f"{prefix}.{name}", direction) for name, direction in self.terms))


@dataclass(frozen=True)
class Tension:
    """The tension of a rod or spring in N (negative: compression) as factor [m] times the signal `name` [N/m]."""

    name: str
    factor: float = 1.0


@dataclass(frozen=True)
class Shape:
    """A solid at one point, or a line between two.

    points: its centre, or both ends;  axes: directions of the frame of a solid (their lengths do not matter), () for
    those of space;  size: lengths in m, see `ShapeKind`, () for the choice of the picture;  scale: of a size that the
    picture chooses
    """

    kind: ShapeKind
    points: tuple[Place, ...]
    label: str = ""
    size: tuple[float, ...] = ()
    axes: tuple[Place, ...] = ()
    scale: float = 1.0
    tension: Tension | None = None

    def prefixed(self, prefix: str) -> Shape:
        """The same of a member of that name."""
        return replace(
            self,
            points=tuple(p.prefixed(prefix) for p in self.points),
            axes=tuple(a.prefixed(prefix) for a in self.axes),
            label=f"{prefix}.{self.label}",
            tension=self.tension and replace(self.tension, name=f"{prefix}.{self.tension.name}"),
        )

    def signals(self) -> list[str]:
        """Scalar names of the signals it moves with, without its tension."""
        return [name for place in (*self.points, *self.axes) for name, _ in place.terms]


def to_data(shapes: Sequence[Shape]) -> list[dict[str, Any]]:
    """Shapes as lists and dictionaries of JSON."""

    def place(p: Place) -> dict[str, Any]:
        return {"offset": list(p.offset), "terms": {name: list(direction) for name, direction in p.terms}}

    return [
        {
            "kind": s.kind.value,
            "label": s.label,
            "points": [place(p) for p in s.points],
            "axes": [place(a) for a in s.axes],
            "size": list(s.size),
            "scale": s.scale,
            "tension": s.tension and {"name": s.tension.name, "factor": s.tension.factor},
        }
        for s in shapes
    ]


def from_data(data: Sequence[Mapping[str, Any]]) -> tuple[Shape, ...]:
    """The shapes that `to_data` made of them. Raises KeyError, TypeError or ValueError for other data."""

    def vector(v: Sequence[Any]) -> Vector:
        x, y, z = map(float, v)
        return x, y, z

    def place(p: Mapping[str, Any]) -> Place:
        return Place(vector(p["offset"]), tuple((str(name), vector(v)) for name, v in p["terms"].items()))

    return tuple(
        Shape(
            ShapeKind(s["kind"]),
            tuple(map(place, s["points"])),
            str(s["label"]),
            tuple(map(float, s["size"])),
            tuple(map(place, s["axes"])),
            float(s["scale"]),
            Tension(str(s["tension"]["name"]), float(s["tension"]["factor"])) if s["tension"] else None,
        )
        for s in data
    )
