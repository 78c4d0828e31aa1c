"""A structure without its systems: units by name, their values before the start, and links between their variables.

Connections through connectors of systems are followed to the end; conversions of units and transformations on the way become
one linear map.  Values at connectors of systems are handed on to what they are connected with.

Connectors of elements, as the system around them sees them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

from phfmu.fmu.words import plain
from phfmu.ssp.structure import (
    SINKS,
    SOURCES,
    AnnotatedJunction,
    Binding,
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
from phfmu.ssp.units import conversion, named
from phfmu.words import meant

#: names of elements from the outermost system down to an element
Path = tuple[str, ...]
#: kind of the connectors of a signal dictionary
INOUT = "inout"


@dataclass(frozen=True)
class ElementConnector:
    """A connector of an element, as the system around it sees it: whether it gives or takes a value there."""

    path: Path
    connector: Connector
    inside: bool

    @property
    def gives(self) -> bool | None:
        """None: of a signal dictionary, which does both."""
        if self.connector.kind == INOUT:
            return None
        return self.connector.kind in (SINKS if self.inside else SOURCES)

    def __str__(self) -> str:
        return ".".join((*self.path, self.connector.name))


def connector_of(element: Component | SSPSystem | Reference, name: str, where: str) -> Connector:
    """The connector `name` of an element, called `where` in messages; SSPError if there is none, or its direction is open."""
    found = element.connectors.get(name)
    if found is None:
        raise SSPError(f"'{where}' has no connector '{plain(name, 200)}'; {meant(name, element.connectors)}")
    if found.kind not in (*SINKS, *SOURCES) and not (isinstance(element, Reference) and found.kind == INOUT):
        raise SSPError(
            f"'{where}.{name}' is of the kind '{plain(found.kind, 50)}', whose direction is open; say input or output"
        )
    return found


@dataclass(frozen=True)
class VariableLink:
    """A link from an output of one unit to an input of another: input = linear(output); `terminal`: of terminals all the way."""

    source: str
    output: str
    target: str
    input: str
    linear: Linear
    terminal: bool = False

    def __str__(self) -> str:
        factor = "" if self.linear == Linear() else f" (times {self.linear.factor:g}, plus {self.linear.offset:g})"
        return f"{self.source}.{self.output} -> {self.target}.{self.input}{factor}"


@dataclass(frozen=True)
class StartValue:
    """The value of a variable before the start, in `unit` (None: in that of the variable)."""

    value: float
    unit: Unit | None


@dataclass(frozen=True)
class FlatStructure:
    """Units by the name of their member; `values`: member -> variable -> value; `joints`: ends are (member, port)."""

    units: dict[str, Component]
    links: list[VariableLink]
    values: dict[str, dict[str, StartValue]] = field(default_factory=dict)
    joints: tuple[AnnotatedJunction, ...] = ()


def flat(structure: Structure) -> FlatStructure:
    """SSPError names elements and connectors that there are not, inputs that are fed twice, units that do not fit."""
    return _Flattening(structure).result()


class _Flattening:
    def __init__(self, structure: Structure):
        self.structure = structure
        self.components = dict(_components(structure.system, ()))
        self.names = _members(self.components)
        self.dictionaries = dict(_dictionaries(structure.system, ()))
        #: what feeds a connector: (path, name) -> (path, name), the map, and whether it is a connection of terminals
        self.fed: dict[tuple[Path, str], tuple[tuple[Path, str], Linear, bool]] = {}
        self.values: dict[tuple[Path, str], StartValue] = {}

    def result(self) -> FlatStructure:
        self._connect(self.structure.system, ())
        self._bind(self.structure.system, ())
        links = []
        for path, name in list(self.fed):
            if path in self.names:
                links += self._followed(path, name)
        values: dict[str, dict[str, StartValue]] = {}
        for (path, name), value in self.values.items():
            if path in self.names:
                values.setdefault(self.names[path], {})[name] = value
        units = {self.names[p]: c for p, c in self.components.items()}
        links += self._signals(self.structure.system, ())
        return FlatStructure(units, links, values, tuple(self._joints(self.structure.system, ())))

    # -- connections --------------------------------------------------------------------------------------------------

    def _connect(self, system: SSPSystem, path: Path) -> None:
        for c in (one for whole in system.connections for one in self._entries(system, path, whole)):
            a, b = (self._place(system, path, e, n) for e, n in c.ends)
            if a.gives == b.gives:
                both = (
                    "are entries of dictionaries" if a.gives is None else "give a value" if a.gives else "take a value"
                )
                raise SSPError(f"connection {a} - {b}: both {both} ({a.connector.kind}, {b.connector.kind})")
            source, target = (a, b) if a.gives or b.gives is False else (b, a)
            key = (target.path, target.connector.name)
            if key in self.fed:
                other, name = self.fed[key][0]
                raise SSPError(f"{target} is fed twice: by {'.'.join((*other, name))} and by {source}")
            self.fed[key] = ((source.path, source.connector.name), self._linear(c, source, target), c.terminal)
        for name, element in system.elements.items():
            if isinstance(element, SSPSystem):
                self._connect(element, (*path, name))

    def _entries(self, system: SSPSystem, path: Path, c: Connection) -> Iterator[Connection]:
        """The connection, or those of the entries of two arrays."""
        shapes = []
        for element, name in c.ends:
            owner = system if not element else system.elements.get(element)
            shapes.append(() if owner is None else owner.arrays.get(name, ()))
        if shapes[0] != shapes[1]:
            sizes = " and ".join("a scalar" if not s else f"an array of {' x '.join(map(str, s))}" for s in shapes)
            ends = " - ".join(".".join((*path, *filter(None, end))) for end in c.ends)
            raise SSPError(f"connection {ends}: joins {sizes}; connect entries by startIndices and endIndices")
        for a, b in zip(*(entries(n, s) for (_, n), s in zip(c.ends, shapes, strict=True)), strict=True):
            yield replace(c, start_connector=a, end_connector=b)

    def _place(self, system: SSPSystem, path: Path, element: str, name: str) -> ElementConnector:
        if not element:
            return ElementConnector(path, connector_of(system, name, ".".join(path) or system.name), True)
        if element not in system.elements:
            where = ".".join(path) or system.name
            raise SSPError(
                f"a connection of '{where}' names the element '{element}'; {meant(element, system.elements)}"
            )
        found, where = system.elements[element], ".".join((*path, element))
        if isinstance(found, Reference):
            return self._entry(found, path, name, where)
        return ElementConnector((*path, element), connector_of(found, name, where), False)

    def _entry(self, reference: Reference, path: Path, name: str, where: str) -> ElementConnector:
        """An entry of the dictionary of that name in this system, or in the nearest around it."""
        scopes = [
            s for s in (path[:n] for n in range(len(path), -1, -1)) if reference.dictionary in self.dictionaries[s]
        ]
        if not scopes:
            raise SSPError(
                f"'{where}' refers to the signal dictionary '{reference.dictionary}', which no system around it has"
            )
        entries = self.dictionaries[scopes[0]][reference.dictionary]
        if name not in entries:
            raise SSPError(
                f"the signal dictionary '{reference.dictionary}' has no entry '{name}'; {meant(name, entries)}"
            )
        return ElementConnector(
            (*scopes[0], f"dictionary {reference.dictionary}"), connector_of(reference, name, where), False
        )

    def _linear(self, c: Connection, source: ElementConnector, target: ElementConnector) -> Linear:
        """The transformation, after the conversion of units unless it stands for that."""
        a, b = (self._unit(p.connector) for p in (source, target))
        if c.suppress:
            return c.transformation
        return conversion(a, b, f"connection {source} -> {target}").then(c.transformation)

    def _unit(self, connector: Connector) -> Unit | None:
        known = self.structure.units.get(connector.unit)
        return known if known is not None else named(connector.unit)

    def _followed(self, path: Path, name: str) -> Iterator[VariableLink]:
        """The link that ends at a variable of a unit; none where it begins at a connector of a system that nothing feeds."""
        at, linear, terminal, seen = (path, name), Linear(), True, set[tuple[Path, str]]()
        while at in self.fed:
            if at in seen:
                raise SSPError(f"connections go round in a circle at {'.'.join((*at[0], at[1]))}")
            seen.add(at)
            at, step, of_terminals = self.fed[at]
            linear, terminal = step.then(linear), terminal and of_terminals
            if at[0] in self.names:
                yield VariableLink(self.names[at[0]], at[1], self.names[path], name, linear, terminal)
                return
        if at in self.values:
            given = self.values[at]
            self.values[path, name] = StartValue(linear(given.value), None)

    # -- values -------------------------------------------------------------------------------------------------------

    def _bind(self, system: SSPSystem, path: Path) -> None:
        """Bind values: outer systems override inner ones, and of one element the last binding counts."""
        for name, element in system.elements.items():
            if isinstance(element, SSPSystem):
                self._bind(element, (*path, name))
            elif isinstance(element, Component):
                for key, value in bound(element.bindings).items():
                    self.values[(*path, name), key] = value
        for key, value in bound(system.bindings).items():
            for place, connector in _named_by(system, path, key):
                self.values[place] = value if connector is None else self._at(value, connector)

    def _at(self, value: StartValue, connector: Connector) -> StartValue:
        """The value in the unit of a connector of a system."""
        linear = conversion(value.unit, self._unit(connector), f"the value of '{connector.name}'")
        return StartValue(linear(value.value), None)

    # -- junctions ----------------------------------------------------------------------------------------------------

    def _joints(self, system: SSPSystem, path: Path) -> Iterator[AnnotatedJunction]:
        for j in system.joints:
            ends = tuple((self._named(system, path, e, f"junction '{j.name}'"), port) for e, port in j.ends)
            yield AnnotatedJunction(identifier("_".join((*path, j.name))), j.kind, ends)
        for name, element in system.elements.items():
            if isinstance(element, SSPSystem):
                yield from self._joints(element, (*path, name))

    def _signals(self, system: SSPSystem, path: Path) -> Iterator[VariableLink]:
        for s in system.signals:
            a, b = (self._named(system, path, e, f"signal {n}") for e, n in (s.source, s.target))
            yield VariableLink(a, s.source[1], b, s.target[1], s.transformation)
        for name, element in system.elements.items():
            if isinstance(element, SSPSystem):
                yield from self._signals(element, (*path, name))

    def _named(self, system: SSPSystem, path: Path, element: str, what: str) -> str:
        """The member that an annotation of a system calls by the name of its element."""
        if (*path, element) not in self.names:
            units = [n for n, e in system.elements.items() if isinstance(e, Component)]
            raise SSPError(f"the annotated {what} names the unit '{element}'; {meant(element, units)}")
        return self.names[*path, element]


def _components(system: SSPSystem, path: Path) -> Iterator[tuple[Path, Component]]:
    for name, element in system.elements.items():
        if isinstance(element, SSPSystem):
            yield from _components(element, (*path, name))
        elif isinstance(element, Component):
            yield (*path, name), element


def _dictionaries(system: SSPSystem, path: Path) -> Iterator[tuple[Path, Mapping[str, tuple[str, ...]]]]:
    yield path, system.dictionaries
    for name, element in system.elements.items():
        if isinstance(element, SSPSystem):
            yield from _dictionaries(element, (*path, name))


def _members(components: Mapping[Path, Component]) -> dict[Path, str]:
    """Path -> name of the member, an identifier."""
    names: dict[Path, str] = {}
    for path in components:
        name = identifier("_".join(path))
        if name in names.values():
            other = next(p for p, n in names.items() if n == name)
            raise SSPError(f"{'.'.join(other)} and {'.'.join(path)} would both be called '{name}' here; rename one")
        names[path] = name
    return names


def identifier(text: str) -> str:
    """The text as a name of a member, junction or network."""
    name = re.sub(r"\W", "_", text, flags=re.ASCII)
    return name if name and not name[0].isdigit() else f"m_{name}"


def bound(bindings: tuple[Binding, ...]) -> dict[str, StartValue]:
    """The values of all bindings, of which the last counts most."""
    out: dict[str, StartValue] = {}
    for b in bindings:
        out |= {n: StartValue(v, b.units.get(n)) for n, v in b.values.items()}
    return out


def _named_by(system: SSPSystem, path: Path, name: str) -> Iterator[tuple[tuple[Path, str], Connector | None]]:
    """All that a hierarchical name stands for: a connector, and what is behind the name of an element and a dot."""
    if name in system.connectors:
        yield (path, name), system.connectors[name]
    for element, inner in system.elements.items():
        rest = name.removeprefix(f"{element}.")
        if rest == name:
            continue
        if isinstance(inner, SSPSystem):
            yield from _named_by(inner, (*path, element), rest)
        elif isinstance(inner, Component):
            yield ((*path, element), rest), None
