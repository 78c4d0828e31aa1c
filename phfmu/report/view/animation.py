"""A motion as an animated GIF, drawn by matplotlib; for pages that show images only."""

from __future__ import annotations

import os
from itertools import product
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from phfmu.declare.shape import ShapeKind
from phfmu.report.picture.extra import require
from phfmu.report.picture.picture import COLOURS
from phfmu.report.view.poses import Floats, Motion

#: pixels of an edge, pictures a second, and the longest time that a file plays, s
EDGE, RATE, LONGEST = 480, 25, 10.0
#: the faces of a box of edge 1
_FACES = [
    np.insert(np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]), axis, side, axis=1)
    for axis, side in product(range(3), (-0.5, 0.5))
]


def write_gif(motion: Motion, path: str | os.PathLike[str]) -> None:
    """Write the motion as it is seen from its front, at its own pace or, where it is longer than 10 s, faster.

    Errors: ValueError without matplotlib, with the command that installs it; OSError.
    """
    require("matplotlib")
    from matplotlib.animation import FuncAnimation, PillowWriter
    from matplotlib.figure import Figure

    span = float(motion.time[-1] - motion.time[0])
    frames = max(2, round(RATE * min(max(span, 2.0), LONGEST)))
    wanted = np.linspace(motion.time[0], motion.time[-1], frames)
    rows = np.clip(np.searchsorted(motion.time, wanted), 0, len(motion.time) - 1)
    figure = Figure(figsize=(EDGE / 100, EDGE / 100), dpi=100)
    axes: Any = figure.add_axes((0.0, 0.0, 1.0, 1.0), projection="3d")
    _frame(axes, motion)
    scene = _Scene(axes, motion)
    scene.show(0)
    animation = FuncAnimation(figure, lambda k: scene.show(int(rows[k])), frames=frames, blit=False)
    animation.save(os.fspath(path), PillowWriter(fps=RATE))


def _frame(axes: Any, motion: Motion) -> None:
    """The view and its limits: the box of the motion, a plane from its front."""
    middle, half = (motion.low + motion.high) / 2, motion.extent / 2
    for i, name in enumerate("xyz"):
        getattr(axes, f"set_{name}lim")(middle[i] - half, middle[i] + half)
    flat = motion.high[1] - motion.low[1] < 1e-6 * motion.extent
    axes.view_init(elev=4 if flat else 20, azim=-90 if flat else -60)
    axes.set_box_aspect((1, 1, 1), zoom=1.35)
    axes.set_axis_off()


class _Scene:
    """The artists of the shapes."""

    def __init__(self, axes: Any, motion: Motion):
        from mpl_toolkits.mplot3d.art3d import Poly3DCollection

        self._motion, points = motion, EDGE / motion.extent
        self._lines = [
            axes.plot(
                [], [], [], color="0.45", linewidth=max(1.2, points * motion.size(s)[0] * 0.9), solid_capstyle="round"
            )[0]
            for s in motion.lines
        ]
        self._solids: list[Any] = []
        count = 0
        for s in motion.solids:
            pin = s.kind is ShapeKind.PIN
            colour = "0.3" if pin else COLOURS[count % len(COLOURS)]
            count += not pin
            if s.kind in (ShapeKind.BALL, ShapeKind.PIN):
                marker = {"marker": "s" if pin else "o", "markersize": max(3.0, 1.3 * points * motion.size(s)[0])}
                self._solids.append(axes.plot([], [], [], color=colour, linestyle="", **marker)[0])
            else:
                solid = Poly3DCollection([], facecolors=colour, edgecolors="0.25", linewidths=0.4, shade=False)
                self._solids.append(axes.add_collection3d(solid, autolim=False))

    def show(self, row: int) -> None:
        """Move all to a row."""
        motion = self._motion
        for i, line in enumerate(self._lines):
            line.set_data_3d(*motion.ends[row, i].reshape(2, 3).T)
        for i, (shape, artist) in enumerate(zip(motion.solids, self._solids, strict=True)):
            centre, turn = motion.poses[row, i, :3], motion.poses[row, i, 3:]
            if shape.kind in (ShapeKind.BALL, ShapeKind.PIN):
                artist.set_data_3d(*centre[:, None])
            else:
                turned = Rotation.from_quat(turn)
                artist.set_verts([turned.apply(face) + centre for face in _faces(shape.kind, motion.size(shape))])


def _faces(kind: ShapeKind, size: tuple[float, ...]) -> list[Floats]:
    """Faces of a box or a cylinder in its own frame."""
    if kind is ShapeKind.BOX:
        return [face * np.array(size) for face in _FACES]
    radius, length = size
    angle = np.linspace(0.0, 2 * np.pi, 25)
    circle = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(25)])
    up = np.array([0.0, 0.0, length / 2])
    mantle = [np.array([a - up, b - up, b + up, a + up]) for a, b in zip(circle[:-1], circle[1:], strict=True)]
    return [circle - up, circle + up, *mantle]
