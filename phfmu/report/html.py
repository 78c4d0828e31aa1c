"""A picture as part of a web page, by plotly; the page holds all it needs and loads nothing."""

import html
import os
from collections.abc import Sequence
from importlib import import_module
from typing import Any

from phfmu.report.extra import require
from phfmu.report.picture import COLOURS, Curve, Picture

DASHES = ("solid", "dash", "dot", "dashdot")
PANEL, ENTRY, GAP, FRAME = 190, 19, 55, 110
LABELLED = 12
_FONT = "system-ui, 'Segoe UI', Roboto, sans-serif"
_STYLE = f"""
body {{ font-family: {_FONT}; margin: 1.5rem auto; max-width: 1250px; padding: 0 1rem; color: #222; }}
h1 {{ font-size: 1.4rem; }} h2 {{ font-size: 1.1rem; margin: 2rem 0 .5rem; border-bottom: 1px solid #ddd; }}
p.note {{ color: #555; font-size: .85rem; }} table {{ border-collapse: collapse; font-size: .88rem; }}
td, th {{ padding: .15rem .8rem .15rem 0; text-align: left; }} td.n, th.n {{ text-align: right; }}
th {{ border-bottom: 1px solid #999; font-weight: 600; }} .bad {{ color: #b00020; font-weight: 600; }}
.wide {{ overflow-x: auto; }}
.wide svg {{ max-width: 100%; min-width: 600px; height: auto; }}
"""


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
            f"<title>{text}</title>\n<style>{_STYLE}</style>\n<script>{import_module('plotly.offline').get_plotlyjs()}</script>\n</head>\n<body>\n"
            f"<h1>{text}</h1>\n"
        )
        file.write("\n".join(body))
        file.write("\n</body>\n</html>\n")


def chart(drawn: Picture) -> str:
    """Panels below each other over one time axis, each with a legend of its own."""
    require("plotly")
    heights = [max(PANEL, ENTRY * sum(not c.limit for c in p.curves)) for p in drawn.panels]
    total = sum(heights) + GAP * (len(heights) - 1)
    figure: Any = import_module("plotly.subplots").make_subplots(
        rows=max(len(heights), 1), cols=1, shared_xaxes=True, vertical_spacing=GAP / max(total, 1),
        row_heights=heights or None, subplot_titles=[html.escape(p.title) for p in drawn.panels],
    )  # fmt: skip
    for i, panel in enumerate(drawn.panels, 1):
        legend = "legend" if i == 1 else f"legend{i}"
        for curve in panel.curves:
            figure.add_scatter(x=curve.time, y=curve.values, legend=legend, row=i, col=1, **_style(curve))
        axis = figure.layout["yaxis" if i == 1 else f"yaxis{i}"]
        axis.update(title={"text": panel.unit}, type="log" if panel.log else "linear", exponentformat="power")
        figure.layout[legend] = {"y": axis.domain[1], "yanchor": "top", "x": 1.01, "font": {"size": 11}}
    _marks(figure, drawn)
    for note in figure.layout.annotations[: len(drawn.panels)]:
        note.update(x=0.0, xanchor="left", font={"size": 13})
    figure.update_xaxes(title_text="time [s]", row=len(heights), col=1)
    figure.update_xaxes(showgrid=True, gridcolor="#e8e8e8", zeroline=False)
    figure.update_yaxes(showgrid=True, gridcolor="#e8e8e8", zeroline=False)
    figure.update_layout(
        height=total + FRAME, margin={"l": 80, "r": 20, "t": 40, "b": 50}, plot_bgcolor="white",
        font={"family": _FONT, "size": 12}, showlegend=True,
    )  # fmt: skip
    return part(figure)


def part(figure: Any) -> str:
    """A figure as HTML that uses the page's plotly."""
    config = {"displaylogo": False, "responsive": True, "plotlyServerURL": ""}
    return figure.to_html(full_html=False, include_plotlyjs=False, include_mathjax=False, config=config)


def _style(curve: Curve) -> dict[str, Any]:
    colour = COLOURS[curve.colour]
    name = html.escape(curve.label)
    if curve.limit:
        return {"mode": "lines", "name": name, "showlegend": False, "opacity": 0.8,
                "line": {"color": colour, "dash": "dash", "width": 1}}  # fmt: skip
    dash = DASHES[curve.dash % len(DASHES)]
    return {"mode": "lines", "name": name, "line": {"color": colour, "dash": dash, "width": 1.5}}


def _marks(figure: Any, drawn: Picture) -> None:
    """A dotted line through all panels for each mark, its text at the first."""
    shapes = [
        {"type": "line", "xref": "x", "yref": "paper", "x0": m.time, "x1": m.time, "y0": 0, "y1": 1,
         "line": {"color": "#777", "width": 1, "dash": "dot"}}
        for m in drawn.marks
    ]  # fmt: skip
    figure.update_layout(shapes=shapes)
    if len(drawn.marks) <= LABELLED:
        for m in drawn.marks:
            figure.add_annotation(
                x=m.time, y=1.0, xref="x", yref="paper", text=html.escape(m.text), textangle=-90, showarrow=False,
                xanchor="left", yanchor="top", font={"size": 10, "color": "#444"},
            )  # fmt: skip
