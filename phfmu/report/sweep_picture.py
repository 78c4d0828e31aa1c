"""A sweep as a picture: measures against what varied, as lines over one value, as maps over two, as points over more."""

from __future__ import annotations

import html
import os
from importlib import import_module
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np

from phfmu.report.picture.extra import require
from phfmu.report.picture.html import part, write_page
from phfmu.report.picture.png import DPI
from phfmu.report.recording import Floats
from phfmu.report.sweep_table import SweepTable, logarithmic

#: pixels of an axis; axes side by side
WIDTH, HEIGHT, COLUMNS = 560, 380, 2
_COLOUR = "#0072B2"


def draw_sweep(table: SweepTable, path: str | os.PathLike[str], size: tuple[int, int] | None = None) -> None:
    """Write the picture as PNG (`size`: width, height in pixels) or HTML."""
    if Path(path).suffix == ".png":
        _png(table, path, size)
    else:
        body = [part(_figure(table)), *(f'<p class="note">{html.escape(note)}</p>' for note in table.notes)]
        write_page(path, table.title, body)


def _axes(table: SweepTable) -> list[tuple[str, str]]:
    """(measure, what it is drawn against; "" for a map) of each axis."""
    if len(table.varied) == 2:
        return [(m, "") for m in table.measured]
    return [(m, name) for m in table.measured for name in table.varied]


def _layout(table: SweepTable) -> tuple[int, int]:
    """Rows and columns of axes: those of a measure stand side by side."""
    n = len(_axes(table))
    columns = len(table.varied) if len(table.varied) > 2 else min(n, COLUMNS)
    return ceil(n / columns), columns


def _png(table: SweepTable, path: str | os.PathLike[str], size: tuple[int, int] | None) -> None:
    require("matplotlib")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows, columns = _layout(table)
    wide, high = size or (max(columns * WIDTH, 700), rows * HEIGHT + 60)
    figure = Figure(figsize=(wide / DPI, high / DPI), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    for i, (measure, name) in enumerate(_axes(table)):
        ax = figure.add_subplot(rows, columns, i + 1)
        if name:
            x, y = _points(table, measure, name)
            ax.plot(x, y, "o-" if len(table.varied) == 1 else "o", color=_COLOUR, ms=3.5, lw=1.1)
            ax.set(xlabel=name, ylabel=measure)
            ax.ticklabel_format(axis="y", useOffset=False)
            ax.grid(color="0.9", lw=0.6)
            ax.spines[["top", "right"]].set_visible(False)
        else:
            _map(figure, ax, table, measure)
        _scale(ax.set_xscale, ax.xaxis, table.varied[name or next(iter(table.varied))])
    figure.suptitle(table.title, fontsize=11)
    if table.notes:
        figure.supxlabel("\n".join(table.notes), fontsize=7, color="0.35")
    figure.savefig(path, dpi=DPI, format="png")


def _map(figure: Any, ax: Any, table: SweepTable, measure: str) -> None:
    """Cells of a grid of two values, coloured points where there is no grid; what failed stays white."""
    across, up = table.varied
    grid = table.grid(measure)
    if grid is None:
        drawn = ax.scatter(*table.varied.values(), c=table.measured[measure], s=16)
    else:
        drawn = ax.pcolormesh(*grid, shading="nearest")
    ax.set(xlabel=across, ylabel=up, title=measure)
    ax.title.set_fontsize(10)
    _scale(ax.set_yscale, ax.yaxis, table.varied[up])
    figure.colorbar(drawn, ax=ax)


def _scale(set_scale: Any, axis: Any, values: Floats) -> None:
    """Logarithmic where the values are spaced by factors, with numbers as people write them."""
    if logarithmic(values):
        set_scale("log")
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("{x:g}")


def _points(table: SweepTable, measure: str, name: str) -> tuple[Any, Any]:
    """Values and measures in the order of the values."""
    order = np.argsort(table.varied[name], kind="stable")
    return table.varied[name][order], table.measured[measure][order]


def _figure(table: SweepTable) -> Any:
    require("plotly")
    rows, columns = _layout(table)
    figure: Any = import_module("plotly.subplots").make_subplots(
        rows=rows, cols=columns, horizontal_spacing=0.26 / columns, vertical_spacing=0.3 / (rows + 1),
        subplot_titles=[html.escape(m) for m, _ in _axes(table)],
    )  # fmt: skip
    for i, (measure, name) in enumerate(_axes(table)):
        row, col = i // columns + 1, i % columns + 1
        across = name or next(iter(table.varied))
        if name:
            x, y = _points(table, measure, name)
            mode = "lines+markers" if len(table.varied) == 1 else "markers"
            figure.add_scatter(
                x=x, y=y, mode=mode, line={"color": _COLOUR}, name=html.escape(measure), row=row, col=col
            )
        else:
            up = list(table.varied)[1]
            _plotly_map(figure, table, measure, row, col)
            scale = "log" if logarithmic(table.varied[up]) else "linear"
            figure.update_yaxes(title_text=html.escape(up), type=scale, row=row, col=col)
        scale = "log" if logarithmic(table.varied[across]) else "linear"
        figure.update_xaxes(title_text=html.escape(across), type=scale, row=row, col=col)
    figure.update_layout(
        height=rows * HEIGHT + 80, showlegend=False, plot_bgcolor="white", margin={"l": 70, "r": 20, "t": 50, "b": 60}
    )
    figure.update_xaxes(showgrid=True, gridcolor="#e8e8e8", zeroline=False)
    figure.update_yaxes(showgrid=True, gridcolor="#e8e8e8", zeroline=False)
    return figure


def _plotly_map(figure: Any, table: SweepTable, measure: str, row: int, col: int) -> None:
    grid = table.grid(measure)
    x, y = next(figure.select_xaxes(row=row, col=col)), next(figure.select_yaxes(row=row, col=col))
    bar = {"x": x.domain[1] + 0.005, "y": sum(y.domain) / 2, "len": y.domain[1] - y.domain[0], "thickness": 12}
    if grid is None:
        across, up = table.varied.values()
        marker = {"color": table.measured[measure], "colorscale": "Viridis", "showscale": True, "colorbar": bar}
        figure.add_scatter(x=across, y=up, mode="markers", marker=marker, row=row, col=col)
    else:
        figure.add_heatmap(x=grid[0], y=grid[1], z=grid[2], colorscale="Viridis", colorbar=bar, row=row, col=col)
