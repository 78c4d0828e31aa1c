"""A plant with all its controls that feeds an island, and one at a stiff grid whose exciter meets its limit."""

from __future__ import annotations

from cmath import exp
from functools import cache
from math import pi, sqrt

from phfmu import Event, Network, Scene
from phfmu.components.control import bases, meter, pss1a, sexs, tgov1
from phfmu.components.electrical.breaker import clearing_fault
from phfmu.components.electrical.infinite_bus import infinite_bus
from phfmu.components.electrical.machines.machine_data import MachineData, machine_set
from phfmu.components.electrical.machines.synchronous_machine import synchronous_machine
from phfmu.components.electrical.phases import ALPHA
from phfmu.components.electrical.rl_line import rl_line
from phfmu.components.electrical.rlc_load import rlc_load
from phfmu.components.electrical.switch import fault_resistor
from phfmu.operating import PV, Load, NetworkPoint, Slack, Specification, operating_point


def island(step: float = 0.1, t_step: float = 0.5, *, stop: float = 5.0) -> Scene:
    """A steam turbine with governor, exciter and stabiliser, its machine, a line and loads; a load is switched on at 0.5 s.

    Arguments: step [1], power of the load that is switched on, in per unit of the machine; t_step [s]; stop [s]

    Members gen (555 MVA, 24 kV), meter, avr (SEXS), pss (PSS1A), gov (TGOV1), line (X = 0.1), house and town (loads
    of 0.2 and 0.5 per unit), more (what is switched on).  The exciter
    sets the voltage of the field, the governor the torque of the shaft:
    signals, whose work is booked at gen.field_source and gen.shaft_source.  All begin in the operating point.
    The frequency comes to rest near 60 (1 - R dP) Hz, R = 0.05 the droop of the governor.
    """
    net = _island().started()
    net.description = "turbine, governor, exciter, machine, line; a load is switched on"
    data, Z = _data()
    events = (Event(t_step, "more.G", step / Z),)
    return Scene(
        "island",
        net,
        stop=stop,
        step=2e-4,
        events=events,
        shown=("meter.frequency", "meter.voltage", "avr.Efd", "gov.valve", "gov.Pm"),
    )


def smib_exciter(EMAX: float = 3.0, *, t_fault: float = 0.1, t_clear: float = 0.2, stop: float = 2.0) -> Scene:
    """A machine with exciter and governor at a stiff grid; a fault at its bus drives the field voltage to its limit.

    Arguments: EMAX [1], limit of the field voltage in per unit; t_fault, t_clear [s]; stop [s]

    SEXS with K = 200, TE = 0.02 s: Efd rises to EMAX, stays at exactly that value, and leaves when the voltage is back.
    The fault, 0.1 and 0.05 per unit in each phase, clears at its current zeros; the machine's bus has a cable of 0.05 per unit.
    """
    net = _at_grid(EMAX).started()
    net.description = "machine with exciter and governor at a stiff grid; fault until the exciter is at its limit"
    _, Z = _data()
    events = (Event(t_fault, "fault.command", 1.0), Event(t_clear, "fault.command", 0.0))
    return Scene(
        "smib_exciter",
        net,
        stop=stop,
        step=1e-4,
        events=events,
        shown=("avr.Efd", "meter.voltage", "gen.field.i", "gov.Pm"),
    )


def _data() -> tuple[MachineData, float]:
    """The machine and its base impedance."""
    data = machine_set("kundur555_1q")
    return data, data.Vn_rms_ll**2 / data.Sn


def _plant(net: Network, EMAX: float, stabiliser: bool) -> list[str]:
    """Machine, meter, exciter, governor, joined by signals; the ends that meet at its bus."""
    data, _ = _data()
    base = bases(data)
    net.add("gen", synchronous_machine(data))
    net.add("meter", meter(data.Vn_rms_ll, data.Sn, data.fn))
    net.add("avr", sexs(TA=1.0, TB=10.0, K=200.0, TE=0.02, EMIN=-EMAX, EMAX=EMAX, base=base))
    net.add("gov", tgov1(VMAX=1.2, base=base))
    net.signal("meter.voltage", "avr.V")
    net.signal("avr.field", "gen.field.v")
    net.signal("gen.shaft.speed", "gov.w")
    net.signal("gov.torque", "gen.shaft.torque")
    if stabiliser:
        net.add("pss", pss1a(KS=10.0, T6=0.01, VSTMAX=0.1, VSTMIN=-0.1, rest=1.0, u_base=data.fn, unit="1/s"))
        net.signal("meter.frequency", "pss.u")
        net.signal("pss.Vs", "avr.Vs")
    return ["gen.terminal", "meter.a"]


@cache
def _island() -> NetworkPoint:
    data, Z = _data()
    w, v, i = data.omega, data.Vn_rms_ll * sqrt(2.0 / 3.0), sqrt(2.0 / 3.0) * data.Sn / data.Vn_rms_ll
    net = Network("island")
    ends = _plant(net, 4.0, True)
    net.add("house", rlc_load(5.0 * Z, 20.0 * Z / w, i=_lagging(v / (20.0 * Z)), nominal=v))
    net.add("line", rl_line(0.01 * Z, 0.1 * Z / w, v=v, rated=i))
    net.add(
        "town", rlc_load(2.0 * Z, 5.0 * Z / w, 0.05 / Z / w, v=_lagging(1j * v), i=_lagging(v / (5.0 * Z)), nominal=v)
    )
    net.add("more", fault_resistor(nominal=v))
    net.junction("bus1", [*ends, "line.a", "house.terminal"])
    net.junction("bus2", ["line.b", "town.terminal", "more.terminal"])
    slack = Slack("gen.terminal", V=data.Vn_rms_ll, free=("avr.Vref", "gov.Pref"))
    return operating_point(net, [slack, *_loads(data)], data.fn)


def _lagging(phasor: complex) -> list[float]:
    """Phase values of a balanced quantity a quarter of a period behind the phasor."""
    return [(phasor * exp(-1j * (pi / 2.0 + a))).real for a in ALPHA]


def _loads(data: MachineData) -> list[Specification]:
    return [
        Load("house.terminal", P=0.2 * data.Sn, Q=0.05 * data.Sn),
        Load("town.terminal", P=0.5 * data.Sn, Q=0.2 * data.Sn),
    ]


@cache
def _at_grid(EMAX: float) -> NetworkPoint:
    data, Z = _data()
    w, v, i = data.omega, data.Vn_rms_ll * sqrt(2.0 / 3.0), sqrt(2.0 / 3.0) * data.Sn / data.Vn_rms_ll
    net = Network("smib_exciter")
    ends = _plant(net, EMAX, False)
    net.add("line", rl_line(0.02 * Z, 0.3 * Z / w, v=v, rated=i))
    net.add("grid", infinite_bus(v, data.fn, i=i))
    net.add("cable", rlc_load(C=0.05 / Z / w, v=_lagging(1j * v), nominal=v))
    net.add("fault", clearing_fault(0.1 * Z, 0.05 * Z / w, i=i, v=v))
    net.junction("bus1", [*ends, "line.a", "cable.terminal", "fault.a"])
    net.junction("bus2", ["line.b", "grid.terminal"])
    plant = PV("gen.terminal", P=0.8 * data.Sn, V=1.02 * data.Vn_rms_ll, free=("avr.Vref", "gov.Pref"))
    return operating_point(net, [plant], data.fn)
