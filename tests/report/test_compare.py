"""phfmu compare: what differs, by how much and where; times that differ; what is not there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from phfmu.cli import main


def write(path: Path, time: np.ndarray, **columns: np.ndarray) -> str:
    names = ",".join(("time", *columns))
    np.savetxt(path, np.column_stack([time, *columns.values()]), "%.17g", ",", header=names, comments="")
    return str(path)


T = np.linspace(0.0, 1.0, 11)


def test_the_largest_difference_and_where(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    x = np.sin(T)
    y = x.copy()
    y[7] += 0.25
    a = write(tmp_path / "a.csv", T, x=x, v=2 * T)
    b = write(tmp_path / "b.csv", T, x=y, v=2 * T * (1 + 1e-12))
    assert main(["compare", a, b]) == 1
    out = capsys.readouterr().out
    line = out.splitlines()[1].split()
    assert line[0] == "x" and float(line[2]) == 0.25 and float(line[3]) == pytest.approx(0.7) and line[-1] == "beyond"
    assert float(line[1]) == pytest.approx(0.25 / np.abs(y).max(), rel=1e-2)
    assert "2 signals: 0 equal, 1 within rtol 1e-09, 1 beyond" in out
    assert main(["compare", a, b, "v"]) == 0
    assert main(["compare", a, b, "--rtol", "0.5"]) == 0
    assert main(["compare", a, b, "--rtol", "0", "--atol", "0.26"]) == 0
    assert main(["compare", a, b, "--rtol", "0", "--atol", "0.24"]) == 1


def test_a_table_with_more_rows_is_taken_at_the_times_of_the_other(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fine, off = np.linspace(0.0, 1.0, 21), np.linspace(0.0, 1.0, 14)
    a = write(tmp_path / "a.csv", T, x=3 * T)
    b = write(tmp_path / "b.csv", fine, x=3 * fine)
    c = write(tmp_path / "c.csv", off, x=3 * off)
    assert main(["compare", a, b]) == 0 and "linearly" not in capsys.readouterr().out
    assert main(["compare", b, a]) == 0
    assert main(["compare", a, c]) == 0 and "linearly" in capsys.readouterr().out


def test_numbers_that_are_none_differ_from_those_that_are(tmp_path: Path) -> None:
    x = np.ones(11)
    y = x.copy()
    y[3] = np.nan
    a, b = write(tmp_path / "a.csv", T, x=x), write(tmp_path / "b.csv", T, x=y)
    assert main(["compare", a, b, "--rtol", "1e9"]) == 1 and main(["compare", b, b]) == 0


def test_residuals_are_measured_by_the_energies_of_the_run(tmp_path: Path) -> None:
    r = 1e-14 * np.cos(9 * T)
    names = {"gen.energy.stored": 100 + T, "gen.energy.residual": r}
    a = write(tmp_path / "a.csv", T, **names)
    b = write(tmp_path / "b.csv", T, **names | {"gen.energy.residual": -r})
    c = write(tmp_path / "c.csv", T, **names | {"gen.energy.residual": r + 1e-6})
    assert main(["compare", a, b]) == 0 and main(["compare", a, c]) == 1


def test_runs_of_both_engines_and_their_audits(
    tmp_path: Path, compiler: None, capsys: pytest.CaptureFixture[str]
) -> None:
    for engine in ("native", "python"):
        names = [str(tmp_path / f"{engine}.parquet"), str(tmp_path / f"{engine}.audit.parquet")]
        words = ["--quiet", "--stop", "0.2", "-o", names[0], "--audit", names[1]]
        assert main(["run", "oscillator", "--engine", engine, *words]) == 0
    assert main(["compare", *(str(tmp_path / f"{e}.parquet") for e in ("native", "python"))]) == 0
    assert main(["compare", *(str(tmp_path / f"{e}.audit.parquet") for e in ("native", "python")), "*.H"]) == 0
    assert main(["run", "oscillator", "--step", "0.02", "--quiet", "--stop", "0.2", "-o", str(tmp_path / "c.csv")]) == 0
    assert main(["compare", str(tmp_path / "native.parquet"), str(tmp_path / "c.csv")]) == 1


@pytest.mark.parametrize(
    ("columns", "words", "said"),
    [
        ({"y": T}, [], "no signal in common"),
        ({"x": T}, ["z"], "has no signal 'z'"),
        ({"x": T}, ["--rtol", "-1"], "--rtol -1"),
    ],
)
def test_bad_input(
    columns: dict[str, np.ndarray], words: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    a, b = write(tmp_path / "a.csv", T, x=T), write(tmp_path / "b.csv", T, **columns)
    assert main(["compare", a, b, *words]) == 2
    assert said in capsys.readouterr().err


def test_times_in_common_there_must_be(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a, b = write(tmp_path / "a.csv", T, x=T), write(tmp_path / "b.csv", T + 5, x=T)
    assert main(["compare", a, b]) == 2 and "no times in common" in capsys.readouterr().err
