"""Sweeps as pictures: what is drawn against what, and what is no such table."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import csv, parquet

from phfmu.cli import main
from phfmu.report.sweep_picture import _axes
from phfmu.report.sweep_table import is_sweep, logarithmic, read_sweep

X, Y = np.array([1.0, 2.0, 3.0]), np.array([0.1, 1.0, 10.0, 100.0])


def table(path: Path, names: int = 2, rows: int = 12, failed: int = -1) -> Path:
    """max(w) = x y of runs over a grid of x and y (and z), or of the first rows of it."""
    grid = [g.ravel()[:rows] for g in np.meshgrid(X, Y, [5.0], indexing="ij")][:names]
    value = pa.array(grid[0] * (grid[1] if names > 1 else 1.0), mask=np.arange(rows) == failed)
    errors = ["no start" if i == failed else "" for i in range(rows)]
    columns = dict(zip(("x", "y", "z[1]"), grid, strict=False))
    columns |= {
        "max(w)": value,
        "last(energy.stored)": value,
        "steps": np.ones(rows, int),
        "ledger": np.zeros(rows),
        "error": errors,
    }
    (csv.write_csv if path.suffix == ".csv" else parquet.write_table)(pa.table(columns), path)
    return path


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_a_grid_of_two_values_is_a_map(tmp_path: Path, ending: str, capsys: pytest.CaptureFixture[str]) -> None:
    file = table(tmp_path / f"sweep.{ending}", failed=5)
    assert is_sweep(file)
    found = read_sweep(file)
    assert list(found.varied) == ["x", "y"] and list(found.measured) == ["max(w)", "last(energy.stored)"]
    grid = found.grid("max(w)")
    assert grid is not None
    exact = np.outer(Y, X)
    exact[1, 1] = np.nan  # the run that failed
    assert np.array_equal(grid[0], X) and np.array_equal(grid[1], Y)
    np.testing.assert_array_equal(grid[2], exact)
    assert main(["plot", str(file), "max(w)", "-o", str(tmp_path / "map.html")]) == 0
    assert "1 run of 12 failed: no start" in capsys.readouterr().out
    page = (tmp_path / "map.html").read_text(encoding="utf-8")
    (figure,) = [json.loads(t) for t in re.findall(r'class="figure">(\{.*?\})</script>', page, re.DOTALL)]
    assert [t["type"] for t in figure["data"]] == ["heatmap"]
    assert figure["layout"]["yaxis"]["type"] == "log" and figure["layout"]["xaxis"]["type"] == "linear"
    assert main(["plot", str(file), "-o", str(tmp_path / "map.png"), "--size", "900x400"]) == 0


def test_one_value_is_a_curve_and_what_is_no_grid_or_more_are_points(tmp_path: Path) -> None:
    one = read_sweep(table(tmp_path / "one.csv", names=1, rows=3))
    assert _axes(one) == [("max(w)", "x"), ("last(energy.stored)", "x")]
    part = read_sweep(table(tmp_path / "part.csv", rows=11))
    assert part.grid("max(w)") is None
    three = read_sweep(table(tmp_path / "three.csv", names=3))
    assert _axes(three)[:3] == [("max(w)", "x"), ("max(w)", "y"), ("max(w)", "z[1]")]
    for name in ("one", "part", "three"):
        for ending in ("png", "html"):
            assert main(["plot", str(tmp_path / f"{name}.csv"), "-o", str(tmp_path / f"{name}.{ending}")]) == 0
            assert (tmp_path / f"{name}.{ending}").stat().st_size > 1000


def test_axes_of_factors_are_logarithmic() -> None:
    assert logarithmic(Y) and logarithmic(np.geomspace(1.0, 4.0, 10))
    assert not any(
        map(logarithmic, (X, np.array([1.0, 2.0]), np.geomspace(1.0, 2.0, 9), np.array([-1.0, 1.0, 3.0]), np.ones(4)))
    )


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["min(w)"], "has no signal 'min(w)'; did you mean max(w)?"),
        (["--window", "0:1"], "--window is about the time of one run"),
    ],
)
def test_what_a_sweep_has_not_is_told(
    words: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = table(tmp_path / "sweep.csv")
    assert main(["plot", str(file), *words, "-o", str(tmp_path / "x.png")]) == 2
    assert said in capsys.readouterr().err


def test_a_sweep_writes_csv_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    call = [
        "sweep",
        "mass",
        "--vary",
        "m=1,2,4",
        "--measure",
        "last(v)",
        "--stop",
        "0.01",
        "--engine",
        "python",
        "--set",
        "flange.force=1",
    ]
    assert main([*call, "-o", "s.csv"]) == main([*call, "-o", "s.parquet"]) == 0
    one, two = (read_sweep(f"s.{ending}") for ending in ("csv", "parquet"))
    assert one.measured["last(v)"].tolist() == two.measured["last(v)"].tolist() == pytest.approx([0.01, 0.005, 0.0025])
    assert not is_sweep("s.csv.none")
    assert main([*call, "-o", "s.txt"]) == 2
    assert "the ending must be .parquet or .csv" in capsys.readouterr().err
