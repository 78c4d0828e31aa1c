"""Terminals of the draft of SSP 2.1: power ports as connectors, joined by one connection.

A document defines types of terminals; a connector of the kind `terminal` names its type and stands for the connectors that are
called `terminal.member`.  A connection of two terminals connects members of one name; the draft has no sign for a flow, so
a pair of ports is written as one only if its connections have no factor: one of the two counts its flow outward.
Source: github.com/modelica/ssp-standard, pull request 120, "Add terminal support".
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace

from phfmu.fmu.export.manifest import PortMap
from phfmu.fmu.importer.unit_file import UnitFile
from phfmu.fmu.words import plain
from phfmu.fmu.xml import Element, etree
from phfmu.network.wires import Wire
from phfmu.ssp.names import tag
from phfmu.ssp.structure import Connection, Linear, SSPError
from phfmu.words import meant

#: kind of the connectors
KIND = "terminal"
RULES = ("plug", "bus", "sequence", "none")


@dataclass(frozen=True)
class Terminal:
    """A type of terminals: its `name`, the rule by which members are matched, and their names in order."""

    name: str
    rule: str
    members: tuple[str, ...]


# -- read -----------------------------------------------------------------------------------------------------------------


def read_terminals(root: Element, where: str) -> dict[str, Terminal]:
    """The types that a description defines, by name; SSPError for what the draft does not say how to connect."""
    listed = root.find(tag("ssd", "Terminals"))
    found = dict[str, Terminal]()
    for t in () if listed is None else listed:
        name, rule = plain(t.get("name", ""), 200), t.get("matchingRule", "")
        if not name or name in found or rule not in RULES:
            raise SSPError(
                f"{where}: the terminal type '{name}' with the rule '{plain(rule, 50)}'; expected names of their own, and one "
                f"of the rules {', '.join(RULES)}"
            )
        if t.find(tag("ssd", "Terminals")) is not None:
            raise SSPError(
                f"{where}: the terminal type '{name}' has terminals inside, which are not read; list its members"
            )
        connectors = t.find(tag("ssd", "Connectors"))
        members = tuple(plain(c.get("name", "")) for c in (() if connectors is None else connectors))
        found[name] = Terminal(name, rule, members)
    return found


def type_of(connector: Element, known: Mapping[str, Terminal], where: str) -> Terminal:
    """The type of a connector of the kind `terminal`; SSPError if it names none of those that are known."""
    own = connector.find(tag("ssc", "Terminal"))
    name = "" if own is None else plain(own.get("name", ""), 200)
    if name not in known:
        raise SSPError(f"{where} is a terminal of the type '{name}'; {meant(name, known)}")
    return known[name]


def of_members(c: Connection, terminals: tuple[Terminal | None, Terminal | None], where: str) -> Iterator[Connection]:
    """A connection, or those of the members of two terminals; SSPError for terminals that do not match."""
    a, b = terminals
    if a is None and b is None:
        yield c
        return
    ends = " - ".join(".".join(filter(None, end)) for end in c.ends)
    if a is None or b is None:
        raise SSPError(f"{where}: the connection {ends} joins a terminal and a variable; connect one of its members")
    if c.transformation != Linear():
        raise SSPError(
            f"{where}: the connection {ends} of terminals has a transformation, which is of no single member"
        )
    for one, other in _matched(a, b, f"{where}: the connection {ends}"):
        start, end = f"{c.start_connector}.{one}", f"{c.end_connector}.{other}"
        yield replace(c, start_connector=start, end_connector=end, terminal=True)


def _matched(a: Terminal, b: Terminal, what: str) -> list[tuple[str, str]]:
    """Pairs of members; each of the two types has a rule of its own."""
    rules = {a.rule, b.rule}
    if "none" in rules:
        raise SSPError(f"{what} joins terminals of which one has the rule 'none'; connect their members")
    if "sequence" in rules:
        if len(a.members) != len(b.members):
            raise SSPError(f"{what} joins {len(a.members)} and {len(b.members)} members in sequence")
        return list(zip(a.members, b.members, strict=True))
    for one, other in ((a, b), (b, a)):
        if one.rule == "plug" and (lost := [m for m in one.members if m not in other.members]):
            raise SSPError(
                f"{what}: '{lost[0]}' of the type '{one.name}' is no member of '{other.name}', and it is a plug"
            )
    return [(m, m) for m in a.members if m in b.members]


def without(root: Element) -> Element:
    """A copy that is of SSP 2.0: without types, connectors and connections of terminals."""
    bare = deepcopy(root)
    bare.set("version", "2.0")
    for listed in bare.findall(tag("ssd", "Terminals")):
        bare.remove(listed)
    for system in list(bare.iter(tag("ssd", "System"))):
        elements = system.find(tag("ssd", "Elements"))
        owners = {"": system} | {e.get("name", ""): e for e in (() if elements is None else elements)}
        ends = {(n, c.get("name")) for n, owner in owners.items() for c in _connectors(owner) if c.get("kind") == KIND}
        connections = system.find(tag("ssd", "Connections"))
        if connections is None:
            continue
        for c in list(connections):
            told = ((c.get(f"{side}Element", ""), c.get(f"{side}Connector")) for side in ("start", "end"))
            if any(end in ends for end in told):
                connections.remove(c)
        if not len(connections):
            system.remove(connections)
    for connector in list(bare.iter(tag("ssd", "Connector"))):
        if connector.get("kind") == KIND:
            connector.getparent().remove(connector)
    for listed in list(bare.iter(tag("ssd", "Connectors"))):
        if not len(listed):
            listed.getparent().remove(listed)
    return bare


def _connectors(element: Element) -> Sequence[Element]:
    found = element.find(tag("ssd", "Connectors"))
    return () if found is None else found


# -- written ----------------------------------------------------------------------------------------------------------------


def members_of(port: PortMap) -> tuple[str, ...]:
    """Names of the members of a port, inputs and outputs in turns; none where its variables are not called `port.member`."""
    names = [n for pair in zip(port.inputs, port.outputs, strict=True) for n in pair]
    start = f"{port.name}."
    return tuple(n.removeprefix(start) for n in names) if all(n.startswith(start) for n in names) else ()


def type_name(port: PortMap) -> str:
    """The name of the type of a port: its domain, with the number of pairs where there are more; empty where it has none.

    Two ports of a domain have the same members, whichever of a pair they take.
    """
    n = len(port.inputs)
    return f"org.phfmu.{port.domain.name}{f'.{n}' if n > 1 else ''}" if members_of(port) else ""


def write_terminals(root: Element, units: Mapping[str, UnitFile]) -> None:
    """`Terminals` with the types of all ports, nothing without any."""
    ports = {type_name(p): (u, p) for u in units.values() for p in u.port_maps if type_name(p)}
    if not ports:
        return
    listed = etree.SubElement(root, tag("ssd", "Terminals"))
    for name, (unit, port) in sorted(ports.items()):
        terminal = etree.SubElement(listed, tag("ssd", "Terminal"), name=name, matchingRule="plug")
        terminal.set("terminalKind", f"org.phfmu.{port.domain.name}")
        connectors = etree.SubElement(terminal, tag("ssd", "Connectors"))
        for member in sorted(members_of(port)):
            connector = etree.SubElement(connectors, tag("ssd", "Connector"), name=member, kind="local")
            type_ = etree.SubElement(connector, tag("ssc", "Real"))
            variable = unit.interface.variables[f"{port.name}.{member}"]
            if variable.unit != "1" and variable.unit in unit.interface.units:
                type_.set("unit", variable.unit)


def write_connectors(parent: Element, unit: UnitFile) -> Iterator[tuple[str, Element]]:
    """Connectors of the kind `terminal` for the ports of a unit: name and element."""
    for port in unit.port_maps:
        if name := type_name(port):
            connector = etree.SubElement(parent, tag("ssd", "Connector"), name=port.name, kind=KIND)
            etree.SubElement(connector, tag("ssc", "Terminal"), name=name)
            yield port.name, connector


def one_connection(links: Sequence[Wire], ports: tuple[PortMap, PortMap]) -> Wire | None:
    """The connection of two terminals that says what the links of a junction say; None where it would not."""
    a, b = ports
    if not links or not type_name(a) or type_name(a) != type_name(b):
        return None
    starts = (f"{a.name}.", f"{b.name}.")
    for w in links:
        own, other = starts if w.output.startswith(starts[0]) and w.input.startswith(starts[1]) else starts[::-1]
        if w.factor != 1.0 or w.offset or w.output.removeprefix(own) != w.input.removeprefix(other):
            return None
    first = links[0]
    return Wire(first.source, a.name, first.target, b.name)
