"""A library that never answers: the process can be ended all the same, and says which unit it waited for."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from tests.fmu import foreign

#: a run that tells when the step of its unit that hangs has taken 0.3 s
RUN = """
import signal, sys, threading, time
signal.signal(signal.SIGINT, signal.default_int_handler)  # which a script's processes in the background are to ignore
from phfmu.cli import main
from phfmu.fmu.isolation import exit_guard

def tell():
    call = None
    while call is None or exit_guard.current is not call or call[1].__name__ != "doStep" or call[2][0] < 0.25:
        call = exit_guard.current
        time.sleep(0.3)
    print("it hangs", file=sys.stderr, flush=True)

threading.Thread(target=tell, daemon=True).start()
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), pytest.param(signal.SIGTERM, 143, marks=pytest.mark.slow)]
)
def test_a_second_signal_ends_a_run_whose_unit_hangs(tmp_path: Path, number: signal.Signals, code: int) -> None:
    path = foreign.mass(tmp_path / "pump.fmu", "3.0")
    line = ["run", str(path), "--set", f"mode={foreign.HANG}", "-o", str(tmp_path / "rows.csv")]
    run = subprocess.Popen([sys.executable, "-c", RUN, *line], stderr=subprocess.PIPE, text=True)
    late = threading.Timer(60, run.kill)
    late.start()
    try:
        assert run.stderr is not None
        for awaited in ("it hangs", "waiting for the unit 'foreign', doStep at t = 0.3 s"):
            while awaited not in (said := run.stderr.readline()):
                assert said, f"it ended before: {awaited}"
            run.send_signal(number)
        assert run.wait(20) == code
        assert "the unit 'foreign' does not answer in doStep at t = 0.3 s (a second signal)" in run.stderr.read()
    finally:
        late.cancel()
        run.kill()
        run.wait()


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_one_signal_ends_a_run_that_waits_for_a_unit_in_a_process_of_its_own(tmp_path: Path) -> None:
    """The rows of the steps before are kept, and nobody waits until the call is late."""
    path = foreign.mass(tmp_path / "pump.fmu", "3.0")
    table = tmp_path / "rows.csv"
    line = ["run", str(path), "--set", f"mode={foreign.HANG}", "--isolate-timeout", "600", "-o", str(table)]
    code = "import sys; from phfmu.cli import main; sys.exit(main(sys.argv[1:]))"
    run = subprocess.Popen([sys.executable, "-c", code, *line], stderr=subprocess.PIPE, text=True)
    try:
        begun = time.monotonic()
        while not list(tmp_path.glob("rows.csv.*")) and time.monotonic() < begun + 60:
            time.sleep(0.1)
        time.sleep(2.0)  # three steps, and the one that hangs
        run.send_signal(signal.SIGTERM)
        _, err = run.communicate(timeout=30)
    finally:
        run.kill()
        run.wait()
    assert run.returncode == 143 and "phfmu: interrupted (SIGTERM)" in err and "Traceback" not in err
    assert table.read_text().splitlines()[-1].startswith("0.3")
