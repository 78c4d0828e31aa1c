"""Scenes with bare nodes, and the machine at an infinite bus as one ordinary differential equation."""

from __future__ import annotations

from functools import cache

import numpy as np
from machine_reference import ALPHA, MachineReference
from reference_tools import load
from scipy.integrate import solve_ivp

from phfmu import (
    ELECTRICAL,
    PHDAE,
    Network,
    Port,
    damping,
    energy,
    state,
)
from phfmu.components.electrical.machines.machine_data import machine_set
from phfmu.components.electrical.machines.machine_init import steady_state
from phfmu.components.electrical.machines.synchronous_machine import synchronous_machine
from phfmu.components.electrical.rl_line import rl_line

RATED = 18881.48  # A, peak, of kundur555_1q
STOP = 0.02


def plant_current(plant: complex, w: float, t: float) -> np.ndarray:
    """Of the phases, Re(plant exp(j (w t - alpha)))."""
    return (plant * np.exp(1j * (w * t - ALPHA))).real


@cache
def lumped(plant: complex = 0j) -> tuple[object, object]:
    """smib with the torque step at t = 0 and the line folded into the machine (no node): t -> I, and bus data.

    `plant`: what a balanced current source delivers to the node [A]; on the line it adds R i + L i' to the grid's voltage.
    """
    scene, machines = load("scenes")["smib"], load("machines")
    machine = MachineReference(machines[scene["machine"]], scene["d"], scene["Rx"], scene["Lx"])
    bus, inputs, initial = scene["infinite_bus"], scene["inputs"], scene["initial"]
    w = bus["w"]

    def rhs(t: float, y: np.ndarray) -> np.ndarray:
        v = bus["amp"] * np.cos(w * t + bus["phase"] - ALPHA)
        v += plant_current(plant * (scene["Rx"] + 1j * w * scene["Lx"]), w, t)
        d = machine.rhs(y[:6], machine.J * w + y[6], w * t + y[7], v, inputs["Vf"], inputs["tau1"])
        return np.concatenate([d[0], [d[1], y[6] / machine.J]])

    psi = machine.fluxes(initial["I"], initial["theta"])
    y0 = np.concatenate([psi, [initial["p"] - machine.J * w, initial["theta"]]])
    scale = np.concatenate([np.full(3, 50.0), np.abs(psi[3:]), [machine.J], [1.0]])
    found = solve_ivp(rhs, (0.0, STOP), y0, "DOP853", rtol=3e-14, atol=1e-14 * scale, max_step=1e-4, dense_output=True)

    def currents(t: float) -> np.ndarray:
        y = found.sol(t)
        rest = machine.rhs(y[:6], machine.J * w + y[6], w * t + y[7], np.zeros(3), 0.0, 0.0)
        return rest[3][:3]

    return currents, scene


def mean_voltage(h: float) -> np.ndarray:
    """Mean over the last step of v = v_bus - Rx I - Lx I'."""
    currents, scene = lumped()
    bus = scene["infinite_bus"]  # type: ignore[index]
    t, b = np.polynomial.legendre.leggauss(8)
    times = STOP - h + h * (t + 1) / 2
    grid = sum(
        bi / 2 * bus["amp"] * np.cos(bus["w"] * ti + bus["phase"] - ALPHA) for ti, bi in zip(times, b, strict=True)
    )
    mean = sum(bi / 2 * currents(ti) for ti, bi in zip(times, b, strict=True))  # type: ignore[operator]
    slope = (currents(STOP) - currents(STOP - h)) / h  # type: ignore[operator]
    return grid - scene["Rx"] * mean - scene["Lx"] * slope  # type: ignore[index]


def two_bare_nodes() -> PHDAE:
    """Machine - line - node - line - second machine: two coupled bare nodes."""
    data = machine_set("krause_hydro325", d=50.0)
    start = steady_state(data)
    net = Network("row")
    size = {"i": [-x for x in start.I[:3]], "v": 2e4}
    net.add("gen", synchronous_machine(data, start=start))
    net.add("line1", rl_line(1e-2, 1e-3, **size))
    net.add("line2", rl_line(2e-2, 2e-3, **size))
    net.junction("bus1", ["gen.terminal", "line1.a"])
    net.junction("bus2", ["line1.b", "line2.a"])
    return net.compose()


def saturable(name: str, scale: float, start: float) -> PHDAE:
    """An inductor with H = (flux^2/2 + flux^4/4)/scale."""
    flux = state("flux", unit="Wb", start=start)
    h = energy((flux**2 / 2 + flux**4 / 4) / scale)
    return PHDAE(name, states=(flux,), energies=(h,), dissipation=(damping(flux, 0.3),),
                 ports=(Port("p", ELECTRICAL, "effort", {flux: 1}), Port("drive", ELECTRICAL, "effort", {flux: 1})))  # fmt: skip


def joined(*models: PHDAE) -> PHDAE:
    net = Network("joined")
    for i, m in enumerate(models):
        net.add(f"m{i}", m)
    net.junction("bus", [f"m{i}.{m.ports[0].name}" for i, m in enumerate(models)])
    return net.compose()


def saturable_pair() -> PHDAE:
    """Currents +- (1 + 1^3) at the start."""
    return joined(saturable("a", 1.0, 1.0), saturable("b", 1.0, -1.0))


def scene_inductance(model) -> float:
    names = [n for v in model.declaration.parameters for n in v.names()]
    return float(model.p0[names.index("line.L")])
