"""Ports of a unit of another tool as its user tells them: a table per port, from Python or a file beside the unit.

[shaft]
effort = "tau"          # a variable, or a list of them: entry 1, 2, ..; the name of an array has all its entries
flow = "w"              # one of the two is an input of the unit
sign = 1                # 1: the one that sums to zero at a junction counts into the unit, -1: out of it
domain = "rotational"   # found by the units of the variables where these tell it
displacement = "phi"    # optional: whose rate of change is the output

Units of the variables of a port: which domain they tell, and the factors to those of the domain.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from phfmu.declare.expressions.units import PhysicalUnit, UnitError, is_power, parse_unit
from phfmu.declare.port import DOMAINS, Domain, Given, conjugate
from phfmu.fmu.export.manifest import PortMap
from phfmu.fmu.export.variables import FMUError
from phfmu.fmu.importer.unit_interface import UnitInterface
from phfmu.words import meant

#: factors that differ by less are one
SAME = 1e-12


def unit_of(interface: UnitInterface, name: str) -> PhysicalUnit | None:
    """The unit of a variable by the definitions of the description, else by its text; None where that says nothing."""
    text = interface.variables[name].unit
    if text in interface.units:
        return interface.units[text]
    try:
        return None if text in ("", "1") else parse_unit(text)
    except UnitError:
        return None


def domain_of(effort: PhysicalUnit | None, flow: PhysicalUnit | None) -> Domain | None:
    """The domain with these dimensions."""
    for d in DOMAINS.values():
        own = parse_unit(d.effort_unit), parse_unit(d.flow_unit)
        if all(
            a is not None and a.without_angle() == b.without_angle() for a, b in zip((effort, flow), own, strict=True)
        ):
            return d
    return None


def factor_to(wanted: str, units: Mapping[str, PhysicalUnit | None], where: str) -> float:
    """The factor from values of the variables in `units` to the unit `wanted`; 1 where they have none.

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


#: `pump.fmu` -> `pump.ports.toml`
ENDING = ".ports.toml"

KEYS = ("effort", "flow", "sign", "domain", "displacement", "effort_unit", "flow_unit", "displacement_unit")


def sidecar(path: Path) -> Path:
    """The file that may tell the ports of a unit."""
    return path.with_name(path.stem + ENDING)


def read_sidecar(path: Path, interface: UnitInterface) -> tuple[PortMap, ...]:
    """The ports of the file; FMUError says what is wrong with it."""
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise FMUError(f"{path}: no TOML: {error}") from None
    return port_maps(tables, interface, str(path))


def port_maps(tables: Mapping[str, Any], interface: UnitInterface, where: str) -> tuple[PortMap, ...]:
    """Ports by their tables, or as they are; FMUError names the port, what does not fit and the remedy."""
    return tuple(
        t if isinstance(t, PortMap) else _Table(name, t, interface, f"{where}: port '{name}'").port()
        for name, t in tables.items()
    )


class _Table:
    """One port as its user tells it."""

    def __init__(self, name: str, table: Any, interface: UnitInterface, where: str):
        self.name, self.table, self.interface, self.where = name, table, interface, where
        if not isinstance(table, Mapping):
            raise FMUError(f"{where}: expected a table with {', '.join(KEYS)}, got {table!r}")
        unknown = next((k for k in table if k not in KEYS), None)
        if unknown is not None:
            raise FMUError(f"{where}: unknown key '{unknown}'; {meant(unknown, KEYS)}")
        if not (name.isascii() and name.isidentifier()):
            raise FMUError(f"{where}: a name of a port is letters, digits and _")

    def port(self) -> PortMap:
        members = {m: self._variables(m) for m in ("effort", "flow")}
        given = self._given(members)
        inputs, outputs = members[given], members[conjugate(given)]
        if len(inputs) != len(outputs):
            raise FMUError(f"{self.where}: {len(inputs)} inputs but {len(outputs)} outputs; give pairs")
        domain = self._domain(members)
        displacements = self._variables("displacement") if "displacement" in self.table else ()
        if displacements and len(displacements) != len(outputs):
            raise FMUError(
                f"{self.where}: {len(displacements)} displacements for {len(outputs)} outputs; give one for each"
            )
        other = conjugate(given)
        return PortMap(
            self.name, domain, given, inputs, outputs, sign=self._sign(domain), vector=self._vector(),
            displacements=displacements, input_factor=self._factor(given, inputs, domain.unit(given)),
            output_factor=self._factor(other, outputs, domain.unit(other)),
            displacement_factor=self._factor("displacement", displacements, f"s.{domain.unit(other)}"),
        )  # fmt: skip

    def _factor(self, key: str, names: tuple[str, ...], wanted: str) -> float:
        return factor_to(wanted, {n: self._unit(key, n) for n in names}, self.where)

    def _unit(self, key: str, name: str) -> PhysicalUnit | None:
        """The unit of measurement of a variable: the one of the table, else the one that the unit tells."""
        told = self.table.get(f"{key}_unit")
        try:
            return unit_of(self.interface, name) if told is None else parse_unit(str(told))
        except UnitError as error:
            raise FMUError(f"{self.where}: {key}_unit: {error}") from None

    def _vector(self) -> bool:
        """True for ports given as a list, or by the name of an array."""
        told = self.table["effort"]
        return not isinstance(told, str) or told not in self.interface.variables

    def _variables(self, key: str) -> tuple[str, ...]:
        """Names of scalars; that of an array stands for its entries."""
        told = self.table.get(key)
        names = [told] if isinstance(told, str) else told
        if not isinstance(names, list | tuple) or not names or not all(isinstance(n, str) for n in names):
            raise FMUError(f'{self.where}: say which variable is its {key}: {key} = "name", or a list of names')
        try:
            return tuple(entry for n in names for entry in entries_of(n, self.interface))
        except FMUError as error:
            raise FMUError(f"{self.where}: {error}") from None

    def _given(self, members: Mapping[str, tuple[str, ...]]) -> Given:
        """The one of the two that is an input."""
        causality = {m: {self.interface.variables[n].causality for n in names} for m, names in members.items()}
        inputs = [m for m, found in causality.items() if found == {"input"}]
        if len(inputs) != 1 or any("input" in found for m, found in causality.items() if m not in inputs):
            told = "; ".join(f"{m} {', '.join(n)} is {' and '.join(sorted(causality[m]))}" for m, n in members.items())
            raise FMUError(f"{self.where}: {told}; of a pair one has to be an input, the other an output")
        return "effort" if inputs == ["effort"] else "flow"

    def _domain(self, members: Mapping[str, tuple[str, ...]]) -> Domain:
        told, units = self.table.get("domain"), {m: self._unit(m, names[0]) for m, names in members.items()}
        if isinstance(told, Domain):
            return told
        if isinstance(told, Mapping):
            return self._own_domain(told)
        if told is not None and told not in DOMAINS:
            own = "or a table: domain = {name, effort, effort_unit, flow, flow_unit, common}"
            raise FMUError(f"{self.where}: unknown domain {told!r}; there are {', '.join(DOMAINS)}, {own}")
        found = DOMAINS[told] if told else domain_of(*units.values())
        if found is None:
            texts = ", ".join(
                f"{m} {members[m][0]} in {u.text if u else 'none that is known'}" for m, u in units.items()
            )
            raise FMUError(
                f"{self.where}: its units ({texts}) do not tell its domain; say domain = one of {', '.join(DOMAINS)}"
            )
        return found

    def _own_domain(self, told: Mapping[str, Any]) -> Domain:
        names = [f.name for f in fields(Domain)]
        if {*told} != {*names} or not all(isinstance(v, str) for v in told.values()):
            raise FMUError(f"{self.where}: a domain of its own has {', '.join(names)}")
        if told["common"] not in ("effort", "flow"):
            raise FMUError(f"{self.where}: common = {told['common']!r}; effort or flow is what ports share that meet")
        try:
            power = is_power(told["effort_unit"], told["flow_unit"])
        except UnitError as error:
            raise FMUError(f"{self.where}: {error}") from None
        if not power:
            raise FMUError(f"{self.where}: {told['effort_unit']} times {told['flow_unit']} is no W")
        return Domain(**told)

    def _sign(self, domain: Domain) -> float:
        sign, summed = self.table.get("sign"), domain.word(domain.summed)
        if sign not in (1, -1):
            told = f"sign = {sign!r}" if "sign" in self.table else "no sign"
            raise FMUError(
                f"{self.where}: {told}; say sign = 1 if the {summed} counts into the unit (times the other of the pair it is "
                "power into it), sign = -1 if it counts out of it"
            )
        return float(sign)


def entries_of(name: str, interface: UnitInterface) -> list[str]:
    """The variable, or the entries of an array; FMUError if there is no such variable."""
    known = interface.variables
    entries = [name] if name in known else [v for v in known if v.startswith(f"{name}[")]
    if not entries:
        raise FMUError(f"{interface.name} has no variable '{name}'; {meant(name, known)}")
    return entries
