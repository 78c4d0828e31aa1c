"""Controllers of a network: their states and set points follow, block by block, from what the network needs.

Where each input that controllers give the network (a field voltage, a torque) meets one freed value of a controller (Vref,
Pref), the equations are block triangular: the network with these inputs freed comes first, then the controllers between
what they measure and what they have to give.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.network.network import Network
from phfmu.operating.newton import ITERATIONS, REST, solution, solved
from phfmu.operating.specifications import Specification
from phfmu.operating.system import NoOperatingPoint, System
from phfmu.signals import of_member
from phfmu.words import first_few

Array = NDArray[np.float64]

#: of the nominal value of a guard, by which a point may lie beyond it
BEYOND = 1e-9


def solved_in_blocks(system: System) -> tuple[Array, int]:
    """The unknowns and the iterations of a point: first of the network, then of its controllers."""
    given = _given(system)
    if not given:
        return solved(system)
    net = system.net
    controllers = _controllers(net)
    alone = replace(
        net,
        members={n: m for n, m in net.members.items() if n not in controllers},
        wires=[w for w in net.wires if not {w.source, w.target} & controllers],
    )
    freed = [replace(s, free=s.free and tuple(given.get(n, n) for n in s.free)) for s in system.specifications]
    first = System(alone, freed, system.omega)
    v, taken = solved(first)
    values: dict[str, list[float]] = {}
    for name, value in zip(first.named, v, strict=True):
        values.setdefault(name, []).append(float(value))
    start = np.array(system.start)
    for i, name in enumerate(system.named):
        if values.get(name):
            start[i] = values[name].pop(0)
    v, more = _controlled(system, start, controllers, given)
    return v, taken + more


def require_within_limits(net: Network, values: Mapping[str, float]) -> None:
    """NoOperatingPoint names the limits of controllers that a point lies beyond; `values`: states and parameters by name."""
    found = []
    for name in sorted(_controllers(net)):
        model = net.declared[name]
        symbols = [v.sx for v in (*model.states, *model.parameters)]
        own = {n: values[of_member(name, n)] for v in (*model.states, *model.parameters) for n in v.names()}
        armed = [e.guard for e in model.state_events if all(own[n] == value for n, value in e.when.items())]
        if not armed:
            continue
        function = ca.Function("guards", [ca.vertcat(*symbols)], [ca.vertcat(*(g.expr for g in armed))])
        reached = np.array(function(list(own.values()))).ravel()
        for guard, value in zip(armed, reached, strict=True):
            if guard.direction * value > BEYOND * guard.nominal:
                unit = "" if guard.unit == "1" else f" {guard.unit}"
                found.append(f"{of_member(name, guard.name)} by {abs(value):.4g}{unit}")
    if found:
        raise NoOperatingPoint(
            f"{net.name}: the point lies beyond limits of its controllers: {first_few(found)}; ask for less power or voltage, "
            "or give the limits more room"
        )


def _controllers(net: Network) -> set[str]:
    """Members that stand at no junction and have no energy: signals in, signals out."""
    joined = {end.member for j in net.junctions for end in j.ends}
    return {n for n, m in net.declared.items() if n not in joined and not (m.energies or m.closed or m.algebraics)}


def _given(system: System) -> dict[str, str]:
    """Freed value of a controller -> the input of the network that it is found for; {} where these are not as many.

    Such an input is the first that signals lead to from the controller.
    """
    net, out = system.net, dict[str, str]()
    controllers = _controllers(net)
    into = {of_member(w.target, w.input) for w in net.wires if w.source in controllers and w.target not in controllers}
    for name in (n for s in system.specifications for n in _free(s) if n.partition(".")[0] in controllers):
        reached, front = set[str](), [name.partition(".")[0]]
        while front:
            member = front.pop()
            reached.add(member)
            front += [w.target for w in net.wires if w.source == member and w.target in controllers - reached]
        ends = [of_member(w.target, w.input) for w in net.wires if w.source in reached and w.target not in controllers]
        left = [e for e in ends if e not in out.values()]
        if not left:
            return {}
        out[name] = left[0]
    return out if set(out.values()) == into else {}


def _free(specification: Specification) -> tuple[str, ...]:
    return tuple(specification.free or ())


def _controlled(system: System, v: Array, controllers: set[str], given: dict[str, str]) -> tuple[Array, int]:
    """Newton's method for the rows of the controllers and the signals; what stands in the network is kept."""
    rows: list[int] = []
    columns: list[int] = [system.freed[n] for n in given]
    for name in controllers:
        n = system.kind_of[name].size.x
        rows += range(system.row_of[name], system.row_of[name] + n)
        columns += range(system.state_at[name], system.state_at[name] + n)
    for wire, (row, at) in zip(system.net.wires, system.wired, strict=True):
        if wire.target in controllers:
            columns.append(at)
        if {wire.source, wire.target} & controllers:
            rows.append(row)
    for iteration in range(1, ITERATIONS + 1):
        F, J = system.evaluate(v)
        try:
            update = solution(J[rows][:, columns], F[rows])
        except RuntimeError:
            break
        v = v.copy()
        v[columns] -= update
        if (np.abs(update) <= 1e3 * REST * np.maximum(np.abs(v[columns]), 1.0)).all():
            return v, iteration
    raise NoOperatingPoint(
        f"{system.net.name}: no set points of {', '.join(given)} were found that give what the network needs at "
        f"{', '.join(given.values())}; check the parameters of {', '.join(sorted(controllers))}"
    )
