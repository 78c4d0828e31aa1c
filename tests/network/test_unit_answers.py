"""What units answer in the compiled master: warnings, refusals, fatal errors, crashes."""

from __future__ import annotations

import ctypes
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phfmu import (
    StepFailure,
    build_model,
    export,
)
from phfmu.components.scenes.mechanical.oscillator import oscillator
from phfmu.fmu.importer.access import Access
from tests.network.both_loops import SAME, called_back
from tests.wide import slow

pytestmark = pytest.mark.usefixtures("compiler")


DO_STEP = ctypes.CFUNCTYPE(
    ctypes.c_int, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_bool, *[ctypes.c_void_p] * 4
)


def answering(monkeypatch: pytest.MonkeyPatch, status: int, late: float, most: int = 1000) -> list[float]:
    """The second mass answers steps from `late` on with this status, at most so often; times of its steps."""
    functions, kept, times, answered = Access.functions, [], list[float](), list[float]()

    def of(self: Access, names: Any) -> list[Any]:
        found = functions(self, names)
        if self.values.name != "mass2":
            return found
        real: Any = ctypes.cast(found[2], DO_STEP)

        def do_step(instance: Any, t: float, h: float, *rest: Any) -> int:
            times.append(t)
            done = real(instance, t, h, *rest)
            if t <= late or len(answered) == most:
                return done
            answered.append(t)
            return max(done, status)

        kept.append(DO_STEP(do_step))
        found[2] = kept[-1]
        return found

    monkeypatch.setattr(Access, "functions", of)
    return times


def test_a_warning_is_no_refusal(made: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    times = answering(monkeypatch, 1, 0.0)
    stepper = made(oscillator().system, "fmi3", 1, 1e-2)
    stepper.check_start()
    stepper.advance(0.0, 1e-2, 5)
    assert stepper.master.taken == 5 and len(times) >= 10


@pytest.mark.parametrize("status", [2, 3, 5])
def test_what_is_not_answered_with_ok_is_asked_again(made: Any, monkeypatch: pytest.MonkeyPatch, status: int) -> None:
    """Then the unit does it, as a member that refuses once does: the rows are those of a unit that is called back."""
    found = []
    for called in (False, True):
        answering(monkeypatch, status, 0.025, most=1)
        stepper = called_back(made(oscillator().system, "fmi3", 1, 1e-2), called)
        stepper.check_start()
        found.append(stepper.advance(0.0, 1e-2, 6))
    assert np.abs(found[0].H - found[1].H).max() <= SAME * np.abs(found[1].H).sum()
    assert np.array_equal(found[0].iterations, found[1].iterations)


def test_after_a_fatal_error_nothing_is_called(made: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """The run ends with the unit, the call and the time, and keeps the steps before; other members are back."""
    times = answering(monkeypatch, 4, 0.025)
    stepper = made(oscillator().system, "fmi3", 1, 1e-2)
    stepper.check_start()
    with pytest.raises(StepFailure, match=r"mass2 at t = 0.03 s, h = 0.01 s: fmi3DoStep answers 'fatal'") as caught:
        stepper.advance(0.0, 1e-2, 6)
    assert caught.value.recorded and len(caught.value.recorded["steps"].H) == 3
    assert times.count(0.03) == 1 and times[-1] == 0.03
    one, dead, *_ = sorted(
        (m.unit for m in stepper.joined.members), key=lambda u: u.name != "mass1" and u.name != "mass2"
    )
    assert dead.name == "mass2" and dead.dead and not one.dead and one.get(["energy.stored"]).size == 1
    assert one.time == pytest.approx(0.03)


CRASH = """
import ctypes, sys
from phfmu import Coupled, FMUInstance
from phfmu.outcome.steps import Steps
from phfmu.fmu.importer.access import Access
from phfmu.network.members.fmu_member import FMUMember
from phfmu.components.scenes.mechanical.oscillator import oscillator
functions = Access.functions
def of(self, names):
    found = functions(self, names)
    if self.values.name == "mass2":
        found[names.index(sys.argv[1])] = {how}
    return found
Access.functions = of
net = oscillator().system
stepper = Coupled(net, [FMUMember(n, FMUInstance(p, name=n, start=0.0)) for n, p in zip(net.members, sys.argv[2:])])
stepper.check_start()
stepper.advance(0.0, 0.01, 3)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
@pytest.mark.parametrize(
    ("how", "call", "said"),
    [
        ("ctypes.c_void_p(8)", "DoStep", "crashed in doStep at t = 0 s (SIGSEGV"),
        slow(("ctypes.CDLL(None).abort", "GetFMUState", "crashed in fmi3GetFMUState (SIGABRT")),
        slow(("ctypes.CDLL(None).exit", "DoStep", "ended the process in doStep at t = 0 s")),
    ],
)
def test_a_unit_that_crashes_is_named(tmp_path: Path, how: str, call: str, said: str) -> None:
    net: Any = oscillator().system
    paths = [
        export(build_model(replace(d, name=n)), tmp_path, ("3.0",), step=1e-2)[0] for n, d in net.separate().items()
    ]
    run = [sys.executable, "-c", CRASH.replace("{how}", how), call, *map(str, paths)]
    done = subprocess.run(run, capture_output=True, text=True, timeout=100)
    assert done.returncode == 3 and f"the unit 'mass2' {said}" in done.stderr and "--isolate" in done.stderr
