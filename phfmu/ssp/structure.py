"""A System Structure Description in its own words (names of fields are those of the standard)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Protocol

#: kinds of connectors that give a value to what is connected with them, seen from inside their element
SOURCES = ("output", "calculatedParameter", "constant", "local")
SINKS = ("input", "parameter", "structuralParameter")


class SSPError(ValueError):
    """A package cannot be read or written; names the file, the entry and the remedy."""


@dataclass(frozen=True)
class Linear:
    """target = factor * source + offset."""

    factor: float = 1.0
    offset: float = 0.0

    def then(self, other: Linear) -> Linear:
        """First this one, then the other."""
        return Linear(other.factor * self.factor, other.factor * self.offset + other.offset)

    def __call__(self, value: float) -> float:
        return self.factor * value + self.offset


@dataclass(frozen=True)
class Unit:
    """SI value = factor * value + offset, in the product of the base units to `exponents`.

    The base units are BASE of `phfmu.declare.expressions.units`.
    """

    name: str
    factor: float
    offset: float
    exponents: tuple[int, ...]


@dataclass(frozen=True)
class Connector:
    """`kind`: input, output, parameter, ..; `type`: Real, Float64, Integer, ..; `unit`: name in the units of its file."""

    name: str
    kind: str
    type: str = "Real"
    unit: str = ""


def entries(name: str, shape: tuple[int, ...]) -> list[str]:
    """name[1,1], name[1,2], .. of an array; the name of a scalar."""
    if not shape:
        return [name]
    return [f"{name}[{','.join(map(str, place))}]" for place in product(*(range(1, n + 1) for n in shape))]


@dataclass(frozen=True)
class Connection:
    """A connection of two connectors of elements, or (element "") of the system itself; `suppress`: no conversion of units;
    `terminal`: of members of two terminals.
    """

    start_element: str
    start_connector: str
    end_element: str
    end_connector: str
    transformation: Linear = Linear()
    suppress: bool = False
    terminal: bool = False

    @property
    def ends(self) -> tuple[tuple[str, str], tuple[str, str]]:
        """(element, connector) of both."""
        return (self.start_element, self.start_connector), (self.end_element, self.end_connector)


@dataclass(frozen=True)
class Binding:
    """Values by name: those of a parameter set after prefix and mapping; `units`: of those that tell theirs."""

    values: Mapping[str, float]
    units: Mapping[str, Unit] = field(default_factory=dict)


@dataclass(frozen=True)
class AnnotatedJunction:
    """A junction of power ports, told by the annotation: kind "0" or "1", ends (element, port)."""

    name: str
    kind: str
    ends: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class AnnotatedSignal:
    """A connection told by the annotation, because its source is no output: (element, variable) of both ends."""

    source: tuple[str, str]
    target: tuple[str, str]
    transformation: Linear = Linear()


class Files(Protocol):
    """Places of the files that a description names; `path`: what holds them."""

    path: Path

    def file(self, uri: str) -> Path: ...


@dataclass(frozen=True)
class Component:
    """A unit; `source`: its file in `files`; `arrays`: connectors whose entries `connectors` has, and their sizes."""

    name: str
    source: str
    files: Files
    connectors: Mapping[str, Connector] = field(default_factory=dict)
    bindings: tuple[Binding, ...] = ()
    description: str = ""
    arrays: Mapping[str, tuple[int, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class Reference:
    """An element by which signals are put into the dictionary called `dictionary`, and taken out of it."""

    name: str
    dictionary: str
    connectors: Mapping[str, Connector] = field(default_factory=dict)
    arrays: Mapping[str, tuple[int, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class SSPSystem:
    """Elements in their order, and what connects them; `arrays` as of a component; `dictionaries`: name -> entries."""

    name: str
    elements: Mapping[str, Component | SSPSystem | Reference] = field(default_factory=dict)
    connections: tuple[Connection, ...] = ()
    connectors: Mapping[str, Connector] = field(default_factory=dict)
    bindings: tuple[Binding, ...] = ()
    joints: tuple[AnnotatedJunction, ...] = ()
    signals: tuple[AnnotatedSignal, ...] = ()
    description: str = ""
    arrays: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    dictionaries: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class Structure:
    """A package: its system, `units` by name, default experiment; `step`, s, is told by the annotation only.

    `notes`: what was not read or checked, a line each.
    """

    version: str
    name: str
    system: SSPSystem
    units: Mapping[str, Unit] = field(default_factory=dict)
    start: float = 0.0
    stop: float | None = None
    step: float | None = None
    notes: tuple[str, ...] = ()
    #: what no run needs, to be written again (`round_trip.py`)
    kept: object = None
    #: whether units of measurement that are not defined count as not told
    lenient: bool = False
