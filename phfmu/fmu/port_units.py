"""Units of the variables of a port: which domain they tell, and the factors to those of the domain."""

from __future__ import annotations

from collections.abc import Mapping

from phfmu.declare.port import DOMAINS, Domain
from phfmu.declare.units import Unit, UnitError, parse_unit
from phfmu.fmu.unit_interface import UnitInterface
from phfmu.fmu.variables import FMUError

#: factors that differ by less are one
SAME = 1e-12


def unit_of(interface: UnitInterface, name: str) -> Unit | None:
    """The unit of a variable by the definitions of the description, else by its text; None where that says nothing."""
    text = interface.variables[name].unit
    if text in interface.units:
        return interface.units[text]
    try:
        return None if text in ("", "1") else parse_unit(text)
    except UnitError:
        return None


def domain_of(effort: Unit | None, flow: Unit | None) -> Domain | None:
    """The domain with these dimensions."""
    for d in DOMAINS.values():
        own = parse_unit(d.effort_unit), parse_unit(d.flow_unit)
        if all(
            a is not None and a.without_angle() == b.without_angle() for a, b in zip((effort, flow), own, strict=True)
        ):
            return d
    return None


def factor_to(wanted: str, units: Mapping[str, Unit | None], where: str) -> float:
    """What a value of the variables in `units` is multiplied by to be in the unit `wanted`; 1 where they have none.

    FMUError for another dimension, or variables of different units.
    """
    target, factors = parse_unit(wanted), set[float]()
    for n, unit in units.items():
        if unit is None:
            factors.add(1.0)
        elif unit.without_angle() != target.without_angle():
            raise FMUError(f"{where}: {n} is in {unit.text}, its port has {wanted} there")
        else:
            ratio = unit.factor / target.factor
            factors.add(1.0 if abs(ratio - 1) < SAME else ratio)
    if len(factors) > 1:
        raise FMUError(f"{where}: {', '.join(units)} are not in one unit; make a port of each")
    return factors.pop() if factors else 1.0
