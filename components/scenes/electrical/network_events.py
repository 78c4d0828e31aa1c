"""Events that networks are studied for first: short circuits of any kind, an inverter in a weak grid, iron that saturates."""

from __future__ import annotations

from math import pi, sqrt

from phfmu import Network, Scene
from phfmu.components.electrical.infinite_bus import infinite_bus
from phfmu.components.electrical.network.inverter import grid_following_inverter
from phfmu.components.electrical.network.lines import coupled_line, series_compensated_line
from phfmu.components.electrical.network.loads import load, shunt
from phfmu.components.electrical.network.saturation import MagnetisationCurve, saturating_reactor
from phfmu.components.electrical.network.shunts import fault, fault_events
from phfmu.components.electrical.network.thevenin import thevenin_source
from phfmu.components.electrical.network.transformers import two_winding_transformer
from phfmu.components.electrical.rl_line import rl_line
from phfmu.components.electrical.rlc_load import rlc_load
from phfmu.operating import operating_point

#: flux and current of transformer iron as parts of the rated peaks: knee at 1.15, then nearly as air
IRON = MagnetisationCurve(((1.0, 0.002), (1.15, 0.01), (1.25, 0.1), (1.55, 1.1)))


def short_circuit(kind: str = "ag", *, R: float = 0.5, begins: float = 0.04, clears: float = 0.14) -> Scene:
    """A 20 kV feeder of 500 MVA, 50 Hz with a line and a load of 8 MW, from its steady state; a fault at the load.

    Arguments: kind (of the fault: abcg, abc, ab, abg, ag, ...), R [ohm], begins, clears [s]
    """
    V, v = 20e3, 20e3 * sqrt(2.0 / 3.0)
    net = Network("short_circuit", description=f"fault {kind} at the end of a feeder")
    net.add("grid", thevenin_source(V, 500e6, rated=500.0))
    net.add("line", coupled_line(1.0, 5e-3, R0=2.5, L0=16e-3, v=v, rated=500.0))
    net.add("load", load(8e6, 3e6, V=V))
    net.add("fault", fault(kind, R, nominal=v))
    net.junction("bus1", ["grid.terminal", "line.a"])
    net.junction("bus2", ["line.b", "load.terminal", "fault.terminal"])
    point = operating_point(net, [], 50.0)
    events = fault_events("fault", begins, clears)
    return Scene("short_circuit", point.started(), 0.2, 1e-4, events, restart=4, shown=("line.i",))


def weak_grid(ratio: float = 3.0, *, P: float = 8e6, R: float = 5.0, begins: float = 0.1, clears: float = 0.2) -> Scene:
    """An inverter of 10 MVA with a capacitor of 10 % at the end of a 20 kV line, from its steady state; a fault beside it.

    In the fault the current is at its limit of 1.1; what the inverter takes for the angle of its voltage swings and settles.

    Arguments: ratio [1], short-circuit power of the grid, of 10 MVA;  P [W], delivered;
      R [ohm], begins, clears [s], of the fault
    """
    V, S = 20e3, 10e6
    v, i, Z = V * sqrt(2.0 / 3.0), sqrt(2.0 / 3.0) * S / V, V**2 / S / ratio
    net = Network("weak_grid", description="inverter in a weak grid: fault, limit of the current, loop that settles")
    net.add("grid", infinite_bus(v, 50.0, i=i))
    net.add("line", rl_line(0.1 * Z, Z / (100.0 * pi), v=v, rated=i))
    net.add("filter", shunt(-0.1 * S, V=V, f=50.0))
    net.add("fault", fault("abcg", R, nominal=v))
    net.add("inverter", grid_following_inverter(P, 0.0, V=V, S=S))
    net.connect("grid.terminal", "line.a", name="source")
    net.junction("bus", ["line.b", "filter.terminal", "fault.terminal", "inverter.terminal"])
    point = operating_point(net, [], 50.0)
    return Scene(
        "weak_grid",
        point.started(),
        0.5,
        1e-4,
        fault_events("fault", begins, clears),
        shown=("inverter.U", "inverter.Id", "inverter.frequency"),
    )


def inrush(phase: float = -pi / 2.0, *, residual: float = 0.0) -> Scene:
    """A transformer of 1 MVA, 20/0.4 kV, Dyn11, is energised over a cable, nearly without load: its iron saturates.

    Arguments: phase [rad] of the voltage of phase a; at -pi/2 it rises through zero.  residual [1]: flux of limb a at the start,
    as a part of the rated peak; b and c share the opposite.
    """
    V, S = 20e3, 1e6
    v, i = V * sqrt(2.0 / 3.0), sqrt(2.0 / 3.0) * S / V
    left = (residual, -residual / 2.0, -residual / 2.0)
    unit = two_winding_transformer(S, V, 400.0, r=0.01, x=0.06, group="Dyn11", curve=IRON, linkage0=left)
    net = Network("inrush", description="a transformer is energised: its iron saturates")
    net.add("grid", infinite_bus(v, 50.0, phase, i=i))
    net.add("cable", coupled_line(5.0, 30e-3, v=v, rated=i))
    net.add("charging", shunt(-20e3, V=V, angle=phase))
    net.add("unit", unit)
    net.add("load", load(10e3, V=400.0, kind="series"))
    net.connect("grid.terminal", "cable.a", name="bus")
    net.junction("high", ["cable.b", "charging.terminal", "unit.a"])
    net.junction("low", ["unit.b", "load.terminal"])
    return Scene("inrush", net, 0.2, 1e-4, shown=("unit.i_m", "unit.linkage"))


def ferroresonance(phase: float = -pi / 2.0, *, flux0: float = 0.0) -> Scene:
    """One phase of an unloaded transformer of 1 MVA, 20 kV, that only the capacitance to an open conductor feeds.

    In series with its iron the capacitor of 0.3 uF moves in one of two ways: a sine of 0.8 times the voltage of the grid, or
    pulses that saturate the iron, repeat after several cycles only and reach more than twice that voltage. The instant of the
    switching decides between them.

    Arguments: phase [rad] of the voltage at the start; at -pi/2 it rises through zero.  flux0 [1]: of the core at the start, as a
    part of the rated peak.
    """
    V, S = 20e3 / sqrt(3.0), 1e6 / 3.0
    peak, rated = sqrt(2.0) * V, sqrt(2.0) * S / V
    rated_flux = peak / (100.0 * pi)
    iron = MagnetisationCurve(IRON.points, 0.3).scaled(rated_flux, rated)
    net = Network("ferroresonance", description="a capacitor in series with saturating iron")
    net.add("grid", thevenin_source(V, 20e6, x_r=2.0, angle=phase, rated=rated, phases=1))
    net.add("cable", rlc_load(None, None, 0.2e-6, nominal=peak, phases=1))
    net.add("open", series_compensated_line(50.0, 0.2, 0.3e-6, v=peak, rated=1.0, phases=1))
    net.add("stray", rlc_load(400e3, None, 0.1e-6, nominal=peak, phases=1))
    net.add("iron", saturating_reactor(iron.points, 1.0, rounding=iron.rounding, v=peak, flux0=flux0 * rated_flux))
    net.junction("bus", ["grid.terminal", "cable.terminal", "open.a"])
    net.junction("core", ["open.b", "stray.terminal", "iron.terminal"])
    return Scene("ferroresonance", net, 0.3, 2e-5, shown=("stray.v", "iron.i"))
