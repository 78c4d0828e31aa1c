"""Steps that follow the energy at junctions (`--energy-rtol`), against exact motions and the formula of their tolerance."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from phfmu.audit import read
from phfmu.cli import main
from phfmu.runs.march.adaptive import GROW
from phfmu.words import counted
from tests.fmu import foreign
from tests.network.unit_members import pump_folder
from tests.network.unit_members import table as rows_of
from tests.wide import wide

#: two carts and a spring between them, one of which may be a unit; {more}: beside them
SCENE = """
from phfmu import Network, Scene
from phfmu.components.mechanical.translational import mass, spring


def pair():
    net = Network("pair")
    net.add("pump", {pump})
    net.add("cart", mass(2.0, q=0.3))
    net.add("spring", spring(40.0, elongation=0.3))
    net.junction("a", ["pump.flange", "spring.a"])
    net.junction("b", ["cart.flange", "spring.b"])
    {more}
    return Scene("pair", net, stop=2.0, step=0.01)
"""
SMALL = """
    net.add("light", mass(1e-6))
    net.add("other", mass(1e-6, q=1e-3))
    net.add("fast", spring(2e-3, elongation=1e-3))
    net.junction("c", ["light.flange", "fast.a"])
    net.junction("d", ["other.flange", "fast.b"])
"""


def folder(at: Path, pump: str = "mass(1.0)", more: str = "") -> Path:
    return pump_folder(at, "pair.py", SCENE.format(pump=pump, more=more))


def speed(t: np.ndarray, mass: float, other: float, k: float, e: float) -> np.ndarray:
    """Of the first of two masses on a spring that is stretched by e, from rest."""
    w = np.sqrt(k * (1 / mass + 1 / other))
    return k * e / (mass * w) * np.sin(w * t)


def error(rows: np.ndarray) -> float:
    exact = speed(rows["time"], 1.0, 2.0, 40.0, 0.3)
    return float(np.abs(rows["pump.v"] - exact).max() / np.abs(exact).max())


@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize("coupling", wide(["newton", "anderson"], "newton"))
def test_units_of_other_tools_keep_a_tolerance(tmp_path: Path, version: str, coupling: str) -> None:
    """hidden ~ h^3, error ~ h^2: with R / 100, 4.6 times as many steps and 21.5 times smaller errors, but for the first steps."""
    foreign.mass(tmp_path / "pump.fmu", version)
    own = folder(tmp_path, '"pump.fmu"')
    found = [rows_of(own, "pair.py", "--coupling", coupling, "--energy-rtol", r) for r in ("1e-3", "1e-5")]
    errors, steps = [error(rows) for rows in found], [len(rows) - 1 for rows in found]
    assert 3.5 < steps[1] / steps[0] < 7.0 and 10.0 < errors[0] / errors[1] < 45.0
    w = np.sqrt(60.0)
    assert errors[1] < (w * np.diff(found[1]["time"]).max()) ** 2  # of order two with a constant below one


def test_every_step_keeps_the_tolerance_at_every_junction(tmp_path: Path) -> None:
    """By the columns of the run: means of what is exchanged over each step."""
    R = 1e-3
    rows = rows_of(folder(tmp_path), "pair.py", "--coupling", "newton", "--order", "2", "--energy-rtol", str(R))
    h = np.diff(rows["time"])
    for velocity, force in (("a.velocity", "pump.flange.force"), ("b.velocity", "cart.flange.force")):
        v, F = rows[velocity][1:], rows[force][1:]
        slope = 2.0 * h[1:] / (h[1:] + h[:-1])
        hidden = h[1:] / 12.0 * np.abs(slope**2 * np.diff(v) * np.diff(F))
        passed = h * np.abs(v * F)
        power, floor = 0.0, passed[0]
        for i in range(1, len(h)):
            power += 0.1 * (passed[i - 1] / h[i - 1] - power)
            allowed = R * np.sqrt((passed[: i + 1].sum() + floor) * (passed[i] + h[i] * power + floor))
            assert hidden[i - 1] <= allowed * (1 + 1e-6)


def test_the_weakest_junction_counts_too(tmp_path: Path) -> None:
    """A light pair that swings 8 times as fast beside a heavy one with 1e9 times its energy is resolved as well."""
    rows = rows_of(
        folder(tmp_path, more=SMALL), "pair.py", "--coupling", "newton", "--order", "2", "--energy-rtol", "1e-4"
    )
    exact = speed(rows["time"], 1e-6, 1e-6, 2e-3, 1e-3)
    turned = np.sqrt(2e-3 * 2e6) * np.diff(rows["time"])  # by the light pair in each step
    late = np.sum(turned - 2.0 * np.arctan(turned / 2.0))  # what steps of the midpoint rule turn less
    assert np.abs(rows["light.v"] - exact).max() < 1.1 * late * np.abs(exact).max() and late < 0.5
    assert np.median(turned) < 0.2
    alone = rows_of(folder(tmp_path), "pair.py", "--coupling", "newton", "--order", "2", "--energy-rtol", "1e-4")
    assert len(rows) > 2 * len(alone)


def test_steps_are_taken_again_and_counted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """From a first step that is far too long."""
    own, by_energy = folder(tmp_path), ("--order", "2", "--step", "0.2", "--energy-rtol", "1e-4")
    rows = rows_of(own, "pair.py", "--coupling", "newton", *by_energy)
    told = capsys.readouterr().out
    assert "energy rtol 0.0001, steps" in told and "rejected: 0" not in told and "rejected: " in told
    assert rows["time"][-1] == 2.0 and np.diff(rows["time"])[1:].max() < 0.1


def test_where_a_member_cannot_take_steps_back_the_next_ones_are_sized(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    foreign.mass(tmp_path / "pump.fmu", "2.0")
    own = folder(tmp_path, '"pump.fmu"')
    rows = rows_of(own, "pair.py", "--energy-rtol", "1e-4", "--coupling", "newton", "--set", "pump.forgets=1")
    told = "".join(capsys.readouterr())
    assert "pump cannot take a step back: no step was taken again" in told and "rejected: 0" in told
    assert len(rows) > 100 and error(rows) < 0.05


@pytest.mark.parametrize("coupling", ["jacobi", "gauss-seidel"])
def test_couplings_that_take_each_step_once_keep_a_tolerance(tmp_path: Path, coupling: str) -> None:
    """made ~ h^2, error ~ h: a tolerance 100 times as small makes ten times as many steps, and errors a tenth."""
    options = ("--coupling", coupling, "--stop", "0.5", "--energy-rtol")
    found = [rows_of(folder(tmp_path), "pair.py", *options, r) for r in ("1e-2", "1e-4")]
    errors, steps = [error(rows) for rows in found], [len(rows) - 1 for rows in found]
    assert 7.0 < steps[1] / steps[0] < 20.0 and 5.0 < errors[0] / errors[1] < 25.0


REFUSED = {
    "which exchanges none: take --rtol, or step members apart": ("oscillator", "--energy-rtol", "1e-4"),
    "of order 4: take equal steps, or --order 2": (
        "oscillator",
        "--coupling",
        "newton",
        "--order",
        "4",
        "--energy-rtol",
        "1e-4",
    ),
    "leave out --rtol, --ecco": ("oscillator", "--energy-rtol", "1e-4", "--rtol", "1e-4", "--ecco", "1e-2"),
    "expected a number between 0 and 1": ("oscillator", "--coupling", "newton", "--energy-rtol", "2"),
    "an energy in J from 0": ("oscillator", "--coupling", "newton", "--energy-rtol", "1e-4", "--atol", "-1"),
    "steps by --energy-rtol have others": ("oscillator", "--coupling", "jacobi", "--energy-rtol", "1e-4", "--accuracy"),
}


@pytest.mark.parametrize("words", REFUSED)
def test_where_it_means_nothing_it_is_refused(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", *REFUSED[words]]) == 2
    assert words in capsys.readouterr().err


def test_the_audit_tells_which_steps_were_taken_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Their sum is what the run counts; a step that was taken again is shorter than the trial that the steps before allow."""
    own, audit = folder(tmp_path), tmp_path / "a.parquet"
    options = ["--coupling", "anderson", "--energy-rtol", "1e-5", "--audit", str(audit)]
    assert main(["run", str(own / "pair.py"), *options]) == 0
    told = capsys.readouterr().out
    rows = [r for r in read(audit).to_pylist() if r["row"] == "network"]
    again = [r["rejected"] for r in rows]
    assert sum(again) > 0 and f"rejected: {counted(sum(again), 'trial step')}" in told
    # what a step hides is known from the second one on: the first has the step of the scene, the trial of the second too
    assert again[0] == 0 and rows[0]["h"] == 0.01 and again[1] > 0 and rows[1]["h"] < 0.01
    for before, row in pairwise(rows):
        assert not row["rejected"] or row["h"] < GROW * before["h"]
    assert main(["run", "oscillator", "--coupling", "newton", "--stop", "0.1", "--audit", str(audit), "--quiet"]) == 0
    assert "rejected" not in read(audit).column_names
