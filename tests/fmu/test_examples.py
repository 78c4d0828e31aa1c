"""Units with reference solutions for other tools: the files, their form, and that a wrong reference is not kept."""

from __future__ import annotations

import csv
import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

FILE = Path(__file__).parents[2] / "fmus" / "examples.py"
_spec = importlib.util.spec_from_file_location("fmus_examples", FILE)
assert _spec is not None and _spec.loader is not None
maker = importlib.util.module_from_spec(_spec)
sys.modules["fmus_examples"] = maker  # its dataclasses look their module up
_spec.loader.exec_module(maker)


def made(folder: Path, name: str) -> list[Path]:
    assert maker.main(["-o", str(folder), name]) == 0
    return [folder / version / name for version in ("fmi2", "fmi3")]


def test_folder_has_what_importers_need(compiler: None, tmp_path: Path) -> None:
    for folder in made(tmp_path, "dc_motor"):
        names = {"dc_motor.fmu", "dc_motor_ref.csv", "dc_motor_in.csv", "dc_motor_ref.opt", "README.txt"}
        assert {p.name for p in folder.iterdir()} == names
        told = dict(line.split(", ") for line in (folder / "dc_motor_ref.opt").read_text().splitlines())
        text = (folder / "dc_motor_ref.csv").read_text().splitlines()
        assert text[0].startswith('"time","terminal.i",') and text[0].count('"') == 2 * len(text[0].split(","))
        rows = np.array([[float(x) for x in row] for row in csv.reader(text[1:])])
        assert rows[0, 0] == float(told["StartTime"]) and rows[-1, 0] == float(told["StopTime"])
        assert np.allclose(np.diff(rows[:, 0]), float(told["OutputIntervalLength"]), rtol=1e-9)
        v, R, k, d, torque = 24.0, 0.4, 0.05, 1e-5, -0.1
        i = (d * v - k * torque) / (k * k + d * R)  # at rest: v = R i + k w, k i = d w - torque
        column = text[0].replace('"', "").split(",").index("terminal.i")
        assert rows[-1, column] == pytest.approx(i, rel=0.02)  # 0.19 s after the load, time constant 0.016 s
    assert "FMPy" in (tmp_path / "README.md").read_text()


def test_wrong_reference_is_refused(compiler: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    right = maker.reference
    monkeypatch.setattr(maker, "reference", lambda e: right(e) * (1 + 1e-6))
    with pytest.raises(SystemExit, match="differs from the reference by 1.0e-06"):
        maker.main(["-o", str(tmp_path), "dc_motor"])


def test_unknown_example_is_told(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match=r"no dc_moto; it has: dc_motor, four_particle, smib"):
        maker.main(["-o", str(tmp_path), "dc_moto"])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["four_particle", "smib"])
def test_other_examples(compiler: None, tmp_path: Path, name: str) -> None:
    for folder in made(tmp_path, name):
        assert (folder / f"{name}.fmu").stat().st_size > 0
