"""Coupled runs that end where nobody wants them to: killed, or on a full disk. The log is read and the run goes again."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from phfmu.studies.stress.case import StressCase, StressOutcome, not_supported

RUN = (
    "run",
    "oscillator",
    "--coupling",
    "newton",
    "--engine",
    "python",
    "--step",
    "1e-3",
    "--audit",
    "a.audit.parquet",
)
STREAM = "a.audit.arrows"
ENOUGH = 1 << 15  # bytes of the stream when the run is killed
PATIENCE = 120.0  # s
FULL = 1 << 16  # bytes that a file may have
#: the command line
PLAIN = "import sys; from phfmu.cli import main; raise SystemExit(main(sys.argv[1:]))"
#: and where no file may become larger
LIMITED = """
import resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, ({0}, {0}))
from phfmu.cli import main
raise SystemExit(main(sys.argv[1:]))
"""


def started(folder: Path, *words: str, code: str = PLAIN) -> subprocess.Popen[str]:
    """The command line in a process of its own."""
    command = [sys.executable, "-c", code, *words]
    return subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def killed() -> StressOutcome:
    """SIGKILL while rows are being written: every complete batch is there, and the same run goes again."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        process, begun = started(folder, *RUN, "--stop", "1e5"), time.monotonic()
        stream = folder / STREAM
        while not (stream.exists() and stream.stat().st_size > ENOUGH):
            if process.poll() is not None or time.monotonic() - begun > PATIENCE:
                process.kill()
                return StressOutcome(f"did not get far: {process.communicate()[1][-200:]}", False)
            time.sleep(0.01)
        process.kill()
        process.communicate()
        return _again(folder)


def full() -> StressOutcome:
    """A file that may not become larger: the run says so, and what was written is there."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        process = started(folder, *RUN, "--stop", "1e5", code=LIMITED.format(FULL))
        said = process.communicate(timeout=PATIENCE)[1]
        told = process.returncode == 2 and STREAM in said
        again = _again(folder)
        text = f"exit code {process.returncode}, {'names the file' if told else said[-200:]}; {again.happened}"
        return StressOutcome(text, told and bool(again.holds))


def _again(folder: Path) -> StressOutcome:
    """The rest of a run is recovered, and the run is started again."""
    from phfmu.audit import recover, summarise

    refused = started(folder, *RUN, "--stop", "0.01")
    refused.communicate(timeout=PATIENCE)
    found = recover(folder / STREAM)
    summary = summarise(found.path)
    kept = found.path.rename(folder / "kept.parquet")
    rerun = started(folder, *RUN, "--stop", "0.1")
    rerun.communicate(timeout=PATIENCE)
    closed = summary.closed and summarise(folder / "a.audit.parquet").steps == 100
    text = f"recovered, ledger {'closed' if closed else 'open'}; runs again with exit code {rerun.returncode}"
    return StressOutcome(
        text, kept.exists() and refused.returncode == 2 and summary.steps > 0 and closed and not rerun.returncode
    )


def _posix(call: Callable[[], StressOutcome]) -> Callable[[], StressOutcome]:
    return call if os.name == "posix" else not_supported("limits of file sizes are those of POSIX")


CASES: Sequence[StressCase] = (
    StressCase(
        "crash", "a coupled run, kill -9", "a left log is not overwritten; recovered, closed; runs again", killed
    ),
    StressCase(
        "crash",
        "a coupled run, no room for its log",
        "exit code 2 names the file; recovered, closed; runs again",
        _posix(full),
    ),
)
