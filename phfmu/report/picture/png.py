"""A picture as PNG, by matplotlib."""

import os
from math import ceil
from typing import Any

import numpy as np

from phfmu.report.picture.extra import require
from phfmu.report.picture.labels import EventCluster, Label, entry, height, labels, parted
from phfmu.report.picture.picture import COLOURS, Panel, Picture, PlotCurve
from phfmu.report.picture.prefix import scaled
from phfmu.report.recording import Mark

DPI = 100
WIDTH, HEIGHT, ENTRY, FRAME = (1100, 1500), 190, 15, 90
#: panels above which they stand beside each other
ONE_COLUMN = 6
DASHES = ("-", (0, (5, 2)), (0, (1, 1.3)), (0, (6, 2, 1, 2)))
#: widths of the whole run and of the close look at a part of it; share of a column that axes have beside their legends
WIDE, NEAR, SHARE = 1.7, 1.0, 0.75
#: points between lines of texts of events, ticks of crowds of them as a share of an axis
UP, TICK = 10, 0.06
#: factor by which log axes reach beyond their values
EDGE = 3.0


def write_png(drawn: Picture, path: str | os.PathLike[str], size: tuple[int, int] | None = None) -> None:
    """Write a picture of `size` (width, height) in pixels; by default as high as its panels need.

    Errors: ValueError without matplotlib, with the command that installs it.
    """
    require("matplotlib")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    columns = 1 if len(drawn.panels) <= ONE_COLUMN else 2
    rows = max(ceil(len(drawn.panels) / columns), 1)
    span = _span(drawn)
    alone, crowds = parted(drawn.marks, *span)
    texts = labels([*alone, *(c.mark for c in crowds)], *span, (size or (WIDTH[columns - 1], 0))[0] / columns * SHARE)
    heights = _heights(drawn, rows, columns)
    width, full = size or (WIDTH[columns - 1], FRAME + height(texts) + sum(heights))
    figure = Figure(figsize=(width / DPI, full / DPI), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    near = any(p.near for p in drawn.panels)
    grid = figure.add_gridspec(
        rows,
        columns * (1 + near),
        height_ratios=heights,
        width_ratios=[WIDE, NEAR] * columns if near else [1] * columns,
    )
    for i, panel in enumerate(drawn.panels):
        row, column = i // columns, i % columns * (1 + near)
        places = [grid[row, column], grid[row, column + 1]] if panel.near else [grid[row, column : column + 1 + near]]
        axes = [figure.add_subplot(place) for place in places]
        _panel(axes[0], panel, panel.curves)
        axes[0].set_xlim(*span)
        above = texts if row == 0 else []
        axes[0].set_title(
            panel.title, fontsize=9, loc="left", pad=4 + UP * (1 + max((t.row for t in above), default=-1))
        )
        _marks(axes[0], alone, above)
        _crowds(axes[0], crowds)
        if panel.near:
            _near(axes[1], panel, axes[0])
        _legend(axes[-1], panel)
        last = i + columns >= len(drawn.panels)
        _times(axes[0], span, last)
    figure.suptitle(_wrapped(drawn.title, width // 9), fontsize=11)
    if drawn.notes:
        figure.supxlabel(_wrapped("\n".join(drawn.notes), width // 6), fontsize=7, color="0.35")
    figure.savefig(path, dpi=DPI, format="png")


def _span(drawn: Picture) -> tuple[float, float]:
    times = [c.time for p in drawn.panels for c in p.curves if len(c.time)]
    first, last = min((float(t[0]) for t in times), default=0.0), max((float(t[-1]) for t in times), default=1.0)
    return (first, last) if last > first else (first - 0.5, first + 0.5)


def _heights(drawn: Picture, rows: int, columns: int) -> list[int]:
    """Pixels of each row: legends stand beside their axes."""
    entries = [sum(len(entry(c.label)) for c in p.curves if not c.limit) for p in drawn.panels] + [0] * columns
    return [max(HEIGHT, 30 + ENTRY * max(entries[i * columns : (i + 1) * columns])) for i in range(rows)]


def _panel(ax: Any, panel: Panel, curves: tuple[PlotCurve, ...]) -> None:
    """Curves on their axis; the higher bands lie below."""
    from matplotlib.ticker import MaxNLocator

    reach = [0.0 if c.band is None else float(np.nanmax(c.band[2]) - np.nanmin(c.band[1])) for c in curves]
    below = sorted(range(len(curves)), key=lambda i: -reach[i])
    for i, curve in enumerate(curves):
        if curve.band is not None:
            time, low, high = curve.band
            ax.fill_between(
                time, low, high, fc=COLOURS[curve.colour], ec="none", alpha=0.25, zorder=1 + below.index(i) / 100
            )
            ax.plot(time, low, color=COLOURS[curve.colour], lw=0.5)
            ax.plot(time, high, color=COLOURS[curve.colour], lw=0.5)
        else:
            ax.plot(curve.time, curve.values, **_style(curve, panel.log))
    if panel.reach:
        ax.set_yscale("log")
        ax.set_ylim(panel.reach[0] / EDGE, panel.reach[1] * EDGE)
    else:
        ax.yaxis.set_major_locator(MaxNLocator("auto", integer=panel.whole, steps=[1, 2, 2.5, 5, 10]))
        if panel.whole:
            low, high = ax.get_ylim()
            ax.set_ylim(min(low, np.ceil(low) - 0.5), max(high, np.floor(high) + 0.5))
        ax.ticklabel_format(axis="y", useOffset=False, style="plain")
    ax.set_ylabel(panel.unit, fontsize=9)
    ax.tick_params(labelsize=8)
    ax.grid(color="0.9", lw=0.6)
    ax.spines[["top", "right"]].set_visible(False)


def _near(ax: Any, panel: Panel, whole: Any) -> None:
    """A few periods, and where they are in the whole."""
    from matplotlib.ticker import MaxNLocator

    _panel(ax, panel, panel.near)
    ax.set_ylabel("")
    times = [c.time for c in panel.near if len(c.time)]
    start, stop = float(times[0][0]), float(times[0][-1])
    ax.set_xlim(start, stop)
    ax.xaxis.set_major_locator(MaxNLocator(3))
    ax.set_title("in the grey window", fontsize=8, loc="right", color="0.4")
    ax.set_facecolor("0.975")
    whole.axvspan(start, stop, color="0.5", alpha=0.35, lw=0, zorder=0.5)


def _legend(ax: Any, panel: Panel) -> None:
    from matplotlib.lines import Line2D

    curves = [c for c in panel.curves if not c.limit]
    if [c.label for c in curves] == [panel.title]:
        return
    lines = [Line2D([], [], **_style(c, panel.log)) for c in curves]
    ax.legend(handles=lines, fontsize=8, frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.02), handlelength=2.6)


def _times(ax: Any, span: tuple[float, float], last: bool) -> None:
    """Times in s, ms or µs, written at the lowest axis of a column."""
    from matplotlib.ticker import FuncFormatter

    factor, unit = scaled(max(abs(t) for t in span), "s")
    if factor != 1.0:
        ax.xaxis.set_major_formatter(FuncFormatter(lambda t, _: f"{t * factor:g}"))
    ax.tick_params(labelbottom=last)
    if last:
        ax.set_xlabel(f"time [{unit}]")


def _style(curve: PlotCurve, log: bool = False) -> dict[str, Any]:
    colour = COLOURS[curve.colour]
    if curve.limit:
        return {"color": colour, "ls": (0, (4, 3)), "lw": 0.8, "alpha": 0.8}
    label = "\n".join(entry(curve.label))
    if curve.points:
        return {"color": colour, "ls": "", "marker": ".", "ms": 4, "alpha": 0.6, "label": label}
    dash = DASHES[curve.dash % len(DASHES)]
    shape: dict[str, Any] = (
        {"lw": 0.6, "marker": ".", "ms": 2} if log else {"lw": 1.1}
    )  # between zeros are single points
    return {"color": colour, "ls": dash, "label": label} | shape


def _crowds(ax: Any, crowds: list[EventCluster]) -> None:
    """Ticks at the foot of the axis."""
    for crowd in crowds:
        ax.vlines(crowd.ticks, 0.0, TICK, transform=ax.get_xaxis_transform(), color="0.3", lw=0.6)


def _marks(ax: Any, alone: list[Mark], texts: list[Label]) -> None:
    """A dotted line for each event; its text above the axis, below the title."""
    for mark in alone:
        ax.axvline(mark.time, color="0.45", lw=0.8, ls=":")
    for t in texts:
        ax.annotate(
            t.text, (t.time, 1.0), (-3 if t.right else 3, 2 + UP * t.row), xycoords=ax.get_xaxis_transform(),
            textcoords="offset points", ha="right" if t.right else "left", va="bottom", fontsize=7.5, color="0.25",
            arrowprops={"arrowstyle": "-", "ls": ":", "lw": 0.8, "color": "0.45", "relpos": (1.0 if t.right else 0.0, 0.0),
                        "shrinkA": 0, "shrinkB": 0},
        )  # fmt: skip


def _wrapped(text: str, columns: int) -> str:
    from textwrap import fill

    return "\n".join(fill(line, columns) for line in text.splitlines())
