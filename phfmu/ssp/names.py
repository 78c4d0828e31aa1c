"""Names of the standard: namespaces, file names, types; and those of our annotation."""

from __future__ import annotations

_BASE = "http://ssp-standard.org/SSP1/SystemStructure"
#: the same in SSP 1.0 and 2.0; prefixes as the standard nicknames them, which some importers ask for
NAMESPACES = {
    "ssd": f"{_BASE}Description",
    "ssc": f"{_BASE}Common",
    "ssv": f"{_BASE}ParameterValues",
    "ssm": f"{_BASE}ParameterMapping",
    "ssb": f"{_BASE}SignalDictionary",
}
#: of our annotation: junctions of power ports, and the step
PORTS = "org.phfmu.ports"

#: prefix -> root element
ROOTS = {
    "ssd": "SystemStructureDescription",
    "ssv": "ParameterSet",
    "ssm": "ParameterMapping",
    "ssb": "SignalDictionary",
}
VERSIONS = ("1.0", "2.0", "2.1")
#: of which it is a draft: 2.0 with terminals
DRAFT = "2.1"
STRUCTURE = "SystemStructure.ssd"
FMU = "application/x-fmu-sharedlibrary"
#: components that are systems: another description, another package
DEFINITION, PACKAGE = "application/x-ssp-definition", "application/x-ssp-package"
DICTIONARY = "application/x-ssp-signal-dictionary"
#: values of a parameter that are one number
NUMBERS = (
    "Real",
    "Float64",
    "Float32",
    "Integer",
    "Boolean",
    *(f"{u}Int{n}" for u in ("", "U") for n in (8, 16, 32, 64)),
)


def tag(prefix: str, name: str) -> str:
    """ssd, System -> {http://..}System."""
    return f"{{{NAMESPACES[prefix]}}}{name}"
