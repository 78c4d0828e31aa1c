"""Scenes with signals between members, composed and apart.

`governed`: a machine at a grid over a line (a bare node between them); a governor measures its speed and sets the torque of a
turbine, an exciter measures its electrical torque (not linear in the states) and sets the voltage of its field.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from phfmu import (
    PHDAE,
    Collocated,
    Coupled,
    EngineMember,
    Monolithic,
    Network,
    Options,
    PythonInstance,
    build_model,
    driven,
    run,
    signal_input,
    signal_output,
    state,
)
from phfmu.components.electrical.machines.synchronous_machine import machine_at_bus
from phfmu.components.electrical.sources import voltage_source
from phfmu.components.mechanical.torque_source import torque_source
from phfmu.components.scenes.electrical.smib import circuit, smib
from phfmu.components.scenes.mechanical.speed_control import speed_control
from phfmu.network.members.member import Member
from phfmu.network.scene import Event
from tests.network.both_loops import called_back

STOP = 0.02
COMPARED = ("gen.theta", "gen.p", "governor.x", "governor.out", "exciter.x", "exciter.out", "gen.Te")


def lag(name: str, gain: float, T: float, at: float, level: float, unit: str, command: str) -> PHDAE:
    """T x' = gain (at - measured) - x;  out = level + x."""
    measured = signal_input("measured", at, unit=unit)
    reference = signal_input("reference", at, unit=unit)
    x = state("x", unit=command, nominal=abs(level))
    right = (gain * (reference - measured) - x) / T
    return PHDAE(
        name, (x,), parameters=(measured, reference), ports=(driven("lag", {x: right}),),
        observables=(signal_output("out", level + x, unit=command),),
    )  # fmt: skip


def governed(folded: bool = False) -> Network:
    """The loop; `folded`: the line is part of the machine, so that there is no bare node (index 1)."""
    data, start, R, L, grid = circuit("kundur555_1q")
    if folded:
        net = Network("governed")
        net.add("gen", machine_at_bus(data, R, L, start=start))
        net.add("grid", grid)
        net.connect("gen.terminal", "grid.terminal", name="bus2")
    else:
        whole = smib().system
        assert isinstance(whole, Network)
        net = Network("governed", members=dict(whole.members), junctions=list(whole.junctions))
    w, base = data.omega / data.pole_pairs, data.Sn / data.omega * data.pole_pairs
    torque = signal_input("level", start.Vf, unit="V")
    net.add("turbine", torque_source(start.tau, nominal=base))
    net.add("field", voltage_source(torque.sx, parameters=(torque,), v=start.Vf, i=1e3))
    net.connect("gen.shaft", "turbine.shaft", name="shaft")
    net.connect("gen.field", "field.terminal", name="winding")
    # strong and fast, so that the loops are felt within a few steps
    net.add("governor", lag("governor", 50.0 * base / w, 0.02, w, start.tau, "rad/s", "N.m"))
    net.add("exciter", lag("exciter", 5.0 * start.Vf / base, 0.01, -start.tau, start.Vf, "N.m", "V"))
    net.signal("gen.shaft.speed", "governor.measured")
    net.signal("governor.out", "turbine.torque")
    net.signal("gen.Te", "exciter.measured")
    net.signal("exciter.out", "field.level")
    return net


def step_of_load(net: Network) -> tuple[Event, ...]:
    """The set points move at once: the governor's by 1 %, the exciter's by 20 %."""
    values = {
        n: v.start[0] for n in ("governor", "exciter") for v in net.declared[n].parameters if v.name == "reference"
    }
    return (
        Event(0.0, "governor.reference", 1.01 * values["governor"]),
        Event(0.0, "exciter.reference", 1.2 * values["exciter"]),
    )


def apart(
    net: Network, k: int, engine: Any = PythonInstance, parts: dict[str, int] | None = None, **options: Any
) -> Coupled:
    members: list[Member] = []
    for name, part in net.separate().items():
        model = build_model(part, Collocated(k))
        members.append(EngineMember(name, model, engine(model), (parts or {}).get(name, 1)))
    return Coupled(net, members, **options)


def composed(net: Network, k: int, engine: Any = PythonInstance) -> Monolithic:
    model = build_model(net.compose(), Collocated(k))
    return Monolithic(model, engine(model))


def ran(net: Network, system: Any, h: float, stop: float = STOP) -> Any:
    return run(system, Options(stop=stop, step=h, events=step_of_load(net)))


def apart_by(one: Any, other: Any, names: tuple[str, ...] = COMPARED) -> float:
    """Largest relative difference of columns."""
    return max(float(np.abs(one.column(n) - other.column(n)).max() / np.abs(other.column(n)).max()) for n in names)


def loop() -> Network:
    """Rotor, controller and actuator."""
    net = speed_control().system
    assert isinstance(net, Network)
    return net


def speed(k: int, engine: Any = PythonInstance, called: bool = False, **how: Any) -> tuple[Any, Coupled]:
    """The controlled rotor, apart."""
    scene = speed_control()
    system = called_back(apart(loop(), k, engine, **how), called)
    return run(system, Options(stop=0.2, step=1e-2, events=scene.events)), system


LOOP = ("rotor.w", "controller.x", "controller.command", "controller.error")
