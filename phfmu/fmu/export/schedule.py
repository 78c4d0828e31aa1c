"""Events that a unit has inside: parameters that take values at given times.

An event on the input of a port makes the port fed from inside: the value is a parameter of the name of the input, and the
work of the port is booked as before.  Such a port is not offered to importers any more.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from math import isfinite

from phfmu.declare.phdae import PHDAE
from phfmu.declare.port import Port
from phfmu.declare.variable import Variable, parameter
from phfmu.discretise.model import Model
from phfmu.fmu.export.variables import FMUError


@dataclass(frozen=True)
class UnitEvent:
    """At time t (s) the parameter `name` takes `value`; the bare name of a vector stands for all its entries."""

    t: float
    name: str
    value: float


def in_order(model: Model, events: Iterable[UnitEvent]) -> tuple[UnitEvent, ...]:
    """Events on scalars, in order of time; FMUError for what is no parameter or not finite."""
    known = {n: v.names() for v in model.declaration.parameters for n in (v.name, *v.names())}
    out = []
    for e in events:
        if e.name not in known or not (isfinite(e.t) and isfinite(e.value)):
            raise FMUError(
                f"{model.name}: event {e.name} = {e.value} at t = {e.t} s sets no parameter to a finite value"
            )
        out += [replace(e, name=n) for n in known[e.name] if e.name in (n, n.partition("[")[0])]
    return tuple(sorted(out, key=lambda e: e.t))


def fed_inside(declaration: PHDAE, names: Sequence[str]) -> PHDAE:
    """`declaration` with the ports whose inputs are among `names` fed by parameters that are called like these inputs."""
    made: list[Variable] = []

    def fed(port: Port) -> Port:
        scalars = port.input_names()
        bare = scalars[0].partition("[")[0]
        if not port.external or port.signal or not {bare, *scalars} & {*names}:
            return port
        value = parameter(bare, port.start, port.size, unit=port.input_unit, description=f"input of port {port.name}")
        made.append(value)
        return replace(port, source=value.sx)

    new = declaration.mapped(lambda v: v, fed)
    return replace(new, parameters=(*new.parameters, *made))
