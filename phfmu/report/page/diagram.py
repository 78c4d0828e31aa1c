"""One-line diagram of members (boxes), junctions (bars) and external ports (arrows) as SVG; widths are energies."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from phfmu.report.page.flows import JUNCTION, MEMBER, Node, PortEnergy
from phfmu.report.page.svg import LINE, OUTSIDE, head, picture, text, width_of
from phfmu.report.picture.prefix import engineering

#: pixels: box and bar, room between layers, room of an external port, of an edge's end, and of a line at the most
BOX, BAR, GAP, PORT, END, WIDEST = 116, 8, 190, 96, 24, 13.0
ARROW, MARGIN, STRAIGHT = 48, 14, 120
#: width below which a page scrolls a diagram instead of making it smaller, and beyond which it goes on in another row
READABLE, PAGE = 600, 1200
#: room below a bar with its name, and beside one whose name has a mark
NAMED, BESIDE = 34, 30


@dataclass
class _DiagramNode:
    """A node: its middle, size, and the ports that end at its left and right side and above it."""

    node: Node
    layer: int
    x: float = 0.0
    y: float = 0.0
    left: list[PortEnergy] = field(default_factory=list)
    right: list[PortEnergy] = field(default_factory=list)
    above: list[PortEnergy] = field(default_factory=list)

    @property
    def width(self) -> float:
        return _width_of(self.node, len(self.above))

    @property
    def height(self) -> float:
        return max(46.0, END * max(len(self.left), len(self.right)) + 8)

    @property
    def room(self) -> float:
        """Pixels above its middle that belong to it."""
        return self.height / 2 + (ARROW + 34 if self.above else 0) + 8

    def end(self, p: PortEnergy) -> tuple[float, float]:
        """The point of this node at which a port ends."""
        side = self.left if p in self.left else self.right
        y = self.y + END * (side.index(p) - (len(side) - 1) / 2)
        return self.x + self.width / 2 * (-1 if side is self.left else 1), y


@dataclass
class _DiagramRow:
    """Parts of a network side by side: nodes with their layers; `marks`: what stands beside a bar that is in two rows."""

    parts: Sequence[dict[Node, int]]
    ports: Sequence[PortEnergy]
    marks: Mapping[Node, str] = field(default_factory=dict[Node, str])


def _width_of(node: Node, above: int) -> float:
    """Pixels of a bar, or of a box with so many ports above it."""
    return BAR if node.kind == JUNCTION else max(BOX, PORT * above + 10, 7.6 * len(node.name) + 20)


def one_line(members: Sequence[str], ports: Sequence[PortEnergy], below: Mapping[str, str]) -> str:
    """The SVG; `below` is a text under a member's name. Empty for members without ports."""
    if not ports:
        return ""
    largest = max(abs(p.energy) for p in ports) or 1.0
    parts, width, height = list[str](), 0.0, 0.0
    for row in _rows(_layers(members, ports), ports):
        places = _placed(row, height)
        parts += [t for p in row.ports if p.junction for t in _edge(places, p, largest)]
        for place in places.values():
            mark = row.marks.get(place.node, "")
            parts += _bar(place, mark) if place.node.kind == JUNCTION else _box(place, below, largest)
        width = max(width, *(p.x + p.width / 2 + MARGIN + 60 for p in places.values()))
        height = max(p.y + p.height / 2 + MARGIN + 18 for p in places.values())
    return picture(width, height, min(width, READABLE), 11, "".join(parts))


def _layers(members: Sequence[str], ports: Sequence[PortEnergy]) -> list[dict[Node, int]]:
    """Distance of each node from an end of its part of the network; the end that takes most from outside stands left."""
    near: dict[Node, list[Node]] = {Node(MEMBER, m): [] for m in members}
    outside: dict[Node, float] = {}
    for p in ports:
        member = Node(MEMBER, p.component)
        near.setdefault(member, [])
        if p.junction:
            near[member].append(Node(JUNCTION, p.junction))
            near.setdefault(Node(JUNCTION, p.junction), []).append(member)
        else:
            outside[member] = outside.get(member, 0.0) + p.energy
    parts, left = [], dict.fromkeys(near)
    while left:
        first = _distances(next(iter(left)), near)
        one = _distances(max(first, key=lambda n: first[n]), near)
        other = _distances(max(one, key=lambda n: one[n]), near)
        parts.append(max((one, other), key=lambda d: outside.get(next(iter(d)), 0.0)))
        for node in first:
            left.pop(node)
    return parts


def _distances(start: Node, near: Mapping[Node, list[Node]]) -> dict[Node, int]:
    found, todo = {start: 0}, deque([start])
    while todo:
        node = todo.popleft()
        for other in near[node]:
            if other not in found:
                found[other] = found[node] + 1
                todo.append(other)
    return found


def _rows(parts: Sequence[dict[Node, int]], ports: Sequence[PortEnergy]) -> Iterator[_DiagramRow]:
    """Parts that fit the page as one row; a wider one goes on below at its junctions, which stand in both rows."""
    fitting = [part for part in parts if _wide(part, ports, max(part.values(), default=0)) <= PAGE]
    if fitting:
        yield _DiagramRow(fitting, _within(ports, set().union(*fitting)))
    for part in parts:
        if part in fitting:
            continue
        first, last = 0, max(part.values())
        while first <= last:
            end = _end(part, ports, first, last)
            row = {n: k - first for n, k in part.items() if first <= k <= end}
            marks = {n: "goes on below" for n, k in part.items() if k == end < last}
            marks |= {n: "from above" for n, k in part.items() if k == first and first}
            yield _DiagramRow([row], _within(ports, set(row)), marks)
            first = end if end < last else last + 1


def _end(part: Mapping[Node, int], ports: Sequence[PortEnergy], first: int, last: int) -> int:
    """The last layer of a row that begins with the layer `first`: a layer of junctions, unless all fits."""
    bars = sorted({k for n, k in part.items() if n.kind == JUNCTION and first < k < last})
    for k in (last, *reversed(bars)):
        if _wide(part, ports, k, first) <= PAGE:
            return k
    return bars[0] if bars else last


def _wide(part: Mapping[Node, int], ports: Sequence[PortEnergy], last: int, first: int = 0) -> float:
    """Pixels of the layers from first to last."""
    outside = Counter(p.component for p in ports if not p.junction)
    widths = dict.fromkeys(range(first, last + 1), 0.0)
    for node, k in part.items():
        if first <= k <= last:
            widths[k] = max(widths[k], _width_of(node, outside[node.name]))
    return sum(widths.values()) + GAP * (len(widths) - 1)


def _within(ports: Sequence[PortEnergy], nodes: set[Node]) -> list[PortEnergy]:
    """Ports between nodes of a row, and of its members to the outside."""
    ends = [(p, Node(MEMBER, p.component), Node(JUNCTION, p.junction)) for p in ports]
    return [p for p, member, bar in ends if member in nodes and (not p.junction or bar in nodes)]


def _placed(row: _DiagramRow, top: float) -> dict[Node, _DiagramNode]:
    places = {node: _DiagramNode(node, layer) for part in row.parts for node, layer in part.items()}
    for p in row.ports:
        member = places[Node(MEMBER, p.component)]
        if not p.junction:
            member.above.append(p)
            continue
        bar = places[Node(JUNCTION, p.junction)]
        first, second = (member, bar) if member.layer < bar.layer else (bar, member)
        first.right.append(p)
        second.left.append(p)
    top += MARGIN
    for part in row.parts:
        top = _stacked([places[n] for n in part], top)
    _spread(places, MARGIN + (BESIDE if row.marks else 0))
    for place in places.values():
        for side, far in ((place.left, -1), (place.right, 1)):
            side.sort(key=lambda p, place=place: (_other(places, p, place).y, far))
    return places


def _stacked(part: Sequence[_DiagramNode], top: float) -> float:
    """Put the nodes of each layer below each other, near those of the layer before, about one line; the lower end of all."""
    layers: dict[int, list[_DiagramNode]] = {}
    for place in part:
        layers.setdefault(place.layer, []).append(place)
    for k, nodes in sorted(layers.items()):
        before = layers.get(k - 1, [])
        nodes.sort(key=lambda n: _mean([b.y for b in before if set(map(id, n.left)) & set(map(id, b.right))]))
        y = 0.0
        for n in nodes:
            n.y = y + n.room
            y = n.y + n.height / 2 + (NAMED if n.node.kind == JUNCTION else 20)
        middle = (nodes[0].y + nodes[-1].y) / 2
        for n in nodes:
            n.y -= middle
    down = top - min(n.y - n.room for n in part)
    for n in part:
        n.y += down
    return max(n.y + n.height / 2 for n in part) + 30


def _spread(places: Mapping[Node, _DiagramNode], left: float) -> None:
    """Layers side by side from `left` on, as wide as their widest node."""
    for k in range(max(p.layer for p in places.values()) + 1):
        nodes = [p for p in places.values() if p.layer == k]
        wide = max(n.width for n in nodes)
        for n in nodes:
            n.x = left + wide / 2
        left += wide + GAP


def _other(places: Mapping[Node, _DiagramNode], p: PortEnergy, here: _DiagramNode) -> _DiagramNode:
    kinds = (JUNCTION, p.junction) if here.node.kind == MEMBER else (MEMBER, p.component)
    return places[Node(*kinds)]


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values) if values else 0.0


def _edge(places: Mapping[Node, _DiagramNode], p: PortEnergy, largest: float) -> Iterator[str]:
    """A line from bar to member with its name and energy, and a head in the direction in which the energy went."""
    bar, member = places[Node(JUNCTION, p.junction)], places[Node(MEMBER, p.component)]
    (x0, y0), (x1, y1) = bar.end(p), member.end(p)
    w, flat = width_of(p.energy, largest, WIDEST), x1 + (STRAIGHT if x1 < x0 else -STRAIGHT)  # below the text
    bend = (x0 + flat) / 2
    yield (
        f'<path d="M{x0:.1f},{y0:.1f} C{bend:.1f},{y0:.1f} {bend:.1f},{y1:.1f} {flat:.1f},{y1:.1f} H{x1:.1f}" fill="none" '
        f'stroke="{LINE}" stroke-opacity="0.55" stroke-width="{w:.2f}"/>'
    )
    if p.energy:
        right = (x1 > x0) == (p.energy > 0)
        yield head(x1 + (14 if x1 < x0 else -14), y1, 0 if right else 180, w, LINE)
    anchor, shift = ("start", 24) if x1 < x0 else ("end", -24)
    yield text(x1 + shift, y1 - w / 2 - 4, f"{p.port} {engineering(abs(p.energy), 'J')}", anchor)


def _box(place: _DiagramNode, below: Mapping[str, str], largest: float) -> Iterator[str]:
    name, x, y = place.node.name, place.x, place.y
    for i, p in enumerate(place.above):
        at, w = x + PORT * (i - (len(place.above) - 1) / 2) - 18, width_of(p.energy, largest, WIDEST)
        top = y - place.height / 2 - ARROW
        yield (
            f'<line x1="{at:.1f}" y1="{top:.1f}" x2="{at:.1f}" y2="{y - place.height / 2:.1f}" '
            f'stroke="{OUTSIDE}" stroke-opacity="0.6" stroke-width="{w:.2f}"/>'
        )
        if p.energy:
            yield head(at, top + ARROW / 2, 90 if p.energy > 0 else 270, w, OUTSIDE)
        side = at + max(w / 2, 7) + 4
        yield text(side, top + 12, p.port, "start") + text(side, top + 26, engineering(abs(p.energy), "J"), "start")
    yield (
        f'<rect x="{x - place.width / 2:.1f}" y="{y - place.height / 2:.1f}" width="{place.width:.1f}" '
        f'height="{place.height:.1f}" rx="5" fill="#eef4f9" stroke="{LINE}"/>'
    )
    words = below.get(name, "")
    yield text(x, y + (-3 if words else 4), name, "middle", "font-weight='600' font-size='12'")
    if words:
        yield text(x, y + 13, words, "middle", "fill='#555' font-size='10'")


def _bar(place: _DiagramNode, mark: str) -> Iterator[str]:
    x, y, high = place.x, place.y, place.height + 14
    yield f'<rect x="{x - BAR / 2:.1f}" y="{y - high / 2:.1f}" width="{BAR}" height="{high:.1f}" fill="#222"/>'
    yield text(x, y + high / 2 + 14, place.node.name, "middle", "font-weight='600'")
    if mark:
        yield text(x, y + high / 2 + 27, mark, "middle", "fill='#555' font-size='10'")
