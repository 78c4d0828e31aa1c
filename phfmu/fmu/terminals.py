"""terminalsAndIcons.xml: every external power port as a terminal.

Of the pair the variable that sums to zero at a connection is the inflow: current and volume flow, but force and torque;
the other one is equal on both sides and a signal.  Power, and with it the inflow, counts positive into the component.
"""

from __future__ import annotations

from lxml import etree

from phfmu.declare.port import Port
from phfmu.fmu import description
from phfmu.fmu.description import Unit

#: domains in which efforts balance and flows are equal at a connection
EFFORT_BALANCES = ("translational", "rotational")


def terminals(unit: Unit) -> bytes | None:
    """The document, or None without external ports."""
    ports = [p for p in unit.declaration.ports if p.external]
    if not ports:
        return None
    root = etree.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    listed = etree.SubElement(root, "Terminals")
    for port in ports:
        _terminal(listed, port)
    return description.text_of(root)


def _terminal(parent: etree._Element, port: Port) -> None:
    """Members are named by effort and flow, so that two terminals of a domain have the same members."""
    terminal = etree.SubElement(
        parent, "Terminal", name=port.name, matchingRule="plug", terminalKind=f"org.phfmu.{port.domain.name}"
    )
    terminal.set("description", f"{port.description or port.name}; power is positive into the component")
    efforts, flows = port.input_names(), port.output_names()
    if port.given == "flow":
        efforts, flows = flows, efforts
    balance = efforts if port.domain.name in EFFORT_BALANCES else flows
    for names in zip(efforts, flows, strict=True):
        for name in names:
            etree.SubElement(
                terminal, "TerminalMemberVariable", variableName=name, memberName=name.removeprefix(f"{port.name}."),
                variableKind="inflow" if name in balance else "signal",
            )  # fmt: skip
