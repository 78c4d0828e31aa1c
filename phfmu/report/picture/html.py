"""A picture as part of a web page, by plotly; the page holds all it needs and loads nothing."""

import base64
import gzip
import html
import json
import os
from collections.abc import Sequence
from dataclasses import replace
from importlib import import_module
from math import ceil, log10
from typing import Any

import numpy as np

from phfmu.report.picture.extra import require
from phfmu.report.picture.labels import LINE, EventCluster, Label, entry, height, labels, parted
from phfmu.report.picture.picture import COLOURS, Panel, Picture, PlotCurve
from phfmu.report.picture.thinning import COLUMNS, PER_COLUMN, columns_within, lean, thin
from phfmu.report.recording import Floats, Mark

DASHES = ("solid", "dash", "dot", "dashdot")
PANEL, ENTRY, GAP, FRAME = 190, 19, 55, 110
#: counts on an axis with a line for each; ticks of crowds of events, as a share of an axis
FEW, TICK = 6, 0.06
#: pixels of an axis that texts of events are laid out for
AXIS = 800
_FONT = "system-ui, 'Segoe UI', Roboto, sans-serif"
_STYLE = f"""
body {{ font-family: {_FONT}; margin: 1.5rem auto; max-width: 1250px; padding: 0 1rem; color: #222; }}
h1 {{ font-size: 1.4rem; }} h2 {{ font-size: 1.1rem; margin: 2rem 0 .5rem; border-bottom: 1px solid #ddd; }}
p.note {{ color: #555; font-size: .85rem; }} table {{ border-collapse: collapse; font-size: .88rem; margin-bottom: .8rem; }}
td, th {{ padding: .15rem .8rem .15rem 0; text-align: left; }} td.n, th.n {{ text-align: right; }}
th {{ border-bottom: 1px solid #999; font-weight: 600; }} .bad {{ color: #b00020; font-weight: 600; }}
.facts th {{ border: 0; padding-right: 1.2rem; color: #555; }}
.wide {{ overflow-x: auto; }}
.wide svg {{ max-width: 100%; height: auto; }}
"""
#: unpacks the library, draws the figures in their places; a browser that cannot says so
_UNPACK = """
(async () => {
  const packed = Uint8Array.from(atob(document.getElementById("plotly").textContent), c => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const library = document.createElement("script");
  library.textContent = await new Response(stream).text();
  document.head.append(library);
  for (const figure of document.querySelectorAll("script.figure")) {
    const {data, layout, config} = JSON.parse(figure.textContent);
    await Plotly.newPlot(figure.previousElementSibling, data, layout, config);
  }
  document.body.dataset.drawn = "all";
})().catch(error => {
  const text = "This picture needs a browser from 2023 on: " + error;
  for (const place of document.querySelectorAll("div.figure")) place.textContent = text;
});
"""
#: points of all curves of a picture, and digits of theirs: single precision where it shows all of them
POINTS = 60_000
_SINGLE = 6e-8
#: how much more a line may be moved where its points are too many
COARSER = (1, 3, 10, 30)


def write_html(drawn: Picture, path: str | os.PathLike[str]) -> None:
    """Write a page with a picture. Errors: ValueError without plotly, with the command that installs it."""
    body = [chart(drawn), *(f'<p class="note">{html.escape(note)}</p>' for note in drawn.notes)]
    write_page(path, drawn.title, body)


def write_page(path: str | os.PathLike[str], title: str, body: Sequence[str]) -> None:
    """Write a page of parts that are HTML already."""
    require("plotly")
    text = html.escape(title)
    with open(path, "w", encoding="utf-8") as file:
        file.write(
            f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            f'<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            f"<title>{text}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n"
            f"<h1>{text}</h1>\n"
        )
        file.write("\n".join([*body, _library()]))
        file.write("\n</body>\n</html>\n")


def chart(drawn: Picture) -> str:
    """Panels below each other over one time axis, each with a legend of its own."""
    require("plotly")
    panels = drawn.panels
    heights = [max(PANEL, ENTRY * sum(len(entry(c.label)) for c in p.curves if not c.limit)) for p in panels]
    total = sum(heights) + GAP * (len(heights) - 1)
    alone, crowds = parted(drawn.marks, *_span(drawn))
    texts = labels([*alone, *(c.mark for c in crowds)], *_span(drawn), AXIS)
    near = any(p.near for p in panels)
    specs = [[{}, {}] if p.near else [{"colspan": 2}, None] for p in panels] if near else None
    figure: Any = import_module("plotly.subplots").make_subplots(
        rows=max(len(heights), 1), cols=1 + near, vertical_spacing=GAP / max(total, 1), row_heights=heights or None,
        column_widths=[0.68, 0.32] if near else None, horizontal_spacing=0.05 if near else None, specs=specs,
    )  # fmt: skip
    panels, note = fitted(panels)
    for i, panel in enumerate(panels, 1):
        name = "legend" if i == 1 else f"legend{i}"
        for curve in panel.curves:
            style = _style(curve, panel.log) | (
                {"showlegend": False} if panel.near else {}
            )  # bands are pale: told by near
            figure.add_scatter(x=single(curve.time), y=single(curve.values), legend=name, row=i, col=1, **style)
        x, y = next(figure.select_xaxes(row=i, col=1)), next(figure.select_yaxes(row=i, col=1))
        x.update(matches="x" if i > 1 else None, showticklabels=i == len(panels), range=_span(drawn))
        y.update(title={"text": panel.unit}, **_scale(panel))
        figure.layout[name] = {"y": y.domain[1], "yanchor": "top", "x": 1.01, "font": {"size": 11}}
        _title(figure, panel.title, 0.0, y.domain[1], height(texts) * (i == 1))
        if panel.near:
            _near(figure, panel, i)
    _marks(figure, len(panels), alone, crowds, texts)
    figure.update_xaxes(title_text="time [s]", row=len(heights), col=1)
    figure.update_xaxes(showgrid=True, gridcolor="#e8e8e8", zeroline=False)
    figure.update_yaxes(showgrid=True, gridcolor="#e8e8e8", zeroline=False)
    figure.update_layout(
        height=total + FRAME + height(texts), margin={"l": 80, "r": 20, "t": 40 + height(texts), "b": 50},
        plot_bgcolor="white", font={"family": _FONT, "size": 12}, showlegend=True,
    )  # fmt: skip
    return part(figure) + (f'\n<p class="note">{note}</p>' if note else "")


def fitted(panels: Sequence[Panel]) -> tuple[list[Panel], str]:
    """Panels with at most `POINTS` points in their curves, and what a reader must know of that.

    Points that a line does not need are left out first; then all curves are thinned alike.
    """
    lean_ones = [replace(p, curves=_lean(p, p.curves), near=_lean(p, p.near)) for p in panels]
    sizes = [len(c.time) for p in lean_ones for c in (*p.curves, *p.near)]
    columns = columns_within(sizes, POINTS)
    if all(n <= PER_COLUMN * columns for n in sizes):
        return lean_ones, ""
    few = [replace(p, curves=_lean(p, p.curves, columns), near=_lean(p, p.near, columns)) for p in lean_ones]
    return (
        few,
        f"at most {POINTS} points: of fast curves the first, smallest, largest and last of each of {columns} columns",
    )


def _lean(panel: Panel, curves: Sequence[PlotCurve], columns: int = COLUMNS) -> tuple[PlotCurve, ...]:
    """Without points on a line, more of them where they are too many for the columns; on a log axis every point counts."""
    finite = [c.values[np.isfinite(c.values)] for c in curves]
    size = max((float(np.ptp(v)) for v in finite if len(v)), default=0.0)
    found = list[PlotCurve]()
    for c in curves:
        time, values = c.time, c.values
        for coarse in () if panel.log or c.points else COARSER:
            if coarse == 1 or len(time) > PER_COLUMN * columns:
                time, values = lean(time, values, size * coarse)
        time, values = thin(time, values, columns)
        found.append(replace(c, time=time, values=values))
    return tuple(found)


def single(values: Floats) -> Any:
    """In single precision, if that resolves a hundred-thousandth of their height."""
    finite = values[np.isfinite(values)]
    if not len(finite) or _SINGLE * np.abs(finite).max() > 1e-5 * np.ptp(finite) or np.abs(finite).max() > 1e37:
        return values
    tiny = np.abs(finite[finite != 0.0]).min(initial=1.0)
    return values if tiny < 1e-37 else values.astype(np.float32)


def _near(figure: Any, panel: Panel, row: int) -> None:
    """A few periods beside the whole, and where they are in it."""
    for curve in panel.near:
        name = "legend" if row == 1 else f"legend{row}"
        figure.add_scatter(x=single(curve.time), y=single(curve.values), legend=name, row=row, col=2, **_style(curve))
    x, y = next(figure.select_xaxes(row=row, col=2)), next(figure.select_yaxes(row=row, col=2))
    _title(figure, "in the grey window", x.domain[0], y.domain[1], colour="#777")
    time = next(c.time for c in panel.near if len(c.time))
    figure.add_vrect(
        x0=float(time[0]), x1=float(time[-1]), fillcolor="#777", opacity=0.35, line_width=0, row=row, col=1,
        layer="below",
    )  # fmt: skip


def _title(figure: Any, text: str, x: float, y: float, up: int = 0, colour: str = "#222") -> None:
    figure.add_annotation(
        x=x, y=y, xref="paper", yref="paper", text=html.escape(text), showarrow=False, xanchor="left", yanchor="bottom",
        yshift=up, font={"size": 13, "color": colour},
    )  # fmt: skip


def _span(drawn: Picture) -> tuple[float, float]:
    times = [t for p in drawn.panels for c in p.curves for t in (c.time[:1], c.time[-1:]) if len(t)]
    return (min(float(t[0]) for t in times), max(float(t[0]) for t in times)) if times else (0.0, 0.0)


def part(figure: Any) -> str:
    """A figure that the page's plotly draws once it is there: its place, and its data and layout as JSON."""
    config = {"displaylogo": False, "responsive": True, "plotlyServerURL": ""}
    text = json.dumps(json.loads(figure.to_json()) | {"config": config}, separators=(",", ":")).replace("</", "<\\/")
    high = figure.layout.height or PANEL
    place = f'<div class="figure" style="height:{high:.0f}px"></div>'
    return f'{place}\n<script type="application/json" class="figure">{text}</script>'


def _library() -> str:
    """plotly, compressed to a third of its size, and what unpacks it and then draws the figures."""
    packed = gzip.compress(import_module("plotly.offline").get_plotlyjs().encode(), 9, mtime=0)
    return f'<script type="text/plain" id="plotly">{base64.b64encode(packed).decode()}</script>\n<script>{_UNPACK}</script>'


def _scale(panel: Panel) -> dict[str, Any]:
    """The values of an axis: log ones within their reach, counts at whole numbers."""
    if panel.reach:
        low, high = log10(panel.reach[0]) - 0.5, log10(panel.reach[1]) + 0.5
        return {
            "type": "log",
            "range": [low, high],
            "dtick": ceil((high - low) / 5.0),
            "exponentformat": "power",
            "tickfont": {"size": 10},
        }
    values = [float(f(c.values)) for c in panel.curves if len(c.values) for f in (np.nanmin, np.nanmax)]
    if panel.whole and max(values) - min(values) <= FEW:
        return {"range": [min(values) - 0.25, max(values) + 0.25], "dtick": 1}
    return {"exponentformat": "power"}


def _style(curve: PlotCurve, log: bool = False) -> dict[str, Any]:
    colour = COLOURS[curve.colour]
    name = "<br>".join(map(html.escape, entry(curve.label)))
    if curve.limit:
        return {"mode": "lines", "name": name, "showlegend": False, "opacity": 0.8,
                "line": {"color": colour, "dash": "dash", "width": 1}}  # fmt: skip
    if curve.points:
        return {"mode": "markers", "name": name, "marker": {"color": colour, "size": 4, "opacity": 0.6}}
    if curve.band is not None:  # as lines, to zoom into
        return {"mode": "lines", "name": name, "opacity": 0.6, "line": {"color": colour, "width": 0.8}}
    dash = DASHES[curve.dash % len(DASHES)]
    line = {"color": colour, "dash": dash, "width": 1 if log else 1.5, "simplify": False}
    if log:  # between zeros are single points
        return {"mode": "lines+markers", "name": name, "line": line, "marker": {"size": 3}}
    return {"mode": "lines", "name": name, "line": line}


def _marks(
    figure: Any, panels: int, alone: Sequence[Mark], crowds: Sequence[EventCluster], texts: Sequence[Label]
) -> None:
    """A dotted line in all panels for each mark, ticks at their feet for crowds; their texts above the first."""
    axes = [figure.get_subplot(i, 1) for i in range(1, panels + 1)]
    # one path each: a shape for every event would take a browser minutes
    kinds = [([m.time for m in alone], 1.0, {"color": "#777", "width": 1, "dash": "dot"})]
    kinds += [(c.ticks, TICK, {"color": "#444", "width": 0.7}) for c in crowds]
    drawn = [
        {"type": "path", "path": " ".join(f"M{t!r},0 L{t!r},{high:g}" for t in times), "line": line,
         "xref": a.xaxis.plotly_name.replace("axis", ""), "yref": f"{a.yaxis.plotly_name.replace('axis', '')} domain"}
        for a in axes for times, high, line in kinds if times
    ]  # fmt: skip
    figure.update_layout(shapes=[*figure.layout.shapes, *drawn])
    for t in texts:
        figure.add_annotation(
            x=t.time, y=1.0, xref="x", yref="paper", text=html.escape(t.text), showarrow=False,
            xanchor="right" if t.right else "left", yanchor="bottom", yshift=2 + LINE * t.row,
            font={"size": 10, "color": "#444"},
        )  # fmt: skip
