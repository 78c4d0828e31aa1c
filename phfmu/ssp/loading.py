"""A package of SSP as a scene: its units are members, connected ports are junctions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

from phfmu.declare.port import Port
from phfmu.fmu.importer.unit_file import UnitFile, unit_file
from phfmu.network.junction import Kind
from phfmu.network.network import Network
from phfmu.network.scene import Scene
from phfmu.network.wires import Wire, in_order
from phfmu.ssp.bonds import Bond, End, PortVariables, bonds, derived_ports, joins_plainly
from phfmu.ssp.flat import StartValue, VariableLink, flat, identifier
from phfmu.ssp.reading import read_structure
from phfmu.ssp.structure import AnnotatedJunction, Component, SSPError, Structure, Unit
from phfmu.ssp.terminals import KIND as TERMINAL
from phfmu.ssp.units import conversion, undefined
from phfmu.words import meant

#: stop and step, s, of packages and units that do not tell them
STOP, STEP = 1.0, 1e-3


def load(path: str | Path, lenient: bool = False) -> Scene:
    """The scene of a .ssp or .ssd; its notes say what was left out or assumed.

    `lenient`: units of measurement that it does not define count as not told, which is noted.

    SSPError (with the file, the entry and the remedy), FMUError or ConnectionError for what cannot be read or joined.
    """
    try:
        return _load(read_structure(path, lenient))
    except SSPError as error:
        text = str(error)
        raise SSPError(text if text.startswith(str(path)) else f"{path}: {text}") from None


def _load(structure: Structure) -> Scene:
    whole, notes = flat(structure), list(structure.notes)
    units = {name: _unit(c, structure, notes) for name, c in whole.units.items()}
    if not units:
        raise SSPError("the system has no components; add a Component whose source is an FMU")
    told, lines = derived_ports(whole.links, {n: u.port_maps for n, u in units.items()})
    units = {n: replace(u, port_maps=told[n]) for n, u in units.items()}
    found, rest = bonds(whole.links, PortVariables(told))
    notes += lines
    net = Network(identifier(structure.system.name or structure.name), description=structure.system.description)
    for name, unit in units.items():
        net.add(name, with_values(name, unit, whole.values.get(name, {}), notes))
    _join(net, whole.joints, found)
    _wire(net, rest)
    steps = [u.interface.step for u in units.values() if u.interface.step]
    if structure.start:
        notes.append(f"the run starts at t = 0 instead of {structure.start:g} s")
    stop = STOP if structure.stop is None else structure.stop - structure.start
    step = structure.step or min(steps, default=STEP)
    return Scene(net.name, net, stop, step, notes=tuple(notes), kept=structure.kept)


def _unit(component: Component, structure: Structure, notes: list[str]) -> UnitFile:
    """The unit of a component, whose connectors it must have."""
    unit = unit_file(component.files.file(component.source))
    unit = replace(unit, source=f"{component.files.path}/{component.source}")
    known = unit.interface.variables
    for c in component.connectors.values():
        where = f"component '{component.name}', connector '{c.name}'"
        if c.name not in known:
            if c.kind == TERMINAL or c.type in ("String", "Binary", "Clock"):
                continue
            raise SSPError(f"{where}: {component.source} has no such variable; {meant(c.name, known)}")
        variable = known[c.name]
        if c.kind in ("input", "output", "parameter") and variable.causality != c.kind:
            raise SSPError(
                f"{where} is of the kind {c.kind}, the variable of {component.source} is {variable.causality}"
            )
        told, own = structure.units.get(c.unit), _unit_of(unit, c.name)
        if c.unit and told is None and structure.units:
            notes += undefined(where, c.unit, structure.lenient, meant(c.unit, structure.units))
        if conversion(told, own, where).factor != 1.0:
            theirs = f"the variable of {component.source} in '{variable.unit}'"
            raise SSPError(f"{where}: unit mismatch: it is in '{c.unit}', {theirs}")
    return unit


def _unit_of(unit: UnitFile, name: str) -> Unit | None:
    """The unit of measurement that the unit states for its variable."""
    found = unit.interface.units.get(unit.interface.variables[name].unit)
    return None if found is None else Unit(found.text, found.factor, 0.0, found.exponents)


def with_values(name: str, unit: UnitFile, values: Mapping[str, StartValue], notes: list[str]) -> UnitFile:
    """Values before the start, in the unit's own units; the standard ignores names that a unit has not."""
    settable, starts = unit.settable_names(), {}
    for variable, value in values.items():
        if variable not in unit.interface.variables:
            notes.append(f"{name} has no variable '{variable}'; its value {value.value:g} is ignored")
        elif variable not in settable:
            raise SSPError(f"{name}.{variable} is calculated; a parameter set cannot give it the value {value.value:g}")
        else:
            linear = conversion(value.unit, _unit_of(unit, variable), f"the value of {name}.{variable}")
            starts[variable] = linear(value.value)
    return unit.with_starts(starts)


def _join(net: Network, joints: Sequence[AnnotatedJunction], found: Sequence[Bond]) -> None:
    """Junctions of the annotation, which the connections must not contradict, then bonds it does not name."""
    left = {frozenset((b.a, b.b)): b for b in found}
    for j in joints:
        bond = left.pop(frozenset(j.ends), None)
        others = [b for b in left.values() if {b.a, b.b} & {*j.ends}]
        plain = joins_plainly([_port(net, j, end).given for end in j.ends])
        if others or (bond is None and plain) or (bond is not None and bond.kind != j.kind):
            told = ", ".join(map(_dotted, j.ends))
            raise SSPError(
                f"the annotation joins {told} at '{j.name}' (kind {j.kind}), the connections do not"
                + (f": they join {_dotted(others[0].a)} and {_dotted(others[0].b)}" if others else "")
                + "; take the Junction out of the annotation where the connections were changed"
            )
        net.junction(j.name, [_dotted(e) for e in j.ends], cast(Kind, j.kind))
    for b in left.values():
        net.junction("_".join((*b.a, *b.b)), [_dotted(b.a), _dotted(b.b)], cast(Kind, b.kind))


def _port(net: Network, joint: AnnotatedJunction, end: End) -> Port:
    ports = {p.name: p for p in net.members[end[0]].ports}
    if end[1] not in ports:
        raise SSPError(f"the annotated junction '{joint.name}' names the port {_dotted(end)}; {meant(end[1], ports)}")
    return ports[end[1]]


def _dotted(end: End) -> str:
    return ".".join(end)


def _wire(net: Network, links: Sequence[VariableLink]) -> None:
    """Connections that are no power ports: signals."""
    wires = []
    for link in links:
        source, target = net.units[link.source], net.units[link.target]
        output, given = (u.interface.variables.get(n) for u, n in ((source, link.output), (target, link.input)))
        if output is None or given is None:
            raise SSPError(f"{link}: there is no such {'output' if output is None else 'input'}")
        if given.causality != "input":
            raise SSPError(f"{link}: {link.target}.{link.input} is {given.causality}; connect outputs with inputs")
        port = next((p for p in target.port_maps if link.input in p.inputs), None)
        if port is not None:
            raise SSPError(
                f"{link}: {link.input} belongs to the power port {link.target}.{port.name}. Connect {', '.join(port.outputs)} "
                f"back to a port of {link.source} too, or leave the port free and drive it with --input"
            )
        wires.append(Wire(link.source, link.output, link.target, link.input, link.linear.factor, link.linear.offset))
    net.wires = in_order(net.members, wires)
