"""Composition: members and junctions -> one PHDAE.

Per junction the common variable c and, for every port that is given the other variable, its input u_j become algebraic
variables.  With P the map from these unknowns to port inputs, U = P xi, the rows are

    0 = P^T Y + C xi,    C skew (c against u_j),

so the junctions join the structure matrix J and create no power (van der Schaft, Jeltsema 2014, section 6).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import casadi as ca

from phfmu.collector import resting
from phfmu.declare.block import skew
from phfmu.declare.entries.copies import copied
from phfmu.declare.event import StateEvent
from phfmu.declare.observable import Observable
from phfmu.declare.phdae import PHDAE
from phfmu.declare.port import Port
from phfmu.declare.variable import Variable
from phfmu.network.junction import ConnectionError, End, Junction, JunctionUnknowns, junction_unknowns
from phfmu.network.signal_ports import fed
from phfmu.network.wires import Wire, outputs, signal_symbols


@resting()
def compose(
    name: str,
    members: Mapping[str, PHDAE],
    junctions: Sequence[Junction],
    description: str = "",
    wires: Sequence[Wire] = (),
) -> PHDAE:
    """One PHDAE with all states, terms and free ports of the members, and the junction equations."""
    require_members(name, members)
    if wires:
        members = wired(members, wires)
    unknowns = [junction_unknowns(members, j) for j in junctions]
    feed = {end: u for u in unknowns for end in u.junction.ends}
    parts = [_prefixed(member, model, feed) for member, model in members.items()]
    blocks = []
    for u in unknowns:
        for v in u.dual.values():
            blocks.append(skew(u.common, v, -ca.SX.eye(v.n)))
    return PHDAE(
        name,
        states=_all(parts, "states"),
        algebraics=_all(parts, "algebraics") + tuple(v for u in unknowns for v in (u.common, *u.dual.values())),
        parameters=_all(parts, "parameters"),
        energies=_all(parts, "energies"),
        E={v: m for p in parts for v, m in p.E.items()},
        structure=_all(parts, "structure") + tuple(blocks),
        dissipation=_all(parts, "dissipation"),
        ports=_all(parts, "ports"),
        z={v: m for p in parts for v, m in p.z.items()},
        constraints=_all(parts, "constraints"),
        closed=_all(parts, "closed"),
        observables=_all(parts, "observables"),
        state_events=_all(parts, "state_events"),
        switches=_all(parts, "switches"),
        members=_all(parts, "members"),
        junctions=tuple((j.name, tuple(map(str, j.ends))) for j in junctions),
        description=description,
        shapes=_all(parts, "shapes"),
    )


def wired(members: Mapping[str, PHDAE], wires: Sequence[Wire]) -> dict[str, PHDAE]:
    """Members whose signal inputs are the outputs that feed them; `wires` are in order."""
    symbols, exprs = ca.SX(0, 1), ca.SX(0, 1)
    values: dict[str, dict[str, ca.SX]] = {}
    for w in wires:
        found = outputs(members[w.source])[w.output.partition("[")[0]]
        expr = ca.substitute(found.expr[found.names.index(w.output)], symbols, exprs)
        expr = expr if (w.factor, w.offset) == (1.0, 0.0) else w.factor * expr + w.offset
        (symbol,) = signal_symbols(members[w.target], [w.input])
        symbols, exprs = ca.vertcat(symbols, symbol), ca.vertcat(exprs, expr)
        values.setdefault(w.target, {})[w.input] = expr
    return {name: fed(model, values[name]) if name in values else model for name, model in members.items()}


def require_members(name: str, members: Mapping[str, object]) -> None:
    """ConnectionError if there is nothing to step."""
    if not members:
        raise ConnectionError(f"network '{name}'", "has no members", "add one: network.add('name', component)")


def _all(parts: list[PHDAE], field: str) -> tuple:
    return tuple(item for p in parts for item in getattr(p, field))


def _owner(prefix: str, owner: str) -> str:
    return f"{prefix}.{owner}" if owner else prefix


def _prefixed(prefix: str, model: PHDAE, feed: dict[End, JunctionUnknowns]) -> PHDAE:
    """`model` with prefixed names and its joined ports bound to the junction variables."""

    def rename(v: Variable) -> Variable:
        return copied(v, name=f"{prefix}.{v.name}")

    def bind(port: Port) -> Port:
        end = End(prefix, port.name)
        bound = port.bound
        if end in feed:
            bound = tuple(ca.vertsplit(feed[end].input_of(end).sx))
        return copied(port, name=f"{prefix}.{port.name}", owner=_owner(prefix, port.owner), bound=bound)

    new = model.mapped(rename, bind)

    def owned(items: tuple) -> tuple:
        return tuple(copied(i, owner=_owner(prefix, i.owner)) for i in items)

    return copied(
        new,
        energies=owned(new.energies),
        structure=owned(new.structure),
        dissipation=owned(new.dissipation),
        constraints=owned(new.constraints),
        closed=owned(new.closed),
        observables=tuple(_renamed(o, prefix) for o in new.observables),
        state_events=tuple(_event(e, prefix) for e in new.state_events),
        switches=tuple(replace(s, name=f"{prefix}.{s.name}", owner=_owner(prefix, s.owner)) for s in new.switches),
        members=tuple(_owner(prefix, m) for m in model.members),
        junctions=(),
        shapes=tuple(s.prefixed(prefix) for s in new.shapes),
    )


def _renamed(o: Observable, prefix: str) -> Observable:
    return copied(o, name=f"{prefix}.{o.name}")


def _event(e: StateEvent, prefix: str) -> StateEvent:
    guard = replace(e.guard, name=f"{prefix}.{e.guard.name}")
    return replace(e, guard=guard, jump=e.jump and replace(e.jump, owner=_owner(prefix, e.jump.owner)))
