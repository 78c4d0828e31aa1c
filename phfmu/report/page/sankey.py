"""The flows of a window as a Sankey diagram, by plotly."""

import html
from collections.abc import Sequence
from importlib import import_module
from typing import Any

from phfmu.report.page.flows import (
    CREATED,
    EVENT,
    JUNCTION,
    LOSS,
    MEMBER,
    NUMERICAL,
    PORT,
    RESIDUAL,
    STORE,
    Link,
    Node,
)
from phfmu.report.picture.prefix import engineering
from phfmu.words import counted

#: Okabe and Ito
KIND_COLOURS = {
    MEMBER: "#0072B2", JUNCTION: "#444444", PORT: "#009E73", STORE: "#56B4E9", LOSS: "#D55E00", NUMERICAL: "#E69F00",
    EVENT: "#CC79A7", RESIDUAL: "#000000", CREATED: "#000000",
}  # fmt: skip
#: what ends are called that give or take
_ENDS = {
    (STORE, "from"): "from store", (STORE, "to"): "into store", (RESIDUAL, "from"): "residual (created)",
    (RESIDUAL, "to"): "residual (lost)", (CREATED, "from"): "created at junctions", (CREATED, "to"): "lost at junctions",
}  # fmt: skip
#: pixels that a node needs with its two lines of text, and bounds of the whole height
NODE, LEAST, MOST = 34, 340, 900
#: share of the largest energy below which a flow is not drawn: its line would be that of a larger one
SEEN = 1e-6


def seen(links: Sequence[Link], rounding: float) -> tuple[list[Link], str]:
    """The flows that a diagram can show, and a line about the others ("" for none); `rounding`: energies in J that are none."""
    most = max((x.energy for x in links), default=0.0)
    if most <= rounding:
        return [], f"No energy moved but what rounding leaves, {engineering(most, 'J')} at most."
    left = [x for x in links if x.energy < SEEN * most]
    if not left:
        return list(links), ""
    sizes = f"the largest {engineering(max(x.energy for x in left), 'J')}"
    return [
        x for x in links if x not in left
    ], f"Not drawn: {counted(len(left), 'flow')} below {SEEN:g} of the largest, {sizes}."


def sankey(links: Sequence[Link]) -> Any:
    """The figure; node labels say how much passes, hovering says all digits."""
    nodes = list(dict.fromkeys(n for link in links for n in (link.source, link.target)))
    place = {node: i for i, node in enumerate(nodes)}
    go: Any = import_module("plotly.graph_objects")
    figure = go.Figure(
        go.Sankey(
            node={
                "label": [label(n, links) for n in nodes], "color": [KIND_COLOURS[n.kind] for n in nodes], "pad": NODE,
                "thickness": 14, "line": {"width": 0}, "hovertemplate": "%{label}<extra></extra>",
            },
            link={
                "source": [place[x.source] for x in links], "target": [place[x.target] for x in links],
                "value": [x.energy for x in links], "color": [_tinted(x) for x in links],
                "customdata": [f"{x.energy:.12g} J" for x in links],
                "hovertemplate": "%{source.label} → %{target.label}<br>%{customdata}<extra></extra>",
            },
        )
    )  # fmt: skip
    figure.update_layout(
        height=min(max(LEAST, NODE * len(nodes)), MOST), margin={"l": 10, "r": 10, "t": 44, "b": 20}, font={"size": 12}
    )
    return figure


def label(node: Node, links: Sequence[Link]) -> str:
    """Name and energy that passes."""
    through = max(sum(x.energy for x in links if x.source == node), sum(x.energy for x in links if x.target == node))
    word = _ENDS.get((node.kind, node.side), node.name)
    between = "<br>" if node.kind in (MEMBER, JUNCTION, PORT) else "  "  # side by side these meet in the last column
    return f"{html.escape(word)}{between}{engineering(through, 'J')}"


def _tinted(link: Link) -> str:
    """The colour of the end of a link that says most: outside, store, loss; else of its junction's source."""
    kind = next((n.kind for n in (link.target, link.source) if n.kind not in (MEMBER, JUNCTION)), MEMBER)
    r, g, b = (int(KIND_COLOURS[kind][i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({r},{g},{b},0.35)"
