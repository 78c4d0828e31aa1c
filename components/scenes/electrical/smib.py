"""Single machine at an infinite bus."""

from __future__ import annotations

from cmath import phase
from math import sqrt

from phfmu import PHDAE, Event, Network, Scene
from phfmu.components.electrical.breaker import breaker, clearing_fault
from phfmu.components.electrical.infinite_bus import infinite_bus
from phfmu.components.electrical.machines.machine_data import MachineData, machine_set
from phfmu.components.electrical.machines.machine_init import OperatingPoint, steady_state
from phfmu.components.electrical.machines.synchronous_machine import Coordinates, machine_at_bus, synchronous_machine
from phfmu.components.electrical.rl_line import rl_line


def smib(machine: str = "kundur555_1q", *, coordinates: Coordinates = "dq-flux", name: str = "smib") -> Scene:
    """A generator at 0.8 and 0.2 of rated P and Q feeds a stiff grid over a line; its torque rises by 10 % at 0.5 s.

    Line per phase R = 0.02, X = 0.3 of the machine's base impedance; the machine's bus has no capacitor (index 2).
    Source of the machine data: Kundur 1994 (kundur555_1q), Krause et al. 2013 (krause_hydro325); d = 50 N.m.s/rad.
    """
    data, start, R, L, grid = circuit(machine)
    net = Network(name, description=f"{machine} at an infinite bus, torque step at 0.5 s")
    net.add("gen", synchronous_machine(data, coordinates=coordinates, start=start))
    net.add("line", rl_line(R, L, i=[-x for x in start.I[:3]], v=data.Vn_rms_ll * sqrt(2.0 / 3.0)))
    net.add("grid", grid)
    net.junction("bus1", ["gen.terminal", "line.a"])
    net.junction("bus2", ["line.b", "grid.terminal"])
    return _scene(name, net, start)


def smib_folded(
    machine: str = "kundur555_1q", *, coordinates: Coordinates = "dq-flux", name: str = "smib_folded"
) -> Scene:
    """`smib` with the line folded into the machine: the same currents and angle, but no node without capacitor.

    Index 1, so that all states have the order of the scheme.  bus1 with its voltage does not appear.
    """
    data, start, R, L, grid = circuit(machine)
    net = Network(name, description=f"{machine} with its line at an infinite bus, torque step at 0.5 s")
    net.add("gen", machine_at_bus(data, R, L, coordinates=coordinates, start=start))
    net.add("grid", grid)
    net.connect("gen.terminal", "grid.terminal", name="bus2")
    return _scene(name, net, start)


def circuit(machine: str) -> tuple[MachineData, OperatingPoint, float, float, PHDAE]:
    """Machine, its start, line R [ohm] and L [H] per phase, and the grid that feeds it."""
    data = machine_set(machine, d=50.0)
    base = data.Vn_rms_ll**2 / data.Sn
    R, L = 0.02 * base, 0.3 * base / data.omega
    v = data.Vn_rms_ll * sqrt(2.0 / 3.0)
    i = -(complex(0.8, 0.2) * data.Sn / (1.5 * v)).conjugate()  # current into the machine
    grid = v + (R + 1j * data.omega * L) * i
    return data, steady_state(data), R, L, infinite_bus(abs(grid), data.fn, phase(grid), i=abs(i))


def _scene(name: str, net: Network, start: OperatingPoint) -> Scene:
    step = Event(0.5, "gen.shaft.torque", 1.1 * start.tau)
    return Scene(name, net, stop=5.0, step=1e-4, events=(step,), shown=("gen.shaft.speed", "gen.Te", "gen.I[1]"))


def smib_hydro() -> Scene:
    """`smib` with the salient hydro machine krause_hydro325."""
    return smib("krause_hydro325", name="smib_hydro")


def smib_breaker(
    machine: str = "kundur555_1q",
    *,
    t_fault: float = 0.02,
    t_open: float = 0.08,
    chop: float = 0.0,
    forced: bool = False,
) -> Scene:
    """`smib` with two equal lines: a fault on one of them, a breaker at the machine opens it, the fault clears.

    Each line has twice the R and X of `smib`; the fault at `t_fault` [s],
    1 mohm and 10 uH per phase to ground, is at 0.2 of the second one.
    From `t_open` [s] on each pole of the breaker and each phase of the fault opens at its next current zero, with `chop` [A] the
    breaker below that current already, or `forced` at once.  Both nodes, at the machine and at the fault, have no capacitor.
    """
    data, start, R, L, grid = circuit(machine)
    half, v = [-x / 2 for x in start.I[:3]], data.Vn_rms_ll * sqrt(2.0 / 3.0)
    at, i = 0.2, sqrt(2.0 / 3.0) * data.Sn / data.Vn_rms_ll
    net = Network("smib_breaker", description=f"{machine} on two lines, fault on one, which opens at its current zeros")
    net.add("gen", synchronous_machine(data, start=start))
    net.add("line", rl_line(2 * R, 2 * L, i=half, v=v))
    net.add("breaker", breaker(2 * at * R, 2 * at * L, chop=chop, i=i, v=v, start=half))
    net.add("rest", rl_line(2 * (1 - at) * R, 2 * (1 - at) * L, i=half, v=v))
    net.add("fault", clearing_fault(1e-3, 1e-5, i=i, v=v))
    net.add("grid", grid)
    net.junction("bus1", ["gen.terminal", "line.a", "breaker.a"])
    net.junction("spot", ["breaker.b", "rest.a", "fault.a"])
    net.junction("bus2", ["line.b", "rest.b", "grid.terminal"])
    command = 2.0 if forced else 0.0
    events = (
        Event(t_fault, "fault.command", 1.0),
        Event(t_open, "breaker.command", command),
        Event(t_open, "fault.command", 0.0),
    )
    return Scene(
        "smib_breaker",
        net,
        stop=0.2,
        step=2e-4,
        events=events,
        shown=("gen.I[1]", "gen.I[2]", "gen.I[3]", "fault.i", "gen.Te"),
    )
