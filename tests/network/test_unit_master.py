"""Units of this package in the compiled master: rows and books of the loop in Python, refusals, crashes, what is left to it."""

from __future__ import annotations

import ctypes
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phfmu import (
    Collocated,
    Coupled,
    EngineMember,
    FMUInstance,
    NativeInstance,
    PythonInstance,
    StepFailure,
    build_model,
    export,
)
from phfmu.components.scenes.drive import drive
from phfmu.components.scenes.oscillator import oscillator
from phfmu.components.scenes.smib import smib
from phfmu.components.scenes.speed_control import speed_control
from phfmu.components.scenes.stops import buffer
from phfmu.components.scenes.two_machine import two_machine
from phfmu.engine.steps import Steps
from phfmu.fmu.access import Access
from phfmu.network.members.fmu_member import FMUMember
from tests.network.both_loops import SAME
from tests.network.test_master import BOOKS, pulled
from tests.wide import slow

pytestmark = pytest.mark.usefixtures("compiler")

UNITS = {"fmi2": "2.0", "fmi3": "3.0"}
MIXED = "fmi3 native fmi2"


@pytest.fixture
def made(tmp_path: Path) -> Iterator[Callable[..., Coupled]]:
    """(network, kinds in turn, k, step) -> members stepped apart."""
    with ExitStack() as stack:
        paths: dict[Any, Path] = {}

        def make(net: Any, kinds: str, k: int, h: float, isolate: float | None = None, **how: Any) -> Coupled:
            members: list[Any] = []
            for (name, d), kind in zip(net.separate().items(), cycle(kinds.split()), strict=False):
                model = build_model(replace(d, name=name), Collocated(k))
                if kind not in UNITS:
                    members.append(EngineMember(name, model, NativeInstance(model)))
                    continue
                if (name, kind) not in paths:
                    kicked = model.events is None and any(p.kind != "none" for p in PythonInstance(model).impulse_ports)
                    folder, version = tmp_path / f"{name}{k}", (UNITS[kind],)
                    (paths[name, kind],) = export(model, folder, version, step=h, node_inputs=k > 1, impulses=kicked)
                unit = stack.enter_context(FMUInstance(paths[name, kind], start=0.0, name=name, isolate=isolate))
                members.append(FMUMember(name, unit))
            return Coupled(net, members, **how)

        yield make


SCENES = {oscillator: 1e-2, drive: 1e-3, smib: 1e-3, two_machine: 2e-4, speed_control: 1e-3}
QUICK = ((oscillator, MIXED, 1), (smib, MIXED, 2))
CASES = [
    pytest.param(make, kinds, k, marks=() if (make, kinds, k) in QUICK else pytest.mark.slow)
    for make in SCENES
    for kinds in ("fmi2", "fmi3", MIXED)
    for k in (1, 2, 3)
]


@pytest.mark.parametrize(("make", "kinds", "k"), CASES)
def test_rows_and_books_are_those_of_the_loop_in_python(made: Any, make: Any, kinds: str, k: int) -> None:
    """To rounding: the factors of the interface matrix are sparse ones, and trials start from the same continuations."""
    net, h = make().system, SCENES[make]
    one, two = (made(net, kinds, k, h, compiled=compiled) for compiled in (True, False))
    steps = []
    for stepper in (one, two):
        stepper.check_start()
        stepper.prepare(0.0, h)
        steps.append(stepper.advance(0.0, h, 12))
    if one._signals.any_held:  # of order 2, where units have no values at nodes
        assert one._master is None
    else:
        assert one._master.taken == 12
    assert two._master is None
    a, b = steps
    scale = np.abs(b.H).sum(axis=1).max()
    assert np.abs(a.H - b.H).max() <= SAME * scale
    assert all(np.abs(getattr(a, n) - getattr(b, n)).max() <= SAME * scale for n in (*BOOKS, "numerical", "moved"))
    assert np.abs(a.signals - b.signals).max() <= SAME * max(np.abs(b.signals).max(), scale)
    assert sum(a.iterations) <= sum(b.iterations) + 3
    now = [m.unit for s in (one, two) for m in s.joined.members if isinstance(m, FMUMember)]
    assert {u.time for u in now} == {12 * h} and np.abs(one.read() - two.read()).max() <= SAME * max(
        np.abs(two.read()).max(), scale
    )
    c, d = (s.advance(0.0, h, 3, 12) for s in (one, two))
    assert np.abs(c.H - d.H).max() <= SAME * scale


@pytest.mark.parametrize("kinds", ["fmi2", "fmi3"])
def test_a_step_that_fails_leaves_units_where_they_were(made: Any, kinds: str) -> None:
    """With the error of the loop in Python and the words of the unit; then a shorter step is taken."""
    texts = []
    for compiled in (True, False):
        stepper = made(pulled(), kinds, 1, 0.05, compiled=compiled)
        stepper.check_start()
        stepper.advance(0.0, 0.05, 3)
        H, first = stepper.energies(), 3
        with pytest.raises(StepFailure) as caught:
            for first in range(3, 100):
                H, values = stepper.energies(), stepper.read()
                stepper.advance(0.0, 0.05, 1, first)
        texts.append(str(caught.value))
        assert np.array_equal(stepper.energies(), H) and np.array_equal(stepper.read(), values)
        assert all(m.unit.time == pytest.approx(first * 0.05) for m in stepper.joined.members)
        assert len(stepper.advance(first * 0.05, 1e-6, 1).H) == 1
    assert texts[0] == texts[1]


@pytest.mark.parametrize("kinds", [slow("fmi2"), "fmi3", slow(MIXED)])
def test_threads_and_blocks_change_no_bit(made: Any, kinds: str) -> None:
    found = []
    for blocks, threads in (((12,), 1), ((1, 4, 7), 1), ((12,), 2)):
        stepper = made(oscillator().system, kinds, 2, 1e-2, threads=threads)
        stepper.check_start()
        first, rows = 0, []
        for n in blocks:
            rows.append(stepper.advance(0.0, 1e-2, n, first).signals)
            first += n
        assert stepper._master.taken == 12 and stepper._master.threads == threads
        found.append(np.concatenate(rows))
    assert np.array_equal(found[0], found[1]) and np.array_equal(found[0], found[2])


def test_units_in_processes_of_their_own_stay_in_python(made: Any) -> None:
    stepper = made(oscillator().system, MIXED, 1, 1e-2, isolate=60.0)
    stepper.check_start()
    assert len(stepper.advance(0.0, 1e-2, 2).H) == 2 and stepper._master is None


# -- what a unit answers ------------------------------------------------------------------------------------------------

DO_STEP = ctypes.CFUNCTYPE(
    ctypes.c_int, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_bool, *[ctypes.c_void_p] * 4
)


def answering(monkeypatch: pytest.MonkeyPatch, status: int, late: float) -> list[float]:
    """The second mass answers steps from `late` on with this status instead of doing them; times of its steps."""
    functions, kept, times = Access.functions, [], list[float]()

    def of(self: Access, names: Any) -> list[Any]:
        found = functions(self, names)
        if self.values.name != "mass2":
            return found
        real: Any = ctypes.cast(found[2], DO_STEP)

        def do_step(instance: Any, t: float, h: float, *rest: Any) -> int:
            times.append(t)
            done = real(instance, t, h, *rest)
            return max(done, status) if t > late else done

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
    assert stepper._master.taken == 5 and len(times) >= 10


@pytest.mark.parametrize("status", [2, 3, 5])
def test_what_is_not_answered_with_ok_is_asked_again_in_python(
    made: Any, monkeypatch: pytest.MonkeyPatch, status: int
) -> None:
    """There the unit does it, as a member that refuses once does: the rows are those of the loop in Python."""
    answering(monkeypatch, status, 0.025)
    found = []
    for compiled in (True, False):
        stepper = made(oscillator().system, "fmi3", 1, 1e-2, compiled=compiled)
        stepper.check_start()
        found.append(stepper.advance(0.0, 1e-2, 6))
        assert not compiled or stepper._master.taken == 3
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
from phfmu.engine.steps import Steps
from phfmu.fmu.access import Access
from phfmu.network.members.fmu_member import FMUMember
from phfmu.components.scenes.oscillator import oscillator
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


# -- events ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kinds", "h"), [("fmi3", 0.01), slow(("fmi2", 0.01)), slow((MIXED.replace("native", "fmi2"), 0.02))]
)
def test_steps_with_state_events_in_a_unit_are_told_by_the_loop_in_python(made: Any, kinds: str, h: float) -> None:
    """A body that bounces on its bumper: compiled code takes the steps between impacts, and back what has one."""
    found, steps = [], round(0.5 / h)
    for compiled in (True, False):
        stepper = made(buffer().system, kinds, 1, h, compiled=compiled)
        stepper.check_start()
        stepper.prepare(0.0, h)
        parts = [stepper.advance(0.0, h, 1, i) for i in range(steps // 2)]
        parts.append(stepper.advance(0.0, h, steps - steps // 2, steps // 2))
        found.append(Steps.joined(parts))
        assert not compiled or 0.5 * steps <= stepper._master.taken < steps
    one, two = found
    assert np.abs(one.H - two.H).max() <= 1e-9 * np.abs(two.H).max()  # impacts make rounding grow
    (a, b) = ([e for e in s.events or ()] for s in found)
    assert 2 <= len(a) == len(b)
