"""extra/org.phfmu.ports/fmi-ls-manifest.xml: what the standard cannot say about power ports.

It names the conjugate pairs, the energies, and what the directional derivative of a step output is.
"""

from __future__ import annotations

from dataclasses import dataclass

from lxml import etree

from phfmu.fmu import description
from phfmu.fmu.description import Unit, number
from phfmu.fmu.variables import LEDGER, STEP_LEDGER

LAYER = "org.phfmu.ports"
PATH = f"extra/{LAYER}/fmi-ls-manifest.xml"
VERSION = "1.0.0"
_LS = "http://fmi-standard.org/fmi-ls-manifest"

#: attribute of the energies of one step
ENERGY = {"stored_step": "storedStep", "supplied_step": "suppliedStep", "dissipated_step": "dissipatedStep"}

TEXT = (
    "power ports with conjugate pairs: (length of the step) * input * step output is the energy supplied to the "
    "component in a step, exactly"
)
DERIVATIVE = (
    "the directional derivative of a step output with respect to a port input is the sensitivity of the step map of "
    "the last communication step, taken as one internal step"
)


@dataclass(frozen=True)
class PortMap:
    """Names of one port's scalars: inputs, outputs at the present time, step means.

    power = sign * input * output is positive into the component; `step_outputs` is empty where a unit has none.
    """

    name: str
    domain: str
    given: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    step_outputs: tuple[str, ...] = ()
    sign: float = 1.0
    energy: str = ""


def manifest(unit: Unit) -> bytes:
    """The document."""
    root = etree.Element("PowerPorts", nsmap={"fmi-ls": _LS})
    for name, value in (("name", LAYER), ("version", VERSION), ("description", TEXT)):
        root.set(f"{{{_LS}}}fmi-ls-{name}", value)
    etree.SubElement(root, "Step", internalStepSize=number(unit.step), directionalDerivative=DERIVATIVE)
    energy = etree.SubElement(root, "Energy")
    for what, _, _ in (*LEDGER, *STEP_LEDGER):
        energy.set(ENERGY.get(what, what), f"energy.{what}")
    for port in unit.declaration.ports:
        if not port.external:
            continue
        element = etree.SubElement(root, "Port", name=port.name, domain=port.domain.name, given=port.given)
        element.set("effortUnit", port.domain.effort_unit)
        element.set("flowUnit", port.domain.flow_unit)
        element.set("energy", f"{port.name}.energy")
        for pair in zip(port.input_names(), port.output_names(), port.output_names("_step"), strict=True):
            etree.SubElement(element, "Pair", dict(zip(("input", "output", "stepOutput"), pair, strict=True)))
    return description.text_of(root)


def read_ports(root: etree._Element) -> list[PortMap]:
    """The ports of a manifest."""
    ports = []
    for port in root.findall("Port"):
        pairs = port.findall("Pair")
        column = {k: tuple(p.get(k, "") for p in pairs) for k in ("input", "output", "stepOutput")}
        ports.append(PortMap(port.get("name", ""), port.get("domain", ""), port.get("given", ""), column["input"],
                             column["output"], column["stepOutput"], 1.0, port.get("energy", "")))  # fmt: skip
    return ports
