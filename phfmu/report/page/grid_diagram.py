"""One-line diagram of a meshed network: junctions laid out by their distances, members between two of them as lines, SVG.

Members at one junction are drawn beside it, those that join three or more as boxes.  Widths are energies, heads the way that
energy went; what passed less than a part FAINT of the most is left out.  Positions: Kamada and Kawai's method (1989), whose
stress is the sum over pairs of (distance on paper / distance in lines - 1)^2, as networkx has it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from html import escape
from typing import Any

import numpy as np

from phfmu.report.page.flows import PortEnergy
from phfmu.report.page.svg import LINE, OUTSIDE, head, picture, text, width_of
from phfmu.report.picture.extra import require
from phfmu.report.picture.prefix import engineering

#: junctions up to which positions are found in a few seconds
MOST_JUNCTIONS = 400
#: energies that are drawn, of the largest
FAINT = 1e-6
#: pixels: the length of a line, of what stands beside a junction, radii, margin, width of the largest energy
LENGTH, STALK, RADIUS, SMALL, MARGIN, WIDEST = 120.0, 34.0, 5.0, 9.0, 70.0, 10.0
#: junctions of which lines are twice as long, at the most
CROWD = 250
#: least distance of two junctions, and rounds in which closer ones are pushed apart
APART, ROUNDS = 76.0, 200
#: angles that members beside a junction are apart at least
FAN = math.radians(34)

Point = tuple[float, float]


@dataclass
class _Grid:
    """Members by the junctions that they join, with the energy that they took at each [J]."""

    between: dict[str, dict[str, float]] = field(default_factory=dict[str, dict[str, float]])
    beside: dict[str, dict[str, float]] = field(default_factory=dict[str, dict[str, float]])
    joining: dict[str, dict[str, float]] = field(default_factory=dict[str, dict[str, float]])
    faint: int = 0

    @property
    def groups(self) -> tuple[dict[str, dict[str, float]], ...]:
        return self.between, self.beside, self.joining

    @property
    def junctions(self) -> list[str]:
        return list(dict.fromkeys(j for group in self.groups for own in group.values() for j in own))

    @cached_property
    def largest(self) -> float:
        """Largest magnitude of the energies [J], once all members are there."""
        return max(abs(e) for group in self.groups for own in group.values() for e in own.values())


def grid_diagram(ports: Sequence[PortEnergy], below: Mapping[str, str]) -> tuple[str, int]:
    """The SVG, "" if the network is no mesh of up to MOST_JUNCTIONS, and the number of members that were left out.

    `below`: of a member, what its title says besides its energies.
    """
    grid = _grid(ports)
    names = grid.junctions
    if len(grid.between) + len(grid.joining) < 2 or not 2 < len(names) <= MOST_JUNCTIONS:
        return "", 0
    at = _positions(grid)
    width, height = (max(p[i] for p in at.values()) + MARGIN for i in (0, 1))
    titles = {m: f"{m}{': ' if m in below else ''}{below.get(m, '')}" for group in grid.groups for m in group}
    parts = [*_lines(grid, at, titles), *_stars(grid, at, titles), *_buses(grid, at, titles)]
    return picture(width, height, 0.8 * width, 10, "".join(parts)), grid.faint


def _grid(ports: Sequence[PortEnergy]) -> _Grid:
    members: dict[str, dict[str, float]] = {}
    for p in ports:
        own = members.setdefault(p.component, {})
        if p.junction:
            own[p.junction] = own.get(p.junction, 0.0) + p.energy
    most, grid = max((abs(p.energy) for p in ports), default=0.0), _Grid()
    for name, own in members.items():
        if not own or max(map(abs, own.values())) <= FAINT * most:
            grid.faint += 1
            continue
        (grid.beside if len(own) == 1 else grid.between if len(own) == 2 else grid.joining)[name] = own
    return grid


# -- where junctions are -----------------------------------------------------------------------------------------------


def _positions(grid: _Grid) -> dict[str, Point]:
    """Pixels of junctions and of members that join three or more; parts that nothing joins stand below each other."""
    require("networkx")
    import networkx

    graph: Any = networkx.Graph()
    graph.add_nodes_from(grid.junctions)
    graph.add_edges_from(tuple(own) for own in grid.between.values())
    for name, own in grid.joining.items():
        graph.add_edges_from((name, junction) for junction in own)
    found, top = dict[str, Point](), MARGIN
    for nodes in sorted(networkx.connected_components(graph), key=len, reverse=True):
        part = graph.subgraph(sorted(nodes))
        own = _laid(part, networkx.kamada_kawai_layout(part) if len(part) > 1 else dict.fromkeys(part, (0.0, 0.0)))
        found |= {n: (MARGIN + x, top + y) for n, (x, y) in own.items()}
        top += max(y for _, y in own.values()) + 1.5 * MARGIN
    return found


def _laid(graph: Any, found: Mapping[str, Any]) -> dict[str, Point]:
    """Pixels from the upper left corner: the longest axis horizontal, a line LENGTH at the middle of all, none too close."""
    names = list(found)
    crowded = 1.0 + min(len(names) / CROWD, 1.0)
    at = np.array([found[n] for n in names], float)
    at -= at.mean(axis=0)
    at = at @ np.linalg.svd(at, full_matrices=False)[2].T if len(at) > 2 else at
    ends = np.array([(names.index(a), names.index(b)) for a, b in graph.edges], int).reshape(-1, 2)
    lengths = np.linalg.norm(at[ends[:, 0]] - at[ends[:, 1]], axis=1)
    at *= LENGTH / np.median(lengths) * crowded if len(lengths) else 1.0
    for _ in range(ROUNDS):
        apart = at[:, None] - at[None]
        distance = np.linalg.norm(apart, axis=2) + np.eye(len(at)) * 4 * APART
        close = np.clip(crowded * APART / np.maximum(distance, 1e-9) - 1.0, 0.0, 1.0)
        if not close.any():
            break
        at += 0.35 * (apart * close[:, :, None]).sum(axis=1)
    at -= at.min(axis=0)
    return {n: (float(x), float(y)) for n, (x, y) in zip(names, at, strict=True)}


# -- what is drawn -----------------------------------------------------------------------------------------------------


def _lines(grid: _Grid, at: Mapping[str, Point], titles: Mapping[str, str]) -> Iterator[str]:
    """A line for each member between two junctions; those between the same two are bent apart."""
    together: dict[frozenset[str], list[str]] = {}
    for name, own in grid.between.items():
        together.setdefault(frozenset(own), []).append(name)
    for names in together.values():
        for i, name in enumerate(names):
            own = grid.between[name]
            first, last = own
            bend = 18.0 * (i - (len(names) - 1) / 2) * (1 if first < last else -1)
            yield _line(at[first], at[last], bend, (own[first] - own[last]) / 2, grid.largest, titles[name])


def _line(a: Point, b: Point, bend: float, through: float, largest: float, title: str) -> str:
    """`through`: energy that went from a to b."""
    length = math.dist(a, b) or 1.0
    across = (a[1] - b[1]) / length, (b[0] - a[0]) / length
    middle = ((a[0] + b[0]) / 2 + bend * across[0], (a[1] + b[1]) / 2 + bend * across[1])
    control = (middle[0] + bend * across[0], middle[1] + bend * across[1])
    width = width_of(through, largest, WIDEST)
    way = math.degrees(math.atan2(b[1] - a[1], b[0] - a[0])) + (180 if through < 0 else 0)
    said = engineering(abs(through), "J")
    arrow = head(*middle, way, width, LINE) if through else ""
    return (
        f"<g><title>{escape(title)} {said}</title>"
        f'<path d="M{a[0]:.1f},{a[1]:.1f} Q{control[0]:.1f},{control[1]:.1f} {b[0]:.1f},{b[1]:.1f}" fill="none" '
        f'stroke="{LINE}" stroke-opacity="0.5" stroke-width="{width:.2f}"/>{arrow}'
        f"{text(middle[0] + 7 + width / 2, middle[1] - 5, said, 'start', _GREY)}</g>"
    )


_GREY = "fill='#555' font-size='9'"


def _stars(grid: _Grid, at: Mapping[str, Point], titles: Mapping[str, str]) -> Iterator[str]:
    """Members that join three junctions or more, with a line to each."""
    for name, own in grid.joining.items():
        for junction, energy in own.items():
            yield _line(at[junction], at[name], 0.0, energy, grid.largest, f"{titles[name]} at {junction}")
        x, y = at[name]
        yield f'<rect x="{x - 8:.1f}" y="{y - 8:.1f}" width="16" height="16" rx="3" fill="#eef4f9" stroke="{LINE}"/>'
        yield text(x, y + 22, name, "middle")


def _buses(grid: _Grid, at: Mapping[str, Point], titles: Mapping[str, str]) -> Iterator[str]:
    """Each junction with its name, and around it its members: what gave energy as circles, what took it as triangles."""
    beside: dict[str, list[tuple[str, float]]] = {}
    for name, own in grid.beside.items():
        ((junction, energy),) = own.items()
        beside.setdefault(junction, []).append((name, energy))
    near: dict[str, list[float]] = {}
    for own in (*grid.between.values(), *grid.joining.values()):
        for a in own:
            ends = [at[b] for b in own if b != a]
            near.setdefault(a, []).extend(math.atan2(y - at[a][1], x - at[a][0]) for x, y in ends)
    for junction in grid.junctions:
        x, y = at[junction]
        members = beside.get(junction, [])
        *angles, named = _free(near.get(junction, []), len(members) + 1)
        for (name, energy), angle in zip(members, angles, strict=True):
            yield _symbol(x, y, angle, name, energy, grid.largest, titles[name])
        yield f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{RADIUS}" fill="#222"/>'
        c, s = math.cos(named), math.sin(named)
        anchor = "start" if c > 0.3 else "end" if c < -0.3 else "middle"
        yield text(x + 10 * c, y + 10 * s + 4 + 4 * s, junction, anchor, "font-weight='600' font-size='11'")


def _free(taken: Sequence[float], n: int) -> list[float]:
    """n angles in the widest gaps between those that are taken; names stand to the right, or to the left."""
    found, used = list[float](), [*taken]
    for _ in range(n):
        angles = sorted(a % (2 * math.pi) for a in used)
        if not angles:
            found.append(0.0)
        else:
            gaps = [(b - a, a) for a, b in zip(angles, [*angles[1:], angles[0] + 2 * math.pi], strict=True)]
            wide, begin = max(gaps, key=lambda g: g[0])
            found.append((begin + min(wide / 2, max(FAN, wide / 2))) % (2 * math.pi))
        used.append(found[-1])
    # the name stands where it is least upright
    last = max(range(n), key=lambda i: abs(math.cos(found[i])))
    return [*(a for i, a in enumerate(found) if i != last), found[last]]


def _symbol(x: float, y: float, angle: float, name: str, energy: float, largest: float, title: str) -> str:
    """A circle that gave, a triangle that took, at the end of a stalk; energy: that it took."""
    c, s = math.cos(angle), math.sin(angle)
    tip, width = (x + STALK * c, y + STALK * s), width_of(energy, largest, WIDEST)
    stalk = (
        f'<line x1="{x:.1f}" y1="{y:.1f}" x2="{tip[0]:.1f}" y2="{tip[1]:.1f}" stroke="{OUTSIDE}" stroke-opacity="0.6" '
        f'stroke-width="{width:.2f}"/>'
    )
    if energy < 0:
        shape = f'<circle cx="{tip[0]:.1f}" cy="{tip[1]:.1f}" r="{SMALL}" fill="#fff" stroke="{OUTSIDE}" stroke-width="1.6"/>'
    else:
        shape = head(*tip, math.degrees(angle), SMALL, OUTSIDE)
    anchor, side = ("start", 1) if c >= 0 else ("end", -1)
    words = text(tip[0] + 13 * side, tip[1] + 4, name, anchor, _GREY)
    said = f"<title>{escape(title)} {'gave' if energy < 0 else 'took'} {engineering(abs(energy), 'J')}</title>"
    return f"<g>{said}{stalk}{shape}{words}</g>"
