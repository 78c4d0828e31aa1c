"""Rows of --input: what they cost, what is told about them, and that they are the events they were."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from time import process_time

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from phfmu import Event, Monolithic, NativeInstance, Options, PythonInstance, build_model, run
from phfmu.audit import read
from phfmu.cli import main
from phfmu.components.mechanical.translational import mass
from phfmu.runs.result import Result
from tests.engines import ENGINES

Run = Callable[..., tuple[int, str]]


@pytest.fixture
def go(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    monkeypatch.chdir(tmp_path)

    def call(*words: str) -> tuple[int, str]:
        capsys.readouterr()
        code = main(["run", "mass", *words, "--engine", "python"])
        out, err = capsys.readouterr()
        return code, out + err

    return call


def pushed(engine: type, t: np.ndarray, force: np.ndarray, **more: float) -> Result:
    model = build_model(mass(2.0))
    events = [Event(a, "flange.force", b) for a, b in zip(t.tolist(), force.tolist(), strict=True)]
    return run(Monolithic(model, engine(model)), Options(stop=float(t[-1]) + 1e-3, step=1e-3, events=events, **more))


@pytest.mark.parametrize("engine", ENGINES)
def test_rows_on_the_grid_are_held_over_their_steps(compiler: None, engine: type) -> None:
    """m v' = F: v is the sum of h F / m over the rows, and the work of each step is booked at its own force."""
    t, force = 1e-3 * np.arange(200), np.random.default_rng(1).standard_normal(200)
    found = pushed(engine, t, force)
    v = np.concatenate([[0.0], np.cumsum(1e-3 * force / 2.0)])
    assert np.abs(found.column("v") - v).max() < 1e-14
    energy = np.concatenate([[0.0], np.cumsum(force * (v[:-1] + v[1:]) / 2 * 1e-3)])
    assert np.abs(found.column("flange.energy") - energy).max() < 1e-15
    assert len(found.time) == 201 and found.ledger.summary().closed


def test_rows_beside_other_events_and_off_the_grid_stay_in_order() -> None:
    """A parameter changes in the middle, and one row lies between two steps: both begin a new grid."""
    model = build_model(mass(2.0))
    events = [Event(0.01 * i, "flange.force", float(i)) for i in range(10)]
    events += [Event(0.03, "m", 4.0), Event(0.065, "flange.force", 7.0)]
    whole = Monolithic(model, PythonInstance(model))
    found = run(whole, Options(stop=0.1, step=0.01, events=events))
    p = 0.01 * (0 + 1 + 2)
    assert found.column("v")[4] == pytest.approx((p + 0.01 * 3) / 4 + p / 2 - p / 4)  # v is kept where m jumps
    rest = 0.01 * (3 + 4 + 5) + 0.005 * (6 + 7) + 0.01 * (7 + 8 + 9)
    assert found.column("v")[-1] == pytest.approx(p / 2 + rest / 4) and whole._inputs.u[0] == 9.0


def test_many_rows_cost_little_more_than_the_run(compiler: None) -> None:
    """2e4 rows at 1 kHz took 0.6 ms each when every one ended a block of steps; the time of the processor counts."""
    t, force = 1e-3 * np.arange(20_000), np.sin(np.arange(20_000.0))
    pushed(NativeInstance, t[:10], force[:10])
    start = process_time()
    found = pushed(NativeInstance, t, force)
    assert len(found.time) == 20_001 and process_time() - start < 2.0


def test_each_change_is_in_the_log(go: Run) -> None:
    Path("in.csv").write_text("time,flange.force\n0,1\n0.1,2\n0.2,2\n0.3,5\n")
    code, said = go("--stop", "0.5", "--step", "0.1", "--input", "in.csv", "--audit", "a.parquet")
    assert code == 0 and "events: 2 input" in said
    messages = read("a.parquet").column("message").drop_null().to_pylist()
    assert messages == ["flange.force = 2", "flange.force = 5"]


def test_parquet_is_read_like_csv(go: Run) -> None:
    t, force = 0.1 * np.arange(5), np.arange(5.0)
    pq.write_table(pa.table({"time": t, "flange.force": force}), "in.parquet")
    np.savetxt("in.csv", np.c_[t, force], delimiter=",", header="time,flange.force", comments="")
    for name in ("in.parquet", "in.csv"):
        assert go("--stop", "0.5", "--step", "0.1", "--input", name, "-o", f"{name}.out.csv")[0] == 0
    assert Path("in.parquet.out.csv").read_text() == Path("in.csv.out.csv").read_text()
    pq.write_table(pa.table({"time": t, "flange.force": ["a"] * 5}), "words.parquet")
    assert "column flange.force: string is not a number" in go("--input", "words.parquet")[1]
    pq.write_table(pa.table({"time": t[::-1], "flange.force": force}), "back.parquet")
    assert "row 2: time 0.3 after 0.4" in go("--input", "back.parquet")[1]
    pq.write_table(pa.table({"time": t, "flange.force": np.full(5, np.nan)}), "inf.parquet")
    assert "column flange.force: nan is not finite" in go("--input", "inf.parquet")[1]
    Path("no.parquet").write_text("time\n")
    code, said = go("--input", "no.parquet")
    assert code == 2 and "no.parquet is not a Parquet file" in said


def test_data_that_begin_late_or_end_early_are_told(go: Run) -> None:
    t = 0.01 * np.arange(5, 50)
    np.savetxt("in.csv", np.c_[t, t], delimiter=",", header="time,flange.force", comments="")
    said = go("--stop", "1", "--step", "0.01", "--input", "in.csv")[1]
    assert "in.csv: begins at t = 0.05 s, the start values hold before" in said
    assert "in.csv: ends at t = 0.49 s, its last row holds until the end at 1 s" in said
    assert "ends at" not in go("--stop", "0.5", "--step", "0.01", "--input", "in.csv")[1]


#: reads a file of inputs and says by how many bytes a row the memory grew, all that is imported being there before
GROWTH = """
import re, sys
import pyarrow.parquet
from phfmu.runs.inputs.input_file import read_inputs
peak = lambda: 1024 * int(re.search(r"VmHWM:\\s+(\\d+)", open("/proc/self/status").read())[1])
read_inputs(sys.argv[2], ["flange.force"])
before = peak()
rows = len(read_inputs(sys.argv[1], ["flange.force"]).time)
print(rows, (peak() - before) / rows, peak() / 1e6)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the most memory of a process is told by Linux")
@pytest.mark.parametrize(
    ("rows", "ending"),
    [(300_000, ".csv"), *(pytest.param(3_000_000, e, marks=pytest.mark.slow) for e in (".csv", ".parquet"))],
)
def test_inputs_take_little_more_memory_than_their_numbers(tmp_path: Path, rows: int, ending: str) -> None:
    """16 bytes a row are the numbers; lists of words and of places took 480."""
    t = 1e-3 * np.arange(rows)
    long, short = tmp_path / f"long{ending}", tmp_path / f"short{ending}"
    for path, n in ((long, rows), (short, 10)):
        if ending == ".parquet":
            pq.write_table(pa.table({"time": t[:n], "flange.force": t[:n]}), path)
        else:
            with path.open("w") as f:
                f.write("time,flange.force\n")
                f.writelines(f"{v:.3f},{v:.6f}\n" for v in t[:n].tolist())
    command = [sys.executable, "-c", GROWTH, str(long), str(short)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    found, each, peak = map(float, done.stdout.split())
    assert found == rows and each < 100 and peak < 300, done.stdout


def test_places_of_mistakes_are_right_in_every_block(go: Run) -> None:
    """Empty lines and comments count; rows are read by blocks, whose edges are no places."""
    good = [f"{i},1" for i in range(40_000)]
    for line in (16_385, 16_386, 16_387, 39_990):
        rows = [*good]
        rows[line - 4] = "x,1"
        Path("in.csv").write_text("\n".join(["time,flange.force", "# a comment", "", *rows]))
        assert f"in.csv, line {line}, column time: 'x' is not a number" in go("--input", "in.csv")[1]
    back = [*good]
    back[20_000] = "5,1"
    Path("in.csv").write_text("\n".join(["time,flange.force", *back]))
    assert "in.csv, line 20002: time 5 after 19999" in go("--input", "in.csv")[1]
    t = np.arange(40_000.0)
    t[30_000] = np.inf
    pq.write_table(pa.table({"time": t, "flange.force": np.zeros(40_000)}), "in.parquet")
    assert "in.parquet, row 30001, column time: inf is not finite" in go("--input", "in.parquet")[1]
