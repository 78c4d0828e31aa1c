"""Writing a network of units as a package of SSP.

Ports that fit plainly are connected variable by variable, with the factor -1 where flows meet that both count inward, so that any
importer joins them; our annotation names all junctions, also those of several ports, which connections cannot say.

The file beside a unit that tells its ports, written: what `phfmu.fmu.importer.ports.port_tables` reads.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from math import copysign, isclose
from pathlib import Path

from phfmu.declare.expressions.units import UnitError, parse_unit, unit_text
from phfmu.declare.port import Given, conjugate
from phfmu.fmu.export.description import generation_date, generation_tool
from phfmu.fmu.export.manifest import PortMap
from phfmu.fmu.export.package import write
from phfmu.fmu.importer.ports.port_tables import ENDING
from phfmu.fmu.importer.unit_file import UnitFile
from phfmu.fmu.importer.unit_interface import Scalar
from phfmu.fmu.words import plain
from phfmu.fmu.xml import Element, etree, number, text_of
from phfmu.network.junction import Junction
from phfmu.network.network import Network
from phfmu.network.wires import Wire
from phfmu.ssp.bonds import joins_plainly
from phfmu.ssp.names import DRAFT, NAMESPACES, PORTS, ROOTS, STRUCTURE, tag
from phfmu.ssp.round_trip import CONNECTION, CONNECTOR, META, VERBATIM, RoundTripContent
from phfmu.ssp.terminals import one_connection, write_connectors, write_terminals
from phfmu.ssp.units import write_units


def sidecar_text(ports: Iterable[PortMap]) -> str:
    """TOML with a table per port."""
    return "\n".join(_table(p) for p in ports)


def _scaled(unit: str, factor: float) -> str:
    """`factor` times a unit as a text, e.g. kN; empty where there is none: the unit's own definitions tell it then."""
    known = parse_unit(unit)
    text = unit_text(known.without_angle(), factor * known.factor)
    try:
        parse_unit(text)
    except UnitError:
        return ""
    return text


def _table(p: PortMap) -> str:
    effort, flow = (p.inputs, p.outputs) if p.given == "effort" else (p.outputs, p.inputs)
    told = {"effort": effort, "flow": flow, "displacement": p.displacements}
    # text and lists of text are written alike in JSON and TOML; without a list a port is a scalar
    lines = [f"{k} = {json.dumps(v if p.vector or len(v) > 1 else ''.join(v))}" for k, v in told.items() if v]
    factors: dict[Given, float] = {p.given: p.input_factor, conjugate(p.given): p.output_factor}
    for member, factor in factors.items():
        if factor != 1.0 and (text := _scaled(p.domain.unit(member), factor)):
            lines.append(f"{member}_unit = {json.dumps(text)}")
    domain = ", ".join(f"{k} = {json.dumps(v)}" for k, v in asdict(p.domain).items())
    return "\n".join([f"[{p.name}]", *lines, f"sign = {int(p.sign)}", f"domain = {{ {domain} }}", ""])


#: name of all parameter sets: some importers apply one set by its name
VALUES = "parameters"
#: types of variables -> types of SSP 1.0
_TYPES = {"Float64": "Real", "Float32": "Real", "Boolean": "Boolean", "Enumeration": "Integer"}
_KINDS = ("input", "output", "parameter")


@dataclass(frozen=True)
class Contents:
    """A network whose members are all units, and its run; `version`: of SSP; `kept`: what its description says besides.

    Times in s.
    """

    network: Network
    stop: float
    step: float
    version: str = "1.0"
    kept: RoundTripContent = RoundTripContent()


def write_package(path: Path, contents: Contents) -> list[str]:
    """The archive; lines about junctions and signals that other tools will not see."""
    units = contents.network.units
    files = {**contents.kept.files, STRUCTURE: structure(contents)}
    for name, unit in units.items():
        files[f"resources/{name}.fmu"] = unit.path.read_bytes()
        if unit.port_maps != unit.interface.ports:
            files[f"resources/{name}{ENDING}"] = sidecar_text(unit.port_maps).encode()
        if values := values_before(unit):
            files[f"resources/{name}.ssv"] = parameter_set(values, unit, min(contents.version, "2.0"))
    write(path, files)
    hidden = [f"signal {w}" for w in contents.network.wires if not _is_output(units, w)]
    hidden += [
        f"junction {j.name} ({', '.join(map(str, j.ends))})"
        for j in contents.network.junctions
        if not joins_plainly([contents.network.port_of(e).given for e in j.ends])
    ]
    return [
        f"{what}: only in the annotation {PORTS}, which other tools do not read; plain connections cannot say it"
        for what in hidden
    ]


def structure(contents: Contents) -> bytes:
    """SystemStructure.ssd."""
    network, units, kept = contents.network, contents.network.units, contents.kept
    root = _root("ssd", contents.version, name=network.name)
    kept.root.onto(root)
    system = etree.SubElement(root, tag("ssd", "System"), name=network.name)
    if network.description:
        system.set("description", plain(network.description))
    kept.system.onto(system, "ElementGeometry", META)
    elements = etree.SubElement(system, tag("ssd", "Elements"))
    for name, unit in units.items():
        _component(elements, name, unit, contents)
    links = [link for j in network.junctions for link in _connections(contents, j)]
    links += [w for w in network.wires if _is_output(units, w)]
    if links:
        listed = etree.SubElement(system, tag("ssd", "Connections"))
        for w in links:
            ends = {"startElement": w.source, "startConnector": w.output}
            ends |= {"endElement": w.target, "endConnector": w.input}
            connection = etree.SubElement(listed, tag("ssd", "Connection"), ends)
            if told := _linear(w):
                etree.SubElement(connection, tag("ssc", "LinearTransformation"), told)
            kept.connection((w.source, w.output, w.target, w.input)).onto(connection, *CONNECTION)
    kept.system.onto(system, "SystemGeometry", "GraphicalElements")
    _annotate(system, contents)
    kept.root.onto(root, "Enumerations")
    used = {v.unit: u.interface.units[v.unit] for u in units.values() for v in _connected(u) if _told(u, v)}
    write_units(root, "ssd", used)
    listed = root.find(tag("ssd", "Units"))
    if more := kept.more_units(listed):
        (etree.SubElement(root, tag("ssd", "Units")) if listed is None else listed).extend(more)
    if contents.version == DRAFT:
        write_terminals(root, units)
    experiment = {"startTime": number(0.0), "stopTime": number(contents.stop)}
    etree.SubElement(root, tag("ssd", "DefaultExperiment"), experiment)
    kept.root.onto(root, META, "Annotations")
    return text_of(root, *VERBATIM)


def parameter_set(values: Mapping[str, float], unit: UnitFile, version: str) -> bytes:
    """An .ssv with values before the start."""
    root = _root("ssv", version, name=VALUES)
    listed = etree.SubElement(root, tag("ssv", "Parameters"))
    for name, value in values.items():
        element = etree.SubElement(etree.SubElement(listed, tag("ssv", "Parameter"), name=name), tag("ssv", "Real"))
        element.set("value", number(value))
        variable = unit.interface.variables[name]
        if _told(unit, variable):
            element.set("unit", variable.unit)
    used = [unit.interface.variables[n] for n in values]
    write_units(root, "ssv", {v.unit: unit.interface.units[v.unit] for v in used if _told(unit, v)})
    return text_of(root)


def _is_output(units: Mapping[str, UnitFile], wire: Wire) -> bool:
    """True if a signal begins at an output, as connections do."""
    return units[wire.source].interface.variables[wire.output].causality == "output"


def _linear(wire: Wire) -> dict[str, str]:
    """Attributes of the transformation, those that are not usual."""
    told = {"factor": (wire.factor, 1.0), "offset": (wire.offset, 0.0)}
    return {name: number(value) for name, (value, usual) in told.items() if value != usual}


def _connections(contents: Contents, junction: Junction) -> list[Wire]:
    """The connections of a junction: of variables, or one of terminals where that says the same."""
    network, links = contents.network, list(_links(contents.network, junction))
    if contents.version == DRAFT and links:
        one, other = (_map(network, e.member, e.port) for e in junction.ends)
        if (whole := one_connection(links, (one, other))) is not None:
            return [whole]
    return links


def _links(network: Network, junction: Junction) -> Iterator[Wire]:
    """The connections of a junction, both ways, entry by entry."""
    if not joins_plainly([network.port_of(e).given for e in junction.ends]):
        return
    (a, pa), (b, pb) = ((e.member, _map(network, e.member, e.port)) for e in junction.ends)
    for one, p, other, q in ((a, pa, b, pb), (b, pb, a, pa)):
        turns = q.given != junction.shared
        factor = (-1.0 if turns else 1.0) * p.output_sign / q.input_sign
        for out, into in zip(p.outputs, q.inputs, strict=True):
            converted = _converted(network.units[one], out, network.units[other], into)
            yield Wire(one, out, other, into, _tidy(factor / converted))


def _converted(a: UnitFile, output: str, b: UnitFile, name: str) -> float:
    """The conversion of a value by the units of two connectors, without any transformation."""
    ends = [(u, u.interface.variables[n]) for u, n in ((a, output), (b, name))]
    if not all(_told(u, v) for u, v in ends):
        return 1.0
    one, other = (u.interface.units[v.unit].factor for u, v in ends)
    return one / other


def _tidy(factor: float) -> float:
    """Without the rounding of units that cancel."""
    return copysign(1.0, factor) if isclose(abs(factor), 1.0, rel_tol=1e-12) else factor


def _map(network: Network, member: str, port: str) -> PortMap:
    return next(p for p in network.units[member].port_maps if p.name == port)


def _root(kind: str, version: str, **attributes: str) -> Element:
    used = {k: v for k, v in NAMESPACES.items() if k in (kind, "ssc")}
    root = etree.Element(tag(kind, ROOTS[kind]), nsmap=used, version=version, **attributes)
    root.set("generationTool", generation_tool())
    if date := generation_date():
        root.set("generationDateAndTime", date)
    return root


def _component(parent: Element, name: str, unit: UnitFile, contents: Contents) -> None:
    component = etree.SubElement(parent, tag("ssd", "Component"), name=name, source=f"resources/{name}.fmu")
    kept, version = contents.kept, contents.version
    kept.component(name).onto(component)
    if unit.description and "description" not in component.attrib:
        component.set("description", plain(unit.description))
    listed = etree.SubElement(component, tag("ssd", "Connectors"))
    for v in _connected(unit):
        connector = etree.SubElement(listed, tag("ssd", "Connector"), name=v.name, kind=v.causality)
        part = kept.connector(name, v.name)
        own = v.type if unit.interface.version != "2.0" and version != "1.0" else _TYPES.get(v.type, "Integer")
        if part.enumeration:
            etree.SubElement(connector, tag("ssc", "Enumeration"), name=part.enumeration)
            part.onto(connector, *CONNECTOR)
            continue
        type_ = etree.SubElement(connector, tag("ssc", own))
        if _told(unit, v) and own in ("Real", "Float64", "Float32"):
            type_.set("unit", v.unit)
        part.onto(connector, *CONNECTOR)
    if version == DRAFT:
        for own, connector in write_connectors(listed, unit):
            kept.connector(name, own).onto(connector, *CONNECTOR)
    kept.component(name).onto(component, "ElementGeometry")
    if values_before(unit):
        bindings = etree.SubElement(component, tag("ssd", "ParameterBindings"))
        etree.SubElement(bindings, tag("ssd", "ParameterBinding"), source=f"resources/{name}.ssv")
    kept.component(name).onto(component, META, "Annotations")


def _told(unit: UnitFile, v: Scalar) -> bool:
    """True if the unit of a variable is one, and defined."""
    return v.unit != "1" and v.unit in unit.interface.units


def _connected(unit: UnitFile) -> list[Scalar]:
    """The variables that become connectors."""
    return [v for v in unit.interface.variables.values() if v.causality in _KINDS]


def values_before(unit: UnitFile) -> dict[str, float]:
    """Values of a unit before its start: parameters, and what else was set before the start."""
    variables = unit.interface.variables
    own = {n: v.start for n, v in variables.items() if v.causality == "parameter" and v.start is not None}
    return own | dict(unit.starts)


def _annotate(system: Element, contents: Contents) -> None:
    listed = etree.SubElement(system, tag("ssd", "Annotations"))
    annotation = etree.SubElement(listed, tag("ssc", "Annotation"), type=PORTS)
    network = etree.SubElement(annotation, f"{{{PORTS}}}Network", nsmap={"ports": PORTS}, step=number(contents.step))
    for j in contents.network.junctions:
        junction = etree.SubElement(network, f"{{{PORTS}}}Junction", name=j.name, kind=j.kind)
        for e in j.ends:
            etree.SubElement(junction, f"{{{PORTS}}}End", element=e.member, port=e.port)
    for w in contents.network.wires:
        if not _is_output(contents.network.units, w):
            ends = {"source": w.source, "output": w.output, "target": w.target, "input": w.input}
            etree.SubElement(network, f"{{{PORTS}}}Signal", ends | _linear(w))
    listed.extend(contents.kept.annotations())
