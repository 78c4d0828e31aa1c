"""Junctions: ports that meet, and connections that cannot be made.

The unknowns of a junction: its common variable, and inputs of ports that give it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from phfmu.declare.error import Refusal
from phfmu.declare.port import Given, Port
from phfmu.declare.variable import Variable, algebraic
from phfmu.signals import of_member

Kind = Literal["0", "1"]
SHARED: dict[Kind, Given] = {"0": "effort", "1": "flow"}
#: the kind of a junction whose ports share this
KIND: dict[Given, Kind] = {shared: kind for kind, shared in SHARED.items()}


class ConnectionError(Refusal):
    """A connection that cannot be made; `entry` names the sides."""


class WithPorts(Protocol):
    """A member, as far as junctions look at it: a declaration or a unit."""

    def port(self, name: str) -> Port: ...


@dataclass(frozen=True)
class End:
    """One side of a connection: port `port` of member `member`."""

    member: str
    port: str

    def __str__(self) -> str:
        return of_member(self.member, self.port)


@dataclass(frozen=True)
class Junction:
    """Ports that meet: kind "0" (common effort) or "1" (common flow)."""

    name: str
    kind: Kind
    ends: tuple[End, ...]

    @property
    def shared(self) -> Given:
        """The member of the pair that all its ports have in common."""
        return SHARED[self.kind]

    def ports(self, members: Mapping[str, WithPorts]) -> dict[End, Port]:
        """The ports that meet, in the order of the ends."""
        return {e: members[e.member].port(e.port) for e in self.ends}


@dataclass(frozen=True)
class JunctionUnknowns:
    """Unknowns of one junction: the common variable and the inputs of the ports that output it."""

    junction: Junction
    common: Variable
    dual: dict[End, Variable]

    def input_of(self, end: End) -> Variable:
        """The algebraic variable that feeds the port `end`."""
        return self.dual.get(end, self.common)


def junction_unknowns(members: Mapping[str, WithPorts], junction: Junction) -> JunctionUnknowns:
    """The algebraic variables of `junction`; named `<junction>.v[..]` and `<member>.<port>.i[..]` (domain names)."""
    ports = junction.ports(members)
    first = next(iter(ports.values()))
    shared = junction.shared
    name, unit = first.domain.word(shared), first.domain.unit(shared)
    givers = [p for p in ports.values() if p.given == shared]
    common = algebraic(f"{junction.name}.{name}", first.size, unit=unit, nominal=_size(givers), start=_start(givers),
                       elements=next((p.elements for p in ports.values() if p.elements), ()),
                       description=f"common {shared} of {', '.join(map(str, junction.ends))}")  # fmt: skip
    dual = {}
    for end, port in ports.items():
        if port.given != shared:
            member = port.input_names()[0].split("[")[0]
            dual[end] = algebraic(of_member(end.member, member), port.size, unit=port.input_unit, nominal=port.nominal,
                                  start=port.start, elements=port.elements, description=f"input of {end}")  # fmt: skip
    return JunctionUnknowns(junction, common, dual)


def _size(ports: list[Port]) -> float:
    return max((float(np.max(p.nominal)) for p in ports), default=1.0)


def _start(ports: list[Port]):
    return ports[0].start if ports else 0.0
