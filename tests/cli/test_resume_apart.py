"""A run of members stepped apart, or of a unit, that ends between any two blocks goes on from there to the same bits."""

from __future__ import annotations

import argparse
import pickle
import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from phfmu.cli import options
from phfmu.cli.checkpoints import plain
from phfmu.cli.job import job_of
from phfmu.cli.timeline import timeline
from phfmu.cli.verbs import run as verb
from phfmu.runs import march
from phfmu.runs.loop import run
from phfmu.runs.result import Result


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


def ended_often(args: argparse.Namespace, chance: random.Random, ends: int) -> tuple[int, Result]:
    """The run, ended `ends` times at random; how often it went on."""
    kept: bytes | None = None
    for end in range(ends + 1):
        found = None if kept is None else plain(kept)
        try:
            return end, taken(args, Ending(chance.randint(1, 12) if end < ends else None, found))
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


RUNS = {
    "newton": "oscillator --coupling newton --stop 1",
    "anderson": "two_machine --coupling anderson --stop 0.02",
    "gauss-seidel, a sequence": "oscillator --coupling gauss-seidel --sequence mass1,spring12,mass2 --stop 1",
    "state events": "two_point_control --coupling newton --order 4 --stop 3",
    "switches": "rectifier --coupling newton --order 4 --stop 0.02",
    "units, FMI 3.0": "oscillator --coupling newton --stop 0.5 --engine fmu --order 4",
    "one unit": "pendulum --stop 0.5 --engine fmu",
}
MORE = {
    "events of time": "two_machine --coupling newton --order 4 --stop 0.11 --step 1e-3",
    "jacobi": "oscillator --coupling jacobi --stop 0.5 --step 1e-3",
    "order 6": "two_machine --coupling newton --order 6 --stop 0.02",
    "size of steps by energy": "oscillator --coupling jacobi --stop 0.2 --ecco 1e-3",
    "clutch": "clutch_engagement --coupling newton --order 4",
    "damping after events": "two_point_control --coupling newton --order 4 --stop 3 --restart 2",
    "damping after events of time": "two_machine --coupling newton --stop 0.11 --step 1e-3 --restart 3",
    "signals held": "speed_control --coupling gauss-seidel --stop 2",
    "signals held, newton": "island --coupling newton --stop 0.004 --engine fmu",
    "signals at nodes": "speed_control --coupling newton --order 4 --stop 2",
    "signals, switches": "buck --coupling newton --stop 0.0002",
    "python": "oscillator --coupling newton --stop 1 --engine python",
    "halved": "oscillator --coupling newton --stop 0.5 --unconverged halve",
    "units, FMI 2.0": "oscillator --coupling anderson --stop 0.5 --engine fmu --fmi 2.0",
    "units in turn": "oscillator --coupling gauss-seidel --stop 1 --engine fmu",
    "units in turn, FMI 2.0": "oscillator --coupling jacobi --step 1e-3 --stop 0.1 --engine fmu --fmi 2.0",
    "units of their own process": "oscillator --coupling newton --stop 0.5 --engine fmu --isolate",
    "one unit with events": "bouncing_ball --stop 0.7 --engine fmu",
    "one unit, FMI 2.0": "pendulum --stop 0.5 --engine fmu --fmi 2.0",
    "one member is a unit": "oscillator --coupling newton --stop 0.5 --member spring12=fmu",
}


@pytest.mark.parametrize("name", [*RUNS, *(pytest.param(name, marks=pytest.mark.slow) for name in MORE)])
def test_a_run_goes_on_from_between_any_two_blocks(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    args = arguments(*(RUNS | MORE)[name].split())
    was = taken(args, Ending(None))
    monkeypatch.setattr(march, "BLOCK", 3)  # steps of a block at most, as where the machine has other things to do
    resumed, now = ended_often(args, random.Random(name), 2)
    assert resumed == 2
    require_equal(was, now)
