"""Columns of a run are worked out once, and told to whoever writes them before the first row."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phfmu import Monolithic, Options, PythonInstance, build_model, run
from phfmu.cli import main
from phfmu.components.mechanical.translational import mass
from phfmu.network.members.inputs import places, with_bare
from phfmu.runs.rows import RunColumns


def test_names_and_units_come_before_the_first_row() -> None:
    heard: list[Any] = []
    model = build_model(mass(1.0, k=4.0, q=0.1))
    options = Options(
        stop=0.02,
        step=0.01,
        signals=("q", "flange.force"),
        columns=lambda names, units, kinds, labels: heard.append((list(names), list(units))),
        keep=lambda time, values, _: heard.append(values.shape[1]),
    )
    run(Monolithic(model, PythonInstance(model)), options)
    assert heard[0] == (["q", "flange.force"], ["m", "N"]) and set(heard[1:]) == {2}


def test_a_run_of_the_command_line_works_them_out_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made, init = [], RunColumns.__init__

    def counted(self: RunColumns, *arguments: Any) -> None:
        made.append(self)
        init(self, *arguments)

    monkeypatch.setattr(RunColumns, "__init__", counted)
    table = tmp_path / "run.csv"
    command = f"run oscillator --engine python --step 0.01 --stop 0.02 --signals *.q --quiet -o {table}".split()
    assert main(command) == 0 and len(made) == 1
    assert table.read_text().splitlines()[0].split(",") == ["time", *made[0].names]


def test_a_pattern_that_means_nothing_leaves_no_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table, log = tmp_path / "run.csv", tmp_path / "run.parquet"
    command = f"run oscillator --engine python --stop 0.02 --signals nothing.* -o {table} --audit {log}".split()
    assert main(command) == 2 and "nothing.*" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_bare_name_is_that_of_all_entries_of_its_vector() -> None:
    table = {n: i for i, n in enumerate(["a[1]", "a[2]", "ab", "b"])}
    assert with_bare(table) == {*table, "a"}
    assert [places(table, n) for n in ("a", "a[2]", "ab", "b", "c")] == [[0, 1], [1], [2], [3], []]
    assert np.array_equal(sorted(i for n in ("a", "ab", "b") for i in places(table, n)), range(4))
