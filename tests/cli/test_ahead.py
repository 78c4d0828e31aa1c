"""What is said before a long run, and what is refused because it is too much at once."""

from __future__ import annotations

from pathlib import Path

import pytest

from phfmu.cli import main
from phfmu.cli.progress import ahead
from phfmu.runs.options import Options


def test_a_long_run_says_how_many_rows_are_coming_and_how_large(tmp_path: Path) -> None:
    table = tmp_path / "o.csv"
    (line,) = ahead(Options(stop=1e6, step=1e-3), 21, table)
    assert line.startswith("1e+09 steps to come; o.csv: 1e+09 rows of 22 columns, about 352 GB, of ")
    assert "that are free" in line and "--every N" in line
    (line,) = ahead(Options(stop=1e6, step=1e-3, every=1000), 21, table)
    assert "1e+06 rows of 22 columns, about 352 MB" in line and "--every" not in line
    assert "1e+06 rows" in ahead(Options(stop=1e6, step=1e-3, every=1.0), 21, table)[0]
    assert "1.1e+07 rows" in ahead(Options(stop=1e3, step=1e-3, dense=10), 21, table.with_suffix(".parquet"))[0]
    assert ahead(Options(stop=1e6, step=1e-3), 21, None) == ["1e+09 steps to come"]
    assert ahead(Options(stop=1e3, step=1e-3), 21, table) == []


@pytest.mark.parametrize("every", ["100000000000000000000", "1e300s", "200"])
def test_rows_further_apart_than_the_run_is_long(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], every: str
) -> None:
    monkeypatch.chdir(tmp_path)
    words = ["run", "mass", "--engine", "python", "--stop", "0.1", "--step", "0.001", "--every", every, "-o", "o.csv"]
    assert main(words) == 0
    assert "no such row within the run of 100 steps; its first and its last are kept" in capsys.readouterr().err
    assert len(Path("o.csv").read_text().splitlines()) == 3


def test_rows_within_a_step_are_limited(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "mass", "--dense", "1000000000"]) == 2
    assert "--dense 1000000000: expected a number of rows per step from 1 to 10000" in capsys.readouterr().err
