"""The nine-bus system of three machines that books on stability use, with all stator and line transients."""

from __future__ import annotations

from functools import cache
from math import pi, sqrt
from typing import Any

from phfmu import Event, Network, Scene
from phfmu.components.electrical.breaker import breaker
from phfmu.components.electrical.machines.machine_data import MachineData
from phfmu.components.electrical.machines.machine_per_unit import from_per_unit
from phfmu.components.electrical.machines.synchronous_machine import Coordinates, synchronous_machine
from phfmu.components.electrical.phases import ALPHA
from phfmu.components.electrical.resistor import transformer
from phfmu.components.electrical.rl_line import rl_line
from phfmu.components.electrical.rlc_load import rlc_load
from phfmu.components.electrical.switch import fault_resistor
from phfmu.operating import PV, Load, NetworkPoint, Slack, Specification, operating_point

BASE, VOLTAGE, FREQUENCY = 100e6, 230e3, 60.0
#: r, x, b in per unit of 100 MVA, 230 kV
LINES = {
    "line45": (0.010, 0.085, 0.176), "line46": (0.017, 0.092, 0.158), "line57": (0.032, 0.161, 0.306),
    "line69": (0.039, 0.170, 0.358), "line78": (0.0085, 0.072, 0.149), "line89": (0.0119, 0.1008, 0.209),
}  # fmt: skip
#: bus -> active and reactive power
LOADS = {"5": (125e6, 50e6), "6": (90e6, 30e6), "8": (100e6, 35e6)}
#: machine -> bus behind its transformer, reactance of that, rated voltage, voltage in per unit, power (the first takes the rest)
PLANTS: dict[str, tuple[str, float, float, float, float]] = {
    "1": ("4", 0.0576, 16.5e3, 1.04, 0.0),
    "2": ("7", 0.0625, 18.0e3, 1.025, 163e6),
    "3": ("9", 0.0586, 13.8e3, 1.025, 85e6),
}
MACHINES: dict[str, dict[str, Any]] = {
    "1": {"H": 23.64, "xl": 0.0336, "xd": 0.146, "xd1": 0.0608, "xd2": 0.06, "Td10": 8.96, "Td20": 0.01,
          "xq": 0.0969, "xq2": 0.06, "Tq20": 0.01},
    "2": {"H": 6.4, "xl": 0.0521, "xd": 0.8958, "xd1": 0.1198, "xd2": 0.11, "Td10": 6.0, "Td20": 0.01,
          "xq": 0.8645, "xq2": 0.1969, "Tq20": 0.535},
    "3": {"H": 3.01, "xl": 0.0742, "xd": 1.3125, "xd1": 0.1813, "xd2": 0.18, "Td10": 5.89, "Td20": 0.01,
          "xq": 1.2578, "xq2": 0.25, "Tq20": 0.6},
}  # fmt: skip


def wscc9(
    *, t_fault: float = 0.1, t_clear: float = 0.18, stop: float = 2.0, coordinates: Coordinates = "dq-flux"
) -> Scene:
    """Three machines, six lines, three loads; a three-phase fault of 1 ohm at bus 7.

    Arguments: t_fault, t_clear [s], when it begins and ends; stop [s], end of the run

    Members gen1 .. gen3 (machines), transformer1 .. 3 with leakage1 .. 3, line45 .. line89, shunt4 .. shunt9 (the load and half
    of the charging of the lines at each bus), fault; junctions bus1 .. bus9.  All begin in the operating point of the published
    power flow; field voltages and torques stay constant.  Where a machine meets its transformer there is no capacitor.
    Source: Anderson and Fouad, Power System Control and Stability, 1977, chapter 2; Sauer and Pai, Power System Dynamics and
    Stability, 1998, chapter 7.  Neither gives dampers: xd'', Td0'' = 10 ms and ra = 1.25e-4 are additions.
    """
    events = (Event(t_fault, "fault.G", 1.0), Event(t_clear, "fault.G", 0.0))
    net = _point(coordinates).started()
    net.description = "nine buses, three machines; three-phase fault at bus 7"
    return Scene(
        "wscc9",
        net,
        stop=stop,
        step=5e-5,
        events=events,
        restart=4,
        shown=("gen1.shaft.speed", "gen2.shaft.speed", "gen3.shaft.speed", "bus7.v"),
    )


def wscc9_steady(*, stop: float = 1.0, coordinates: Coordinates = "dq-flux") -> Scene:
    """`wscc9` without the fault until `stop` [s]: a steady state, in which amplitudes, speeds and powers stay."""
    point = _point(coordinates)
    net = point.started()
    net.description = "nine buses, three machines, in steady state"
    return Scene(
        "wscc9_steady", net, stop=stop, step=5e-5, shown=("gen2.shaft.speed", "line57.i", "bus7.v"), steady=point
    )


def wscc9_trip(
    *,
    t_fault: float = 0.1,
    t_clear: float = 0.18,
    stop: float = 2.0,
    chop: float = 0.0,
    coordinates: Coordinates = "dq-flux",
) -> Scene:
    """`wscc9` whose line 5-7 is opened when the fault ends: each pole at its next current zero.

    Arguments: those of `wscc9`; chop [A], current below which a pole opens already, its energy L i^2/2 lost

    The mode line57.closed tells each pole; the charging of the line stays at its buses.
    """
    point = _point(coordinates)
    net = point.started()
    (R, L), v, i = _line("line57"), VOLTAGE * sqrt(2.0 / 3.0), sqrt(2.0 / 3.0) * BASE / VOLTAGE
    start = [point.states[f"line57.flux[{k}]"] / L for k in (1, 2, 3)]
    net.members["line57"] = breaker(R, L, chop=chop, i=i, v=v, start=start)
    net.description = "nine buses, three machines; three-phase fault at bus 7, line 5-7 opened at its current zeros"
    events = (Event(t_fault, "fault.G", 1.0), Event(t_clear, "fault.G", 0.0), Event(t_clear, "line57.command", 0.0))
    return Scene("wscc9_trip", net, stop=stop, step=5e-5, events=events, restart=4)


def machine_of(number: str) -> MachineData:
    """The machine `1`, `2` or `3` on the base of 100 MVA; its field takes 1000 A at rated voltage without load."""
    voltage = PLANTS[number][2]
    return from_per_unit(
        f"wscc9_gen{number}", "GENSAL", Sn=BASE, Vn_rms_ll=voltage, fn=FREQUENCY, no_load_field_current=1000.0, ra=1.25e-4,
        **MACHINES[number],
    )  # fmt: skip


@cache
def _point(coordinates: Coordinates) -> NetworkPoint:
    """The operating point of the flat network."""
    net, specifications = _flat(coordinates)
    return operating_point(net, specifications, FREQUENCY)


def _flat(coordinates: Coordinates) -> tuple[Network, list[Specification]]:
    """The network with voltages of one per unit and angle 0 and lines without current, and what is to be met."""
    w, Z = 2.0 * pi * FREQUENCY, VOLTAGE**2 / BASE
    v = VOLTAGE * sqrt(2.0 / 3.0)
    net = Network("wscc9")
    ends: dict[str, list[str]] = {bus: [] for bus in "456789"}
    charging = dict.fromkeys(ends, 0.0)
    specifications: list[Specification] = []
    for k, (bus, x, rated, share, P) in PLANTS.items():
        net.add(f"gen{k}", synchronous_machine(machine_of(k), coordinates=coordinates))
        i = sqrt(2.0 / 3.0) * BASE / rated
        net.add(f"leakage{k}", rl_line(0.0, x * rated**2 / BASE / w, v=rated * sqrt(2.0 / 3.0), rated=i))
        net.add(f"transformer{k}", transformer(rated / VOLTAGE, size=3, v=v, i=i))
        net.junction(f"bus{k}", [f"gen{k}.terminal", f"leakage{k}.a"])
        net.connect(f"leakage{k}.b", f"transformer{k}.b", name=f"inside{k}")
        ends[bus].append(f"transformer{k}.a")
        V = share * rated
        specifications.append(PV(f"gen{k}.terminal", P=P, V=V) if P else Slack(f"gen{k}.terminal", V=V))
    for name, (_, _, b) in LINES.items():
        net.add(name, rl_line(*_line(name), v=v, rated=sqrt(2.0 / 3.0) * BASE / VOLTAGE))
        for bus, end in zip(name[4:], "ab", strict=True):
            ends[bus].append(f"{name}.{end}")
            charging[bus] += b / 2
    for bus, b in charging.items():
        P, Q = LOADS.get(bus, (0.0, 0.0))
        R, L = (VOLTAGE**2 / P, VOLTAGE**2 / Q / w) if P else (None, None)
        reactor = [0.0] * 3 if L is None else _phases(v / (1j * w * L))
        net.add(f"shunt{bus}", rlc_load(R, L, b / Z / w, v=_phases(v), i=reactor, nominal=v))
        ends[bus].append(f"shunt{bus}.terminal")
        if P:
            specifications.append(Load(f"shunt{bus}.terminal", P=P, Q=Q))
    net.add("fault", fault_resistor(nominal=v))
    ends["7"].append("fault.terminal")
    for bus, ports in ends.items():
        net.junction(f"bus{bus}", ports)
    return net, specifications


def _line(name: str) -> tuple[float, float]:
    """R [ohm] and L [H] of a line."""
    r, x, _ = LINES[name]
    Z = VOLTAGE**2 / BASE
    return r * Z, x * Z / (2.0 * pi * FREQUENCY)


def _phases(phasor: complex) -> list[float]:
    from cmath import exp

    return [(phasor * exp(-1j * a)).real for a in ALPHA]
