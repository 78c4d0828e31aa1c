"""A picture as PNG, by matplotlib."""

import os
from math import ceil
from typing import Any

import numpy as np

from phfmu.report.extra import require
from phfmu.report.picture import COLOURS, Curve, Panel, Picture

DPI = 100
WIDTH, HEIGHT, ENTRY, FRAME = 1100, 190, 15, 90
#: panels above which they stand beside each other
ONE_COLUMN = 6
DASHES = ("-", (0, (5, 2)), (0, (1, 1.3)), (0, (6, 2, 1, 2)))
#: marks that have room for a text
LABELLED = 12


def write_png(drawn: Picture, path: str | os.PathLike[str], size: tuple[int, int] | None = None) -> None:
    """Write a picture of `size` (width, height) in pixels; by default as high as its panels need.

    Errors: ValueError without matplotlib, with the command that installs it.
    """
    require("matplotlib")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    columns = 1 if len(drawn.panels) <= ONE_COLUMN else 2
    rows = max(ceil(len(drawn.panels) / columns), 1)
    width, height = size or (WIDTH, FRAME + sum(_heights(drawn, rows, columns)))
    figure = Figure(figsize=(width / DPI, height / DPI), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(
        rows, columns, squeeze=False, sharex=True, gridspec_kw={"height_ratios": _heights(drawn, rows, columns)}
    )
    for ax, panel in zip(axes.flat, drawn.panels, strict=False):
        _panel(ax, panel)
        _marks(ax, drawn, labelled=ax in axes[0])
    for ax in axes.flat[len(drawn.panels) :]:
        ax.set_visible(False)
    for j in range(columns):
        last = [ax for ax in axes[:, j] if ax.get_visible()]
        if last:
            last[-1].set_xlabel("time [s]")
            last[-1].tick_params(labelbottom=True)
    figure.suptitle(_wrapped(drawn.title, width // 9), fontsize=11)
    if drawn.notes:
        figure.supxlabel(_wrapped("\n".join(drawn.notes), width // 6), fontsize=7, color="0.35")
    figure.savefig(path, dpi=DPI, format="png")


def _heights(drawn: Picture, rows: int, columns: int) -> list[int]:
    """Pixels of each row: legends stand beside their axes."""
    entries = [sum(not c.limit for c in p.curves) for p in drawn.panels] + [0] * columns
    return [max(HEIGHT, 30 + ENTRY * max(entries[i * columns : (i + 1) * columns])) for i in range(rows)]


def _panel(ax: Any, panel: Panel) -> None:
    from matplotlib.ticker import MaxNLocator

    for curve in panel.curves:
        ax.plot(curve.time, curve.values, **_style(curve, panel.log))
    if panel.log and any(np.isfinite(c.values).any() for c in panel.curves):
        ax.set_yscale("log")
    else:
        ax.yaxis.set_major_locator(MaxNLocator("auto", integer=panel.whole, steps=[1, 2, 2.5, 5, 10]))
        if panel.whole:
            low, high = ax.get_ylim()
            ax.set_ylim(min(low, np.ceil(low) - 0.5), max(high, np.floor(high) + 0.5))
        ax.ticklabel_format(axis="y", useOffset=False, style="plain")
    ax.set_title(panel.title, fontsize=9, loc="left")
    ax.set_ylabel(panel.unit, fontsize=9)
    ax.tick_params(labelsize=8)
    ax.grid(color="0.9", lw=0.6)
    ax.spines[["top", "right"]].set_visible(False)
    ax.margins(x=0.0)
    if [c.label for c in panel.curves] != [panel.title]:
        ax.legend(fontsize=8, frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.02), handlelength=2.6)


def _style(curve: Curve, log: bool = False) -> dict[str, Any]:
    colour = COLOURS[curve.colour]
    if curve.limit:
        return {"color": colour, "ls": (0, (4, 3)), "lw": 0.8, "alpha": 0.8}
    dash = DASHES[curve.dash % len(DASHES)]
    return {"color": colour, "ls": dash, "lw": 0.6 if log else 1.1, "label": curve.label}


def _marks(ax: Any, drawn: Picture, labelled: bool) -> None:
    for mark in drawn.marks:
        ax.axvline(mark.time, color="0.45", lw=0.8, ls=":")
    if labelled and len(drawn.marks) <= LABELLED:
        for mark in drawn.marks:
            ax.annotate(
                _shortened(mark.text), (mark.time, 0.97), (2, 0), xycoords=ax.get_xaxis_transform(),
                textcoords="offset points", rotation=90, va="top", fontsize=7, color="0.3",
                bbox={"boxstyle": "square,pad=0.1", "fc": "white", "ec": "none", "alpha": 0.75},
            )  # fmt: skip


def _shortened(text: str, most: int = 26) -> str:
    return text if len(text) <= most else f"{text[: most - 1]}…"


def _wrapped(text: str, columns: int) -> str:
    from textwrap import fill

    return "\n".join(fill(line, columns) for line in text.splitlines())
