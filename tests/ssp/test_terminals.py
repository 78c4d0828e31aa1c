"""Terminals by the draft of SSP 2.1: packages with them run as others do; what the draft does not connect is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from phfmu.cli import main
from phfmu.fmu.xml import etree
from phfmu.ssp.loading import load
from phfmu.ssp.names import tag
from phfmu.ssp.structure import SSPError
from phfmu.ssp.terminals import without
from tests.ssp.documents import (
    AFTER,
    MASS,
    SPRING,
    UNITS,
    component,
    connection,
    connectors,
    expected,
    linear,
    ran,
    system,
)
from tests.ssp.packages import document, pack, unpacked
from tests.wide import marked, slow

ROD = (("force", "local", "N"), ("velocity", "local", "m/s"))


def terminals(*types: str) -> str:
    """The content of a document behind its system, with these types."""
    return AFTER.replace(UNITS, f"{UNITS}<ssd:Terminals>{''.join(types)}</ssd:Terminals>")


def of_type(name: str = "rod", rule: str = "plug", of=ROD, more: str = "") -> str:
    return f'<ssd:Terminal name="{name}" matchingRule="{rule}">{connectors(of)}{more}</ssd:Terminal>'


def with_terminal(element: str, name: str, type_: str = "rod") -> str:
    """The element with a connector of the kind `terminal` behind its others."""
    own = (
        f'<ssd:Connector name="{name}" kind="terminal"><ssc:Terminal name="{type_}"/></ssd:Connector></ssd:Connectors>'
    )
    return element.replace("</ssd:Connectors>", own, 1)


CART = with_terminal(component("cart", "mass", MASS), "flange")
COIL = with_terminal(component("coil", "spring", SPRING), "a")
JOINED = connection("cart:flange", "coil:a")


def made(folder: Path, units: dict[str, bytes], content: str, after: str | None = None) -> Path:
    text = document(content, "2.1", terminals(of_type()) if after is None else after)
    return pack(folder / "pair.ssp", units | {"SystemStructure.ssd": text})


@pytest.mark.parametrize(
    ("scene", "options"),
    [
        ("oscillator", ["--fmi", "3"]),
        marked(("oscillator", ["--fmi", "2", "--outward", "mass1.flange"]), pytest.mark.long),
        slow(("smib", [])),
    ],
)
def test_a_network_goes_out_and_comes_back(scene: str, options: list[str], compiler: None, tmp_path: Path) -> None:
    """A package with terminals runs as one of SSP 1.0, to the bit but the sign of flows that count outward; it is written again
    byte for byte; it needs neither the annotation nor, for tools that pass values on as they are, any factor (but for a junction
    of two ports that take the same variable, which is in smib)."""
    for version in ("1.0", "2.1"):
        assert main(["export", scene, "--ssp", version, "-o", str(tmp_path / version), *options]) == 0
    one, other = (tmp_path / v / f"{scene}.ssp" for v in ("1.0", "2.1"))
    files = unpacked(other)
    root = etree.fromstring(files["SystemStructure.ssd"])
    pairs = [c for c in root.iter(tag("ssd", "Connection")) if "." not in c.get("startConnector")]
    assert len(pairs) >= 1 and b"LinearTransformation" not in files["SystemStructure.ssd"]
    first, second = ran(one, "--stop", "0.2"), ran(other, "--stop", "0.2")
    names = [n for n in first.dtype.names or () if n in (second.dtype.names or ())]
    turned = [n for n in names if not np.array_equal(first[n], second[n])]
    assert len(names) > 20 and all(np.array_equal(first[n], -second[n]) for n in turned), turned
    assert len(turned) < len(names) / 3 and not any(n.endswith((".q", ".stored")) for n in turned)
    assert main(["export", str(other), "--ssp", "2.1", "-o", str(tmp_path / "again")]) == 0
    assert unpacked(tmp_path / "again" / other.name) == files
    if scene == "smib":
        return

    # the same by values alone: each connection of terminals as those of its members, in a document of SSP 2.0 without annotation
    for system_ in root.iter(tag("ssd", "System")):
        system_.remove(system_.find(tag("ssd", "Annotations")))
    bare = pack(tmp_path / "bare.ssp", files | {"SystemStructure.ssd": etree.tostring(root)})
    listed = root.find(f".//{tag('ssd', 'Connections')}")
    kinds = {
        (e.get("name"), c.get("name")): c.get("kind")
        for e in root.iter(tag("ssd", "Component"))
        for c in e.iter(tag("ssd", "Connector"))
    }
    types = {
        t.get("name"): [c.get("name") for c in t.iter(tag("ssd", "Connector"))]
        for t in root.iter(tag("ssd", "Terminal"))
    }
    type_of = {
        (e.get("name"), c.get("name")): c.find(tag("ssc", "Terminal")).get("name")
        for e in root.iter(tag("ssd", "Component"))
        for c in e.iter(tag("ssd", "Connector"))
        if c.get("kind") == "terminal"
    }
    plain = without(root)
    if plain.find(f".//{tag('ssd', 'Connections')}") is None:
        inner = plain.find(tag("ssd", "System"))
        inner.insert(1, etree.Element(listed.tag))
    for c in pairs:
        ends = [(c.get(f"{s}Element"), c.get(f"{s}Connector")) for s in ("start", "end")]
        for member in types[type_of[ends[0]]]:
            places = [(e, f"{n}.{member}") for e, n in ends]
            start, end = places if kinds[places[0]] == "output" else places[::-1]
            attributes = {
                "startElement": start[0],
                "startConnector": start[1],
                "endElement": end[0],
                "endConnector": end[1],
            }
            etree.SubElement(plain.find(f".//{tag('ssd', 'Connections')}"), tag("ssd", "Connection"), attributes)
    values = pack(tmp_path / "values.ssp", files | {"SystemStructure.ssd": etree.tostring(plain)})
    for path in (bare, values):
        found = ran(path, "--stop", "0.2")
        members = [n for n in second.dtype.names or () if n in (found.dtype.names or ())]
        assert len(members) > 20
        for n in members:
            np.testing.assert_array_equal(found[n], second[n], err_msg=n)


def test_flows_that_both_count_inward_sum_to_zero(units: dict[str, bytes], tmp_path: Path) -> None:
    """FMI 3.0 says so of terminals; a mass that hits a spring, against the analytic solution."""
    found = ran(made(tmp_path, units, system(CART, COIL, connections=(JOINED,))))
    exact = expected(found["time"])
    error = np.abs(found["cart.v"] - exact).max()
    assert 0 < error < 0.2 * np.sqrt(20.0) * 20.0 * 1e-4 / 12 * 2  # phase error t w (w h)^2 / 12 of the midpoint rule
    assert "SSP 2.1 is a draft: terminals are read by it, all else by SSP 2.0" in load(tmp_path / "pair.ssp").notes


@pytest.mark.parametrize("rule", ["bus", "sequence"])
def test_members_are_matched_by_the_rule(rule: str, units: dict[str, bytes], tmp_path: Path) -> None:
    """A bus may have members that the other side has not; in a sequence names do not count."""
    more = (("energy", "local", "J"),) if rule == "bus" else ()
    wide = (*ROD, *more)
    after = terminals(of_type("rod", rule, wide), of_type("other", "bus" if rule == "bus" else "sequence", ROD))
    content = system(CART, with_terminal(component("coil", "spring", SPRING), "a", "other"), connections=(JOINED,))
    found = ran(made(tmp_path, units, content, after))
    assert np.abs(found["cart.v"] - expected(found["time"])).max() < 1e-2


def test_terminals_of_a_nested_system_hand_members_on(units: dict[str, bytes], tmp_path: Path) -> None:
    """The system has connectors for the members too, by the same names."""
    own = (("flange.velocity", "output", "m/s"), ("flange.force", "input", "N"))
    inner = system(CART, connections=(connection("cart:flange", ":flange"),), more=connectors(own))
    axle = f'<ssd:System name="axle">{with_terminal(inner, "flange")}</ssd:System>'
    found = ran(made(tmp_path, units, system(axle, COIL, connections=(connection("axle:flange", "coil:a"),))))
    assert np.abs(found["axle_cart.v"] - expected(found["time"])).max() < 1e-2


REFUSED = [
    (terminals(of_type("pipe")), JOINED, "is a terminal of the type 'rod'"),
    (terminals(of_type(rule="round")), JOINED, "the rule 'round'"),
    (terminals(of_type(), of_type()), JOINED, "names of their own"),
    (terminals(of_type(rule="none")), JOINED, "has the rule 'none'"),
    (
        terminals(of_type(more=f"<ssd:Terminals>{of_type('in')}</ssd:Terminals>")),
        JOINED,
        "terminals inside, which are not read",
    ),
    (terminals(of_type()), connection("cart:flange", "coil:a", linear(-1)), "has a transformation"),
    (terminals(of_type()), connection("cart:flange", "coil:a.velocity"), "joins a terminal and a variable"),
    (terminals(of_type(of=(*ROD, ("heat", "local", "N")))), JOINED, "has no connector 'flange.heat'"),
]


@pytest.mark.parametrize(("after", "joined", "words"), REFUSED)
def test_what_the_draft_does_not_connect_is_refused(
    after: str, joined: str, words: str, units: dict[str, bytes], tmp_path: Path
) -> None:
    path = made(tmp_path, units, system(CART, COIL, connections=(joined,)), after)
    with pytest.raises(SSPError) as error:
        load(path)
    assert words in str(error.value)


@pytest.mark.parametrize("rule", ["plug", "sequence"])
def test_types_that_do_not_match(rule: str, units: dict[str, bytes], tmp_path: Path) -> None:
    other = with_terminal(component("coil", "spring", SPRING), "a", "other")
    after = terminals(of_type(rule=rule), of_type("other", "bus", ROD[:1]))
    words = "'velocity' of the type 'rod' is no member of 'other'" if rule == "plug" else "2 and 1 members in sequence"
    with pytest.raises(SSPError, match=words):
        load(made(tmp_path, units, system(CART, other, connections=(JOINED,)), after))
