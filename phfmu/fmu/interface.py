"""What a unit says about itself: modelDescription.xml of both versions, and the ports of the manifest."""

from __future__ import annotations

from dataclasses import dataclass, field

from lxml import etree

from phfmu.fmu.manifest import PortMap, read_ports
from phfmu.fmu.variables import FMUError

LARGEST = 512 * 2**20
TRUE = ("true", "1")


@dataclass(frozen=True)
class Scalar:
    """A scalar variable of type Real or Float64."""

    name: str
    reference: int
    causality: str
    start: float | None = None
    unit: str = "1"
    nominal: float = 1.0
    description: str = ""


@dataclass(frozen=True)
class Interface:
    """A unit for Co-Simulation.  `energy`: names of the manifest's energies; without a manifest it is a foreign unit."""

    version: str
    name: str
    identifier: str
    token: str
    variables: dict[str, Scalar]
    saves: bool
    derivatives: bool
    start: float = 0.0
    stop: float | None = None
    step: float | None = None
    description: str = ""
    ports: tuple[PortMap, ...] = ()
    energy: dict[str, str] = field(default_factory=dict)

    def references(self, names: list[str] | tuple[str, ...], what: str) -> list[int]:
        """Value references; FMUError names those there are not."""
        from difflib import get_close_matches

        missing = [n for n in names if n not in self.variables]
        if missing:
            close = get_close_matches(missing[0], self.variables, 5)
            hint = f"; did you mean {', '.join(close)}?" if close else ""
            raise FMUError(f"{self.name} has no {what} '{missing[0]}'{hint}")
        return [self.variables[n].reference for n in names]


def parse(data: bytes, name: str) -> etree._Element:
    """The root of an XML document without document type, entities or network; FMUError says what is wrong."""
    if len(data) > LARGEST:
        raise FMUError(f"{name}: {len(data)} bytes of XML, more than {LARGEST}; refused")
    if b"\0" in data[:4] or data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise FMUError(f"{name}: the XML is not in UTF-8, which the standard asks for")
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise FMUError(f"{name}: the XML has a document type definition, which may read other files; refused")
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False)
    try:
        root = etree.fromstring(data, parser)
    except etree.XMLSyntaxError as error:
        raise FMUError(f"{name}: the XML is not well formed: {error}") from None
    if root.getroottree().docinfo.doctype:
        raise FMUError(f"{name}: the XML has a document type definition, which may read other files; refused")
    return root


def read_interface(model_description: bytes, manifest: bytes | None, name: str) -> Interface:
    """The interface of a unit; `name` is for messages."""
    root = parse(model_description, f"{name}/modelDescription.xml")
    version = root.get("fmiVersion", "")
    if version == "2.0":
        scalars, token, flags = _variables2(root), "guid", ("canGetAndSetFMUstate", "providesDirectionalDerivative")
    elif version.startswith("3."):
        scalars, token = _variables3(root), "instantiationToken"
        flags = ("canGetAndSetFMUState", "providesDirectionalDerivatives")
    else:
        raise FMUError(f"{name}: FMI version '{version}'; this reads 2.0 and 3.0")
    cosimulation = root.find("CoSimulation")
    if cosimulation is None:
        raise FMUError(f"{name}: the unit has no Co-Simulation interface")
    experiment = root.find("DefaultExperiment")
    times = {} if experiment is None else {k: float(v) for k, v in experiment.attrib.items() if k in _TIMES}
    ports, energy = (), {}
    if manifest is not None:
        about = parse(manifest, f"{name}/manifest")
        ports = tuple(read_ports(about))
        found = about.find("Energy")
        energy = {} if found is None else {str(k): str(v) for k, v in found.attrib.items()}
    return Interface(
        "2.0" if version == "2.0" else "3.0", root.get("modelName", name), cosimulation.get("modelIdentifier", ""),
        root.get(token, ""), scalars, cosimulation.get(flags[0]) in TRUE, cosimulation.get(flags[1]) in TRUE,
        times.get("startTime", 0.0), times.get("stopTime"), times.get("stepSize"), root.get("description", ""), ports, energy,
    )  # fmt: skip


_TIMES = ("startTime", "stopTime", "stepSize")


def _variables2(root: etree._Element) -> dict[str, Scalar]:
    found = {}
    for v in root.iterfind("ModelVariables/ScalarVariable"):
        real = v.find("Real")
        if real is not None:
            scalar = _scalar(v, real)
            found[scalar.name] = scalar
    return found


def _variables3(root: etree._Element) -> dict[str, Scalar]:
    """Arrays are left out: a port is made of scalars."""
    found = {}
    for v in root.iterfind("ModelVariables/Float64"):
        if v.find("Dimension") is None:
            scalar = _scalar(v, v)
            found[scalar.name] = scalar
    return found


def _scalar(v: etree._Element, numbers: etree._Element) -> Scalar:
    start, nominal = numbers.get("start"), numbers.get("nominal")
    return Scalar(
        v.get("name", ""), int(v.get("valueReference", "0")), v.get("causality", "local"),
        None if start is None else float(start), numbers.get("unit", "1"), 1.0 if nominal is None else float(nominal),
        v.get("description", ""),
    )  # fmt: skip
