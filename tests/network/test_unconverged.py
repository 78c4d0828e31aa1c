"""Steps whose interface iteration is given up: refused, halved or kept, and always told."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from phfmu import Collocated, Coupled, EngineMember, Network, Options, PythonInstance, StepFailure, build_model, run
from phfmu.cli import main
from phfmu.network.couplings.newton import Newton, newton
from phfmu.network.couplings.unconverged import POLICIES
from phfmu.network.interface.coupled_members import CoupledMembers
from tests.network.test_coupled_2k import nonlinear
from tests.wide import wide

COUPLINGS: dict[str, Callable[[CoupledMembers], Any]] = {"held": lambda _: Newton(), "nodes": newton}


def stepper(kind: str, policy: str, net: Network, k: int = 2) -> Coupled:
    models = {name: build_model(part, Collocated(k)) for name, part in net.members.items()}
    members: list[Any] = [EngineMember(n, m, PythonInstance(m)) for n, m in models.items()]
    return Coupled(net, members, lambda joined: POLICIES[policy](COUPLINGS[kind](joined)))


def impatient(monkeypatch: pytest.MonkeyPatch, trials: int) -> None:
    monkeypatch.setattr("phfmu.network.couplings.compiled.solvers.NewtonSolver.iterations", trials)


@pytest.mark.parametrize("kind", COUPLINGS)
def test_the_step_is_refused_by_default(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    impatient(monkeypatch, 2)
    with pytest.raises(StepFailure, match="did not converge"):
        run(stepper(kind, "raise", nonlinear()), Options(stop=1.0, step=0.25))


@pytest.mark.parametrize("kind", COUPLINGS)
def test_of_a_kept_trial_every_joule_is_told(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The members book their own work, so the identity holds to rounding, however much the junctions make."""
    impatient(monkeypatch, 2)
    result = run(stepper(kind, "accept", nonlinear()), Options(stop=1.0, step=0.25))
    s = result.ledger.summary()
    assert s.network is not None
    made = sum(j.residual for j in s.junctions)
    assert s.closed and {j.verdict for j in s.junctions} == {"loose"}
    assert abs(made) > 1e-8, "nothing was left to tell"
    in_play = sum(c.H_start for c in s.components)
    assert abs(s.network.stored + (s.network.dissipated or 0.0) - made) <= 1e-12 * in_play
    assert sum(c.H_end - c.H_start for c in s.components) == pytest.approx(s.network.stored, abs=1e-12 * in_play)
    assert s.events["unconverged"] == 4
    assert any("did not converge; the best trial was kept" in note for note in result.notes)


@pytest.mark.parametrize("kind", wide(COUPLINGS, "held"))
def test_halves_converge_where_the_step_does_not(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Impatient or not, the motion is that of short steps; parts of a step are booked as one."""
    fine = run(stepper(kind, "raise", nonlinear()), Options(stop=1.0, step=0.0125))
    usual = run(stepper(kind, "raise", nonlinear()), Options(stop=1.0, step=0.25))
    impatient(monkeypatch, 3)
    result = run(stepper(kind, "halve", nonlinear()), Options(stop=1.0, step=0.25))
    s = result.ledger.summary()
    assert result.steps == 4 and s.closed
    assert abs(sum(j.residual for j in s.junctions)) <= 1e-12
    assert s.events["halved"] >= 1 and any("went in parts" in note for note in result.notes)
    states = ["body.q", "body.v"]
    off = [max(abs(r.column(n)[-1] - fine.column(n)[-1]) for n in states) for r in (result, usual)]
    assert off[0] < off[1]


def test_a_step_that_no_halving_saves_is_refused_with_the_members_back(monkeypatch: pytest.MonkeyPatch) -> None:
    impatient(monkeypatch, 1)
    own = stepper("nodes", "halve", nonlinear())
    before = [m.get_state() for m in own.joined.members]
    with pytest.raises(StepFailure, match="halved 10 times"):
        own.advance(0.0, 0.25, 1)
    assert all(
        np.array_equal(a.x, b.x) for a, b in zip(before, (m.get_state() for m in own.joined.members), strict=True)
    )


def test_the_command_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    impatient(monkeypatch, 1)
    line = ["run", "oscillator", "--coupling", "newton", "--stop", "0.05"]
    assert main(line) == 3
    assert main([*line, "--unconverged", "accept"]) == 0
    out = capsys.readouterr().out
    assert "5 steps of 5 did not converge; the best trial was kept" in out and "loose" in out
    assert main(["run", "oscillator", "--coupling", "jacobi", "--unconverged", "accept"]) == 2
    assert "jacobi does not iterate" in capsys.readouterr().err
