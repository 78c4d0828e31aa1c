"""Reading a System Structure Description with the parameter files it names."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import isfinite, prod
from pathlib import Path

from phfmu.fmu import limits
from phfmu.fmu.export.variables import FMUError
from phfmu.fmu.words import plain
from phfmu.fmu.xml import Element, parse
from phfmu.ssp.names import DEFINITION, DICTIONARY, FMU, NAMESPACES, PACKAGE, PORTS, tag
from phfmu.ssp.package import Package, Within, open_package
from phfmu.ssp.parameters import Source, bindings, document
from phfmu.ssp.round_trip import round_trip_content
from phfmu.ssp.schema import require_valid
from phfmu.ssp.structure import (
    AnnotatedJunction,
    AnnotatedSignal,
    Component,
    Connection,
    Connector,
    Linear,
    Reference,
    SSPError,
    SSPSystem,
    Structure,
    Unit,
    entries,
)
from phfmu.ssp.terminals import KIND as TERMINAL
from phfmu.ssp.terminals import Terminal, of_members, read_terminals, type_of
from phfmu.ssp.units import read_units
from phfmu.words import meant

#: elements of a connection that are not read
_MAPPINGS = ("BooleanMappingTransformation", "IntegerMappingTransformation", "EnumerationMappingTransformation")
TRUE = ("true", "1")
DEEPEST = 10  # descriptions within each other


def read_structure(path: str | Path, lenient: bool = False) -> Structure:
    """The structure of a .ssp or .ssd, checked against its schema.  SSPError, FMUError say what is wrong.

    `lenient`: units of measurement that it does not define count as not told, which is noted.
    """
    package = open_package(path)
    where = f"{package.path}/{package.structure}" if package.path.name != package.structure else str(package.path)
    return _read(package, where, [], 0, lenient)


def _read(package: Package, where: str, notes: list[str], depth: int, lenient: bool) -> Structure:
    root = parse(package.read(package.structure), where)
    unchecked = require_valid(root, "ssd", where)
    if unchecked and unchecked not in notes:
        notes.append(unchecked)
    try:
        return _Reader(Source(package, where, notes, lenient=lenient), depth).structure(root)
    except (AttributeError, LookupError, TypeError, ValueError) as error:
        if not unchecked or isinstance(error, SSPError | FMUError):
            raise
        raise SSPError(
            f"{where}: not a description of SSP {root.get('version')}; its schemas tell where: pip install phfmu[ssp]"
        ) from error


class _Reader:
    """Reader of tags into data; what lxml's schema checks is not checked again.  `depth`: descriptions around this one."""

    def __init__(self, source: Source, depth: int):
        self.source, self.where, self.depth = source, source.where, depth
        self.units: dict[str, Unit] = {}
        self.types: dict[str, Terminal] = {}

    def structure(self, root: Element) -> Structure:
        system = root.find(tag("ssd", "System"))
        self.units = read_units(root, "ssd")
        self.types = read_terminals(root, self.where)
        experiment = root.find(tag("ssd", "DefaultExperiment"))
        times = {} if experiment is None else experiment.attrib
        step = next((e.get("step") for e in _annotations(system, "Network") if e.get("step")), None)
        return Structure(
            root.get("version", ""),
            plain(root.get("name", "")),
            self.system(system),
            self.units,
            self._number(times.get("startTime", "0"), "startTime"),
            self._number(times["stopTime"], "stopTime") if "stopTime" in times else None,
            None if step is None else self._number(step, "step"),
            tuple(self.source.notes),
            round_trip_content(root, self.source),
            self.source.lenient,
        )

    def system(self, element: Element) -> SSPSystem:
        name = plain(element.get("name", ""))
        elements: dict[str, Component | SSPSystem | Reference] = {}
        for child in _children(element, "Elements"):
            if child.tag == tag("ssd", "System"):
                new: Component | SSPSystem | Reference = self.system(child)
            elif child.tag == tag("ssd", "Component"):
                new = self.component(child)
            elif child.tag != tag("ssd", "SignalDictionaryReference"):
                raise SSPError(f"{self.where}: the system '{name}' has an element '{plain(str(child.tag), 200)}'")
            else:
                called = plain(child.get("name", ""))
                new = Reference(called, plain(child.get("dictionary", "")), *self.connectors(child, called))
            if new.name in elements:
                raise SSPError(f"{self.where}: two elements of the system '{name}' are called '{new.name}'")
            elements[new.name] = new
        connectors, arrays = self.connectors(element, name)
        return SSPSystem(
            name,
            elements,
            tuple(self.connections(element)),
            connectors,
            bindings(element, self.source),
            tuple(self.joint(j) for n in _annotations(element, "Network") for j in n.findall(f"{{{PORTS}}}Junction")),
            tuple(self.signal(s) for n in _annotations(element, "Network") for s in n.findall(f"{{{PORTS}}}Signal")),
            plain(element.get("description", "")),
            arrays,
            {plain(d.get("name", "")): self.entries(d) for d in _children(element, "SignalDictionaries")},
        )

    def entries(self, element: Element) -> tuple[str, ...]:
        """Names of the entries of a signal dictionary."""
        root, _ = document(element, None, "ssb", DICTIONARY, self.source)
        return tuple(plain(e.get("name", "")) for e in root.findall(tag("ssb", "DictionaryEntry")))

    def component(self, element: Element) -> Component | SSPSystem:
        name, kind, source = plain(element.get("name", "")), element.get("type", FMU), element.get("source", "")
        if kind in (PACKAGE, DEFINITION) and source:
            return self.nested(element, name, kind, source)
        if kind != FMU or not source or element.get("implementation", "any") not in ("any", "CoSimulation"):
            what = element.get("implementation") if kind == FMU and source else kind if source else "without a source"
            raise SSPError(
                f"{self.where}: component '{name}' is {plain(str(what))}; this reads FMUs for Co-Simulation ({FMU}), "
                f"descriptions ({DEFINITION}) and packages ({PACKAGE})"
            )
        connectors, arrays = self.connectors(element, name)
        bound = bindings(element, replace(self.source, component=source))
        files = self.source.package
        return Component(name, source, files, connectors, bound, plain(element.get("description", "")), arrays)

    def nested(self, element: Element, name: str, kind: str, source: str) -> SSPSystem:
        """The system of another description, whose connectors the component has; what the component binds counts more."""
        if self.depth >= DEEPEST:
            raise SSPError(
                f"{self.where}: '{name}' would be {self.depth + 1} packages deep; at most {DEEPEST} are read"
            )
        uri, _, chosen = source.partition("#")
        package = self.source.package
        if not uri:
            raise SSPError(
                f"{self.where}: '{name}' refers to '{plain(source, 200)}' of its own document; nest the system"
            )
        inner = Within(package, uri) if kind == DEFINITION else open_package(package.file(uri))
        if kind == PACKAGE and chosen:
            inner = Within(inner, chosen)
        where = f"{package.path}/{plain(source, 200)}"
        found = _read(inner, where, self.source.notes, self.depth + 1, self.source.lenient)
        for unit in found.units.values():
            if self.units.setdefault(unit.name, unit) != unit:
                raise SSPError(
                    f"{self.where} and {plain(source, 200)} define the unit '{unit.name}' differently; rename one"
                )
        for c in self.connectors(element, name)[0]:
            if c not in found.system.connectors:
                known = found.system.connectors
                raise SSPError(f"{self.where}: '{name}' has no connector '{plain(c, 200)}'; {meant(c, known)}")
        bound = (*found.system.bindings, *bindings(element, self.source))
        return replace(found.system, name=name, bindings=bound)

    def connectors(self, element: Element, owner: str) -> tuple[dict[str, Connector], dict[str, tuple[int, ...]]]:
        """Connectors of an element, of arrays their entries; and the sizes of the arrays."""
        found: dict[str, Connector] = {}
        arrays: dict[str, tuple[int, ...]] = {}
        for c in _children(element, "Connectors"):
            name = plain(c.get("name", ""))
            if name in found or name in arrays:
                raise SSPError(f"{self.where}: '{owner}' has two connectors '{name}'")
            own = [e for e in c if e.tag.startswith(f"{{{NAMESPACES['ssc']}}}")]
            types = [e for e in own if e.tag not in (tag("ssc", "Clock"), tag("ssc", "Dimension"))]
            kind = types[0].tag.rpartition("}")[2] if types else "Real"
            unit = types[0].get("unit", "") if types else ""
            sizes = [e.get("size") for e in own if e.tag == tag("ssc", "Dimension")]
            if sizes:
                arrays[name] = self.shape(f"{owner}.{name}", sizes)
            for entry in entries(name, arrays.get(name, ())):
                found[entry] = Connector(entry, c.get("kind", ""), kind, unit)
        return found, arrays

    def shape(self, name: str, sizes: Sequence[str | None]) -> tuple[int, ...]:
        if None in sizes:
            raise SSPError(
                f"{self.where}: the connector '{name}' is an array of unknown size; give each Dimension a size"
            )
        shape = tuple(int(size or 0) for size in sizes)
        limits.within(self.where, prod(shape), limits.VARIABLES, f"entries of the connector '{plain(name, 200)}'")
        return shape

    def connections(self, system: Element) -> Iterator[Connection]:
        """Connections of a system, with those of terminals resolved into those of their members."""
        owners = {"": system} | {plain(e.get("name", "")): e for e in _children(system, "Elements")}
        terminals = {
            (owner, name): type_of(c, self.types, f"{self.where}: '{owner or plain(system.get('name', ''))}.{name}'")
            for owner, e in owners.items()
            for c in _children(e, "Connectors")
            if c.get("kind") == TERMINAL and (name := plain(c.get("name", "")))
        }
        for c in map(self.connection, _children(system, "Connections")):
            one, other = (terminals.get(end) for end in c.ends)
            yield from of_members(c, (one, other), self.where)

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
        start, end = (
            (e, f"{c}[{','.join(chosen)}]" if (chosen := plain(element.get(f"{side}Indices", "")).split()) else c)
            for side, (e, c) in (("start", start), ("end", end))
        )
        return Connection(*start, *end, linear, element.get("suppressUnitConversion", "") in TRUE)

    def joint(self, element: Element) -> AnnotatedJunction:
        ends = tuple((plain(e.get("element", "")), plain(e.get("port", ""))) for e in element)
        name, kind = plain(element.get("name", "")), element.get("kind", "")
        if kind not in ("0", "1") or len(ends) < 2 or not name:
            raise SSPError(f"{self.where}: the annotation {PORTS} has a junction '{name}' of kind '{plain(kind)}' with "
                           f"{len(ends)} ends; expected a name, kind 0 or 1, and two ends at least")  # fmt: skip
        return AnnotatedJunction(name, kind, ends)

    def signal(self, element: Element) -> AnnotatedSignal:
        names = [plain(element.get(k, "")) for k in ("source", "output", "target", "input")]
        linear = Linear(*(self._number(element.get(k, d), k) for k, d in (("factor", "1"), ("offset", "0"))))
        return AnnotatedSignal((names[0], names[1]), (names[2], names[3]), linear)

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
