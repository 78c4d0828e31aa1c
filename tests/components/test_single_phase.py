"""Parts of one phase: networks against their equations in currents and voltages, and against a phase of three."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from phfmu import Collocated, FMUInstance, NativeInstance, Network, PythonInstance, Scene, build_model, check, export
from phfmu.components.electrical import (
    MagnetisationCurve,
    breaker,
    capacitor_bank,
    coupled_line,
    fault,
    fault_events,
    fault_resistor,
    load,
    pi_line,
    rl_branch,
    rlc_branch,
    rlc_load,
    saturating_reactor,
    series_compensated_line,
    shunt,
    surge_arrester,
    thevenin_source,
    two_winding_transformer,
)
from phfmu.components.scenes.electrical.network_events import ferroresonance
from phfmu.studies.stress import iron
from tests.components.orders import orders
from tests.components.test_network_shunts import current
from tests.components.test_scenes import closed, monolithic
from tests.wide import wide

W, BEGIN, END = 100 * np.pi, 0.01, 0.03
#: flux and current of the core in parts of the rated peaks; smooth enough for order 6
CORE = MagnetisationCurve(((0.8, 0.02), (1.1, 0.2), (1.3, 0.9)), 1.5)
V1, V2, S = 11.5e3, 230.0, 50e3
LINE, FAULT, R2, C2 = {"R": 4.0, "L": 12e-3, "C": 2e-6}, 0.5, 1.3, 3e-3


def feeder() -> Network:
    """Source, pi line, saturating transformer, two loads with capacitors and a cable between, an earth fault: one phase."""
    net = Network("feeder")
    net.add("grid", thevenin_source(V1, 20e6, f=50.0, x_r=2.0, rated=10.0, phases=1))
    net.add("line", pi_line(**LINE, v=16e3, rated=10.0, phases=1))
    net.add("unit", two_winding_transformer(S, V1, V2, r=0.02, x=0.05, curve=CORE, phases=1))
    net.add("load", rlc_load(R2, None, C2, nominal=325.0, phases=1))
    net.add("spur", coupled_line(0.02, 2e-4, v=325.0, rated=100.0, phases=1))
    net.add("fault", fault(R=FAULT, nominal=325.0, phases=1))
    net.junction("bus1", ["grid.terminal", "line.a"])
    net.junction("bus2", ["line.b", "unit.a"])
    net.add("far", rlc_load(R2, None, C2 / 2, nominal=325.0, phases=1))
    net.junction("bus3", ["unit.b", "load.terminal", "spur.a"])
    net.junction("bus4", ["spur.b", "far.terminal", "fault.terminal"])
    return net


@cache
def reference() -> np.ndarray:
    """Currents and voltages at END: DOP853 at 1e-13 with the circuit's own equations in SI units."""
    Z, n = V1**2 / 20e6, V1 / V2
    Rs, Ls = Z / np.sqrt(5.0), 2.0 * Z / np.sqrt(5.0) / W
    Zt = V2**2 / S
    Rt, Lt = 0.02 * Zt, 0.05 * Zt / W
    peak, rated = np.sqrt(2) * V2 / W, np.sqrt(2) * S / V2
    points = CORE.points

    def rates(t, y, G):
        i_s, v_a, i, v_b, i_t, core, v_2, i_f, v_3 = y
        i_m = rated * current(core / peak, points, CORE.rounding)
        return [
            (np.sqrt(2) * V1 * np.cos(W * t) - Rs * i_s - v_a) / Ls,
            (i_s - i) / (LINE["C"] / 2),
            (v_a - v_b - LINE["R"] * i) / LINE["L"],
            (i - (i_t + i_m) / n) / (LINE["C"] / 2),
            (v_b / n - v_2 - Rt * i_t) / Lt,
            v_b / n,
            (i_t - v_2 / R2 - i_f) / C2,
            (v_2 - v_3 - 0.02 * i_f) / 2e-4,
            (i_f - v_3 / R2 - G * v_3) / (C2 / 2),
        ]

    y = np.zeros(9)
    for span, G in (((0.0, BEGIN), 0.0), ((BEGIN, END), 1 / FAULT)):
        y = solve_ivp(rates, span, y, "DOP853", rtol=1e-13, atol=1e-10, max_step=2e-5, args=(G,)).y[:, -1]
    return y


NAMES = ("line.i", "unit.i", "load.v", "spur.i")


def error(k: int, n: int) -> float:
    net = feeder()
    scene = Scene("feeder", net, END, END / n, fault_events("fault", BEGIN))
    result = monolithic(scene, scene.step, scene.stop, k)
    assert closed(result, 1e-12)
    y = reference()
    exact = dict(zip(NAMES, (y[2], y[4], y[6], y[7]), strict=True))
    size = {"line.i": 10.0, "unit.i": 300.0, "load.v": 325.0, "spur.i": 100.0}
    return max(abs(result.column(name)[-1] - exact[name]) / size[name] for name in NAMES)


@pytest.mark.parametrize(("k", "n"), wide([(1, 4800), (2, 1200), (3, 300)], (3, 300)))
def test_a_feeder_of_one_phase_converges_to_its_equations(k, n):
    found = [error(k, m) for m in (n, 2 * n)]
    assert found[1] < {1: 2e-2, 2: 1e-3, 3: 1e-4}[k]
    assert orders(found)[0] == pytest.approx(2 * k, abs=0.4), found


@pytest.mark.parametrize(("order", "h"), [(2, 1e-5), (4, 4e-5), (6, 8e-5)])
def test_ferroresonance_converges_to_its_circuit(order, h):
    """The flux after 30 ms against DOP853 in currents and voltages."""
    ends = []
    for step in (h, h / 2):
        plan = build_model(ferroresonance().declaration(), Collocated(order // 2))
        unit = NativeInstance(plan)
        unit.run(0.0, step, round(0.03 / step), ())
        names = [s for v in plan.declaration.states for s in v.names()]
        ends.append(unit.x[names.index("iron.flux")])
    exact = solve_ivp(iron.rates(-np.pi / 2), (0.0, 0.03), np.zeros(6), "DOP853", rtol=1e-12, atol=1e-10).y[-1, -1]
    errors = [abs(x - exact) for x in ends]
    assert orders(errors)[0] == pytest.approx(order, abs=0.5), errors


def test_the_instant_of_the_switching_decides_on_ferroresonance():
    """The voltage of the core stays below that of the grid, or far above."""
    peaks = []
    for phase in (0.0, -np.pi / 2):
        scene = ferroresonance(phase)
        result = monolithic(scene, scene.step, scene.stop, 1)
        assert closed(result, 1e-12)
        peaks.append(np.abs(result.column("stray.v")[result.time > 0.2]).max() / iron.PEAK)
    assert peaks[0] < 0.9 and peaks[1] > 1.8


# -- every part ------------------------------------------------------------------------------------------------------------

ROOT = np.sqrt(3.0)
#: parts of n phases, powers and voltages of three being those of three phases
PARTS = {
    "coupled_line": lambda n, V, S: coupled_line(0.5, 0.01, v=V, rated=S / V, phases=n),
    "pi_line": lambda n, V, S: pi_line(0.5, 0.01, 1e-4, v=V, rated=S / V, phases=n),
    "series_compensated_line": lambda n, V, S: series_compensated_line(0.5, 0.01, 2e-3, v=V, rated=S / V, phases=n),
    "thevenin_source": lambda n, V, S: thevenin_source(V, 10 * S, angle=0.3, phases=n),
    "two_winding_transformer": lambda n, V, S: two_winding_transformer(
        S, V, V / 10, i0=0.03, p0=0.01, r=0.01, phases=n
    ),
    "saturated transformer": lambda n, V, S: two_winding_transformer(S, V, V / 10, curve=CORE, linkage0=0.2, phases=n),
    "load": lambda n, V, S: load(S, S / 2, V=V, angle=0.2, phases=n),
    "capacitive load": lambda n, V, S: load(S, -S / 2, V=V, angle=0.2, phases=n),
    "series load": lambda n, V, S: load(S, S / 2, V=V, kind="series", angle=0.2, phases=n),
    "shunt": lambda n, V, S: shunt(S, V=V, phases=n),
    "capacitor_bank": lambda n, V, S: capacitor_bank(S, V=V, detuning=0.07, phases=n),
    "rlc_branch": lambda n, V, S: rlc_branch(2.0, 0.01, 1e-3, v=100.0, phases=n),
    "resistive branch": lambda n, V, S: rlc_branch(2.0, None, 1e-3, v=100.0, phases=n),
    "rlc_load": lambda n, V, S: rlc_load(2.0, 0.01, 1e-3, v=(1.0, 2.0, 3.0) if n == 3 else 1.0, phases=n),
    "fault": lambda n, V, S: fault(R=0.5, phases=n),
    "fault_resistor": lambda n, V, S: fault_resistor(2.0, phases=n),
    "breaker": lambda n, V, S: breaker(0.5, 0.01, phases=n),
    "saturating_reactor": lambda n, V, S: saturating_reactor(CORE.points, 0.1, size=None if n == 1 else n),
    "surge_arrester": lambda n, V, S: surge_arrester(300.0, size=None if n == 1 else n),
}


def first(names: list[str]) -> list[int]:
    """Places of phase a among the names of three phases, and of what has no phases."""
    return [j for j, name in enumerate(names) if not name.endswith(("[2]", "[3]"))]


@pytest.mark.parametrize(
    ("name", "engine"),
    # the Python engine lands on no state events
    [(n, e) for n in PARTS for e in (NativeInstance, PythonInstance) if (n, e) != ("breaker", PythonInstance)],
)
def test_a_part_of_one_phase_is_phase_a_of_three(name, engine):
    """Three phases of V, line to line, and 3 S against one of V/sqrt(3) and S, with other inputs at b and c."""
    models = [PARTS[name](3, 400.0, 3e4), PARTS[name](1, 400.0 / ROOT, 1e4)]
    ends = []
    for model in models:
        assert check(model) == []
        plan = build_model(model, Collocated(2))
        unit = engine(plan)
        if name == "fault":
            unit.set_parameters([1.0, 0.5])
        width = plan.step.nu // (3 if model is models[0] else 1)
        for n in range(20):
            a = 100.0 * np.sin(0.3 * n + np.arange(width))
            unit.set_input(np.ravel(np.outer(a, [1.0, -0.4, 0.7])) if model is models[0] else a)
            unit.do_step(1e-3 * n, 1e-3)
        names = [s for v in model.states for s in v.names()]
        signals = unit.signals()
        ends.append(
            (unit.x[first(names)] if names else unit.x, np.ravel(signals["y_end"])[:: 3 if model is models[0] else 1])
        )
        row = unit.ledger()
        gap = abs(float(np.sum(row["stored"] + row["dissipated"] - row["supplied"])))
        assert gap <= 1e-12 * (float(np.sum(signals["H"])) + float(np.sum(np.abs(row["supplied"]))) + 1e-300)
    for of_three, of_one in zip(*ends, strict=True):
        assert of_one == pytest.approx(of_three, rel=1e-11, abs=1e-11 * np.max(np.abs(of_three), initial=1e-9))


@pytest.mark.parametrize("name", wide(PARTS, "saturated transformer"))
def test_units_of_both_versions_step_as_the_engine(name, tmp_path):
    plan = build_model(PARTS[name](1, 230.0, 1e4), Collocated(2))
    native = NativeInstance(plan)
    us = [100.0 * np.sin(0.3 * n + np.arange(plan.step.nu)) for n in range(30)]
    for n, u in enumerate(us):
        native.set_input(u)
        native.do_step(1e-3 * n, 1e-3)
    for path in export(plan, tmp_path, step=1e-3):
        with FMUInstance(path) as unit:
            for n, u in enumerate(us):
                unit.set_input(u)
                unit.do_step(1e-3 * n, 1e-3)
            names = [s for v in plan.declaration.states for s in v.names()]
            assert np.asarray(unit.get(names)) == pytest.approx(native.x, rel=1e-12, abs=1e-12) if names else True


def test_an_earthing_impedance_rings_as_its_circuit():
    """A coil of R and L from a neutral to ground beside the capacitance of the neutral: v' = -(v/L) .., in closed form."""
    R, L, C = 2.0, 0.5, 1e-5
    net = Network("earthing")
    net.add("coil", rl_branch(R, L, v=1e3))
    net.add("neutral", rlc_load(None, None, C, v=1e3, nominal=1e3, phases=1))
    net.junction("n", ["coil.terminal", "neutral.terminal"])
    result = monolithic(Scene("earthing", net, 0.02, 1e-4), 1e-4, 0.02, 3)
    s = -R / (2 * L)
    w = np.sqrt(1 / (L * C) - s**2)
    t = result.time
    exact = 1e3 * np.exp(s * t) * (np.cos(w * t) - s / w * np.sin(w * t))
    assert result.column("neutral.v") == pytest.approx(exact, abs=1e-6)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda: coupled_line(0.5, 0.01, phases=2), "phases = 2; a part has 3 phases, or 1"),
        (lambda: coupled_line(0.5, 0.01, R0=1.0, phases=1), "R0 = 1 with one phase"),
        (lambda: pi_line(0.5, 0.01, 1e-6, C0=1e-7, phases=1), "C0 = 1e-07 with one phase"),
        (lambda: thevenin_source(230.0, 1e4, zero=2.0, phases=1), "zero = 2 with one phase"),
        (lambda: two_winding_transformer(1e4, 230.0, 23.0, group="Dyn11", phases=1), "Ii0 and Ii6 have one"),
        (lambda: two_winding_transformer(1e4, 230.0, 23.0, group="Ii6"), "'Ii6' with phases = 3"),
        (lambda: fault("bcg", phases=1), "kind 'bcg' with one phase"),
    ],
)
def test_what_one_phase_does_not_have_is_refused(wrong, words):
    with pytest.raises(ValueError, match=words):
        wrong()
