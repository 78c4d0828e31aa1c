"""What a sweep keeps on disk: believed only where it is what was written; kept when a signal or a full disk ends the sweep."""

from __future__ import annotations

import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from phfmu.sweeps.design import Design
from phfmu.sweeps.outcome import RunOutcomes
from phfmu.sweeps.parts import Parts

DESIGN = Design(("k",), np.arange(6.0)[:, None])


def outcome(first: int, n: int = 2) -> RunOutcomes:
    return RunOutcomes(np.arange(n)[:, None] + 10.0 * first, np.full(n, 7), np.zeros(n), ("",) * (n - 1) + ("refused",))


def written(folder: Path, key: str = "this") -> Path:
    parts = Parts(folder / "s.parquet", key, resume=False)
    for first in (0, 2, 4):
        parts.keep(first, outcome(first))
    assert parts.runs == 6 and "6 of 6 runs" in parts.told(6)
    return folder / "s.parquet.parts"


def read(folder: Path, key: str = "this") -> dict[int, RunOutcomes]:
    return dict(Parts(folder / "s.parquet", key, resume=True).kept())


def test_parts_come_back_as_they_were(tmp_path: Path) -> None:
    written(tmp_path)
    found = read(tmp_path)
    assert list(found) == [0, 2, 4]
    for first, known in found.items():
        assert known.values.tolist() == outcome(first).values.tolist() and known.errors == ("", "refused")


def test_a_damaged_part_is_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Any bit, any length: what is left is right, what is not is said and removed."""
    folder, draw = written(tmp_path), random.Random(5)
    path = folder / "000000002.part"
    whole = path.read_bytes()
    for k in range(200):
        data = bytearray(whole)
        if k % 4:
            data[draw.randrange(len(data))] ^= 1 << draw.randrange(8)
        else:
            del data[draw.randrange(len(data)) :]
        path.write_bytes(data)
        assert list(read(tmp_path)) == [0, 4] and not path.exists()
        assert "000000002.part is damaged or no part of this sweep" in capsys.readouterr().err
    path.write_bytes(whole)
    assert list(read(tmp_path)) == [0, 2, 4]


def test_a_part_of_other_runs_is_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = written(tmp_path)
    shutil.copy(folder / "000000000.part", folder / "000000002.part")  # renamed
    (tmp_path / "other").mkdir()
    shutil.copy(written(tmp_path / "other", "that") / "000000004.part", folder / "000000004.part")
    assert list(read(tmp_path)) == [0]
    assert capsys.readouterr().err.count("its runs are taken again") == 2


SWEEP = "import sys; from phfmu.cli import main; sys.exit(main(sys.argv[1:]))"
WORDS = ["sweep", "mass_spring", "--measure", "last(q[1])", "-o", "s.parquet"]


def test_a_full_disk_is_named_and_what_is_kept_is_gone_on_with(tmp_path: Path, compiler: None) -> None:
    words = ["sweep", "four_particle", "--vary", "k13=40:60:4000", "--measure", "last(v[1])", "-o", "s.parquet"]
    words += ["--stop", "0.02", "--step", "0.01", "--jobs", "1"]
    full = (
        "import resource, signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "from phfmu.sweeps import runs\nkeep = runs.Parts.keep\n"
        "def limited(parts, first, outcome):\n"
        "    if first: resource.setrlimit(resource.RLIMIT_FSIZE, (4000, 4000))\n"
        "    keep(parts, first, outcome)\n"
        "runs.Parts.keep = limited\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", full + SWEEP, *words], cwd=tmp_path, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 2 and "File too large" in done.stderr and "s.parquet.parts/000000504.part" in done.stderr
    assert "504 of 4000 runs are in" in done.stderr and "--resume" in done.stderr
    again = subprocess.run(
        [sys.executable, "-c", SWEEP, *words, "--resume"], cwd=tmp_path, capture_output=True, text=True, timeout=120
    )
    assert again.returncode == 0, again.stderr
    assert pq.read_table(tmp_path / "s.parquet").num_rows == 4000 and not list(tmp_path.glob("*.partial"))


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
@pytest.mark.parametrize(
    ("number", "more"),
    [
        (signal.SIGTERM, ["--stop", "1e6", "--step", "1e-3", "--jobs", "1"]),
        pytest.param(signal.SIGINT, ["--stop", "1e6", "--step", "1e-3", "--jobs", "2"], marks=pytest.mark.slow),
        pytest.param(signal.SIGTERM, ["--stop", "1e5", "--step", "1e-3", "--engine", "python"], marks=pytest.mark.slow),
    ],
)
def test_a_signal_ends_runs_under_way(tmp_path: Path, compiler: None, number: signal.Signals, more: list[str]) -> None:
    """Also runs of a thousand million steps in one compiled call."""
    words = ["sweep", "mass_spring", "--vary", "m1=1:2:6", "--measure", "last(q[1])", "-o", "s.parquet", *more]
    begun = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
    run = subprocess.Popen(
        [sys.executable, "-c", begun + SWEEP, *words], cwd=tmp_path, stderr=subprocess.PIPE, text=True
    )
    try:
        late = time.monotonic() + 120
        while not (tmp_path / "s.parquet.parts" / "sweep").exists() and time.monotonic() < late:
            time.sleep(0.1)
        time.sleep(1.0)
        run.send_signal(number)
        _, err = run.communicate(timeout=60)
    finally:
        run.kill()
        run.wait()
    assert run.returncode == 128 + number, err
    assert "phfmu: interrupted" in err and "0 of 6 runs are in" in err and "Traceback" not in err
