"""Signals between members: a wire carries a value, and no power, from an output of one member to a signal input.

Composed, the input is replaced by the expression of the output; apart, it is exchanged at nodes or held over a step.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from typing import TYPE_CHECKING

import casadi as ca

from phfmu.declare.entries.coefficients import coefficient
from phfmu.declare.expressions.units import PhysicalUnit, UnitError, parse_unit
from phfmu.declare.phdae import PHDAE
from phfmu.declare.port import Port
from phfmu.declare.signal import read_by, signal_inputs
from phfmu.declare.variable import _sx
from phfmu.network.junction import ConnectionError, Junction
from phfmu.signals import of_member
from phfmu.words import first_few, meant

if TYPE_CHECKING:
    from phfmu.fmu.importer.unit_file import UnitFile


@dataclass(frozen=True)
class Wire:
    """From scalar `output` of member `source` to scalar `input` of member `target`: input = factor output + offset."""

    source: str
    output: str
    target: str
    input: str
    factor: float = 1.0
    offset: float = 0.0

    def __str__(self) -> str:
        scale = f" (times {self.factor:g})" if self.factor != 1.0 else ""
        shift = f" (plus {self.offset:g})" if self.offset else ""
        ends = of_member(self.source, self.output), of_member(self.target, self.input)
        return f"{' -> '.join(ends)}{scale}{shift}"


@dataclass(frozen=True)
class Output:
    """An output at which a wire may begin: its scalar names, their expression and unit."""

    names: list[str]
    expr: ca.SX
    unit: str


def outputs(model: PHDAE | UnitFile) -> dict[str, Output]:
    """Name -> observables, states and outputs of ports without feedthrough; of a unit its outputs and local variables."""
    if not isinstance(model, PHDAE):
        told = {n: v for n, v in model.interface.variables.items() if v.causality in ("output", "local")}
        return {n: Output([n], ca.SX.sym(n), v.unit) for n, v in told.items()}
    found = {o.name: Output(o.names(), ca.vec(o.expr), o.unit) for o in model.observables}
    found |= {v.name: Output(v.names(), v.sx, v.unit) for v in model.states}
    through = {id(v) for b in (*model.structure, *model.dissipation) for v in b.variables if isinstance(v, Port)}
    for port in model.ports:
        if port.on and id(port) not in through:
            names = port.output_names()
            found[names[0].partition("[")[0]] = Output(names, _output(model, port), port.output_unit)
    return found


def _output(model: PHDAE, port: Port) -> ca.SX:
    """y = B^T z."""
    y = ca.SX(port.n, 1)
    for v, value in port.on.items():
        y += ca.mtimes(coefficient(value, v.n, port.n).T, model.effort(v))
    return y


def _inputs(model: PHDAE | UnitFile) -> dict[str, str]:
    """Scalar name -> unit of signal inputs; of a unit its inputs that belong to no port."""
    if isinstance(model, PHDAE):
        return signal_inputs(model)
    pairs = (names for p in model.port_maps for names in (*p.node_inputs, *p.impulses))
    own = {n for p in model.port_maps for n in p.inputs}.union(*pairs, *model.interface.taken.values())
    return {n: v.unit for n, v in model.interface.variables.items() if v.causality == "input" and n not in own}


def wires_between(members: Mapping[str, PHDAE | UnitFile], source: str, target: str) -> list[Wire]:
    """One wire per scalar of the two ends, `member.name`; raises ConnectionError for what does not exist or does not fit."""
    a, output = _split(members, source)
    b, wanted = _split(members, target)
    found, name = outputs(members[a]), output.partition("[")[0]
    if name not in found or (output != name and output not in found[name].names):
        what = "has no observable, state or port output (of a port without feedthrough)"
        raise ConnectionError(f"member '{a}'", f"{what} '{output}'", meant(output, found))
    given = found[name].names if output == name else [output]
    units = _inputs(members[b])
    taken = [n for n in units if wanted in (n, n.partition("[")[0])]
    if not taken:
        raise ConnectionError(f"member '{b}'", f"has no signal input '{wanted}'", meant(wanted, units))
    if len(given) != len(taken):
        reason = f"{source} has {len(given)} values, {target} takes {len(taken)}"
        raise ConnectionError(f"signal {source} - {target}", reason, "connect as many as it takes")
    into = members[b]
    _require_unit(_signal_unit(members[a], given[0], source), _signal_unit(into, taken[0], target))
    if isinstance(into, PHDAE):
        _refuse_work(into, taken, target)
    return [Wire(a, g, b, t) for g, t in zip(given, taken, strict=True)]


def at_junction(source: str, members: Mapping[str, PHDAE | UnitFile], junctions: Sequence[Junction]) -> str:
    """The port output that a source `junction.name` stands for; the source itself where no junction has that name.

    Raises ConnectionError where no port at the junction has the common variable as its output: it is a multiplier, which depends
    on all that meets there at once, so that it is measured by a member with a lag.
    """
    name, _, wanted = source.partition(".")
    junction = next((j for j in junctions if j.name == name), None)
    if junction is None or name in members:
        return source
    ports = junction.ports(members)
    word, bracket, index = wanted.partition("[")
    common = next(iter(ports.values())).domain.word(junction.shared)
    if word != common:
        raise ConnectionError(f"junction '{name}'", f"has no '{wanted}'", f"its common variable is {name}.{common}")
    for end, port in ports.items():
        model = members[end.member]
        there = outputs(model)
        told = port.output_names()[0].partition("[")[0]
        if port.given != junction.shared and told in there:
            return f"{of_member(end.member, told)}{bracket}{index}"
    raise ConnectionError(
        f"signal source {source}",
        "no port at the junction has it as its output: it is a multiplier, which follows all that meets there at once",
        "join a member there that measures it through a lag (phfmu.components.control.meter), and take its signal",
    )


@dataclass(frozen=True)
class _SignalUnit:
    """The end of a signal and its unit of measurement: its text, what it is (None: it cannot be read), whether it is `known`.

    That of a variable of an FMU whose description tells none is not; nor is 1 in a declaration, which is what stands there
    where nothing was said.
    """

    end: str
    text: str
    unit: PhysicalUnit | None
    known: bool
    declared: bool


def _signal_unit(member: PHDAE | UnitFile, name: str, end: str) -> _SignalUnit:
    """The unit of the input or output `name` of a member."""
    if isinstance(member, PHDAE):
        inputs, bare = signal_inputs(member), name.partition("[")[0]
        text = inputs[name] if name in inputs else outputs(member)[bare].unit
        return _SignalUnit(end, text, _parsed(text), text != "1", True)
    variable, defined = member.interface.variables[name], member.interface.units
    known = variable.has_unit or bool(member.interface.energy)  # units of this package leave out what is 1
    return _SignalUnit(end, variable.unit, defined.get(variable.unit) or _parsed(variable.unit), known, False)


def _parsed(text: str) -> PhysicalUnit | None:
    try:
        return parse_unit(text)
    except UnitError:
        return None


def _compared(a: _SignalUnit, b: _SignalUnit) -> bool:
    """Whether both ends tell a unit: of two declarations always."""
    return (a.known and b.known) or (a.declared and b.declared)


def _require_unit(source: _SignalUnit, target: _SignalUnit) -> None:
    """ConnectionError where both tell one and they are not the same."""
    if source.text == target.text or not _compared(source, target):
        return
    mine, other = source.unit, target.unit
    if mine is not None and other is not None and mine.without_angle() == other.without_angle():
        if abs(mine.factor / other.factor - 1) <= 1e-12:
            return
    raise ConnectionError(
        f"signal {source.end} - {target.end}",
        f"unit mismatch: {source.end} is in {source.text}, {target.end} in {target.text}",
        "connect signals of one unit, or declare an output that is converted",
    )


def without_unit(members: Mapping[str, PHDAE | UnitFile], wires: Sequence[Wire]) -> str:
    """A line about the signals of which one end tells a unit of measurement and the other, of an FMU, none; "" without such."""
    ends: list[str] = []
    for w in wires:
        a = _signal_unit(members[w.source], w.output, of_member(w.source, w.output))
        b = _signal_unit(members[w.target], w.input, of_member(w.target, w.input))
        if not _compared(a, b) and a.known is not b.known:
            ends.append(f"{b.end if a.known else a.end} (taken for {a.text if a.known else b.text})")
    return f"no unit of measurement is told of {first_few(ends)}" if ends else ""


def _split(members: Mapping[str, PHDAE | UnitFile], end: str) -> tuple[str, str]:
    member, _, name = end.partition(".")
    if member not in members:
        raise ConnectionError(f"signal end {end}", f"the network has no member '{member}'", meant(member, members))
    return member, name


def _refuse_work(model: PHDAE, names: Sequence[str], target: str) -> None:
    """A signal that H, E or a constraint depends on would do work that no port books."""
    if what := works(model, names):
        raise ConnectionError(
            f"signal input {target}",
            f"{target} stands in {what} of its member: a change would do work that no port books",
            "let it act on J, R, B or a source, or change it by events, which book their energy",
        )


def works(model: PHDAE, names: Sequence[str]) -> str:
    """The parts of a model, other than flows, that depend on signals; "" if none does."""
    symbols = signal_symbols(model, names)
    places = [
        *(("H", e.expr) for e in model.energies),
        *(("a closed pair", ca.SX(p.hamiltonian)) for p in model.closed),
    ]
    places += [("E", ca.SX(_sx(m))) for m in model.E.values()] + [("a constraint", c.g) for c in model.constraints]
    return next((what for what, expr in places if read_by(expr, symbols)), "")


def signal_symbols(model: PHDAE, names: Sequence[str]) -> list[ca.SX]:
    """The symbols of scalar inputs."""
    place = {n: s for v in model.parameters for n, s in zip(v.names(), ca.vertsplit(v.sx), strict=True)}
    return [place[n] for n in names]


def in_order(members: Mapping[str, PHDAE | UnitFile], wires: Sequence[Wire]) -> list[Wire]:
    """Wires so that each comes after those its output depends on at once; ConnectionError names a loop of them.

    Of a unit that is not known: its outputs come after its inputs where that makes no loop, else they count as those of states.
    """
    try:
        return [wires[i] for i in _sorted(members, wires, units_pass=True)]
    except CycleError:
        pass
    try:
        return [wires[i] for i in _sorted(members, wires, units_pass=False)]
    except CycleError as error:
        cycle = [str(wires[i]) for i in error.args[1][:-1]]
        raise ConnectionError(
            "signals in a loop without delay",
            f"{', '.join(cycle)}: each depends on the one before at once",
            "put a state into one of the members (a filter, an integrator, an actuator with a time constant)",
        ) from None


def _sorted(members: Mapping[str, PHDAE | UnitFile], wires: Sequence[Wire], units_pass: bool) -> list[int]:
    """Numbers of the wires in order; `units_pass`: outputs of units depend on all their inputs.  CycleError."""
    sorter: TopologicalSorter[int] = TopologicalSorter()
    into: dict[str, list[int]] = {}
    for i, wire in enumerate(wires):
        into.setdefault(wire.target, []).append(i)
    for i, wire in enumerate(wires):
        fed = into.get(wire.source, [])
        model, name = members[wire.source], wire.output.partition("[")[0]
        if not isinstance(model, PHDAE):
            sorter.add(i, *(fed if units_pass else ()))
            continue
        out = outputs(model)[name]
        expr = out.expr[out.names.index(wire.output)]
        through = read_by(expr, signal_symbols(model, [wires[j].input for j in fed]))
        sorter.add(i, *(fed[k] for k in through))
    return list(sorter.static_order())
