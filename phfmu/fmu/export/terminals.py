"""terminalsAndIcons.xml: every external power port as a terminal.

Of a pair, the variable that is equal on both sides of a connection is a signal, the one that sums to zero
there an inflow: voltage and current, but velocity and force.  The inflow is positive into the component; at a port that
was exported outward it is an outflow, positive out of it.
"""

from __future__ import annotations

from phfmu.declare.port import Port
from phfmu.fmu.export.description import ExportedUnit
from phfmu.fmu.version import Version
from phfmu.fmu.words import plain
from phfmu.fmu.xml import Element, etree, text_of


def terminals(unit: ExportedUnit, version: Version) -> bytes | None:
    """The document of a unit of one FMI version, or None without external ports or if it is not wanted."""
    ports = [p for p in unit.declaration.ports if p.external and not p.signal]
    if not ports or not unit.terminals:
        return None
    root = etree.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    listed = etree.SubElement(root, "Terminals")
    for port in ports:
        kind = "outflow" if port.name in unit.outward else "inflow"
        _terminal(listed, port, unit.arrays and version.arrays and port.size is not None, kind)
    return text_of(root)


def _terminal(parent: Element, port: Port, array: bool, kind: str) -> None:
    """Members are named by effort and flow, so that two terminals of a domain have the same members."""
    terminal = etree.SubElement(
        parent, "Terminal", name=port.name, matchingRule="plug", terminalKind=f"org.phfmu.{port.domain.name}"
    )
    sense = (
        "power is positive into the component" if kind == "inflow" else "the outflow is positive out of the component"
    )
    terminal.set("description", f"{plain(port.description or port.name)}; {sense}")
    efforts, flows = port.input_names(), port.output_names()
    if array:
        efforts, flows = ([names[0].rpartition("[")[0]] for names in (efforts, flows))
    if port.given == "flow":
        efforts, flows = flows, efforts
    balance = flows if port.domain.summed == "flow" else efforts
    for names in zip(efforts, flows, strict=True):
        for name in names:
            member = etree.SubElement(terminal, "TerminalMemberVariable", variableName=name)
            member.set("memberName", name.removeprefix(f"{port.name}."))
            member.set("variableKind", kind if name in balance else "signal")
