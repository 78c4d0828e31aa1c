"""A run of members stepped apart, or of a unit, that ends between any two blocks goes on from there to the same bits."""

from __future__ import annotations

import argparse
import pickle
import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phfmu import Coupled, FMUInstance, Network, Options
from phfmu.cli import options
from phfmu.cli.checkpoints import plain
from phfmu.cli.job import job_of
from phfmu.cli.timeline import timeline
from phfmu.cli.verbs import run as verb
from phfmu.fmu.importer.unit_file import unit_file
from phfmu.network.couplings.jacobi import Jacobi
from phfmu.network.couplings.newton import newton
from phfmu.network.couplings.unit import FMUStepper
from phfmu.network.members.unit_member import tried, unit_member
from phfmu.runs.loop import run
from phfmu.runs.march import march
from phfmu.runs.result import Result
from tests.fmu import foreign


class Ended(Exception):
    """The run was ended, with this left."""


@dataclass
class Ending:
    """Ends a run between two blocks, and hands over what is left as bytes; goes on from what was `found`."""

    at: int | None
    found: Mapping[str, Any] | None = None
    blocks: int = 0

    def between_blocks(self, now: Callable[[], dict[str, Any]]) -> None:
        if self.blocks == self.at:
            raise Ended(pickle.dumps(now(), protocol=5))
        self.blocks += 1


def arguments(*words: str) -> argparse.Namespace:
    verbs = argparse.ArgumentParser().add_subparsers()
    verb.add_parser(verbs)
    return verbs.choices["run"].parse_args(words)


def taken(args: argparse.Namespace, ending: Ending) -> Result:
    """The run of a command line, in new steppers."""
    job = job_of(args)
    chosen, stepper = options.of_run(args, job.scene, whole=job.whole), job.build()
    events, rows, _ = timeline(args, job.scene, stepper.settable())
    chosen = replace(chosen, events=events, checkpoints=ending)
    return run(stepper, chosen, inputs=rows, interpolate=args.interpolate)


def ended_often(run_of: Callable[[Ending], Result], chance: random.Random, ends: int) -> tuple[int, Result]:
    """A run, ended `ends` times at random; how often it went on."""
    kept: bytes | None = None
    for end in range(ends + 1):
        found = None if kept is None else plain(kept)
        try:
            return end, run_of(Ending(chance.randint(1, 12) if end < ends else None, found))
        except Ended as ended:
            kept = ended.args[0]
    raise AssertionError


def require_equal(was: Result, now: Result) -> None:
    assert now.names == was.names
    assert np.array_equal(now.values.view(np.int64), was.values.view(np.int64))
    assert np.array_equal(now.time, was.time)
    assert repr(now.ledger.summary()) == repr(was.ledger.summary())
    assert now.notes == was.notes
    assert (now.steps, now.iterations, now.worst) == (was.steps, was.iterations, was.worst)
    assert (now.rejected, now.smallest, now.largest) == (was.rejected, was.smallest, was.largest)


RUNS = {
    "newton": "oscillator --coupling newton --stop 1",
    "anderson": "two_machine --coupling anderson --stop 0.02",
    "gauss-seidel, a sequence": "oscillator --coupling gauss-seidel --sequence mass1,spring12,mass2 --stop 1",
    "state events": "buffer --coupling newton --order 4 --stop 1",
    "switches": "rectifier --coupling newton --order 4 --stop 0.02",
    "units, FMI 3.0": "oscillator --coupling newton --stop 0.5 --engine fmu --order 4",
    "one unit": "pendulum --stop 0.5 --engine fmu",
    "size of steps by energy, taken again": "oscillator --coupling anderson --stop 0.3 --energy-rtol 1e-5",
}
MORE = {
    "events of time": "two_machine --coupling newton --order 4 --stop 0.11 --step 1e-3",
    "state events inside steps": "two_point_control --coupling newton --order 4 --stop 3",
    "jacobi": "oscillator --coupling jacobi --stop 0.5 --step 1e-3",
    "order 6": "two_machine --coupling newton --order 6 --stop 0.02",
    "size of steps by energy": "oscillator --coupling jacobi --stop 0.2 --ecco 1e-3",
    "size of steps by energy, in turn, units": "oscillator --coupling gauss-seidel --stop 0.05 --energy-rtol 1e-4 --engine fmu",
    "size of steps by energy, events of time": "two_machine --coupling newton --stop 0.105 --step 1e-3 --energy-rtol 1e-3",
    "clutch": "clutch_engagement --coupling newton --order 4",
    "damping after events": "two_point_control --coupling newton --order 4 --stop 3 --restart 2",
    "damping after events of time": "two_machine --coupling newton --stop 0.11 --step 1e-3 --restart 3",
    "signals held": "speed_control --coupling gauss-seidel --stop 2",
    "signals held, newton": "island --coupling newton --stop 0.004 --step 5e-5 --engine fmu",
    "signals at nodes": "speed_control --coupling newton --order 4 --stop 2",
    "signals, switches": "buck --coupling newton --stop 0.001",
    "python": "oscillator --coupling newton --stop 1 --engine python",
    "halved": "oscillator --coupling newton --stop 0.5 --unconverged halve",
    "units, FMI 2.0": "oscillator --coupling anderson --stop 0.5 --engine fmu --fmi 2.0",
    "units in turn": "oscillator --coupling gauss-seidel --stop 1 --engine fmu",
    "units in turn, FMI 2.0": "oscillator --coupling jacobi --step 1e-3 --stop 0.1 --engine fmu --fmi 2.0",
    "one unit with events": "bouncing_ball --stop 0.7 --engine fmu",
    "one unit, FMI 2.0": "pendulum --stop 0.5 --engine fmu --fmi 2.0",
    "one member is a unit": "oscillator --coupling newton --stop 0.5 --member spring12=fmu",
}


@pytest.mark.parametrize("name", [*RUNS, *(pytest.param(name, marks=pytest.mark.slow) for name in MORE)])
def test_a_run_goes_on_from_between_any_two_blocks(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    args = arguments(*(RUNS | MORE)[name].split())
    was = taken(args, Ending(None))
    monkeypatch.setattr(march, "BLOCK", 3)  # steps of a block at most, as where the machine has other things to do
    resumed, now = ended_often(partial(taken, args), random.Random(name), 2)
    assert resumed == 2
    require_equal(was, now)


def foreign_pair(folder: Path, coupling: str, ending: Ending) -> Result:
    """Two units of another tool in feedback by signals, which Newton's coupling iterates."""
    net, h = Network("pair"), 0.02
    for name, values in (("one", {"a": -0.5, "b": 4.0, "c": 1.0, "x": 1.0}), ("two", {"a": -1.0, "b": -6.0, "c": 1.0})):
        net.add(name, unit_file(folder / "unit.fmu").with_starts(values))
    net.signal("two.s", "one.r")
    net.signal("one.s", "two.r")
    found = tried(net.units, h)
    members = [unit_member(name, file, h, found[name])[0] for name, file in net.units.items()]
    stepper = Coupled(net, members, COUPLINGS[coupling], signals="agreed" if coupling == "newton" else "extrapolated")
    return run(stepper, Options(stop=1.0, step=h, checkpoints=ending))


COUPLINGS: dict[str, Any] = {"newton": newton, "jacobi": lambda _: Jacobi()}


@pytest.mark.parametrize("coupling", COUPLINGS)
def test_units_of_another_tool_go_on(coupling: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Their states become bytes, and signals that were iterated go on with the matrix of the iteration."""
    able = 'canSerializeFMUstate="true"'
    foreign.unit(tmp_path / "unit.fmu", "2.0", foreign.FIRST_ORDER, saves=True, abilities=able)
    was = foreign_pair(tmp_path, coupling, Ending(None))
    monkeypatch.setattr(march, "BLOCK", 3)
    resumed, now = ended_often(partial(foreign_pair, tmp_path, coupling), random.Random(coupling), 2)
    assert resumed == 2
    require_equal(was, now)


@pytest.mark.parametrize(("version", "isolate"), [("2.0", None), ("3.0", None), ("3.0", 30.0)])
def test_one_unit_of_another_tool_goes_on(
    version: str, isolate: float | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also in a process of its own."""
    able = f'canSerializeFMU{"s" if version == "2.0" else "S"}tate="true"'
    path = foreign.mass(tmp_path / "unit.fmu", version, abilities=able)

    def run_of(ending: Ending) -> Result:
        stepper = FMUStepper(FMUInstance(path, starts={"k": 4.0, "q": 1.0}, start=0.0, isolate=isolate))
        return run(stepper, Options(stop=1.0, step=0.02, checkpoints=ending))

    was = run_of(Ending(None))
    monkeypatch.setattr(march, "BLOCK", 3)
    resumed, now = ended_often(run_of, random.Random(version), 2)
    assert resumed == 2
    assert np.ptp(was.values[:, was.names.index("q")]) > 1.0
    require_equal(was, now)


def test_a_unit_that_cannot_write_its_state_is_refused_by_name(tmp_path: Path) -> None:
    foreign.unit(tmp_path / "unit.fmu", "2.0", foreign.FIRST_ORDER, saves=True)
    with pytest.raises(ValueError, match=r"one cannot write its state to a file .*; two cannot write"):
        foreign_pair(tmp_path, "newton", Ending(None))
    foreign.unit(tmp_path / "unit.fmu", "2.0", foreign.FIRST_ORDER, saves=False)
    with pytest.raises(ValueError, match=r"one cannot (save|take) its state"):
        foreign_pair(tmp_path, "jacobi", Ending(None))
