"""Modes at a time of a run: against closed forms, and a machine at a grid against its own equations in other coordinates."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from machine_reference import ALPHA, MachineReference
from reference_tools import load
from scipy.integrate import solve_ivp

import phfmu as ph
from phfmu import NativeInstance, Options, PythonInstance, build_model, run
from phfmu.cli import main
from phfmu.components.library import build
from phfmu.components.scenes.electrical.smib import smib_folded
from phfmu.derivatives.modes import modes_at
from phfmu.network.couplings.monolithic import Monolithic
from tests.wide import wide


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("order", wide([2, 4, 6], 2))
def test_masses_on_springs(order: int) -> None:
    """The model's eigenvalues are exact at any order, those of the steps have no damping of their own."""
    declaration = build("oscillator").declaration()
    model = build_model(declaration, ph.Collocated(order // 2))
    found = modes_at(model, NativeInstance(model), 0.0, 0.02)
    still, slow, fast = found.modes
    assert found.gone == 0 and abs(still.s) < 1e-10
    for mode, hertz in ((slow, 1.0), (fast, 3.0)):
        assert mode.model is not None and abs(mode.model.imag) / (2 * np.pi) == pytest.approx(hertz, rel=1e-10)
        assert abs(mode.s.real) < 1e-10 * abs(mode.s) and abs(mode.model.real) < 1e-10 * abs(mode.model)
        y = 2 * np.pi * hertz * 0.02
        assert abs(mode.frequency / hertz - 1) < {2: 1.1 * y**2 / 12, 4: y**4 / 700, 6: y**6 / 90000}[order]
    assert dict(fast.shares)["spring12.e"] == max(dict(fast.shares).values())


def test_a_damped_circuit() -> None:
    """s = -R/(2 L) +- i sqrt(1/(L C) - (R/(2 L))^2); both states take part alike."""
    L, C, R = 1e-3, 1e-6, 10.0
    flux, charge = ph.state("flux", unit="Wb", start=1e-3), ph.state("charge", unit="C")
    H = ph.energy(flux.sx**2 / (2 * L) + charge.sx**2 / (2 * C))
    loss = ph.damping(flux, R)
    d = ph.PHDAE(
        "circuit", states=(flux, charge), energies=(H,), structure=(ph.skew(flux, charge, -1),), dissipation=(loss,)
    )
    model = build_model(d)
    (mode,) = modes_at(model, PythonInstance(model), 0.0, 5e-6).modes
    exact = complex(-R / (2 * L), np.sqrt(1 / (L * C) - (R / (2 * L)) ** 2))
    assert mode.model is not None and abs(complex(mode.model.real, abs(mode.model.imag)) - exact) < 1e-8 * abs(exact)
    assert mode.damping == pytest.approx(-exact.real / abs(exact), rel=0.01)
    assert dict(mode.shares)["flux"] == pytest.approx(0.5, abs=1e-9)


@pytest.mark.usefixtures("compiler")
@pytest.mark.slow
def test_the_swing_of_a_machine_over_a_period() -> None:
    """Floquet multipliers of the machine's equations in phase quantities, by differences of SciPy's runs."""
    scene, machines = load("scenes")["smib"], load("machines")
    machine = MachineReference(machines[scene["machine"]], scene["d"], scene["Rx"], scene["Lx"])
    bus, inputs, initial = scene["infinite_bus"], scene["inputs"], scene["initial"]
    w = bus["w"]
    period = 2 * np.pi / w

    def rhs(t: float, y: np.ndarray) -> np.ndarray:
        v = bus["amp"] * np.cos(w * t + bus["phase"] - ALPHA)
        torque = inputs["tau"] if "tau" in inputs else inputs["tau1"] / 1.1
        d = machine.rhs(y[:6], machine.J * w + y[6], w * t + y[7], v, inputs["Vf"], torque)
        return np.concatenate([d[0], [d[1], y[6] / machine.J]])

    psi = machine.fluxes(initial["I"], initial["theta"])
    y0 = np.concatenate([psi, [initial["p"] - machine.J * w, initial["theta"]]])
    scale = np.concatenate([np.full(3, 50.0), np.abs(psi[3:]), [machine.J], [1.0]])

    def after(y: np.ndarray) -> np.ndarray:
        return solve_ivp(rhs, (0.0, period), y, "DOP853", rtol=3e-13, atol=1e-13 * scale, max_step=1e-4).y[:, -1]

    columns = []
    for i in range(8):
        e = np.zeros(8)
        e[i] = 1e-3 * scale[i]
        columns.append((after(y0 + e) - after(y0 - e)) / (2 * e[i]))
    exact = np.log(np.linalg.eigvals(np.column_stack(columns)).astype(complex)) / period
    folded = smib_folded()
    model = build_model(folded.declaration(), ph.Collocated(3))
    stepper = Monolithic(model, NativeInstance(model))
    stepper.check_start()
    n = 100
    found = modes_at(model, stepper.instance, 0.0, period / n, period)
    swing = min(found.modes, key=lambda m: abs(m.frequency - 1.36))
    other = exact[np.argmin(np.abs(exact - swing.s))]
    assert swing.frequency == pytest.approx(1.36, abs=0.05) and abs(swing.s - other) < 1e-4 * abs(other)
    assert {name for name, _ in swing.shares[:2]} == {"gen.p", "gen.theta"}


@pytest.mark.usefixtures("compiler")
def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "m.json"
    period = 1 / 60
    words = ["--at", "0.05", "--period", f"{period:.15g}", "--step", f"{period / 60:.15g}", "-o", str(out)]
    assert main(["modes", "smib", *words]) == 0
    assert "gen.theta" in capsys.readouterr().out
    swing = [m for m in json.loads(out.read_text())["modes"] if 1.3 < m["frequency"] < 1.4]
    assert len(swing) == 1 and 0.05 < swing[0]["damping"] < 0.1
    assert main(["modes", "smib", "--period", "0.0167", "--step", "1e-3"]) == 2
    assert "is not a number of steps" in capsys.readouterr().err


def test_a_run_goes_on_from_where_modes_were_asked() -> None:
    model = build_model(build("dc_motor"))
    instance = PythonInstance(model)
    stepper = Monolithic(model, instance)
    stepper.set_value("terminal.v", 12.0)
    run(stepper, Options(stop=0.01, step=1e-3))
    found = modes_at(model, instance, 0.01, 1e-3)
    assert instance.time == pytest.approx(0.011) and found.t == 0.01
