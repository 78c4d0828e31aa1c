"""The options of a run: checked in one place, before anything is built or stepped."""

from __future__ import annotations

from dataclasses import FrozenInstanceError
from math import inf, nan
from typing import Any

import numpy as np
import pytest

from phfmu import PHDAE, Event, Monolithic, Options, PythonInstance, build_model, energy, run, skew, state
from phfmu.cli import main

RUN: dict[str, Any] = {"stop": 1.0, "step": 0.1}


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"step": 0.0}, "--step 0.0 s must be positive"),
        ({"stop": inf}, "--stop inf s must be finite"),
        ({"t0": 2.0}, "after the start 2.0 s"),
        ({"step": 1e-20}, "lost in the rounding"),
        ({"events": [Event(nan, "k", 1.0)]}, "event k = 1.0 at t = nan s"),
        ({"rtol": 2.0}, "--rtol 2.0: expected"),
        ({"rtol": 1e-3, "atol": 0.0}, "--atol 0.0: expected"),
        ({"rtol": 1e-3, "min_step": 1.0, "max_step": 0.1}, "--min-step 1.0 s and --max-step 0.1 s"),
        ({"max_step": 0.5}, "--max-step is for adaptive steps"),
        ({"atol": 1e-3}, "--atol is for adaptive steps"),
        ({"restart": -1}, "--restart -1"),
        ({"dense": 0}, "--dense 0"),
        ({"kept": ("q",)}, "add --project"),
        ({"audit_rtol": -1.0}, "--audit-rtol -1.0"),
    ],
    ids=str,
)
def test_what_does_not_fit_is_refused_without_a_model(wrong: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Options(**(RUN | wrong))


def test_options_are_constant() -> None:
    with pytest.raises(FrozenInstanceError):
        Options(**RUN).step = 0.2  # type: ignore[misc]


def oscillator() -> Monolithic:
    q, p = state("q", start=1.0), state("p")
    d = PHDAE("osc", states=(q, p), energies=(energy(q**2 / 2), energy(p**2 / 2)), structure=(skew(q, p, 1.0),))
    model = build_model(d)
    return Monolithic(model, PythonInstance(model))


def test_a_run_leaves_nothing_of_its_options_in_the_stepper() -> None:
    """Rows within steps belong to the run that asked for them."""
    stepper = oscillator()
    assert len(run(stepper, Options(**RUN, dense=2)).time) == 31
    after = run(stepper, Options(t0=1.0, stop=2.0, step=0.1))
    assert len(after.time) == 11 and np.all(np.diff(after.time) > 0.09)


@pytest.mark.parametrize("words", [("--restart", "-1"), ("--rtol", "7"), ("--step", "0"), ("--dense", "0")], ids=str)
def test_the_command_line_refuses_before_it_compiles(
    words: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def never(*_: Any) -> None:
        raise AssertionError("a model was built for options that do not fit")

    monkeypatch.setattr("phfmu.discretise.model.build_model", never)
    assert main(["run", "dc_motor", "--engine", "python", *words]) == 2
    assert words[0] in capsys.readouterr().err
