"""A foreign library leaves the arithmetic, the signals and the number of processes of its host as they were."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.fmu import foreign

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows has other calls for all of these")

#: a host that says what it finds of itself after each of the lines in {body}
HOST = """
import ctypes, ctypes.util, os, signal, sys, time
from phfmu.fmu.isolation import process_state
from phfmu.fmu.importer.reader import FMUInstance

process_state.PAUSE = 0.0
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGTERM, lambda *_: None)
maths = ctypes.CDLL(ctypes.util.find_library("m"))
libc, action = ctypes.CDLL(None), ctypes.create_string_buffer(512)

def handler(number):
    libc.sigaction(number, None, action)
    return bytes(action[:8])

def found():
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    one, little = 1.0, 1e-30
    traps = getattr(maths, "fegetexcept", lambda: 0)()
    return traps, [handler(n) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)], blocked, one + little == one

def look(when):
    assert found() == before, (when, before, found())

before = found()
assert before[0] == 0 and before[3]
unit = FMUInstance(sys.argv[1], starts={"mode": float(sys.argv[2])})
look("loaded")
for k in range(5):
    unit.do_step(0.1 * k, 0.1)
    look(f"step {k}")
signal.signal(signal.SIGTERM, signal.SIG_DFL)  # the host itself may change them, also between steps
before = found()
unit.do_step(0.5, 0.1)
look("a handler of the host")
unit.close()
look("closed")
print("alone", os.getpid())
"""
MODES = {"rounding": foreign.ROUND, "signals": foreign.IGNORE, "faults of arithmetic": foreign.TRAPS_ON}


def host(path: Path, mode: int, environment: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    import os

    command = [sys.executable, "-c", HOST, str(path), str(mode)]
    return subprocess.run(
        command, capture_output=True, text=True, timeout=60, env={**os.environ, **(environment or {})}
    )


@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize("what", MODES)
def test_a_step_leaves_the_process_as_it_was(tmp_path: Path, what: str, version: str) -> None:
    done = host(foreign.mass(tmp_path / "pump.fmu", version), MODES[what])
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("what", ("rounding", "signals"))
def test_loading_leaves_the_process_as_it_was(tmp_path: Path, what: str) -> None:
    done = host(foreign.mass(tmp_path / "pump.fmu", "3.0"), 0, {"FOREIGN_UNIT_SPOILS": str(MODES[what])})
    assert done.returncode == 0, done.stderr


def test_a_copy_of_the_process_does_not_go_on(tmp_path: Path) -> None:
    """It says where it came from and ends; the run has its rows once."""
    done = host(foreign.mass(tmp_path / "pump.fmu", "3.0"), foreign.FORK)
    assert done.returncode == 0 and done.stdout.count("alone") == 1
    words = "the unit 'foreign' made a copy of this process (fork) that came back from doStep at t = 0.3 s"
    assert done.stderr.count(words) == 1


def test_a_copy_that_the_interpreter_made_goes_on(tmp_path: Path) -> None:
    program = (
        "import multiprocessing, sys\nfrom phfmu.fmu.importer.reader import FMUInstance\n"
        "unit = FMUInstance(sys.argv[1])\n"
        "def step(q): q.put(unit.do_step(0.0, 0.1))\n"
        "context = multiprocessing.get_context('fork'); q = context.Queue()\n"
        "child = context.Process(target=step, args=(q,)); child.start(); print(q.get(timeout=30)); child.join()"
    )
    path = foreign.mass(tmp_path / "pump.fmu", "3.0")
    done = subprocess.run([sys.executable, "-c", program, str(path)], capture_output=True, text=True, timeout=60)
    assert done.stdout.strip() == "0.1", done.stderr
