"""Sweeps on a Dask cluster here: the same bits as threads; what is kept, and clusters that are none."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from phfmu import Monolithic, NativeInstance, Options, build_model, grid, open_result, run, sweep
from phfmu.cli import main
from phfmu.components.library import build
from phfmu.sweeps.worker_pool import Scheduler
from tests.wide import wide

FOUR = partial(build, "four_particle")
RUNS = grid({"k13": np.linspace(40, 60, 23)})
SHORT = Options(stop=0.2, step=0.01)


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """Of a cluster of two processes with two threads each, on the loopback."""
    distributed: Any = pytest.importorskip("distributed", reason="Dask is not installed (extra dask)")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=2, host="127.0.0.1", dashboard_address=None, silence_logs=50
    ) as cluster:
        yield cluster.scheduler_address


@pytest.mark.slow
def test_a_cluster_gives_the_bits_of_threads(compiler: None, address: str, tmp_path: Path) -> None:
    texts = ["last(v[1])", "mean(energy.stored)"]
    here = sweep(FOUR(), RUNS, texts, options=SHORT, jobs=1)
    there = sweep(FOUR, RUNS, texts, options=SHORT, scheduler=Scheduler(address), file=tmp_path / "s.parquet")
    assert there.equals(here) and pq.read_table(tmp_path / "s.parquet").equals(here)
    broken = grid({"q[1]": [1e9, 2e9]})
    assert all(sweep(FOUR, broken, texts, options=SHORT, scheduler=Scheduler(address))["error"].to_pylist())


@pytest.mark.slow
def test_the_command_on_a_cluster(compiler: None, address: str, tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    """A target in a file beside the command, by address; and whole results that workers write."""
    monkeypatch.chdir(tmp_path)
    Path("m.py").write_text(
        "from phfmu.components.mechanical.translational import mass\ndef body(): return mass(2.0).with_starts({'v': 1.0})\n"
    )
    words = ["sweep", "m.py:body", "--vary", "m=1:3:5", "--measure", "last(v)", "--stop", "1", "--step", "0.1"]
    assert main([*words, "--scheduler", address, "-o", "s.parquet", "--keep", "runs"]) == 0
    assert pq.read_table("s.parquet")["last(v)"].to_pylist() == [1.0] * 5
    assert len(list(Path("runs").glob("*.parquet"))) == 5
    assert "5 runs" in capsys.readouterr().out


@pytest.mark.parametrize("jobs", wide([1, 2], 2))
def test_whole_results_are_those_of_the_runs(compiler: None, tmp_path: Path, jobs: int) -> None:
    runs = grid({"k13": [40.0, 60.0]})
    found = sweep(FOUR(), runs, ["last(v[1])"], options=SHORT, keep=tmp_path / "all", jobs=jobs)
    assert found["last(v[1])"].equals(sweep(FOUR(), runs, ["last(v[1])"], options=SHORT)["last(v[1])"])
    for i, k in enumerate((40.0, 60.0)):
        kept = open_result(tmp_path / "all" / f"{i:06d}.parquet")
        alone = Monolithic(model := build_model(FOUR().with_starts({"k13": k})), NativeInstance(model))
        result = run(alone, SHORT)
        assert kept.names == result.names and np.array_equal(kept.values, result.values)
        declared = build_model(
            FOUR().with_starts({"k13": k})
        )  # its multipliers start from other values: other rounding
        result = run(Monolithic(declared, NativeInstance(declared)), SHORT)
        assert np.allclose(kept.values, result.values, rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--scheduler-file", "none.json"], "none.json: no such file"),
        (["--scheduler", "tcp://127.0.0.1:1", "--scheduler-file", "none.json"], "name two schedulers"),
        (["--scheduler", "tcp://127.0.0.1:1", "--jobs", "2"], "--jobs 2 counts threads here"),
        (["--keep", "."], "not an empty folder"),
    ],
)
def test_clusters_and_folders_that_are_none(
    words: list[str], said: str, compiler: None, tmp_path: Path, monkeypatch: Any, capsys: Any
) -> None:
    pytest.importorskip("distributed", reason="Dask is not installed (extra dask)")
    monkeypatch.chdir(tmp_path)
    Path("here").write_text("")
    command = [
        "sweep",
        "four_particle",
        "--vary",
        "k13=1",
        "--measure",
        "last(v[1])",
        "--stop",
        "0.1",
        "--step",
        "0.01",
    ]
    assert main([*command, *words]) == 2
    assert said in capsys.readouterr().err


def test_a_scheduler_calls_what_gives_the_model(compiler: None) -> None:
    with pytest.raises(ValueError, match="needs a function"):
        sweep(FOUR(), RUNS, ["last(v[1])"], options=SHORT, scheduler=Scheduler("tcp://127.0.0.1:1"))
