"""Poses of shapes over the rows of a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from phfmu.declare.shape import LINES, Place, Shape, ShapeKind
from phfmu.words import counted

Floats = NDArray[np.float64]
Columns = Mapping[str, Floats]

#: lengths that a shape without a size gets, as a share of the extent of the motion
CHOSEN = {
    "ball": (0.03,),
    "box": (0.05,) * 3,
    "cylinder": (0.03, 0.06),
    "rod": (0.006,),
    "spring": (0.014,),
    "pin": (0.03,),
}
#: solids from which on those without a size are drawn smaller
CROWD = 10


@dataclass(frozen=True)
class Motion:
    """Shapes over `time` [n] in s: solids and lines, each with its shape.

    `poses` (n x solids x 7): centre [m] and quaternion (x, y, z, w);  `ends` (n x lines x 6): both ends [m];
    `tension` (n x lines): N, nan where a line tells none;  `low`, `high` (3): the box [m] in which all of it moves
    """

    title: str
    time: Floats
    solids: tuple[Shape, ...]
    lines: tuple[Shape, ...]
    poses: Floats
    ends: Floats
    tension: Floats
    low: Floats
    high: Floats

    @property
    def extent(self) -> float:
        """The longest edge of the box, m."""
        return float(np.max(self.high - self.low)) or 1.0

    def size(self, shape: Shape) -> tuple[float, ...]:
        """Lengths of a shape [m], its own or chosen by the extent of the motion."""
        crowd = min(1.0, CROWD / max(1, len(self.solids)))
        return shape.size or tuple(self.extent * crowd * shape.scale * share for share in CHOSEN[shape.kind])


def needed(shapes: Sequence[Shape], names: Sequence[str], where: str) -> list[str]:
    """The columns that shapes move with, and those of tensions that are there.

    Errors: ValueError names those that `where` lacks.
    """
    there = set(names)
    moved = list(dict.fromkeys(n for s in shapes for n in s.signals()))
    if missing := [n for n in moved if n not in there]:
        raise ValueError(
            f"{where} lacks {counted(len(missing), 'column')} that its shapes move with: {', '.join(missing[:5])}"
            f"{', ..' if len(missing) > 5 else ''}; write them too (phfmu run without --signals), or name another target"
        )
    tensions = dict.fromkeys(s.tension.name for s in shapes if s.tension and s.tension.name in there)
    return [*moved, *(n for n in tensions if n not in moved)]


def chosen_rows(time: Floats, frames: int) -> NDArray[np.intp]:
    """At most `frames` rows, as evenly spread over the time as there are rows."""
    if len(time) <= frames:
        return np.arange(len(time))
    wanted = np.linspace(time[0], time[-1], frames)
    after = np.clip(np.searchsorted(time, wanted), 1, len(time) - 1)
    before = after - 1
    nearest = np.where(wanted - time[before] <= time[after] - wanted, before, after)
    return np.unique(nearest)


def motion(title: str, shapes: Sequence[Shape], time: Floats, columns: Columns) -> Motion:
    """The motion of shapes over rows; `columns` has those that `needed` lists. Errors: ValueError where it is not finite."""
    solids = tuple(s for s in shapes if s.kind not in LINES)
    lines = tuple(s for s in shapes if s.kind in LINES)
    n = len(time)
    poses, ends = np.zeros((n, len(solids), 7)), np.zeros((n, len(lines), 6))
    tension = np.full((n, len(lines)), np.nan)
    for i, solid in enumerate(solids):
        poses[:, i, :3], poses[:, i, 3:] = _over(solid.points[0], columns, n), _turn(solid, columns, n)
    for i, line in enumerate(lines):
        ends[:, i] = np.hstack([_over(p, columns, n) for p in line.points])
        if line.tension and line.tension.name in columns:
            tension[:, i] = line.tension.factor * columns[line.tension.name]
    points = np.concatenate([poses[:, :, :3].reshape(-1, 3), ends.reshape(-1, 3)])
    if not np.isfinite(points).all():
        raise ValueError(f"{title}: positions are not finite from {time[_first_bad(poses, ends)]:g} s on")
    low, high = points.min(axis=0), points.max(axis=0)
    for i, solid in enumerate(solids):  # those with a size reach beyond their centres
        reach = _reach(solid)
        low = np.minimum(low, poses[:, i, :3].min(axis=0) - reach)
        high = np.maximum(high, poses[:, i, :3].max(axis=0) + reach)
    return Motion(title, time, solids, lines, _steady(poses), ends, tension, low, high)


def _reach(solid: Shape) -> float:
    """Distance that a solid of its own size reaches beyond its centre [m]."""
    if not solid.size:
        return 0.0
    return 0.5 * float(np.linalg.norm(solid.size)) if solid.kind is ShapeKind.BOX else solid.size[0]


def _over(place: Place, columns: Columns, n: int) -> Floats:
    """A place over the rows (n x 3)."""
    at = np.tile(np.array(place.offset), (n, 1))
    for name, direction in place.terms:
        at += np.multiply.outer(columns[name], np.array(direction))
    return at


def _turn(solid: Shape, columns: Columns, n: int) -> Floats:
    """Orientation of a solid over the rows as quaternions (n x 4): the rotation nearest to its axes (polar decomposition)."""
    if not solid.axes:
        return np.tile([0.0, 0.0, 0.0, 1.0], (n, 1))
    frame = np.stack([_over(a, columns, n) for a in solid.axes], axis=2)
    frame /= np.maximum(np.linalg.norm(frame, axis=1, keepdims=True), 1e-300)
    u, _, vt = np.linalg.svd(frame)
    u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    return Rotation.from_matrix(u @ vt).as_quat()


def _steady(poses: Floats) -> Floats:
    """Quaternions of neighbouring rows on one side, so that what lies between two is the short way."""
    turned = np.sign(np.einsum("tik,tik->ti", poses[1:, :, 3:], poses[:-1, :, 3:]))
    turned[turned == 0.0] = 1.0
    poses[1:, :, 3:] *= np.cumprod(turned, axis=0)[:, :, None]
    return poses


def _first_bad(poses: Floats, ends: Floats) -> int:
    bad = ~(np.isfinite(poses[:, :, :3]).all(axis=(1, 2)) & np.isfinite(ends).all(axis=(1, 2)))
    return int(np.flatnonzero(bad)[0])
