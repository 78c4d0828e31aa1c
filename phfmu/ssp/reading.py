"""Reading a System Structure Description with the parameter files it names."""

from __future__ import annotations

from collections.abc import Iterator
from math import isfinite
from pathlib import Path

from phfmu.fmu.words import plain
from phfmu.fmu.xml import Element, parse
from phfmu.ssp.names import FMU, NAMESPACES, PORTS, tag
from phfmu.ssp.package import Package, open_package
from phfmu.ssp.parameters import Source, bindings
from phfmu.ssp.schema import require_valid
from phfmu.ssp.structure import (
    Component,
    Connection,
    Connector,
    Joint,
    Linear,
    Signal,
    SSPError,
    Structure,
    System,
)
from phfmu.ssp.units import read_units

#: elements of a connection that are not read
_MAPPINGS = ("BooleanMappingTransformation", "IntegerMappingTransformation", "EnumerationMappingTransformation")
TRUE = ("true", "1")


def read_structure(path: str | Path) -> tuple[Structure, Package]:
    """The structure of a .ssp or .ssd, checked against its schema.  SSPError, FMUError say what is wrong."""
    package = open_package(path)
    where = f"{package.path}/{package.structure}" if package.path.name != package.structure else str(package.path)
    root = parse(package.read(package.structure), where)
    require_valid(root, "ssd", where)
    return _Reader(Source(package, where, [])).structure(root), package


class _Reader:
    """From tags to data; what lxml's schema checks is not checked again."""

    def __init__(self, source: Source):
        self.source, self.where = source, source.where

    def structure(self, root: Element) -> Structure:
        system = root.find(tag("ssd", "System"))
        experiment = root.find(tag("ssd", "DefaultExperiment"))
        times = {} if experiment is None else experiment.attrib
        step = next((e.get("step") for e in _annotations(system, "Network") if e.get("step")), None)
        return Structure(
            root.get("version", ""),
            plain(root.get("name", "")),
            self.system(system),
            read_units(root, "ssd"),
            self._number(times.get("startTime", "0"), "startTime"),
            self._number(times["stopTime"], "stopTime") if "stopTime" in times else None,
            None if step is None else self._number(step, "step"),
            tuple(self.source.notes),
        )

    def system(self, element: Element) -> System:
        name = plain(element.get("name", ""))
        elements: dict[str, Component | System] = {}
        for child in _children(element, "Elements"):
            if child.tag == tag("ssd", "System"):
                new: Component | System = self.system(child)
            elif child.tag == tag("ssd", "Component"):
                new = self.component(child)
            else:
                raise SSPError(
                    f"{self.where}: '{plain(child.get('name', ''))}' is a signal dictionary, which is not read; connect its "
                    "signals directly"
                )
            if new.name in elements:
                raise SSPError(f"{self.where}: two elements of the system '{name}' are called '{new.name}'")
            elements[new.name] = new
        return System(
            name,
            elements,
            tuple(self.connection(c) for c in _children(element, "Connections")),
            self.connectors(element, name),
            bindings(element, self.source),
            tuple(self.joint(j) for n in _annotations(element, "Network") for j in n.findall(f"{{{PORTS}}}Junction")),
            tuple(self.signal(s) for n in _annotations(element, "Network") for s in n.findall(f"{{{PORTS}}}Signal")),
            plain(element.get("description", "")),
        )

    def component(self, element: Element) -> Component:
        name, kind, source = plain(element.get("name", "")), element.get("type", FMU), element.get("source", "")
        if kind != FMU or not source or element.get("implementation", "any") not in ("any", "CoSimulation"):
            what = element.get("implementation") if kind == FMU and source else kind if source else "without a source"
            raise SSPError(
                f"{self.where}: component '{name}' is {plain(str(what))}; this reads FMUs for Co-Simulation ({FMU}). Nest "
                "systems in one description instead of packages in packages"
            )
        return Component(
            name,
            source,
            self.connectors(element, name),
            bindings(element, self.source),
            plain(element.get("description", "")),
        )

    def connectors(self, element: Element, owner: str) -> dict[str, Connector]:
        found: dict[str, Connector] = {}
        for c in _children(element, "Connectors"):
            name = plain(c.get("name", ""))
            if name in found:
                raise SSPError(f"{self.where}: '{owner}' has two connectors '{name}'")
            types = [e for e in c if e.tag.startswith(f"{{{NAMESPACES['ssc']}}}")]
            if types and types[0].tag == tag("ssc", "Clock"):
                types = types[1:]
            if any(e.tag == tag("ssc", "Dimension") for e in types):
                raise SSPError(
                    f"{self.where}: the connector '{owner}.{name}' is an array; connect its entries, '{name}[1]'"
                )
            kind = types[0].tag.rpartition("}")[2] if types else "Real"
            found[name] = Connector(name, c.get("kind", ""), kind, types[0].get("unit", "") if types else "")
        return found

    def connection(self, element: Element) -> Connection:
        start = plain(element.get("startElement", "")), plain(element.get("startConnector", ""))
        end = plain(element.get("endElement", "")), plain(element.get("endConnector", ""))
        where = f"{self.where}: the connection {'.'.join(filter(None, start))} - {'.'.join(filter(None, end))}"
        linear = Linear()
        for e in element:
            name = e.tag.rpartition("}")[2]
            if name in _MAPPINGS:
                raise SSPError(f"{where} has a {name}, which is not read; use a linear one")
            if name == "LinearTransformation":
                linear = Linear(*(self._number(e.get(k, d), k) for k, d in (("factor", "1"), ("offset", "0"))))
        if element.get("startIndices") or element.get("endIndices"):
            raise SSPError(f"{where} has indices; connect entries, '{start[1]}[1]'")
        return Connection(*start, *end, linear, element.get("suppressUnitConversion", "") in TRUE)

    def joint(self, element: Element) -> Joint:
        ends = tuple((plain(e.get("element", "")), plain(e.get("port", ""))) for e in element)
        name, kind = plain(element.get("name", "")), element.get("kind", "")
        if kind not in ("0", "1") or len(ends) < 2 or not name:
            raise SSPError(f"{self.where}: the annotation {PORTS} has a junction '{name}' of kind '{plain(kind)}' with "
                           f"{len(ends)} ends; expected a name, kind 0 or 1, and two ends at least")  # fmt: skip
        return Joint(name, kind, ends)

    def signal(self, element: Element) -> Signal:
        names = [plain(element.get(k, "")) for k in ("source", "output", "target", "input")]
        linear = Linear(*(self._number(element.get(k, d), k) for k, d in (("factor", "1"), ("offset", "0"))))
        return Signal((names[0], names[1]), (names[2], names[3]), linear)

    def _number(self, text: str, what: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not isfinite(value):
            raise SSPError(f"{self.where}: {what} = '{plain(text, 100)}' is no finite number")
        return value


def _children(element: Element, name: str) -> Iterator[Element]:
    found = element.find(tag("ssd", name))
    return iter(() if found is None else found)


def _annotations(element: Element, name: str) -> list[Element]:
    """Elements of our annotation of a system."""
    listed = element.find(tag("ssd", "Annotations"))
    own = [a for a in (() if listed is None else listed) if a.get("type") == PORTS]
    return [e for a in own for e in a if e.tag == f"{{{PORTS}}}{name}"]
