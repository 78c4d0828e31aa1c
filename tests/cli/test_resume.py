"""A run that is killed at any time goes on from its checkpoint to the bits of one that was not; other runs are refused."""

from __future__ import annotations

import pickle
import random
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from phfmu.audit.difference import first_differences
from phfmu.audit.judge import ComponentBalance
from phfmu.audit.log.archive import read
from phfmu.cli.checkpoints import CheckpointFile, plain
from phfmu.runs.march import march
from phfmu.runs.march.adaptive import ControllerState
from tests.cli.commands import Cli
from tests.wide import longer, wide

#: equal steps; state events and damping; steps within a tolerance; the same with events; switches; interpreted in Python
RUNS = {
    "equal": ("pendulum", "--stop", "1000"),
    "constraints": ("four_particle", "--stop", "60", "--order", "6"),
    "events": ("bouncing_ball", "--stop", "20", "--step", "0.0002"),
    "damped": ("buffer", "--stop", "300", "--restart", "2"),
    "tolerance": ("drive", "--stop", "20", "--rtol", "1e-6"),
    "events within a tolerance": ("buffer", "--stop", "25", "--rtol", "1e-6"),
    "switches": ("buck", "--stop", "0.02"),
    "thinned": ("pendulum", "--stop", "1000", "--every", "7"),
    "steps by energy, taken again": ("oscillator", "--coupling", "anderson", "--stop", "20", "--energy-rtol", "1e-5"),
    "members apart, hashes": ("oscillator", "--coupling", "newton", "--stop", "20", "--hash-states", "7"),
}
#: units of their own libraries;  in turn;  switches of members that land as one
APART = {
    "units": ("oscillator", "--coupling", "newton", "--stop", "20", "--engine", "fmu"),
    "in turn": ("oscillator", "--coupling", "gauss-seidel", "--stop", "20"),
    "switches apart": ("rectifier", "--coupling", "newton", "--order", "4", "--stop", "0.2"),
    "one unit": ("pendulum", "--stop", "100", "--engine", "fmu", "--fmi", "2.0"),
}


def command(folder: Path, run: tuple[str, ...], table: str, *more: str) -> list[str]:
    files = ("-o", str(folder / table), "--audit", str(folder / "a.parquet"), "--quiet")
    return [sys.executable, "-m", "phfmu", "run", *run, *files, *more]


def killed(folder: Path, run: tuple[str, ...], table: str, chance: random.Random, kills: int) -> int:
    """Runs to the end, killed `kills` times at random after a checkpoint; how often it went on."""
    checkpoint, resumed, going_on = folder / Path(table).with_suffix(".checkpoint"), 0, list[str]()
    for kill in range(kills + 1):
        process = subprocess.Popen(command(folder, run, table, "--checkpoint", "0", *going_on), stderr=subprocess.PIPE)
        begun = checkpoint.stat().st_mtime_ns if checkpoint.exists() else 0
        while process.poll() is None and kill < kills:
            if checkpoint.exists() and checkpoint.stat().st_mtime_ns > begun:
                time.sleep(chance.uniform(0.0, 0.3))
                process.kill()
                break
            time.sleep(0.005)
        _, error = process.communicate()
        if process.returncode == 0:
            return resumed
        assert process.returncode == -9, error
        going_on, resumed = ["--resume", str(checkpoint)], resumed + 1
        if not checkpoint.exists():  # killed when all was in its place but the streams
            return resumed
    return resumed


def require_equal(was: Path, now: Path, table: str) -> None:
    assert (was / table).read_bytes() == (now / table).read_bytes()
    assert first_differences(read(was / "a.parquet"), read(now / "a.parquet")) == []
    assert not (now / table).with_suffix(".checkpoint").exists()


#: beside the first one those that carry most; all others are long
SLOW = ("events within a tolerance", "members apart, hashes", "units", "switches apart")


@pytest.mark.parametrize("name", ["equal", *longer([n for n in [*RUNS, *APART] if n != "equal"], *SLOW)])
def test_a_killed_run_goes_on_to_the_same_bits(name: str, tmp_path: Path) -> None:
    """Each kind of march, killed twice at random, with the table as CSV or Parquet."""
    run, table = (RUNS | APART)[name], "t.parquet" if name == "equal" else "t.csv"
    was, now = tmp_path / "was", tmp_path / "now"
    was.mkdir(), now.mkdir()
    subprocess.run(command(was, run, table), check=True)
    assert killed(now, run, table, random.Random(name), 2) > 0
    require_equal(was, now, table)


#: with state events, whose marks are in the picture; with the motion of a body; and steps of a block
DRAWN = {
    "picture": (("bouncing_ball", "--stop", "2", "--step", "0.001", "--plot"), "p.html", 50),
    "motion": (("box_on_floor", "--stop", "0.3", "--step", "0.0001", "--view"), "v.html", 133),
}


@pytest.mark.parametrize("name", wide(DRAWN, "picture"))
def test_a_run_that_goes_on_draws_the_whole_of_it(
    name: str, cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Byte for byte the picture or the motion of a run that was never ended; a run that was has drawn nothing."""
    (run, file, block), kept = DRAWN[name], CheckpointFile.between_blocks
    monkeypatch.setattr(march, "BLOCK", block)
    files = {folder: tmp_path / folder / file for folder in ("was", "now")}
    for path in files.values():
        path.parent.mkdir()
    assert cli("run", *run, str(files["was"]))[0] == 0
    ends, blocks = [14, 4, 0], [0]

    def ended(checkpoints: CheckpointFile, now: Callable[[], dict[str, Any]]) -> None:
        kept(checkpoints, now)
        blocks[0] += 1
        if blocks[0] == ends[0]:
            raise KeyboardInterrupt

    monkeypatch.setattr(CheckpointFile, "between_blocks", ended)
    monkeypatch.chdir(files["now"].parent)
    more = list[str]()
    for _ in range(2):
        assert cli("run", *run, str(files["now"]), "--checkpoint", "0", *more)[0] != 0
        assert not files["now"].exists()
        more, blocks[0] = ["--resume", f"{run[0]}.checkpoint"], 0
        ends.pop(0)
    assert cli("run", *run, str(files["now"]), *more)[0] == 0
    assert files["now"].read_bytes() == files["was"].read_bytes()


@pytest.mark.long
def test_a_hundred_kills_at_random(tmp_path: Path) -> None:
    chance, done, was = random.Random(1), 0, tmp_path / "was"
    was.mkdir()
    run = ("buffer", "--stop", "300", "--restart", "2")
    subprocess.run(command(was, run, "t.csv"), check=True)
    while done < 100:
        now = tmp_path / f"now{done}"
        now.mkdir()
        done += killed(now, run, "t.csv", chance, 5)
        require_equal(was, now, "t.csv")


def without_serialised_states(path: Path, to: Path) -> Path:
    """The unit with a description that does not claim them."""
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(to, "w") as new:
        for name in old.namelist():
            data = old.read(name)
            if name == "modelDescription.xml":
                data = data.replace(b'canSerializeFMUState="true"', b'canSerializeFMUState="false"')
            new.writestr(name, data)
    return to


@pytest.fixture
def checkpoint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Of a run in the present folder that was killed."""
    monkeypatch.chdir(tmp_path)
    process = subprocess.Popen(command(Path(), RUNS["equal"], "t.csv", "--checkpoint", "0"))
    while process.poll() is None and not Path("t.checkpoint").exists():
        time.sleep(0.005)
    process.kill()
    process.wait()
    return "t.checkpoint"


def test_another_run_is_refused_with_what_differs(checkpoint: str, cli: Cli) -> None:
    before = {p.name: p.read_bytes() for p in Path().iterdir()}
    files = ("-o", "t.csv", "--audit", "a.parquet", "--resume", checkpoint)
    code, _, err = cli("run", "pendulum", "--stop", "1000", "--order", "4", *files)
    assert code == 2
    assert "--order was None, is 4" in err
    code, _, err = cli("run", "four_particle", "--stop", "1000", *files)
    assert code == 2
    assert "--target was 'pendulum', is 'four_particle'" in err
    assert {p.name: p.read_bytes() for p in Path().iterdir()} == before


def test_a_damaged_checkpoint_is_refused(checkpoint: str, cli: Cli) -> None:
    data = bytearray(Path(checkpoint).read_bytes())
    data[-100] ^= 1
    Path(checkpoint).write_bytes(data)
    code, _, err = cli(
        "run", "pendulum", "--stop", "1000", "-o", "t.csv", "--audit", "a.parquet", "--resume", checkpoint
    )
    assert code == 2
    assert "is damaged" in err


def test_what_has_no_checkpoints_is_refused_before_the_first_step(cli: Cli, tmp_path: Path) -> None:
    assert cli("export", "pendulum", "-o", str(tmp_path))[0] == 0
    unit = without_serialised_states(tmp_path / "pendulum_fmi3.fmu", tmp_path / "q.fmu")
    for more, words in (
        ((str(unit),), "pendulum cannot write its state to a file"),
        (("pendulum", "--accuracy"), "--accuracy is not kept"),
        (("pendulum", "--checkpoint", "-1"), "--checkpoint -1 s"),
    ):
        code, _, err = cli("run", "--checkpoint", "1", *more)
        assert code == 2
        assert words in err


@pytest.mark.parametrize(
    ("carried", "earlier"),
    [
        (march.MarchPosition(piece=3, first=7), b"phfmu.runs.march\nPlace"),
        (march.MarchPosition(piece=3, first=7), b"phfmu.runs.march.march\nPlace"),
        (ControllerState(0.5, rejected=2), b"phfmu.runs.march.adaptive\nControl"),
        (ComponentBalance(1.0, 2.0), b"phfmu.audit.judge\nAccount"),
    ],
)
def test_a_checkpoint_from_before_a_class_moved_or_got_another_name_is_read(carried: Any, earlier: bytes) -> None:
    """Protocol 2 writes module and name of a class as lines."""
    body = pickle.dumps({"carried": carried}, protocol=2)
    now = f"c{type(carried).__module__}\n{type(carried).__name__}\n".encode()
    older = body.replace(now, b"c" + earlier + b"\n")
    assert older != body and pickle.dumps(plain(older), protocol=2) == body
