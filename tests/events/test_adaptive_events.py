"""State events in steps that keep a tolerance: the same zeros, fewer steps, a closed ledger."""

from __future__ import annotations

from functools import cache
from math import sqrt

import numpy as np
import pytest

from phfmu import Collocated, Monolithic, NativeInstance, Options, build_model, run
from phfmu.cli import main
from phfmu.components.library import build
from phfmu.runs.result import Result
from tests.events.scenes import WALL_STOP, exact, wall


@cache
def model():
    return build_model(wall(), Collocated(2))


def hit(rtol: float) -> Result:
    return run(Monolithic(model(), NativeInstance(model())), Options(stop=WALL_STOP, step=0.05, rtol=rtol))


def test_the_error_of_event_times_follows_the_tolerance():
    times, q, p = exact()
    errors, steps = [], []
    for rtol in (1e-5, 1e-7, 1e-9):
        result = hit(rtol)
        summary = result.ledger.summary()
        assert summary.closed and summary.events["state"] == 9
        found = result.time[np.flatnonzero(np.diff(result.time) == 0)]
        errors.append(float(np.abs(found - times).max()))
        steps.append(result.steps)
        assert errors[-1] <= 100 * rtol
        assert abs(result.column("q")[-1] - q) <= 100 * rtol and abs(result.column("p")[-1] - p) <= 100 * rtol
    assert errors[0] > 10 * errors[1] > 100 * errors[2]
    assert steps[0] < steps[1] < steps[2]


def test_bounces_pile_up_to_rest():
    """Their accumulation point lies within one long step."""
    m = build_model(build("bouncing_ball").declaration(), Collocated(2))
    result = run(Monolithic(m, NativeInstance(m)), Options(stop=5.0, step=0.02, rtol=1e-6, max_step=0.5))
    assert result.ledger.summary().closed
    rests = result.time[np.flatnonzero(result.column("flight") == 0)[0]]
    assert rests == pytest.approx(9 * sqrt(2 / 9.81), abs=5e-6)  # what is left is below 1e-6 of the step
    assert result.column("p")[-1] == 0 and result.column("q")[-1] == pytest.approx(0, abs=1e-15)
    assert result.steps < 100


def test_the_command_line_takes_a_tolerance(capsys):
    assert main(["run", "bouncing_ball", "--rtol", "1e-5", "--engine", "native", "--stop", "1"]) == 0
    assert "t = 0.451523640986 s: floor, lost 3.5316 J" in capsys.readouterr().out
