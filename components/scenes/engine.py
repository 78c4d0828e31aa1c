"""A piston engine drives a synchronous machine that feeds a load: heat, mechanics and electricity in one network."""

from __future__ import annotations

from cmath import exp, phase
from math import cos, pi, sin, sqrt

from phfmu import Event, Network, Scene
from phfmu.components.electrical.machines.machine_data import MachineData
from phfmu.components.electrical.machines.machine_init import ALPHA, steady_state
from phfmu.components.electrical.machines.machine_per_unit import from_per_unit
from phfmu.components.electrical.machines.synchronous_machine import synchronous_machine
from phfmu.components.electrical.rl_line import rl_line
from phfmu.components.electrical.rlc_load import rlc_load
from phfmu.components.mechanical.gas_cylinder import gas_cylinder
from phfmu.components.mechanical.mechanisms.slider_crank import slider_crank
from phfmu.components.mechanical.rotational import flexible_shaft, rotational_inertia

#: crank and rod [m], masses of crank, rod and piston [kg], compression ratio, angle of the crank at the start [rad]
CRANK, ROD, MASSES, RATIO, ANGLE = 0.07, 0.25, (6.0, 2.0, 1.5), 9.0, -pi / 2.0
#: stiffness [N.m/rad] and damping [N.m.s/rad] of the soft shaft between flywheel and machine
SHAFT = (3e3, 8.0)


def engine(T_fire: float = 2100.0, *, t_load: float = 0.5, relief: float = 2.0, stop: float = 1.0) -> Scene:
    """One cylinder, crank, flywheel, shaft, machine of 30 kVA, line and load; half of the load is thrown off at 0.5 s.

    Arguments: T_fire [K], temperature of the fire; t_load [s], when the resistance of the load becomes `relief` [1] times its
               value; stop [s]

    Members gas (1.6 l, see `gas_cylinder`), crank (crank, rod, piston: rigid bodies in the plane), crankshaft (100 kN.m/rad),
    flywheel (4 kg.m2), shaft (3 kN.m/rad), gen (400 V, 50 Hz, four poles, its field voltage is kept), line (R = 0.02, X = 0.1
    per unit), load (parallel R and L, 18 kW and 6 kvar at rated voltage).  The gas drives the piston outwards, and the flywheel
    gives the work of compression back.  Nothing governs the speed: the power of the load rises with its square and the work
    of a cycle hardly, so that it comes to rest where both meet.  One ledger has the heat at gas.hot and gas.cold, the work at
    every joint, and what bearings, shafts, windings, line and load lose.
    """
    data, load, line = generator_data(), 0.6 - 0.2j, 0.02 + 0.1j  # admittance and impedance in per unit
    w, Z, speed = data.omega, data.Vn_rms_ll**2 / data.Sn, data.omega / data.pole_pairs
    v = data.Vn_rms_ll * sqrt(2.0 / 3.0)
    current = v * load / Z
    terminal = v + line * Z * current
    power = 1.5 * terminal * current.conjugate()
    start = steady_state(data, power.real, power.imag, abs(terminal) * sqrt(1.5), phase(terminal))
    top = CRANK + ROD + 2.0 * CRANK / (RATIO - 1.0)
    pin = CRANK * cos(ANGLE) + sqrt(ROD**2 - (CRANK * sin(ANGLE)) ** 2)

    net = Network("engine", description="piston engine, flywheel, shaft, machine, line and load; load thrown off")
    net.add("gas", gas_cylinder(stroke=2.0 * CRANK, ratio=RATIO, height=top - pin, T_fire=T_fire))
    net.add("crank", slider_crank(crank=CRANK, rod=ROD, masses=MASSES, friction=0.02, angle=ANGLE, speed=speed))
    net.add("crankshaft", flexible_shaft(1e5, d=5.0))
    net.add("flywheel", rotational_inertia(4.0, d=0.01, speed=speed))
    net.add("shaft", flexible_shaft(SHAFT[0], d=SHAFT[1], twist=-start.tau / SHAFT[0]))
    net.add("gen", synchronous_machine(data, start=start))
    net.add("line", rl_line(line.real * Z, line.imag * Z / w, i=_phases(current), v=v))
    coil = _phases(1j * v * load.imag / Z)
    net.add("load", rlc_load(Z / load.real, Z / -load.imag / w, i=coil, nominal=v))
    net.connect("crank.bore", "gas.piston", name="piston")
    net.connect("crank.main", "crankshaft.a", name="journal")
    net.connect("flywheel.a", "crankshaft.b", name="flange")
    net.connect("flywheel.b", "shaft.a", name="coupling_a")
    net.connect("gen.shaft", "shaft.b", name="coupling_b")
    net.junction("bus1", ["gen.terminal", "line.a"])
    net.junction("bus2", ["line.b", "load.terminal"])
    events = (Event(t_load, "load.R", relief * Z / load.real),)
    return Scene(
        "engine",
        net,
        stop=stop,
        step=1e-4,
        events=events,
        shown=("flywheel.w", "gen.shaft.speed", "gas.p", "gas.T", "crankshaft.b.torque", "line.i"),
    )


def generator_data() -> MachineData:
    """Numbers of this library, as salient machines of this size have them."""
    return from_per_unit(
        "genset30", "GENSAL", Sn=30e3, Vn_rms_ll=400.0, fn=50.0, J=0.5, pole_pairs=2, no_load_field_current=2.0, ra=0.03,
        xl=0.08, xd=2.2, xq=1.1, xd1=0.2, xd2=0.12, Td10=0.6, Td20=0.02, Tq20=0.02,
    )  # fmt: skip


def _phases(phasor: complex) -> list[float]:
    """Values in a, b, c of a balanced quantity."""
    return [(phasor * exp(-1j * a)).real for a in ALPHA]
