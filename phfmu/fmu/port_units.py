"""Units of the variables of a port: which domain they tell, and whether they are those of the domain."""

from __future__ import annotations

from phfmu.declare.port import ELECTRICAL, HYDRAULIC, ROTATIONAL, TRANSLATIONAL, Domain
from phfmu.declare.units import Unit, UnitError, parse_unit
from phfmu.fmu.interface import Interface
from phfmu.fmu.manifest import PortMap
from phfmu.fmu.variables import FMUError

DOMAINS = {d.name: d for d in (ELECTRICAL, TRANSLATIONAL, ROTATIONAL, HYDRAULIC)}

#: factors that differ by less are one
SAME = 1e-12


def unit_of(interface: Interface, name: str) -> Unit | None:
    """The unit of a variable by the definitions of the description, else by its text; None where that says nothing."""
    text = interface.variables[name].unit
    if text in interface.units:
        return interface.units[text]
    try:
        return None if text in ("", "1") else parse_unit(text)
    except UnitError:
        return None


def domain_of(interface: Interface, effort: str, flow: str) -> Domain | None:
    """The domain whose dimensions the two variables have."""
    units = unit_of(interface, effort), unit_of(interface, flow)
    for d in DOMAINS.values():
        own = parse_unit(d.effort_unit), parse_unit(d.flow_unit)
        if all(a is not None and a.without_angle() == b.without_angle() for a, b in zip(units, own, strict=True)):
            return d
    return None


def require_units(port: PortMap, interface: Interface, where: str) -> None:
    """FMUError for a variable whose unit is not that of its domain."""
    efforts, flows = (port.inputs, port.outputs) if port.given == "effort" else (port.outputs, port.inputs)
    for names, own in ((efforts, port.domain.effort_unit), (flows, port.domain.flow_unit)):
        for n in names:
            unit, wanted = unit_of(interface, n), parse_unit(own)
            if unit is None:
                continue
            if unit.without_angle() != wanted.without_angle() or abs(unit.factor / wanted.factor - 1) > SAME:
                raise FMUError(
                    f"{where}: {n} is in {unit.text}, ports of the domain {port.domain.name} have {own} there"
                )
