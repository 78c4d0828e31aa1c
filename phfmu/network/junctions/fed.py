"""Signal inputs of a member replaced by the expressions that feed them, when a network is composed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import casadi as ca

from phfmu.declare.block import Block
from phfmu.declare.coefficients import coefficient
from phfmu.declare.event import StateEvent
from phfmu.declare.phdae import PHDAE
from phfmu.declare.port import Port
from phfmu.declare.signal import driven
from phfmu.declare.switch import Switch
from phfmu.declare.variable import Variable, _sx


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

    def block(b: Block) -> Block:
        return replace(b, matrix=put(b.matrix))

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
        structure=tuple(map(block, model.structure)),
        dissipation=tuple(map(block, model.dissipation)),
        ports=tuple(map(port, model.ports)),
        observables=tuple(replace(o, expr=put(o.expr)) for o in model.observables),
        z={v: put(m) for v, m in model.z.items()},
        state_events=tuple(map(event, model.state_events)),
        switches=tuple(map(switch, model.switches)),
    )
