"""Nine buses through a fault against an integration in phase coordinates by another method, and a line that trips."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from phfmu import (
    Collocated,
    Coupled,
    EngineMember,
    FMUMember,
    Monolithic,
    NativeInstance,
    Options,
    build_model,
    export,
    run,
)
from phfmu.components.scenes.electrical.wscc9 import LINES, PLANTS, VOLTAGE, machine_of, wscc9, wscc9_trip
from phfmu.fmu.importer.reader import FMUInstance
from tests.components.phase_coordinates import PhaseMachine, integrated
from tests.wide import slow

FAULT, CLEAR, STOP = 0.02, 0.04, 0.06
W, Z = 2 * np.pi * 60.0, VOLTAGE**2 / 100e6
BUSES = "456789"


def simulated(scene, k: int, step: float) -> Any:
    model = build_model(scene.declaration(), Collocated(k))
    options = Options(stop=scene.stop, step=step, events=scene.events, restart=scene.restart)
    r = run(Monolithic(model, NativeInstance(model)), options)
    assert r.ledger.summary().closed
    return r


class NineBuses:
    """69 states: fluxes of machine and leakage, momentum, angle (3 x 8); currents of lines (6 x 3); voltages of
    capacitors (6 x 3); currents of reactors at 5, 6, 8 (3 x 3).  The node between machine and transformer has no state."""

    def __init__(self, scene, G: float):
        self.fault, self.poles = G, np.ones((6, 3))
        members = scene.system.declared
        own = lambda m, n: np.ravel(next(v for v in (*members[m].states, *members[m].parameters) if v.name == n).start)  # noqa: E731
        self.machines, self.ratio, self.Vf, self.tau, x = [], [], [], [], []
        for k, (_, reactance, rated, _, _) in PLANTS.items():
            data = machine_of(k)
            leakage = reactance * rated**2 / 100e6 / W
            machine = PhaseMachine(data, L=leakage)
            theta, p = own(f"gen{k}", "theta")[0], own(f"gen{k}", "p")[0]
            turn = np.sqrt(2 / 3) * np.array(
                [f(theta - a) for a in (0, 2 * np.pi / 3, -2 * np.pi / 3) for f in (np.cos, lambda z: -np.sin(z))]
            ).reshape(3, 2)  # fmt: skip
            dq = np.linalg.solve(data.constant_inductance(), own(f"gen{k}", "psi"))
            I = np.concatenate([turn @ dq[:2], dq[3:]])
            x += [*(machine.inductance(theta)[0] @ I), p, theta]
            ports = {q.name: np.ravel(q.start)[0] for q in members[f"gen{k}"].ports if q.name != "terminal"}
            self.machines.append(machine)
            self.ratio.append(rated / VOLTAGE)
            self.Vf.append(ports["field"])
            self.tau.append(ports["shaft"])
        self.R = np.array([LINES[n][0] * Z for n in LINES])
        self.L = np.array([LINES[n][1] * Z / W for n in LINES])
        for name, L in zip(LINES, self.L, strict=True):
            x += list(own(name, "flux") / L)
        self.C, self.G, self.reactor = np.zeros(6), np.zeros(6), {}
        for j, bus in enumerate(BUSES):
            shunt = f"shunt{bus}"
            self.C[j] = own(shunt, "C")[0]
            names = [v.name for v in (*members[shunt].states, *members[shunt].parameters)]
            x += list(own(shunt, next(n for n in names if n in ("q", "charge"))) / self.C[j])
            if "R" in names:
                self.G[j] = 1 / own(shunt, "R")[0]
                self.reactor[j] = own(shunt, "L")[0]
        for j, bus in enumerate(BUSES):
            if j in self.reactor:
                name = next(v.name for v in members[f"shunt{bus}"].states if v.name in ("flux", "psi"))
                x += list(own(f"shunt{bus}", name) / self.reactor[j])
        self.start = np.array(x)
        self.ends = np.array([[BUSES.index(b) for b in n[4:]] for n in LINES])
        self.at = [BUSES.index(PLANTS[k][0]) for k in PLANTS]

    def rates(self, t: float, x: np.ndarray, stage: int) -> np.ndarray:
        i, v, r = x[24:42].reshape(6, 3), x[42:60].reshape(6, 3), x[60:].reshape(3, 3)
        into = -self.G[:, None] * v
        np.subtract.at(into, self.ends[:, 0], i)
        np.add.at(into, self.ends[:, 1], i)
        for n, j in enumerate(self.reactor):
            into[j] -= r[n]
        if stage == 1:
            into[BUSES.index("7")] -= self.fault * v[BUSES.index("7")]
        out = []
        for k, machine in enumerate(self.machines):
            y = x[8 * k : 8 * k + 8]
            rate, I = machine.rates(y, self.ratio[k] * v[self.at[k]], self.Vf[k], self.tau[k])
            into[self.at[k]] -= self.ratio[k] * I[:3]
            out.append(rate)
        di = (v[self.ends[:, 0]] - v[self.ends[:, 1]] - self.R[:, None] * i) / self.L[:, None] * self.poles
        dr = [v[j] / L for j, L in self.reactor.items()]
        return np.concatenate([*out, di.ravel(), (into / self.C[:, None]).ravel(), *dr])


@cache
def reference(G: float) -> tuple[np.ndarray, np.ndarray]:
    net = NineBuses(wscc9(t_fault=FAULT, t_clear=CLEAR), G)
    times = np.arange(0, STOP + 1e-9, 5e-4)
    return times, integrated(net.rates, net.start, times, (FAULT, CLEAR))


def errors(k: int, step: float, G: float, restart: int) -> tuple[float, float]:
    """Of the line currents beside their largest, and of the angles in rad."""
    times, x = reference(G)
    scene = wscc9(t_fault=FAULT, t_clear=CLEAR, stop=STOP)
    events = tuple(replace(e, value=G * e.value) for e in scene.events)
    r = simulated(replace(scene, events=events, restart=restart), k, step)
    rows = np.array([int(np.flatnonzero(np.abs(r.time - t) < 1e-9)[-1]) for t in times])
    worst, largest = 0.0, 0.0
    for n, name in enumerate(LINES):
        for j in range(3):
            own = r.column(f"{name}.i[{j + 1}]")[rows]
            worst = max(worst, np.abs(own - x[:, 24 + 3 * n + j]).max())
            largest = max(largest, np.abs(own).max())
    theta = max(np.abs(r.column(f"gen{k + 1}.theta")[rows] - x[:, 8 * k + 7]).max() for k in range(3))
    return worst / largest, theta


@pytest.mark.slow
@pytest.mark.parametrize(("k", "most"), [(1, 5e-3), (2, 1e-6), (3, 1e-9)])
def test_a_fault_at_nine_buses_has_the_order_of_the_scheme(k: int, most: float) -> None:
    """A fault of 20 ohm, 23 us beside the bus, without damping steps."""
    coarse, fine = errors(k, 5e-5, 0.05, 0), errors(k, 2.5e-5, 0.05, 0)
    assert fine[0] < most and fine[1] < most / 1e4
    assert 2 * k - 0.15 < np.log2(coarse[0] / fine[0]) < 2 * k + 0.15


@pytest.mark.parametrize(("k", "version"), [slow((2, "2.0")), (2, "3.0"), slow((3, "3.0"))])
def test_machines_as_units_run_through_the_fault_as_the_composed_model_does(
    k: int, version: str, tmp_path: Path
) -> None:
    """Each machine an FMU with values at the nodes, the others in the engine, coupled by Newton's method on the interface."""
    scene = wscc9(t_fault=0.001, t_clear=0.003, stop=0.005)
    scene = replace(scene, events=tuple(replace(e, value=0.05 * e.value) for e in scene.events), restart=0)
    net: Any = scene.system
    members: list[Any] = []
    for name, declaration in net.members.items():
        model = build_model(replace(declaration, name=name), Collocated(k))
        if name.startswith("gen"):
            (path,) = export(model, tmp_path, (version,), step=5e-5, node_inputs=True)
            members.append(FMUMember(name, FMUInstance(path, name=name)))
        else:
            members.append(EngineMember(name, model, NativeInstance(model)))
    whole = simulated(scene, k, 5e-5)
    apart = run(Coupled(net, members), Options(stop=scene.stop, step=5e-5, events=scene.events))
    assert apart.ledger.summary().closed
    for name, size in (*((f"gen{m}.psi", 6) for m in "123"), ("line57.flux", 3)):
        one, two = (np.array([r.column(f"{name}[{j + 1}]") for j in range(size)]) for r in (whole, apart))
        assert np.abs(two - one).max() <= 1e-9 * np.abs(one).max(), name


def opened() -> list[float]:
    """Zeros at which the poles of line 5-7 open in phase coordinates, each pole kept open from its zero on."""
    net = NineBuses(wscc9_trip(t_fault=FAULT, t_clear=CLEAR), 0.05)
    _, x = reference(0.05)
    line, x, t, found = list(LINES).index("line57"), x[round(CLEAR / 5e-4)], CLEAR, [0.0] * 3
    for _ in range(3):
        left = [j for j in range(3) if not found[j]]
        zero = [lambda t, y, j=j: y[24 + 3 * line + j] for j in left]
        for z in zero:
            z.terminal = True
        run_ = solve_ivp(
            lambda t, y: net.rates(t, y, 2), (t, STOP), x, "DOP853", events=zero, rtol=1e-12, atol=1e-9, max_step=5e-5
        )
        j, t, x = left[next(n for n, e in enumerate(run_.t_events) if len(e))], run_.t[-1], run_.y[:, -1].copy()
        found[j], net.poles[line, j], x[24 + 3 * line + j] = t, 0.0, 0.0
    return found


def tripped(k: int, chop: float = 0.0) -> Any:
    scene = wscc9_trip(t_fault=FAULT, t_clear=CLEAR, stop=STOP, chop=chop)
    events = tuple(replace(e, value=0.05 * e.value) if e.name == "fault.G" else e for e in scene.events)
    return simulated(replace(scene, events=events, restart=0), k, 2.5e-5)


def openings(r: Any) -> list[tuple[float, float]]:
    """Time and current [A] of each pole of line 5-7 just before it opens; none flows after it."""
    found = []
    for j in range(3):
        i, closed = r.column(f"line57.i[{j + 1}]"), r.column(f"line57.closed[{j + 1}]")
        row = int(np.flatnonzero(np.diff(closed))[0])
        assert np.abs(i[row + 1 :]).max() < 1e-30
        found.append((float(r.time[row]), float(i[row])))
    return found


def lost(r: Any) -> list[float]:
    """Losses of the openings in J, a row of the ledger each; rows without one lose nothing."""
    rows = [row.partition(", lost ")[2] for row in r.notes if "line57.pole" in row]
    return [float(row.split()[0]) if row else 0.0 for row in rows]


def test_each_pole_of_a_line_opens_at_its_current_zero_and_its_loss_is_a_row() -> None:
    r = tripped(1)
    assert all(abs(i) < 1e-9 for _, i in openings(r))
    assert r.ledger.summary().events["state"] == 3 and len(lost(r)) == 3 and max(lost(r)) < 1e-20
    L = LINES["line57"][1] * Z / W
    assert lost(tripped(1, chop=50.0)) == pytest.approx([0.5 * L * 50.0**2] * 3, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("k", [2, 3])
def test_poles_open_within_a_nanosecond_of_the_zeros_in_phase_coordinates(k: int) -> None:
    times = [t for t, _ in openings(tripped(k))]
    assert times == pytest.approx(opened(), abs=(1e-9, 1e-11)[k - 2])
