"""Panels of a picture: signals that share an axis."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from phfmu.report.energies import energies, energy_columns
from phfmu.report.picture.choice import few, first, rank, same, told
from phfmu.report.picture.labels import EQUAL
from phfmu.report.picture.prefix import scaled
from phfmu.report.picture.thinning import BAND, COLUMNS, PER_COLUMN, band, swings, thin
from phfmu.report.picture.thinning import window as periods
from phfmu.report.recording import Floats, Mark, Recording, Signal

#: axes of a picture of signals that nobody chose
MOST_PANELS = 16
#: height of a signal that can be seen as a band, of its axis
SEEN = 0.05
#: decades of a log axis below its largest value: rounding errors of nothing are no reason to shrink the others
DECADES = 12
#: variables that the title of an axis names, and signals that the legend of one curve does
TITLED, NAMED = 4, 4
#: Okabe and Ito's colours, told apart by colour-blind readers; their yellow is lost on white
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")


@dataclass(frozen=True)
class PlotCurve:
    """Points to draw, thinned; `colour` is an index of `COLOURS`, `dash` counts the lines of that colour on the axis.

    `band`: times, smallest and largest values of what swings too fast to be seen as a line.  `points`: no line through them.
    """

    label: str
    time: Floats
    values: Floats
    colour: int
    dash: int = 0
    limit: bool = False
    band: tuple[Floats, Floats, Floats] | None = None
    points: bool = False


@dataclass(frozen=True)
class Panel:
    """One axis: values are in `unit`, its SI prefix or power of ten included ("" where there is none); `whole`: counts.

    `near`: the curves in a short window, where some have bands; `reach`: smallest and largest value of a log axis.
    """

    title: str
    unit: str
    curves: tuple[PlotCurve, ...]
    log: bool = False
    whole: bool = False
    near: tuple[PlotCurve, ...] = ()
    reach: tuple[float, float] | None = None


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
    """The picture of some signals, or of those that `choice` takes, over a window of time.

    Signals of one unit share an axis, slow and fast ones apart; where units are not known, the entries of a variable do.  Of a
    table whose signals nobody chose the last axes are powers and stored energies.  Equal signals are one curve.
    Errors: ValueError for a window without a row.
    """
    asked = list(names) or recording.usual()
    found = [clipped(s, window) for s in recording.read(asked)]
    if found and not any(len(s.time) for s in found):
        raise ValueError(f"{recording.title} has no row from {window[0]:g} s to {window[1]:g} s")
    groups, notes = grouped(found), list[str]()
    if not names:
        groups = [few(group) for group in first(groups)][:MOST_PANELS]
        drawn = {id(s) for group in groups for s in group}
        left = [n for n, s in zip(asked, found, strict=True) if not s.limit and id(s) not in drawn]
        told_as = {*asked, *energy_columns(recording.names, recording.kinds)}
        left += [n for n in recording.names if n not in told_as]
        if left:
            notes.append(told(left, len(recording.names), bool(found[0].topic)))
        groups += [few(group) for group in grouped([clipped(s, window) for s in energies(recording)])]
    shown = [s for group in groups for s in group]
    marks = [m for m in recording.marks() if window[0] <= m.time <= window[1]]
    groups = [group if group[0].log else as_one(group) for group in groups]
    axes = tuple(panel(title_of(group), group, [m.time for m in marks]) for group in groups)
    if any(p.near for p in axes):
        notes.append("bands: least to largest value of signals with too many periods to draw; a few of them beside")
    if any(p.reach and _below(p.curves, p.reach[0]) for p in axes):
        notes.append(f"log axes end {DECADES} decades below their largest value; what is smaller is not seen")
    return Picture(recording.title, axes, tuple(marks), (*notes, *thinned(shown)))


def with_marks(drawn: Picture, marks: Sequence[Mark], window: tuple[float, float] = ALWAYS) -> Picture:
    """The picture with marks beside its own, those within a window."""
    return replace(drawn, marks=(*drawn.marks, *(m for m in marks if window[0] <= m.time <= window[1])))


def clipped(s: Signal, window: tuple[float, float]) -> Signal:
    """The part of a signal within a window."""
    if window == ALWAYS:
        return s
    a, b = np.searchsorted(s.time, window[0], "left"), np.searchsorted(s.time, window[1], "right")
    return replace(s, time=s.time[a:b], values=s.values[a:b])


def grouped(signals: Sequence[Signal]) -> list[list[Signal]]:
    """Signals that share an axis."""
    groups: dict[str, list[Signal]] = {}
    for s in signals:
        key = s.topic or (s.unit if s.unit not in (None, "", "1") else s.name.partition("[")[0])
        groups.setdefault(key, []).append(s)
    return [part for group in groups.values() for part in ([group] if group[0].topic else _by_pace(group)) if part]


def _by_pace(group: Sequence[Signal]) -> tuple[list[Signal], list[Signal]]:
    """Slow signals, fast ones."""
    reach = max(_largest(s.values) for s in group)
    fast = [swings(s.values, reach) > 0.0 for s in group]
    return tuple([s for s, f in zip(group, fast, strict=True) if f == kind] for kind in (False, True))  # type: ignore[return-value]


def title_of(group: Sequence[Signal]) -> str:
    """Title of an axis: its topic, or its variables."""
    variables = list(dict.fromkeys(s.name.partition("[")[0] for s in group))
    return group[0].topic or ", ".join(variables[:TITLED]) + (", .." if len(variables) > TITLED else "")


def panel(title: str, signals: Sequence[Signal], events: Sequence[float] = ()) -> Panel:
    """Signals on one axis, in the SI prefix that fits the largest of them; `events`: times, the first is looked at closely."""
    log, unit = signals[0].log, signals[0].unit
    size = max((_largest(s.values) for s in signals), default=0.0)
    factor, text = (1.0, unit or "") if log else scaled(size, unit)
    paces = [0.0 if log or s.points else _pace(s.values, size) for s in signals]
    span = periods(signals[0].time, min(p for p in paces if p), sorted(events)) if any(paces) else None
    curves, near, lines = list[PlotCurve](), list[PlotCurve](), dict[int, int]()
    for i, (s, pace) in enumerate(zip(signals, paces, strict=True)):
        time, values = _highest(s) if log else thin(s.time, s.values)
        colour = (i if s.owner is None else s.owner) % len(COLOURS)
        edges = band(s.time, s.values * factor, pace) if pace else None
        curve = PlotCurve(
            s.label or s.name, time, values * factor, colour, lines.get(colour, 0), s.limit, edges, s.points
        )
        curves.append(curve)
        if span:
            part = clipped(s, span)
            time, values = thin(part.time, part.values * factor)
            near.append(replace(curve, time=time, values=values, band=None))
        lines[colour] = lines.get(colour, 0) + (not s.limit)
    whole = unit == "1" and all((s.values == np.round(s.values)).all() for s in signals)
    return Panel(
        title, "" if text == "1" else text, tuple(curves), log, whole, tuple(near), _reach(curves) if log else None
    )


def as_one(signals: Sequence[Signal]) -> list[Signal]:
    """Each curve once, with the names of all signals that draw it, those of states and observables first."""
    found: list[list[Signal]] = []
    for s in signals:
        twins = next((f for f in found if same(f[0], s)), None)
        if twins is None or s.limit:
            found.append([s])
        else:
            twins.append(s)
    for f in found:
        f.sort(key=rank)
    return [f[0] if len(f) == 1 else replace(f[0], label=_all_of([s.label or s.name for s in f])) for f in found]


def _all_of(names: Sequence[str]) -> str:
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return EQUAL.join(names[:NAMED]) + more


def thinned(signals: Sequence[Signal]) -> list[str]:
    """The note about points that are not drawn."""
    notes = []
    if any(s.log and len(s.time) > 2 * BAND for s in signals):
        notes.append(f"magnitudes on log axes: the largest of each of {BAND} parts of the time")
    most = max((len(s.time) for s in signals if not s.log), default=0)
    if most > PER_COLUMN * COLUMNS:
        notes.append(
            f"drawn from {most} rows: first, smallest, largest and last of each of {COLUMNS} columns; "
            "no more of them to zoom into"
        )
    return notes


def _highest(s: Signal) -> tuple[Floats, Floats]:
    """Magnitudes, of many rows the largest of each part; a zero has no place on a log axis."""
    size = np.abs(s.values)
    size = np.where(size > 0.0, size, np.nan)
    if len(size) > 2 * BAND:
        time, _, size = band(s.time, size)
        return time, size
    return s.time, size


def _reach(curves: Sequence[PlotCurve]) -> tuple[float, float] | None:
    """The smallest and the largest value, at most `DECADES` apart; None where there is none."""
    parts = [c.values[np.isfinite(c.values)] for c in curves]
    there = np.concatenate(parts)
    return (max(float(there.min()), float(there.max()) * 10.0**-DECADES), float(there.max())) if len(there) else None


def _below(curves: Sequence[PlotCurve], least: float) -> bool:
    return any(bool((c.values < least).any()) for c in curves)


def _pace(values: Floats, size: float) -> float:
    """Swings of a signal that can be seen on an axis of this size."""
    return swings(values, size) if len(values) and np.nanmax(values) - np.nanmin(values) > SEEN * size else 0.0


def _largest(values: Floats) -> float:
    size = np.abs(values[np.isfinite(values)])
    return float(size.max(initial=0.0))
