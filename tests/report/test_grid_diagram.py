"""One-line diagrams of meshed networks: what is drawn where, which way, and what is left out."""

from __future__ import annotations

import math
import re
from xml.etree import ElementTree as ET

import pytest

from phfmu.report.page.flows import PortEnergy
from phfmu.report.page.grid_diagram import MOST_JUNCTIONS, STALK, grid_diagram

pytest.importorskip("networkx")
SVG = "{http://www.w3.org/2000/svg}"


def lattice(n: int) -> list[PortEnergy]:
    """n by n buses, 1 kJ right and down each line; a machine at the first bus, a load at the last, a meter without energy."""
    found = list[PortEnergy]()
    for i in range(n):
        for j in range(n):
            for name, a, b in (("r", i, j + 1), ("d", i + 1, j)):
                if a < n and b < n:
                    line = f"{name}{i}_{j}"
                    found += [PortEnergy(line, "a", f"b{i}_{j}", 1e3), PortEnergy(line, "b", f"b{a}_{b}", -999.0)]
    found += [PortEnergy("gen", "terminal", "b0_0", -5e3), PortEnergy("gen", "shaft", "", 5e3)]
    found += [PortEnergy("load", "terminal", f"b{n - 1}_{n - 1}", 4e3), PortEnergy("meter", "a", "b0_1", 1e-9)]
    return found


def buses(root: ET.Element) -> list[tuple[float, float]]:
    dots = [c for c in root.iter(f"{SVG}circle") if c.get("fill") == "#222"]
    return [(float(c.get("cx", "nan")), float(c.get("cy", "nan"))) for c in dots]


@pytest.mark.parametrize("n", [5, 12])
def test_each_bus_and_line_is_drawn_and_none_is_too_close(n: int) -> None:
    text, faint = grid_diagram(lattice(n), {"r0_0": "dissipated 1 J"})
    root = ET.fromstring(text)
    at = buses(root)
    assert len(at) == n * n and faint == 1
    assert len(root.findall(f".//{SVG}path")) == 2 * n * (n - 1)
    assert min(math.dist(p, q) for i, p in enumerate(at) for q in at[:i]) > 2 * STALK
    width, height = (float(root.get(k, "nan")) for k in ("width", "height"))
    assert all(0 < x < width and 0 < y < height for x, y in at)
    titles = [t.text or "" for t in root.iter(f"{SVG}title")]
    assert "r0_0: dissipated 1 J 1 kJ" in titles and "gen gave 5 kJ" in titles and "load took 4 kJ" in titles
    assert not any("meter" in t for t in titles)


def test_heads_point_the_way_of_the_energy() -> None:
    """From the bus of the machine to that of the load, on every line."""
    root = ET.fromstring(grid_diagram(lattice(4), {})[0])
    names = [t.text for t in root.iter(f"{SVG}text") if (t.text or "").startswith("b")]
    place = dict(zip(names, buses(root), strict=True))
    for g in root.iter(f"{SVG}g"):
        said = next(iter(g)).text or ""
        if match := re.match(r"([rd])(\d)_(\d) ", said):
            i, j = int(match[2]), int(match[3])
            a, b = place[f"b{i}_{j}"], place[f"b{i}_{j + 1}" if match[1] == "r" else f"b{i + 1}_{j}"]
            head = g.find(f"{SVG}polygon")
            assert head is not None
            turned = re.search(r"rotate\((.*)\)", head.get("transform", ""))
            assert turned is not None
            way = math.degrees(math.atan2(b[1] - a[1], b[0] - a[0]))
            assert abs((float(turned[1]) - way + 180) % 360 - 180) < 0.1


def test_members_of_three_junctions_and_parts_apart_are_drawn() -> None:
    """A transformer of three windings joins three lines; another part stands below."""
    ports = [PortEnergy("three", p, f"b{p}", e) for p, e in (("a", 3.0), ("b", -1.0), ("c", -2.0))]
    ports += [
        PortEnergy(f"line{p}", end, f"b{p}{'2' * (end == 'z')}", s)
        for p in "abc"
        for end, s in (("y", 1.0), ("z", -1.0))
    ]
    ports += [PortEnergy("other", "a", "far1", 1.0), PortEnergy("other", "b", "far2", -1.0)]
    root = ET.fromstring(grid_diagram(ports, {})[0])
    assert len(root.findall(f".//{SVG}rect")) == 1 and len(root.findall(f".//{SVG}path")) == 3 + 3 + 1
    assert len(buses(root)) == 8


def test_what_is_no_mesh_is_left_to_the_other_diagram() -> None:
    star = [
        p
        for i in range(30)
        for p in (PortEnergy("hub", f"p{i}", f"j{i}", -1.0), PortEnergy(f"m{i}", "q", f"j{i}", 1.0))
    ]
    assert grid_diagram(star, {}) == ("", 0)
    assert grid_diagram([], {}) == ("", 0)
    row = [PortEnergy(f"l{i}", end, f"b{i + (end == 'b')}", 1.0) for i in range(MOST_JUNCTIONS + 1) for end in "ab"]
    assert grid_diagram(row, {}) == ("", 0)
