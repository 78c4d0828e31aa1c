"""What changes during a run: who wins, what is left out and told, and what it costs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from time import process_time

import numpy as np
import pytest

from phfmu import Event, Monolithic, Options, PythonInstance, build_model, run
from phfmu.cli import main
from phfmu.runs.loop import segments

Run = Callable[..., tuple[int, str]]

MODELS = """
from phfmu import Event, Scene
from phfmu.components.mechanical.translational import mass
def pushed():
    events = (Event(0.0, "flange.force", 2.0), Event(0.5, "flange.force", 4.0), Event(3.0, "m", 2.0))
    return Scene("pushed", mass(2.0), 1.0, 0.1, events)
"""


@pytest.fixture
def go(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """`phfmu run` with the Python engine: exit code and what it prints."""
    monkeypatch.chdir(tmp_path)
    Path("models.py").write_text(MODELS)

    def call(*words: str) -> tuple[int, str]:
        capsys.readouterr()
        code = main(["run", *words, "--engine", "python"])
        out, err = capsys.readouterr()
        return code, out + err

    return call


def v_end(path: str) -> float:
    table = np.genfromtxt(path, delimiter=",", names=True)
    return float(table["v"][-1])


def test_set_wins_over_an_event_at_the_start(go: Run) -> None:
    """1 N until 0.5 s and 4 N after it on 2 kg: 1.25 m/s, not the 1.5 m/s of the event at 0 s."""
    code, said = go("models.py:pushed", "--set", "flange.force=1", "-o", "o.csv")
    assert code == 0 and v_end("o.csv") == pytest.approx(1.25)
    assert "--set wins over the scene's event flange.force = 2 at t = 0 s" in said


def test_input_wins_over_the_scene_and_set_beside_it_is_refused(go: Run) -> None:
    """6 N from 0.2 s on; the scene's 2 N before it count, its 4 N at 0.5 s do not: (2 0.2 + 6 0.8)/2 m/s."""
    Path("in.csv").write_text("time,flange.force\n0.2,6\n")
    code, said = go("models.py:pushed", "--input", "in.csv", "-o", "o.csv")
    assert code == 0 and v_end("o.csv") == pytest.approx(2.6)
    assert "in.csv wins over the scene's event flange.force = 4 at t = 0.5 s" in said
    Path("in.csv").write_text("time,flange.force\n0,6\n")
    code, said = go("models.py:pushed", "--input", "in.csv", "--set", "flange.force=1")
    assert code == 2 and "flange.force is given by --set and by the row of in.csv at 0 s" in said


def test_events_and_rows_outside_the_run_are_told(go: Run) -> None:
    Path("in.csv").write_text("time,flange.force\n-2,7\n-1,6\n0.5,5\n1,4\n2,3\n")
    code, said = go("models.py:pushed", "--input", "in.csv")
    assert code == 0 and "not reached before the end at 1 s: flange.force = 4 at t = 1 s and 1 more" in said
    assert "in.csv: 2 rows before the start, from t = -2 s; the last of them holds at 0 s" in said
    assert "in.csv: 1 row after the end at 1 s, from t = 2 s, not used" in said
    assert "not reached" not in go("mass", "--stop", "0.01")[1]


def test_rows_off_the_grid_shorten_steps_and_that_is_told(go: Run) -> None:
    """Steps of 0.1 s from 0, 0.25 and 0.31 s to 1 s: the third, the only one from 0.25 s, and the last are short."""
    Path("in.csv").write_text("time,flange.force\n0.25,5\n0.31,4\n")
    said = go("mass", "--step", "0.1", "--input", "in.csv")[1]
    assert "11 steps" in said and "3 of 11 steps are shorter than 0.1 s, the shortest 0.05 s" in said
    assert "shorter than" not in go("mass", "--step", "0.1")[1]


def test_one_step_is_one_step(go: Run) -> None:
    said = go("mass", "--step", "1")[1]
    assert " 1 step," in said and "1 steps" not in said


def test_rows_of_input_cost_in_proportion_to_their_number() -> None:
    """2e4 times cost 20 s where each looked through all events; a tenth of a second is ample."""
    events = [Event(1e-5 * i, name, float(i)) for i in range(20_000) for name in ("a", "b")]
    start = process_time()
    found = list(segments(0.0, 1.0, events))
    assert process_time() - start < 2.0
    assert len(found) == 20_000 and all(len(here) == 2 for *_, here in found)
    assert [a for a, *_ in found[1:]] == [b for _, b, _ in found[:-1]] and found[-1][1] == 1.0


def test_times_that_differ_by_rounding_are_one() -> None:
    """0.1 + 0.2 is no other time than 0.3; a step of 6e-17 s between them would be."""
    events = [Event(0.3, "a", 1.0), Event(0.1 + 0.2, "b", 2.0), Event(1.0 - 1e-16, "c", 3.0)]
    found = list(segments(0.0, 1.0, events, close=1e-10))
    assert [(a, b, [e.name for e in here]) for a, b, here in found] == [(0.0, 0.3, []), (0.3, 1.0, ["a", "b"])]


def test_damping_steps_that_were_not_taken_are_counted() -> None:
    """H = 1/2 psi^T L(theta)^-1 psi is not quadratic in abc: Radau steps that would gain energy are told."""
    from phfmu.components.scenes.electrical.smib import smib

    scene = smib(coordinates="abc-flux")
    model = build_model(scene.declaration())
    events = [Event(t, "gen.shaft.torque", v) for t, v in ((0.001, 0.0), (0.003, 3e6))]
    result = run(Monolithic(model, PythonInstance(model)), Options(stop=0.006, step=1e-3, events=events, restart=2))
    refused = 4 - result.restarted
    told = [n for n in result.notes if "damping steps" in n]
    assert refused > 0 and len(told) == 1 and told[0].startswith(f"{refused} of 4 damping steps after events")
