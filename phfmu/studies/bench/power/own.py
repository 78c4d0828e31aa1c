"""The circuits declared with the library, and their steps by the native engine."""

from __future__ import annotations

from cmath import phase
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.discretise.model import Model, build_model
from phfmu.network.network import Network
from phfmu.network.scene import Event
from phfmu.studies.bench.power import circuit
from phfmu.studies.bench.precision.candidate import CandidateRun

Array = NDArray[np.float64]


def machine_data() -> dict[str, Any]:
    """The machine's data in SI: mutual inductances of peak values, field base of 40 mH, dampers with the stator's turns."""
    p, axes = circuit.PU, ["d", "d", "q", "q"]
    k = [p["Lmd"] * circuit.LB / 0.04, 1.5, 1.5, 1.5]
    mutual = [p["Lmd"], p["Lmd"], p["Lmq"], p["Lmq"]]
    leakage, resistance = ([p[x + w] for w in ("fd", "kd", "kq1", "kq2")] for x in ("Ll", "R"))
    rotor = [
        [1.5 * (mutual[i] + (leakage[i] if i == j else 0.0)) * circuit.LB / (k[i] * k[j]) * (axes[i] == axes[j])
         for j in range(4)]
        for i in range(4)
    ]  # fmt: skip
    return {
        "name": "kundur555_2q", "Sn": circuit.SN, "Vn_rms_ll": circuit.VN, "fn": circuit.FREQUENCY, "Ra": p["Rs"] * circuit.ZB,
        "R_rotor": [1.5 * r * circuit.ZB / x**2 for r, x in zip(resistance, k, strict=True)], "axis": axes,
        "Ld": (p["Ll"] + p["Lmd"]) * circuit.LB, "Lq": (p["Ll"] + p["Lmq"]) * circuit.LB, "L0": p["Ll"] * circuit.LB,
        "M_stator_rotor": [m * circuit.LB / x for m, x in zip(mutual, k, strict=True)], "L_rotor": rotor,
        "J": 2 * p["H"] * circuit.SN / circuit.W**2, "d": 0.0,
    }  # fmt: skip


def smib() -> Network:
    """The circuit of one machine."""
    from phfmu.components.electrical.infinite_bus import infinite_bus
    from phfmu.components.electrical.machines.machine_data import machine_set
    from phfmu.components.electrical.machines.machine_init import steady_state
    from phfmu.components.electrical.machines.synchronous_machine import synchronous_machine
    from phfmu.components.electrical.rl_line import rl_line
    from phfmu.components.electrical.rlc_load import rlc_load
    from phfmu.components.electrical.switch import fault_resistor

    flow, data, peak = circuit.power_flow(), machine_set(machine_data()), np.sqrt(2 / 3)
    start = steady_state(data, flow.power.real, flow.power.imag, abs(flow.machine), phase(flow.machine))
    line = (flow.machine - flow.grid) * peak / (circuit.R_LINE + 1j * circuit.W * circuit.L_LINE)
    v = abs(flow.machine) * peak
    net = Network("smib")
    net.add("gen", synchronous_machine(data, start=start))
    net.add("line", rl_line(circuit.R_LINE, circuit.L_LINE, i=circuit.phases(line), v=abs(flow.grid) * peak))
    shunt = rlc_load(
        2 / circuit.G_LINE, None, circuit.C_LINE / 2, v=circuit.phases(flow.machine * peak), i=[0.0] * 3, nominal=v
    )
    net.add("shunt", shunt)
    net.add("fault", fault_resistor(nominal=v))
    net.add("grid", infinite_bus(abs(flow.grid) * peak, circuit.FREQUENCY, phase(flow.grid), i=abs(line)))
    net.junction("bus1", ["gen.terminal", "line.a", "shunt.terminal", "fault.terminal"])
    net.junction("bus2", ["line.b", "grid.terminal"])
    return net


def nine_buses() -> Network:
    """The nine buses of the library from their operating point, each transformer's leakage folded into its machine."""
    from phfmu.components.electrical.machines.machine_init import steady_state
    from phfmu.components.electrical.machines.synchronous_machine import machine_at_bus
    from phfmu.components.scenes.electrical.wscc9 import (
        BASE,
        FREQUENCY,
        LINES,
        PLANTS,
        VOLTAGE,
        machine_of,
        wscc9_steady,
    )

    found = wscc9_steady().system
    assert isinstance(found, Network)
    w, Z, net = 2 * np.pi * FREQUENCY, VOLTAGE**2 / BASE, Network("wscc9")
    ends: dict[str, list[str]] = {bus: [] for bus in "456789"}
    charging = {bus: sum(b / 2 for n, (_, _, b) in LINES.items() if bus in n[4:]) / Z / w for bus in ends}
    for k, (bus, x, rated, _, _) in PLANTS.items():
        L, data = x * rated**2 / BASE / w, machine_of(k)
        i = _phasor(found, f"leakage{k}", "flux") / L
        v = _phasor(found, f"shunt{bus}", "charge") / charging[bus] * rated / VOLTAGE + 1j * w * L * i
        power = 1.5 * v * np.conj(i)
        start = steady_state(data, power.real, power.imag, abs(v) * np.sqrt(1.5), phase(v))
        net.add(f"gen{k}", machine_at_bus(data, 0.0, L, start=start))
        net.add(f"transformer{k}", found.members[f"transformer{k}"])
        net.connect(f"gen{k}.terminal", f"transformer{k}.b", name=f"inside{k}")
        ends[bus].append(f"transformer{k}.a")
    for name in LINES:
        net.add(name, found.members[name])
        for bus, end in zip(name[4:], "ab", strict=True):
            ends[bus].append(f"{name}.{end}")
    net.add("fault", found.members["fault"])
    ends["7"].append("fault.terminal")
    for bus, ports in ends.items():
        net.add(f"shunt{bus}", found.members[f"shunt{bus}"])
        net.junction(f"bus{bus}", [*ports, f"shunt{bus}.terminal"])
    return net


def _phasor(net: Network, member: str, state: str) -> complex:
    """The phasor [peak] of a balanced state of three phases at the start."""
    start = next(v.start for v in net.declared[member].states if v.name == state)
    return complex(2 / 3 * np.sum(np.array(start) * np.exp(1j * circuit.ALPHA)))


class FixedStepNetwork:
    """A network in steps of h [s]; the fault has a conductance [S] from one time to another [s].

    Columns by name are read at multiples of `every` [s] when the run is watched; timed runs record nothing.
    """

    def __init__(self, model: Model, names: Sequence[str], h: float, net: dict[str, Any], every: float):
        from phfmu.engine.native.native import NativeInstance
        from phfmu.network.couplings.monolithic import Monolithic

        self._instance = NativeInstance(model, kernels="compiled")
        self._steps, self._names, self._h, self._every = Monolithic(model, self._instance), names, h, every
        on, off, self._stop = net["fault"]["on"], net["fault"]["off"], net["stop"]
        self._events = [Event(on, "fault.G", 1 / net["fault"]["R"]), Event(off, "fault.G", 0.0)]
        self._events = [e for e in self._events if e.t < self._stop]

    def __call__(self, times: Sequence[float], watch: bool = False) -> CandidateRun:
        self._instance.reset()
        self._steps.set_value("fault.G", 0.0)
        return self._watched() if watch else self._bare()

    def _bare(self) -> CandidateRun:
        marks, steps = [0.0, *(e.t for e in self._events), self._stop], 0
        for start, end, event in zip(marks, marks[1:], [None, *self._events], strict=False):
            if event is not None:
                self._steps.set_value(event.name, event.value)
            n = round((end - start) / self._h)
            self._instance.run(start, self._h, n, record=())
            steps += n
        return CandidateRun(np.zeros((0, 0)), steps)

    def _watched(self) -> CandidateRun:
        from phfmu.runs.loop import run
        from phfmu.runs.options import Options

        found = run(self._steps, Options(stop=self._stop, step=self._h, events=tuple(self._events)))
        stride = round(self._every / self._h)
        rows = np.stack([found.column(n)[::stride] for n in self._names], axis=1)
        return CandidateRun(rows[1:], len(found.time) - 1)


def planned(network: Network, order: int) -> Model:
    """The composed model of an order."""
    from phfmu.schemes.collocated import Collocated

    return build_model(network.compose(), Collocated(order // 2))


def start_of(model: Model, name: str) -> float:
    """The start value of a scalar state."""
    return next(v.start[0] for v in model.declaration.states if v.name == name)
