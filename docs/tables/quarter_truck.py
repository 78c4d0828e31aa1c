"""Steps of a coupling of other people's units: equal ones, and those that follow the energy at their junction."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from pages import REFERENCE, PageBlock, table
from scipy.integrate import solve_ivp

from phfmu import Coupled, Network, Options, run
from phfmu.network.couplings.gauss_seidel import GaussSeidel
from phfmu.network.couplings.newton import newton
from phfmu.network.members.unit_member import tried, unit_member
from phfmu.runs.result import Result

STOP = 10.0
#: how, coupling, first step, and the other options of a run
ROWS: tuple[tuple[str, Any, float, dict[str, float]], ...] = (
    ("`gauss-seidel`, equal steps", GaussSeidel(), 1e-2, {}),
    ("`gauss-seidel`, equal steps", GaussSeidel(), 2e-3, {}),
    ("`gauss-seidel --ecco 1e-1`", GaussSeidel(), 1e-4, {"ecco": 1e-1, "max_step": 1e-2}),
    ("`gauss-seidel --ecco 1e-2`", GaussSeidel(), 1e-4, {"ecco": 1e-2, "max_step": 1e-2}),
    ("`gauss-seidel --ecco 1e-3`", GaussSeidel(), 1e-4, {"ecco": 1e-3, "max_step": 1e-2}),
    ("`gauss-seidel --energy-rtol 1e-3`", GaussSeidel(), 1e-3, {"energy_rtol": 1e-3}),
    ("`newton`, equal steps", newton, 2e-2, {}),
    ("`newton`, equal steps", newton, 1e-2, {}),
    ("`newton --energy-rtol 1e-3`", newton, 1e-3, {"energy_rtol": 1e-3}),
    ("`newton --energy-rtol 1e-4`", newton, 1e-3, {"energy_rtol": 1e-4}),
    ("`newton --energy-rtol 7e-5`", newton, 1e-3, {"energy_rtol": 7e-5}),
)


def quarter_truck() -> PageBlock:
    """The chassis and the wheel of libcosim's test data (FMI 2.0) over 10 s: steps, error, energy that the bond makes."""
    rows = []
    for how, coupling, step, options in ROWS:
        result = _truck(coupling, step, options)
        (bond,) = result.ledger.summary().junctions
        rows.append([how, result.steps, result.rejected, _error(result), bond.residual, bond.gross])
    return table(
        ["how", "steps", "taken again", "error of the position", "made, net [J]", "made, gross [J]"], rows, ".1e"
    )


def _port(effort: str, flow: str, sign: int) -> dict[str, Any]:
    units = {"effort_unit": "N", "flow_unit": "m/s", "domain": "translational"}
    return {"rod": {"effort": effort, "flow": flow, "sign": sign, **units}}


def _truck(coupling: Any, step: float, options: dict[str, float]) -> Result:
    net, folder = Network("truck"), REFERENCE / "data" / "units" / "quarter_truck"
    folder = folder if folder.is_dir() else type(folder)(os.environ["PHFMU_PUBLIC_UNITS"]) / "quarter_truck"
    net.add("chassis", str(folder / "Chassis.fmu"), ports=_port("force", "velocity", -1))
    net.add("wheel", str(folder / "Wheel.fmu"), ports=_port("out_spring_damper_f", "in_vel", 1))
    net.connect("chassis.rod", "wheel.rod", name="bond")
    files = {name: file.with_starts({"timeStep": 1e-5}) for name, file in net.units.items()}
    found = tried(files, step) if coupling is newton else {}
    members = [unit_member(name, file, step, found.get(name))[0] for name, file in files.items()]
    return run(Coupled(net, members, coupling), Options(stop=STOP, step=step, **options))


def _error(result: Result) -> float:
    """Largest error of the chassis' position, relative to the largest position."""

    def rates(_: float, s: np.ndarray) -> list[float]:
        y, v, x, w = s
        force = 15000.0 * (y - x) + 1000.0 * (v - w)
        return [v, -force / 400.0, w, (force - 150000.0 * (x - 0.1)) / 40.0]

    exact = solve_ivp(rates, (0.0, STOP), np.zeros(4), "DOP853", result.time, rtol=1e-12, atol=1e-14).y[0]
    return float(np.abs(result.column("chassis.position") - exact).max() / np.abs(exact).max())
