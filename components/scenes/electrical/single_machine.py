"""A single synchronous machine at its extremes: without torque, from standstill, without any resistance."""

from __future__ import annotations

from math import sqrt

from phfmu import Network, Scene
from phfmu.components.electrical.infinite_bus import infinite_bus
from phfmu.components.electrical.machines.machine_data import MachineData, machine_set
from phfmu.components.electrical.machines.machine_init import operating_point, steady_state
from phfmu.components.electrical.machines.synchronous_machine import Coordinates, synchronous_machine
from phfmu.components.electrical.resistor import resistor
from phfmu.components.electrical.rl_line import rl_line
from phfmu.components.electrical.rlc_load import rlc_load


def spin_down(R: float = 1.0, *, coordinates: Coordinates = "dq-flux", stop: float = 2.0) -> Scene:
    """A hydro generator at rated speed, no longer driven, brakes on a resistor until the rotor is slow.

    Arguments: R [1], the resistor of each phase in per unit of the machine; stop [s]

    Members gen (krause_hydro325 with a twentieth of its inertia, its field voltage that of rated voltage without load,
    d = 50 N.m.s/rad) and brake.  The energy of the rotor, 0.375 s of rated power, becomes heat in brake, windings and friction.
    """
    data = machine_set("krause_hydro325", d=50.0)
    data = machine_set(data, J=data.J / 20.0)
    start = steady_state(data, P=0.0, Q=0.0)
    Z = data.Vn_rms_ll**2 / data.Sn
    still = operating_point(data, start.I, start.p, start.theta, Vf=start.Vf)
    net = Network("spin_down", description="a generator without torque brakes on a resistor")
    net.add("gen", synchronous_machine(data, coordinates=coordinates, start=still))
    net.add("brake", resistor(R * Z, size=3, given="flow", nominal=sqrt(2.0 / 3.0) * data.Sn / data.Vn_rms_ll))
    net.junction("bus", ["gen.terminal", "brake.terminal"])
    return Scene("spin_down", net, stop=stop, step=2e-4, shown=("gen.shaft.speed", "gen.Te", "brake.terminal.i"))


def stall_start(*, coordinates: Coordinates = "dq-flux", stop: float = 3.0) -> Scene:
    """A synchronous machine at standstill is switched onto a grid of rated voltage and starts as an induction motor.

    Member gen (krause_hydro325 with a hundredth of its inertia, its field winding closed without a voltage), line (X = 0.1 per
    unit), grid.  Rotor speed and momentum begin at exactly 0; its dampers give the torque.

    Arguments: stop [s]
    """
    data = machine_set("krause_hydro325")
    data = machine_set(data, J=data.J / 100.0)
    rest = operating_point(data, [0.0] * data.n, 0.0, 0.0)
    Z, v = data.Vn_rms_ll**2 / data.Sn, data.Vn_rms_ll * sqrt(2.0 / 3.0)
    net = Network("stall_start", description="a synchronous machine starts from standstill by its dampers")
    net.add("gen", synchronous_machine(data, coordinates=coordinates, start=rest))
    net.add("line", rl_line(0.005 * Z, 0.1 * Z / data.omega, v=v, rated=v / Z))
    net.add("grid", infinite_bus(v, data.fn, i=v / Z))
    net.junction("bus1", ["gen.terminal", "line.a"])
    net.junction("bus2", ["line.b", "grid.terminal"])
    return Scene("stall_start", net, stop=stop, step=2e-4, shown=("gen.shaft.speed", "gen.Te", "line.i"))


def lossless(*, coordinates: Coordinates = "dq-flux", stop: float = 1.0) -> Scene:
    """A machine without resistance and friction, spinning, is switched onto capacitors: no joule leaves.

    Members gen (krause_hydro325, R = 0 in all windings, d = 0, short-circuited field with the flux of rated voltage) and bank
    (0.3 per unit, without charge at first).  Magnetic, electric and kinetic energy go to and fro.  The fluxes of the rotor
    windings stay.  Since nothing prefers an angle, so does p + (q_a (psi_c - psi_b) + q_b (psi_a - psi_c) + q_c (psi_b -
    psi_a))/sqrt(3) with the charges q, to the order of the scheme.

    Arguments: stop [s]
    """
    data = _without_loss("krause_hydro325")
    start = steady_state(data, P=0.0, Q=0.0)
    Z, v = data.Vn_rms_ll**2 / data.Sn, data.Vn_rms_ll * sqrt(2.0 / 3.0)
    net = Network("lossless", description="a machine without resistance at capacitors")
    net.add(
        "gen",
        synchronous_machine(data, coordinates=coordinates, start=operating_point(data, start.I, start.p, start.theta)),
    )
    net.add("bank", rlc_load(C=0.3 / Z / data.omega, nominal=v))
    net.junction("bus", ["gen.terminal", "bank.terminal"])
    return Scene(
        "lossless",
        net,
        stop=stop,
        step=1e-4,
        shown=("gen.shaft.speed", "bank.v", "gen.energy.stored", "bank.energy.stored"),
    )


def _without_loss(name: str) -> MachineData:
    data = machine_set(name)
    return machine_set(data, Ra=0.0, R_rotor=[0.0] * len(data.axis), d=0.0)
