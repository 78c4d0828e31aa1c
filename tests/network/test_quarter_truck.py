"""A chassis and a wheel of libcosim's test data, which keep the steps before the last one that was told that nothing is restored.

    400 v' = -F,   40 w' = F - K x,   F = 15000 d + 1000 d',   d' = v - w,   x' = w,   K = 150000,   x(0) = -0.1

with x the wheel's height above the ground; the bond carries F v.  The reference is integrated to 1e-12.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from phfmu.cli import main
from tests.fmu.public_units import public
from tests.wide import wide

CHASSIS, WHEEL = "quarter_truck/Chassis.fmu", "quarter_truck/Wheel.fmu"
SCENE = """
from phfmu import Network, Scene


def port(effort, flow, sign):
    units = {"effort_unit": "N", "flow_unit": "m/s", "domain": "translational"}
    return {"rod": {"effort": effort, "flow": flow, "sign": sign, **units}}


def truck():
    net = Network("truck")
    net.add("chassis", "Chassis.fmu", ports=port("force", "velocity", -1))
    net.add("wheel", "Wheel.fmu", ports=port("out_spring_damper_f", "in_vel", 1))
    net.connect("chassis.rod", "wheel.rod", name="bond")
    return Scene("truck", net, stop=10.0, step=1e-3)
"""
FINE = ["--set", "wheel.timeStep=1e-5", "--set", "chassis.timeStep=1e-5"]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for path in (public(CHASSIS, WHEEL), public(WHEEL)):
        shutil.copy(path, tmp_path)
    (tmp_path / "truck.py").write_text(SCENE)
    return tmp_path


def table(folder: Path, *options: str) -> np.ndarray:
    out = folder / "out.csv"
    assert main(["run", *options, "-o", str(out)]) == 0
    return np.genfromtxt(out, delimiter=",", names=True, deletechars="")


@pytest.mark.parametrize("isolate", wide([False, True], False))
def test_the_wheel_alone_goes_on(folder: Path, isolate: bool) -> None:
    """Under the input 0 it swings on both of its springs, damped by 1000."""
    options = [*["--isolate"] * isolate, "--step", "0.01", "--stop", "1", "--set", "timeStep=1e-5"]
    rows = table(folder, str(folder / "Wheel.fmu"), *options)

    def rates(_: float, x: np.ndarray) -> list[float]:
        return [x[1], -(165000.0 * x[0] + 1000.0 * x[1] - 15000.0) / 40.0]

    exact = solve_ivp(rates, (0.0, 1.0), [0.0, 0.0], "DOP853", rows["time"], rtol=1e-12, atol=1e-14).y[0]
    assert np.abs(rows["position"] - exact).max() < 2e-4 * exact.max()  # the unit keeps 1e-4
    usual = table(folder, str(folder / "Wheel.fmu"), "--step", "0.01", "--stop", "0.04")
    assert usual["acceleration"][2] == pytest.approx(34.135, abs=5e-4)


def truth(stop: float) -> float:
    """Energy that has passed through the bond, in both directions."""

    def rates(_: float, s: np.ndarray) -> list[float]:
        y, v, x, w, _ = s
        force = 15000.0 * (y - x) + 1000.0 * (v - w)
        return [v, -force / 400.0, w, (force - 150000.0 * (x - 0.1)) / 40.0, abs(force * v)]

    found = solve_ivp(rates, (0.0, stop), np.zeros(5), "DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    return float(found[4])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("coupling", "step", "stop", "made", "passed"),
    [
        ("newton", 1e-4, 0.2, 1e-11, 1e-3), ("anderson", 1e-4, 0.2, 1e-11, 1e-3),
        ("newton", 1e-3, 10.0, 1e-4, 2e-3),
        ("gauss-seidel", 1e-3, 10.0, 1e-8, 2e-3), ("gauss-seidel", 1e-2, 10.0, 1e-8, 2e-2),
    ],
)  # fmt: skip
def test_energy_through_the_bond(
    folder: Path, coupling: str, step: float, stop: float, made: float, passed: float
) -> None:
    """Nearly none is made, and what passes is right; the wheel cannot take long steps back exactly and is then stepped last."""
    exchanged, net = bond(folder, coupling, step, stop)
    assert abs(net) < made and exchanged == pytest.approx(truth(stop), rel=passed)


@pytest.mark.slow
@pytest.mark.parametrize(("step", "made"), [(1e-3, 3.15), (5e-3, 16.3), (1e-2, 33.4)])
def test_jacobi_makes_energy_in_proportion_to_the_step(folder: Path, step: float, made: float) -> None:
    assert bond(folder, "jacobi", step, 10.0)[1] == pytest.approx(made, rel=5e-3)


def bond(folder: Path, coupling: str, step: float, stop: float) -> tuple[float, float]:
    """Energy exchanged in all, and made, at the bond [J]."""
    from phfmu.audit.analysis import summarise

    audit = folder / "truck.parquet"
    options = ["--coupling", coupling, "--step", f"{step:g}", "--stop", f"{stop:g}", "--audit", str(audit), "--quiet"]
    assert main(["run", f"{folder}/truck.py", *FINE, *options]) == 0
    (found,) = summarise(audit).junctions
    return found.exchanged, found.residual
