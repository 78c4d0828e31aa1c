"""Signals of a member as ports without power: what members stepped apart exchange at the nodes of their steps.

A signal input s becomes the input of a port that acts on no row: its symbol u stands wherever s stood, and y = 0.  An output
f(x, z, u, p, t) becomes the output of a port whose input is zero, by a skew block of J with a port that is always given 1:

    [-y; -y_1] = [0, -f; f, 0] [u; 1],      u = 0:  y = f,  y_1 = 0,      u.y + 1.y_1 = 0.

So inputs and outputs at nodes, sensitivities, internal steps and halved ones are those of power ports, and their energies are 0.

Signal inputs of a member replaced by the expressions that feed them, when a network is composed.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca

from phfmu.declare.block import skew
from phfmu.declare.entries.coefficients import coefficient
from phfmu.declare.event import StateEvent
from phfmu.declare.phdae import PHDAE
from phfmu.declare.port import SIGNAL, Given, Port
from phfmu.declare.signal import driven, signal_input, signal_output
from phfmu.declare.switch import Switch
from phfmu.declare.variable import Variable, _sx
from phfmu.network.junction import ConnectionError
from phfmu.network.wires import Output, Wire, outputs, works


def fed(model: PHDAE, values: Mapping[str, ca.SX]) -> PHDAE:
    """`model` without the signal inputs `values` (all entries, by scalar name), which are what these expressions say.

    A source that depends on one becomes a port of the same name that books the same work, with the power as its output.
    """
    inputs = [v for v in model.parameters if v.signal and v.names()[0] in values]
    old = ca.vertcat(*(v.sx for v in inputs))
    new = ca.vertcat(*(values[n] for v in inputs for n in v.names()))

    def put(value: Any) -> Any:
        expr = ca.SX(_sx(value))
        return ca.substitute(expr, old, new) if ca.depends_on(expr, old) else value

    def port(p: Port) -> Port:
        on = {v: put(m) for v, m in p.on.items()}
        if p.source is None or not ca.depends_on(ca.SX(_sx(p.source)), old):
            return replace(p, on=on)
        source = ca.vec(ca.SX(_sx(put(p.source))))
        right: dict[Variable, Any] = {v: ca.mtimes(coefficient(m, v.n, p.n), source) for v, m in on.items()}
        return driven(p.name, right, description=p.description, owner=p.owner)

    def event(e: StateEvent) -> StateEvent:
        jump = e.jump and replace(
            e.jump, restitution=put(e.jump.restitution), on={v: put(m) for v, m in e.jump.on.items()}
        )
        return replace(e, guard=replace(e.guard, expr=put(e.guard.expr)), jump=jump)

    def switch(s: Switch) -> Switch:
        gap, on = None if s.gap is None else put(s.gap), {v: put(m) for v, m in s.on.items()}
        return replace(s, on=on, gap=gap, restitution=put(s.restitution))

    return replace(
        model,
        parameters=tuple(v for v in model.parameters if v not in inputs),
        structure=tuple(b.changed(put) for b in model.structure),
        dissipation=tuple(b.changed(put) for b in model.dissipation),
        ports=tuple(map(port, model.ports)),
        observables=tuple(replace(o, expr=put(o.expr)) for o in model.observables),
        z={v: put(m) for v, m in model.z.items()},
        state_events=tuple(map(event, model.state_events)),
        switches=tuple(map(switch, model.switches)),
    )


def following(model: PHDAE, port: Port) -> PHDAE:
    """`model` with a source in the place of a free port: it follows a signal input of the name of the port's input.

    The source is the port `<port>_source`, which books its work; the port's output is an observable of the same name.
    """
    name = port.input_names()[0].partition("[")[0]
    start = port.input_starts() if port.size is not None else port.input_starts()[0]
    text = port.description or f"input of port {port.name}"
    command = signal_input(name, start, port.size, unit=port.input_unit, description=text)
    blocks = (*model.structure, *model.dissipation)
    if any(v is port for b in blocks for v in b.variables):
        reason = "stands in J or R, where no source can take its place"
        raise ConnectionError(
            f"signal input {name}", f"port {port.name} {reason}", "join a source to it that a signal sets"
        )
    told = port.output_names()[0].partition("[")[0]
    found = signal_output(told, outputs(model)[told].expr, unit=port.output_unit, description=f"output of {port.name}")

    def put(p: Port) -> Port:
        return replace(p, name=f"{p.name}_source", source=command.sx) if p is port else p

    new = model.mapped(lambda v: v, put)
    return replace(new, parameters=(*new.parameters, command), observables=(*new.observables, found))


def with_signal_ports(model: PHDAE, taken: Collection[str], sent: Collection[str]) -> PHDAE:
    """`model` with ports for some of its signal inputs and outputs, by their bare names; the ports stand after its own."""
    inputs = [v for v in model.parameters if v.signal and v.name in taken]
    into = [_port(v.name, "effort", v.size, v.unit, v.start, v.description) for v in inputs]
    values = {
        n: u for v, p in zip(inputs, into, strict=True) for n, u in zip(v.names(), ca.vertsplit(p.u), strict=True)
    }
    model = fed(model, values) if values else model
    found = outputs(model)
    out = {name: _port(name, "flow", _size(name, found[name]), found[name].unit) for name in sent}
    unit = Port("signals", SIGNAL, "flow", {}, source=1.0)
    blocks = [skew(port, unit, -found[name].expr) for name, port in out.items()]
    ports = (*model.ports, *into, *out.values(), *([unit] if out else []))
    return replace(model, ports=ports, structure=(*model.structure, *blocks))


def exchanging(model: PHDAE, left: Collection[str] = ()) -> PHDAE:
    """`model` with ports for its signal inputs, but those `left` and those that do work, and for its signal outputs."""
    free = [v for v in model.parameters if v.signal and not {v.name, *v.names()} & set(left)]
    taken = [v.name for v in free if not works(model, v.names())]
    return with_signal_ports(model, taken, [o.name for o in model.observables if o.signal])


def holding(model: PHDAE, held: Collection[str]) -> PHDAE:
    """`model`, whose ports tell what they do in composed networks where the signal inputs `held` (bare names) are fed."""
    inputs = [v for v in model.parameters if v.signal and v.name in held]
    own = {n: s for v in inputs for n, s in zip(v.names(), ca.vertsplit(v.sx), strict=True)}
    return replace(fed(model, own), parameters=model.parameters) if own else model


def _port(
    name: str, given: Given, size: int | None, unit: str, start: Sequence[float] = (0.0,), description: str = ""
) -> Port:
    domain = replace(SIGNAL, effort_unit=unit, flow_unit=unit)
    return Port(name, domain, given, {}, size, start=start if size else start[0], description=description)


def signal_places(model: PHDAE) -> tuple[dict[str, int], dict[str, int]]:
    """Scalar names of the signals that ports of `model` take and send, with their places among the external inputs."""
    taken, sent, at = dict[str, int](), dict[str, int](), 0
    for port in (p for p in model.ports if p.external):
        if port.signal:
            into = sent if port.sends else taken
            into |= {n: at + j for j, n in enumerate(port.input_names())}
        at += port.n
    return taken, sent


def _size(name: str, output: Output) -> int | None:
    return None if output.names == [name] else len(output.names)


def separate(members: Mapping[str, PHDAE], wires: Collection[Wire], held: Collection[Wire] = ()) -> dict[str, PHDAE]:
    """`members` with ports for those ends of these wires that they are; parameters stay what `held` wires feed."""
    ends = {name: (dict[str, None](), dict[str, None]()) for name in members}
    for w in wires:
        for end, side, name in ((w.target, 0, w.input), (w.source, 1, w.output)):
            if end in ends:
                ends[end][side][name.partition("[")[0]] = None
    kept = {n: {w.input.partition("[")[0] for w in held if w.target == n} for n in members}
    own = {n: holding(m, kept[n]) if kept[n] else m for n, m in members.items()}
    return {n: with_signal_ports(m, *ends[n]) if any(ends[n]) else m for n, m in own.items()}
