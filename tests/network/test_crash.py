"""Runs that end early: killed, interrupted, failed. What was accepted is kept, and at most a moment of it is lost."""

from __future__ import annotations

import os
import random
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from phfmu.audit import AuditWriter, read, recover, summarise
from phfmu.cli import main
from phfmu.runs.march import march
from tests.wide import longer, slow, wide

#: s of work at which a run is killed: in its first rows, behind LOST, and when blocks have grown
MOMENTS = ((0.0, 0.3), (0.7, 1.0), (1.6, 2.2))
LOST = 0.6  # s of its own work, what a kill may cost a run; other processes' share of the machine is not counted

# the command line, with the work (CPU time) in which the run had taken how many steps, before anything else sees them
WATCHED = """
import os, signal, sys
from resource import RUSAGE_CHILDREN, RUSAGE_SELF, getrusage
for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):  # a test run under nohup hands down that it ignores some
    signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)
from phfmu.cli import main
from phfmu.runs.march.adaptive import Adaptive
from phfmu.runs.march.native_march import NativeMarch
from phfmu.network.couplings.coupled import Coupled
from phfmu.network.couplings.unit import FMUStepper
from phfmu.network.couplings.monolithic import Monolithic
stamps, total = os.open("stamps", os.O_CREAT | os.O_WRONLY | os.O_APPEND), 0
def watched(kind, count, name="advance"):
    advance = getattr(kind, name)
    def stamped(self, *args, **options):
        global total
        found = advance(self, *args, **options)
        total += count(self, args, found)
        spent = sum(sum(getrusage(who)[:2]) for who in (RUSAGE_SELF, RUSAGE_CHILDREN))
        os.write(stamps, f"{total} {spent!r}\\n".encode())
        return found
    setattr(kind, name, stamped)
if "--rtol" in sys.argv:
    watched(Adaptive, lambda self, args, found: 1)
    watched(NativeMarch, lambda self, args, found: len(found.ends), "take")
else:
    for kind in (Monolithic, Coupled, FMUStepper):
        watched(kind, lambda self, args, found: args[2])
raise SystemExit(main(sys.argv[1:]))
"""

# kernels are compiled before the first step: what is compiled beside a run uses CPU time that no step takes
RUNS = {
    "python": "oscillator --engine python --step 1e-4",
    "native": "smib --engine native --step 1e-6 --kernels compiled",
    "newton": "oscillator --engine python --coupling newton --step 1e-4",
    "newton, native": "two_machine --coupling newton --kernels compiled",
    "newton, fmu": "oscillator --engine fmu --coupling newton --step 1e-4",
    "fmu": "smib --engine fmu --step 1e-5",
    "adaptive": "oscillator --engine python --rtol 1e-9",
    "adaptive, native": "smib --rtol 1e-8 --kernels compiled",
}


class Started:
    """A run in a process of its own, in the present folder."""

    def __init__(self, line: str):
        command = [sys.executable, "-c", WATCHED, "run", *line.split(), "--stop", "1e4", "--audit", "a.parquet"]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def wait_for(self, seconds: float) -> None:
        """Until the run has taken steps for so long of its own work (CPU time)."""
        self.wait_until(lambda: (taken := self.stamps()) != [] and taken[-1][1] >= taken[0][1] + seconds)

    def wait_until(self, holds: Callable[[], bool]) -> None:
        deadline = time.monotonic() + 120
        while not holds():
            assert time.monotonic() < deadline, "it takes no steps"
            assert self.process.poll() is None, self.process.communicate()
            time.sleep(0.01)

    def stamps(self) -> list[tuple[int, float]]:
        """(steps taken, CPU time of the run so far)."""
        if not Path("stamps").exists():
            return []
        lines = [line.split() for line in Path("stamps").read_text().splitlines(keepends=False)]
        return [(int(n), float(t)) for n, t in (line for line in lines if len(line) == 2)]

    def end(self, number: int) -> tuple[int, float, str]:
        """Send the signal; exit code, CPU time of the whole run, stderr."""
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        self.process.send_signal(number)
        _, err = self.process.communicate(timeout=60)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return self.process.returncode, sum(after[:2]) - sum(before[:2]), err


@pytest.fixture
def started(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], Started]]:
    monkeypatch.chdir(tmp_path)
    runs: list[Started] = []

    def start(line: str) -> Started:
        Path("stamps").unlink(missing_ok=True)
        runs.append(Started(line))
        return runs[-1]

    yield start
    for run in runs:
        if run.process.poll() is None:
            run.process.kill()
        run.process.communicate()


def lost(run: Started, spent: float) -> float:
    """CPU time before the kill, at which ``spent`` was used, of steps that were accepted and the log does not have."""
    found = recover("a.arrows")
    kept = summarise(read(found.path)).steps
    found.path.unlink()
    before = [t for n, t in run.stamps() if n <= kept]
    if not before:
        before = [run.stamps()[0][1]]
    return spent - before[-1]


# -- kill -9 -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", wide(["python", "newton"], "python"))
def test_kill_loses_a_moment(started: Callable[[str], Started], kind: str, compiler: None) -> None:
    run = started(RUNS[kind])
    run.wait_for(0.8)
    code, spent, _ = run.end(signal.SIGKILL)
    assert code == -signal.SIGKILL and lost(run, spent) <= LOST


@pytest.mark.parametrize("table", wide(["o.csv", "o.parquet"], "o.csv"))
def test_recover_tells_where_the_table_is(
    started: Callable[[str], Started], table: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """From another folder, too; a table of another name is not meant."""
    for name in (f"x{table}.1.partial", "o.csv.partial"):
        Path(name).write_text("")
    Path("results").mkdir()
    run = started(RUNS["python"] + f" -o results/{table}")
    written = Path("results").resolve()
    run.wait_until(lambda: table != "o.csv" or any(p.read_text().count("\n") > 10 for p in written.glob("*.partial")))
    run.wait_for(0.1)
    run.end(signal.SIGKILL)
    (left,) = Path("results").resolve().glob("*.partial")
    os.chdir("results")
    assert main(["audit", "recover", "../a.arrows"]) == 0
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith("recovered ") and str(left) in second
    if table == "o.csv":
        assert "is in" in second and len(left.read_text().splitlines()) > 10
    else:
        assert "may be deleted" in second
    assert str(left) not in str(pq.read_metadata("../a.parquet").metadata)  # not in a log that is passed on


@pytest.mark.parametrize("kind", longer(RUNS, "native", "newton, native", "newton, fmu", "fmu", "adaptive"))
def test_kill_at_any_time_loses_a_moment(started: Callable[[str], Started], kind: str, compiler: None) -> None:
    draw = random.Random(kind)
    for moment in MOMENTS:
        run = started(RUNS[kind])
        run.wait_for(draw.uniform(*moment))
        _, spent, _ = run.end(signal.SIGKILL)
        assert lost(run, spent) <= LOST


def test_log_is_readable_from_the_start(tmp_path: Path) -> None:
    sink = AuditWriter(tmp_path / "a.parquet", {"model": "m"})
    assert read(sink.stream).num_rows == 0
    sink.close()


# -- signals -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "number, code, table",
    [(signal.SIGINT, 130, "o.csv"), slow((signal.SIGTERM, 143, "o.parquet")), slow((signal.SIGHUP, 129, ""))],
)
def test_signals_end_a_run_well(started: Callable[[str], Started], number: int, code: int, table: str) -> None:
    run = started(RUNS["python"] + (f" -o {table}" if table else ""))
    run.wait_for(0.2)
    found, _, err = run.end(number)
    assert found == code, err
    assert f"phfmu: interrupted ({signal.Signals(number).name})" in err and "the audit a.parquet" in err
    assert not Path("a.arrows").exists() and not list(Path().glob("*.partial"))
    summary = summarise(read("a.parquet"))
    # nothing that was accepted is lost, and the log and the table end at the same step
    assert summary.steps == run.stamps()[-1][0] > 0 and summary.events["interrupted"] == 1
    if table:
        t = column(table, "time")
        assert f"{table}, {len(t)} rows to t = {t[-1]:.9g} s" in err
        assert len(t) == summary.steps + 1 and t[-1] == pytest.approx(summary.t_end, abs=1e-15)


def column(path: str, name: str) -> np.ndarray:
    if path.endswith(".parquet"):
        return pq.read_table(path)[name].to_numpy()
    return np.genfromtxt(path, delimiter=",", skip_header=1, usecols=(0,))


# -- one log, one run ----------------------------------------------------------------------------------------


def test_a_log_belongs_to_one_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]):
    monkeypatch.chdir(tmp_path)
    code = "import time; from phfmu.audit import AuditWriter; w = AuditWriter('a.parquet'); print(flush=True); time.sleep(60)"
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as other:
        assert other.stdout is not None and other.stdout.readline()
        for line in ("run mass --audit a.parquet", "audit recover a.arrows"):
            assert main(line.split()) == 2
            said = capfd.readouterr().err
            assert said.count("\n") == 1 and f"being written by process {other.pid} " in said
        assert read("a.arrows").num_rows == 0
        assert main(["audit", "a.parquet"]) == 2
        said = capfd.readouterr().err
        assert f"process {other.pid} " in said and "still writing" in said and "recover" not in said
        other.kill()
    assert main(["run", "mass", "--audit", "a.parquet"]) == 2
    assert "left from a run that did not end" in capfd.readouterr().err
    assert main(["audit", "recover", "a.arrows"]) == 0


def test_pages_are_checked(tmp_path: Path) -> None:
    """A bit that flips in the numbers of the log is told, wherever it is."""
    path = tmp_path / "a.parquet"
    assert main(["run", "oscillator", "--engine", "python", "--audit", str(path), "--quiet"]) == 0
    sound, draw = path.read_bytes(), random.Random(1)
    group = pq.ParquetFile(path).metadata.row_group(0)
    chunks = [group.column(i) for i in range(group.num_columns)]
    ends = [(c.dictionary_page_offset or c.data_page_offset) + c.total_compressed_size for c in chunks]
    large = [(end, end - c.data_page_offset) for c, end in zip(chunks, ends, strict=True)]
    large = [(end, size) for end, size in large if size > 400]  # mostly numbers, not the head of the page
    assert len(large) > 5
    for end, size in large:
        damaged = bytearray(sound)
        damaged[end - draw.randrange(1, size // 2)] ^= 1
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match="damaged"):
            read(path)


# -- places that cannot be written ---------------------------------------------------------------------------


def test_places_are_tried_before_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("d.csv").mkdir()
    Path("d.parquet").mkdir()
    Path("built.py").write_text("raise RuntimeError('the model is built')\n")
    places = [("-o d.csv", "is a folder"), ("--audit d.parquet", "is a folder"), ("-o no/o.csv", "no folder 'no'")]
    if Path("/sys/kernel").is_dir():  # denied to anybody
        places += [(f"{option} /sys/kernel/x.parquet", "cannot write in the folder") for option in ("-o", "--audit")]
    for words, said in places:
        assert main(["run", "built.py:model", *words.split()]) == 2
        err = capfd.readouterr().err
        assert err.count("\n") == 1 and said in err and words in err
    assert sorted(os.listdir()) == ["built.py", "d.csv", "d.parquet"]


def test_outputs_stay_where_the_run_began(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A unit that changes the working folder does not move them."""
    monkeypatch.chdir(tmp_path)
    Path("away").mkdir()
    model = "import os\nfrom phfmu.components.mechanical.translational import mass\n"
    Path("model.py").write_text(model + "def moves():\n    os.chdir('away')\n    return mass()\n")
    words = "run model.py:moves --engine python --stop 0.01 -o o.csv --audit a.parquet --quiet"
    assert main(words.split()) == 0
    assert not os.listdir(tmp_path / "away") and {"o.csv", "a.parquet"} <= set(os.listdir(tmp_path))


def test_a_refused_start_leaves_what_was_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    files = ["-o", "o.csv", "--audit", "a.parquet"]
    assert main(["run", "mass", "--engine", "python", "--stop", "0.01", "--quiet", *files]) == 0
    before = [Path(name).read_bytes() for name in files[1::2]]
    assert main(["run", "mass", "--engine", "python", "--step", "nan", *files]) == 2
    assert [Path(name).read_bytes() for name in files[1::2]] == before
    assert sorted(os.listdir()) == ["a.parquet", "o.columns.json", "o.csv"]


# -- full disks ----------------------------------------------------------------------------------------------

LIMITED = """
import resource, sys
from phfmu.cli import main
# as a disk that is full from here on, after some blocks of steps: one is at most 1.1 MB of the log
resource.setrlimit(resource.RLIMIT_FSIZE, (4_000_000, 4_000_000))
raise SystemExit(main(sys.argv[1:]))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no limits to the size of files")
@pytest.mark.parametrize("option, file", [("-o", "o.csv"), slow(("-o", "o.parquet")), ("--audit", "a.parquet")])
def test_a_full_disk_keeps_whole_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, option: str, file: str, compiler: None
) -> None:
    monkeypatch.chdir(tmp_path)
    command = [sys.executable, "-c", LIMITED, "run", "oscillator", "--stop", "1000", "--step", "0.02", option, file]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100)
    assert done.returncode == 2 and "cannot be written" in done.stderr and "File too large" in done.stderr
    assert not list(Path().glob("*.partial"))
    if file == "o.csv":
        lines = Path(file).read_text().splitlines()
        assert {line.count(",") for line in lines} == {lines[0].count(",")} and len(lines) > 5
        last = float(lines[-1].split(",")[0])
        assert f"kept: o.csv, {len(lines) - 1} rows to t = {last:.9g} s" in done.stderr
    elif file == "a.parquet":
        assert "phfmu audit recover" in done.stderr and not Path(file).exists()
        assert main(["audit", "recover", "a.arrows"]) == 0 and summarise(read(file)).steps > 5
    else:
        assert not Path(file).exists() and "kept" not in done.stderr


# -- blocks --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "line",
    [
        "drive --engine native --step 1e-4",
        "oscillator --coupling newton --step 1e-3",
        slow("oscillator --coupling newton --engine fmu --step 1e-3"),
        slow("oscillator --engine python --step 3e-4"),
    ],
)
def test_results_do_not_depend_on_the_blocks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: str) -> None:
    """Blocks are cut by wall time; every number, the time included, is the same bits however they are cut."""
    found = []
    for size in (1, 7, 4096):
        monkeypatch.setattr(march, "BLOCK", size)
        path = tmp_path / f"{size}.parquet"
        assert main(f"run {line} --stop 0.01 --quiet -o {path}".split()) == 0
        found.append(pq.read_table(path))
    assert found[0].equals(found[1]) and found[0].equals(found[2])
