"""Power ports from the terminals of a unit of another tool.

A terminal of two kinds of members is one: variables that are equal on both sides of a connection (`signal`), and as many that
sum to zero there (`inflow`, `outflow`: out of the unit).  Units of the variables tell the domain.
"""

from __future__ import annotations

import re

from phfmu.declare.port import DOMAINS, Domain
from phfmu.fmu.export.manifest import PortMap
from phfmu.fmu.export.variables import FMUError
from phfmu.fmu.importer.ports.port_tables import domain_of, entries_of, port_maps, unit_of
from phfmu.fmu.importer.unit_interface import UnitInterface
from phfmu.fmu.words import plain
from phfmu.fmu.xml import Element, parse

_SIGNS = {"inflow": 1, "outflow": -1}


def terminal_ports(document: bytes, interface: UnitInterface, where: str) -> tuple[tuple[PortMap, ...], list[str]]:
    """The ports, and a line for each terminal that is none."""
    found, left_out = list[PortMap](), list[str]()
    for name, terminal in _terminals(parse(document, f"{where}: terminals").find("Terminals"), ""):
        try:
            found += _ports(name, terminal, interface)
        except FMUError as error:
            left_out.append(str(error))
    return tuple(found), left_out


def _terminals(parent: Element | None, prefix: str) -> list[tuple[str, Element]]:
    """All terminals, nested ones by dotted names."""
    out = list[tuple[str, Element]]()
    for t in [] if parent is None else parent.findall("Terminal"):
        name = prefix + plain(t.get("name", ""), 100)
        out += [(name, t), *_terminals(t, f"{name}.")]
    return out


def _ports(name: str, terminal: Element, interface: UnitInterface) -> tuple[PortMap, ...]:
    members = [
        (plain(m.get("variableKind", ""), 30), plain(m.get("variableName", "")))
        for m in terminal.findall("TerminalMemberVariable")
    ]
    shared = [n for kind, n in members if kind == "signal"]
    summed = [n for kind, n in members if kind in _SIGNS]
    signs = {_SIGNS[kind] for kind, _ in members if kind in _SIGNS}
    what = f"terminal '{name}'"
    if not members:
        return ()  # it only holds others
    if len(shared) != len(summed) or len(signs) != 1:
        kinds = ", ".join(f"{n} ({kind})" for kind, n in members[:4])
        raise FMUError(f"{what}: is no power port, which has as many signals as inflows or outflows: {kinds}")
    domain = next((d for d in DOMAINS.values() if _fits(d, shared[0], summed[0], interface)), None)
    if domain is None:
        raise FMUError(f"{what}: the units of {shared[0]} and {summed[0]} tell no domain")
    pair = {domain.common: shared, domain.summed: summed}
    told = {k: v[0] if len(v) == 1 else v for k, v in pair.items()}
    return port_maps({re.sub(r"\W", "_", name): {**told, "sign": signs.pop(), "domain": domain}}, interface, what)


def _fits(domain: Domain, shared: str, summed: str, interface: UnitInterface) -> bool:
    effort, flow = (shared, summed) if domain.common == "effort" else (summed, shared)
    units = (unit_of(interface, entries_of(n, interface)[0]) for n in (effort, flow))
    return domain_of(*units) is domain
