"""Panels of a picture: signals that share an axis."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from phfmu.report.prefix import scaled
from phfmu.report.recording import Floats, Mark, Recording, Signal
from phfmu.report.thin import COLUMNS, PER_COLUMN, thin
from phfmu.words import counted

#: axes of a picture of signals that nobody chose
MOST_PANELS = 24
#: Okabe and Ito's colours, told apart by colour-blind readers; their yellow is lost on white
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")


@dataclass(frozen=True)
class Curve:
    """Points to draw, thinned; `colour` is an index of `COLOURS`, `dash` counts the lines of that colour on the axis."""

    label: str
    time: Floats
    values: Floats
    colour: int
    dash: int = 0
    limit: bool = False


@dataclass(frozen=True)
class Panel:
    """One axis: values are in `unit`, its SI prefix or power of ten included ("" where there is none); `whole`: counts."""

    title: str
    unit: str
    curves: tuple[Curve, ...]
    log: bool = False
    whole: bool = False


@dataclass(frozen=True)
class Picture:
    """Panels over one time axis in seconds; `notes` are printed below and on the command line."""

    title: str
    panels: tuple[Panel, ...]
    marks: tuple[Mark, ...] = ()
    notes: tuple[str, ...] = ()


#: a window in seconds that leaves nothing out
ALWAYS = (-math.inf, math.inf)


def picture(recording: Recording, names: Sequence[str] = (), window: tuple[float, float] = ALWAYS) -> Picture:
    """The picture of some signals, or of the usual ones, over a window of time.

    Signals of one unit share an axis; where units are not known, the entries of a variable do.
    Errors: ValueError for a window without a row.
    """
    chosen = list(names) or recording.usual()
    groups, notes = grouped(recording.read(chosen)), []
    if not names and len(groups) > MOST_PANELS:
        others = ", ".join(list(groups)[MOST_PANELS:])
        notes.append(f"{MOST_PANELS} of {len(groups)} axes drawn; name signals for others: {others}")
        groups = dict(list(groups.items())[:MOST_PANELS])
    left = len(recording.names) - len(chosen)
    if left and not names:
        notes.append(f"{counted(left, 'signal')} left out (means and ends of steps, energies); name those wanted")
    groups = {title: [clipped(s, window) for s in group] for title, group in groups.items()}
    shown = [s for group in groups.values() for s in group]
    if shown and not any(len(s.time) for s in shown):
        raise ValueError(f"{recording.title} has no row from {window[0]:g} s to {window[1]:g} s")
    drawn = Picture(recording.title, panels(groups), notes=(*notes, *thinned(shown)))
    return with_marks(drawn, recording.marks(), window)


def with_marks(drawn: Picture, marks: Sequence[Mark], window: tuple[float, float] = ALWAYS) -> Picture:
    """The picture with marks beside its own, those within a window."""
    return replace(drawn, marks=(*drawn.marks, *(m for m in marks if window[0] <= m.time <= window[1])))


def clipped(s: Signal, window: tuple[float, float]) -> Signal:
    """The part of a signal within a window."""
    if window == ALWAYS:
        return s
    a, b = np.searchsorted(s.time, window[0], "left"), np.searchsorted(s.time, window[1], "right")
    return replace(s, time=s.time[a:b], values=s.values[a:b])


def grouped(signals: Sequence[Signal]) -> dict[str, list[Signal]]:
    """Signals that share an axis, by its title."""
    groups: dict[str, list[Signal]] = {}
    for s in signals:
        title = s.topic or (f"unit {s.unit}" if s.unit not in (None, "", "1") else s.name.partition("[")[0])
        groups.setdefault(title, []).append(s)
    return {_title(title, group): group for title, group in groups.items()}


def _title(title: str, group: Sequence[Signal]) -> str:
    """An axis of one variable is called by it."""
    variables = {s.name.partition("[")[0] for s in group}
    return variables.pop() if len(variables) == 1 and not group[0].topic else title


def panels(groups: dict[str, list[Signal]]) -> tuple[Panel, ...]:
    return tuple(panel(title, group) for title, group in groups.items())


def panel(title: str, signals: Sequence[Signal]) -> Panel:
    """Signals on one axis, in the SI prefix that fits the largest of them."""
    log, unit = signals[0].log, signals[0].unit
    size = max((_largest(s.values) for s in signals), default=0.0)
    factor, text = (1.0, unit or "") if log else scaled(size, unit)
    curves, lines = list[Curve](), dict[int, int]()
    for i, s in enumerate(signals):
        time, values = thin(s.time, _logged(s.values) if log else s.values)
        colour = (i if s.owner is None else s.owner) % len(COLOURS)
        curves.append(Curve(s.name, time, values * factor, colour, lines.get(colour, 0), s.limit))
        lines[colour] = lines.get(colour, 0) + (not s.limit)
    whole = unit == "1" and all((s.values == np.round(s.values)).all() for s in signals)
    return Panel(title, "" if text == "1" else text, tuple(curves), log, whole)


def thinned(signals: Sequence[Signal]) -> list[str]:
    """What the reader must know of points that are not drawn."""
    most = max((len(s.time) for s in signals), default=0)
    if most <= PER_COLUMN * COLUMNS:
        return []
    return [
        f"drawn from {most} rows: first, smallest, largest and last of each of {COLUMNS} columns; no more of them to zoom into"
    ]


def _logged(values: Floats) -> Floats:
    """Magnitudes; a zero has no place on a log axis."""
    size = np.abs(values)
    return np.where(size > 0.0, size, np.nan)


def _largest(values: Floats) -> float:
    size = np.abs(values[np.isfinite(values)])
    return float(size.max(initial=0.0))
