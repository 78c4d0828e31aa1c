"""Input rows become events as the run goes on: the memory holds the numbers of the file, whatever the rows set."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from phfmu import Event, Monolithic, NativeInstance, Options, build_model, run
from phfmu.components.mechanical.translational import mass
from phfmu.runs.inputs import input_rows
from phfmu.runs.inputs.input_rows import InputRows
from phfmu.runs.loop import segments
from phfmu.runs.march.stretches import stretches
from tests.wide import longer

ROWS, STEP, MOST = 3_000_000, 1e-3, 300  # MB

CHILD = """
import sys
from phfmu.cli import main
code = main(sys.argv[1:])
peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))
print(int(peak.split()[1]) / 1024, file=sys.stderr)
sys.exit(code)
"""


def told(rows: InputRows) -> list[Event]:
    """Each change of a column, by looking at one row after the other."""
    found, before = list[Event](), dict[str, float]()
    for i, (t, values) in enumerate(zip(rows.time.tolist(), rows.values.tolist(), strict=True)):
        if i + 1 < len(rows.time) and rows.time[i + 1] == t:
            continue
        for n, v in zip(rows.names, values, strict=True):
            if before.get(n) != v:
                found.append(Event(t, n, v))
            before[n] = v
    return found


@pytest.mark.parametrize("block", [1, 2, 3, 100])
def test_events_do_not_depend_on_how_many_rows_are_looked_at_at_once(block: int, monkeypatch: Any) -> None:
    """With rows at one time, of which the last counts, on both sides of where a block ends; from any time on."""
    monkeypatch.setattr(input_rows, "BLOCK", block)
    time = np.array([0.0, 1.0, 1.0, 1.0, 2.0, 3.0, 3.0, 4.0, 5.0, 5.0])
    values = np.array([[1, 2, 3, 1, 1, 4, 4, 4, 5, 4], [0, 0, 1, 0, 0, 0, 2, 2, 2, 2]], float).T
    rows = InputRows(["a", "b"], time, values)
    every = told(rows)
    assert list(rows.events()) == every
    assert list(rows.events(["b"])) == [e for e in every if e.name == "b"]
    for since in (-1.0, 0.5, 1.0, 3.0, 4.5, 6.0):
        assert list(rows.events(since=since)) == [e for e in every if e.t >= since]


def test_inputs_of_a_stretch_are_read_as_steps_are_taken() -> None:
    """No more of them than the steps that are asked for; those of the next stretch follow."""
    read = list[float]()

    def events() -> Any:
        for i in range(100):
            e = Event(0.1 * i, "u" if i != 50 else "p", float(i))
            read.append(e.t)
            yield e

    found = stretches(lambda: segments(0.0, 10.0, events()), 0.1, lambda name: name == "u")
    one = next(found)
    ahead = len(read)
    assert (one.start, one.end) == (0.0, pytest.approx(5.0)) and ahead == 51 + 1
    assert [(k, e.value) for k, e in one.inputs.within(0, 3)] == [(1, 1.0), (2, 2.0)]
    assert len(read) - ahead < 6
    assert [(k, e.value) for k, e in one.inputs.within(3, 2)] == [(0, 3.0), (1, 4.0)]
    two = next(found)
    assert [e.name for e in two.events] == ["p"]
    assert [(k, e.value) for k, e in two.inputs.within(0, 49)] == [(k, 50.0 + k) for k in range(1, 49)]
    assert [e.value for _, e in two.inputs.kept()][:2] == [51.0, 52.0]


def test_rows_on_the_grid_give_the_sums_that_they_are() -> None:
    """m v' = F held: v is the sum of the rows, at every step, and the input stands in each row."""
    n = 5000
    force = np.sin(np.arange(n) * 0.37)
    model = build_model(mass(m=2.0))
    name = next(m for m in Monolithic(model, NativeInstance(model)).free_inputs)
    rows = {"time": np.arange(n) * STEP, name: force}
    result = run(Monolithic(model, NativeInstance(model)), Options(stop=n * STEP, step=STEP), inputs=rows)
    v = next(c for c in result.names if c == "v")
    np.testing.assert_allclose(result.column(v)[1:], np.cumsum(force) * STEP / 2.0, rtol=0, atol=1e-13)
    assert np.array_equal(result.column(name)[1:], force)


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="resident memory is told by Linux")
@pytest.mark.parametrize("kind", longer(["parquet", "csv"], "parquet"))
def test_three_million_rows_in_300_mb(tmp_path: Path, kind: str) -> None:
    """Resident memory of the whole process, most of which are its libraries; the end against the sum of the rows."""
    time, force = np.arange(ROWS) * STEP, np.sin(np.arange(ROWS) * 0.37)
    path, out = tmp_path / f"push.{kind}", tmp_path / "out.csv"
    if kind == "parquet":
        pq.write_table(pa.table({"time": time, "flange.force": force}), path)
    else:
        np.savetxt(
            path, np.column_stack([time, force]), delimiter=",", header="time,flange.force", comments="", fmt="%.17g"
        )
    words = ["run", "mass", "--input", str(path), "--step", str(STEP), "--stop", str(ROWS * STEP), "--audit", "none"]
    words += ["-o", str(out), "--every", "100000", "--signals", "v"]
    child = subprocess.run([sys.executable, "-c", CHILD, *words], capture_output=True, text=True, timeout=300)
    assert child.returncode == 0, child.stderr
    assert float(child.stderr.split()[-1]) < MOST
    v = float(out.read_text().split("\n")[-2].split(",")[-1])
    scale = float(np.abs(np.cumsum(force)).max() * STEP)
    assert abs(v - force.sum() * STEP) < 1e-9 * max(scale, 1.0)
