"""Machines along a line."""

from __future__ import annotations

from math import sqrt

from phfmu import Event, Network, Scene
from phfmu.components.electrical.infinite_bus import infinite_bus
from phfmu.components.electrical.machines.machine_data import machine_set
from phfmu.components.electrical.machines.machine_init import steady_state
from phfmu.components.electrical.machines.synchronous_machine import Coordinates, synchronous_machine
from phfmu.components.electrical.phases import ALPHA
from phfmu.components.electrical.rl_line import rl_line
from phfmu.components.electrical.rlc_load import rlc_load


def ladder(n: int = 3, *, coordinates: Coordinates = "dq-flux") -> Scene:
    """n turbo generators, each with a load that takes its power, along a line that starts at a stiff grid.

    All buses begin at rated voltage and phase 0, the lines without current; the torque of the first machine rises by 10 %
    at 1 ms and its swing travels along the line.  Load per bus: 0.8 of the rated power and -0.2 of it as capacitor,
    0.4 as reactor; lines R = 0.01, X = 0.2 of the machine's base impedance; data kundur555_1q (Kundur 1994).
    Errors: ValueError for n below 1.
    """
    if n < 1:
        raise ValueError(f"ladder: n = {n}, at least one machine is needed")
    data = machine_set("kundur555_1q", d=50.0)
    start = steady_state(data)
    V, w = data.Vn_rms_ll, data.omega
    v, base = V * sqrt(2.0 / 3.0), data.Vn_rms_ll**2 / data.Sn
    R, L, C = base / 0.8, base / 0.4 / w, 0.2 / base / w
    net = Network(f"ladder_{n}", description=f"{n} machines along a line, torque step at the first")
    net.add("grid", infinite_bus(v, data.fn, 0.0, i=v / base))
    for i in range(1, n + 1):
        net.add(f"gen{i}", synchronous_machine(data, coordinates=coordinates, start=start))
        reactor = [-(1j * v / (w * L) * _turn(a)).real for a in ALPHA]
        net.add(f"load{i}", rlc_load(R, L, C, v=[(v * _turn(a)).real for a in ALPHA], i=reactor, nominal=v))
        net.add(f"line{i}", rl_line(0.01 * base, 0.2 * base / w, v=v))
    net.junction("bus0", ["grid.terminal", "line1.a"])
    for i in range(1, n + 1):
        ends = [f"gen{i}.terminal", f"load{i}.terminal", f"line{i}.b"]
        net.junction(f"bus{i}", ends + ([f"line{i + 1}.a"] if i < n else []))
    event = Event(1e-3, "gen1.shaft.torque", 1.1 * start.tau)
    return Scene(
        f"ladder_{n}",
        net,
        stop=1.0,
        step=1e-4,
        events=(event,),
        shown=("gen1.shaft.speed", "gen2.shaft.speed", "gen1.Te", "gen2.Te"),
    )


def _turn(angle: float) -> complex:
    from cmath import exp

    return exp(-1j * angle)
