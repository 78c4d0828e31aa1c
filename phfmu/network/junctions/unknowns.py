"""The unknowns of a junction: its common variable, and inputs of ports that give it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from phfmu.declare.port import Port
from phfmu.declare.variable import Variable, algebraic
from phfmu.network.junctions.junction import End, Junction, WithPorts
from phfmu.signals import of_member


@dataclass(frozen=True)
class Unknowns:
    """Unknowns of one junction: the common variable and the inputs of the ports that output it."""

    junction: Junction
    common: Variable
    dual: dict[End, Variable]

    def input_of(self, end: End) -> Variable:
        """The algebraic variable that feeds the port `end`."""
        return self.dual.get(end, self.common)


def junction_unknowns(members: Mapping[str, WithPorts], junction: Junction) -> Unknowns:
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
    return Unknowns(junction, common, dual)


def _size(ports: list[Port]) -> float:
    return max((float(np.max(p.nominal)) for p in ports), default=1.0)


def _start(ports: list[Port]):
    return ports[0].start if ports else 0.0
