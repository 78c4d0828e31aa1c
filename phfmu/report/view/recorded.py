"""The motion of a run, from its table or from rows as they are made; and the file it is written to, by its ending."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from phfmu.declare.shape import Shape
from phfmu.files import require_writable
from phfmu.report.view.poses import Floats, Motion, chosen_rows, motion, needed
from phfmu.results.file import ResultFile
from phfmu.results.shapes_file import read_shapes, shapes_file

#: pictures of a motion that a file holds, and numbers of all of them
FRAMES, NUMBERS = 900, 3_000_000
ENDINGS = (".html", ".gif")


def check_view(path: str | os.PathLike[str], option: str) -> None:
    """Check before long work of what would fail after it. Errors: ValueError for ending, folder, a package that is missing."""
    if Path(path).suffix not in ENDINGS:
        raise ValueError(f"{option} {path}: the ending must be .html (a page to turn and play) or .gif")
    if Path(path).suffix == ".gif":
        from phfmu.report.picture.extra import require

        require("matplotlib")
    require_writable(Path(path), f"{option} {path}")


def write(made: Motion, path: str | os.PathLike[str]) -> None:
    """Write a motion as a page or as an animated image."""
    if Path(path).suffix == ".gif":
        from phfmu.report.view.animation import write_gif

        write_gif(made, path)
    else:
        from phfmu.report.view.page import write_view

        write_view(made, path)


def frames(shapes: Sequence[Shape]) -> int:
    """The number of pictures that a file of these shapes holds."""
    return max(2, min(FRAMES, NUMBERS // max(1, 7 * len(shapes))))


def require_shapes(shapes: Sequence[Shape], target: str) -> None:
    """Raise ValueError where there is nothing to see."""
    if not shapes:
        raise ValueError(
            f"{target} has no shapes to show; systems of `Multibody` have, and others that declare PHDAE(shapes=..) "
            "(phfmu plot draws signals over time)"
        )


def of_table(path: str | os.PathLike[str], shapes: Sequence[Shape] = ()) -> Motion:
    """The motion of a table that `phfmu run -o` wrote; `shapes`: of the model, where no file beside it tells of them.

    Errors: ValueError for a file that is no table, lacks columns or has no shapes.
    """
    place = Path(path)
    shown = tuple(shapes) or read_shapes(place)
    if not shown:
        raise ValueError(
            f"{place}: no {shapes_file(place).name} beside it tells of shapes; name the target they are of: "
            f"phfmu view {place} --shapes TARGET"
        )
    file = ResultFile(place)
    names = needed(shown, file.names, str(place))
    columns = file.columns(names)
    rows = chosen_rows(file.time, frames(shown))
    return motion(place.name, shown, file.time[rows], {n: columns[n][rows] for n in names})


class LiveMotion:
    """Keeps of the rows of a run to `stop` what pictures need, and no more: which ones does not depend on how they come.

    Errors: ValueError for no shapes, and names that lack what these move with.
    """

    CARRIED = ("_next", "_time", "_values", "_last")

    def __init__(self, title: str, shapes: Sequence[Shape], names: Sequence[str], start: float, stop: float):
        require_shapes(shapes, title)
        self._title, self._shapes = title, tuple(shapes)
        self._names = needed(shapes, names, title)
        self._columns = [names.index(n) for n in self._names]
        self._apart = (stop - start) / (2 * frames(shapes))
        self._next = start
        self._time: list[Floats] = []
        self._values: list[Floats] = []
        #: the last row, which is shown in any case: time (1) and values (1, columns); empty where it is among the others
        self._last: tuple[Floats, Floats] = np.zeros(0), np.zeros((0, len(self._columns)))

    @property
    def rows(self) -> int:
        return sum(map(len, self._time)) + len(self._last[0])

    def add(self, time: Floats, values: Floats) -> None:
        """Take n rows: time [n], values [n, names]."""
        keep = np.zeros(len(time), bool)
        for i, t in enumerate(time):
            if t >= self._next:
                keep[i], self._next = True, t + self._apart
        self._time.append(np.array(time)[keep])
        self._values.append(values[keep][:, self._columns])
        end = slice(len(time), None) if keep[-1] else slice(-1, None)
        self._last = np.array(time)[end], values[end][:, self._columns]

    def motion(self) -> Motion:
        """The motion of the rows so far."""
        time = np.concatenate([*self._time, self._last[0]])
        values = np.concatenate([*self._values, self._last[1]])
        rows = chosen_rows(time, frames(self._shapes))
        columns = dict(zip(self._names, values[rows].T, strict=True))
        return motion(self._title, self._shapes, time[rows], columns)
