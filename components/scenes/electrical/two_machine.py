"""Two machines, a line, a load and a fault."""

from __future__ import annotations

from cmath import phase
from dataclasses import replace
from math import sqrt

from phfmu import Event, Network, Scene
from phfmu.components.electrical.machines.machine_data import MachineData, machine_set
from phfmu.components.electrical.machines.machine_init import steady_state
from phfmu.components.electrical.machines.synchronous_machine import Coordinates, synchronous_machine
from phfmu.components.electrical.phases import ALPHA
from phfmu.components.electrical.rl_line import rl_line
from phfmu.components.electrical.rlc_load import rlc_load
from phfmu.components.electrical.switch import fault_resistor

FAULT_R = 0.05


def rebased(data: MachineData, V: float) -> MachineData:
    """The same per-unit machine wound for the line-line voltage V: stator and damper turns scale, the field keeps its own."""
    k = V / data.Vn_rms_ll
    turns = [1.0 if j == 0 else k for j in range(len(data.axis))]
    return replace(
        data,
        Vn_rms_ll=V, Ra=data.Ra * k**2, Ld=data.Ld * k**2, Lq=data.Lq * k**2, L0=data.L0 * k**2,
        Ll=None if data.Ll is None else data.Ll * k**2,
        R_rotor=tuple(r * t**2 for r, t in zip(data.R_rotor, turns, strict=True)),
        M_stator_rotor=tuple(m * k * t for m, t in zip(data.M_stator_rotor, turns, strict=True)),
        L_rotor=tuple(tuple(x * a * b for x, b in zip(row, turns, strict=True))
                      for row, a in zip(data.L_rotor, turns, strict=True)),
    )  # fmt: skip


def two_machine(
    *, t_fault: float = 0.1, t_clear: float = 0.2, stop: float = 2.0, coordinates: Coordinates = "dq-flux"
) -> Scene:
    """A turbo generator behind a line and a hydro generator at the load; three-phase fault at the load bus.

    Bus 2: 24 kV, load 600 MW, 150 Mvar, -60 Mvar (capacitor) as parallel R, L, C per phase; machine 2 delivers 240 MW,
    60 Mvar, machine 1 the rest over R = 10.4 mohm, L = 0.551 mH.  Bus 1 has no capacitor (index 2).
    Fault: 0.05 ohm per phase to ground from t_fault [s] until t_clear [s]; stop [s]: end of the run.
    Field voltages and torques stay constant.
    """
    V = 24e3
    one = machine_set("kundur555_1q", d=50.0)
    two = rebased(machine_set("krause_hydro325", d=50.0), V)
    w = one.omega
    R, L, C = V**2 / 600e6, V**2 / 150e6 / w, 60e6 / V**2 / w
    base = one.Vn_rms_ll**2 / one.Sn
    line_R, line_L = 0.01 * base, 0.2 * base / w
    v2 = V * sqrt(2.0 / 3.0)
    load_current = v2 * (1 / R + 1 / (1j * w * L) + 1j * w * C)
    line_current = load_current - (complex(240e6, 60e6) / (1.5 * v2)).conjugate()
    v1 = v2 + (line_R + 1j * w * line_L) * line_current
    s1 = 1.5 * v1 * line_current.conjugate()
    start1 = steady_state(one, s1.real, s1.imag, abs(v1) / sqrt(2.0 / 3.0), phase(v1))
    start2 = steady_state(two, 240e6, 60e6, V, 0.0)
    net = Network("two_machine", description="two machines, line, load; fault at the load bus")
    net.add("m1", synchronous_machine(one, coordinates=coordinates, start=start1))
    net.add("m2", synchronous_machine(two, coordinates=coordinates, start=start2))
    net.add("line", rl_line(line_R, line_L, i=_phases(line_current), v=v2))
    net.add("load", rlc_load(R, L, C, v=_phases(complex(v2)), i=_phases(v2 / (1j * w * L)), nominal=v2))
    net.add("fault", fault_resistor(nominal=v2))
    net.junction("bus1", ["m1.terminal", "line.a"])
    net.junction("bus2", ["line.b", "m2.terminal", "load.terminal", "fault.terminal"])
    events = (Event(t_fault, "fault.G", 1.0 / FAULT_R), Event(t_clear, "fault.G", 0.0))
    # the fault discharges the capacitor in 14 us, which Gauss nodes would let ring at this step
    return Scene(
        "two_machine",
        net,
        stop=stop,
        step=1e-4,
        events=events,
        restart=2,
        shown=("m1.shaft.speed", "m2.shaft.speed", "load.v[1]", "m1.Te", "m2.Te"),
    )


def _phases(phasor: complex) -> list[float]:
    from cmath import exp

    return [(phasor * exp(-1j * a)).real for a in ALPHA]
