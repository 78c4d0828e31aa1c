"""Advice must be true for the case: what a message tells to do exists, and the facts bear it out."""

from __future__ import annotations

from pathlib import Path

import pytest

from phfmu import Event, Monolithic, Network, Options, PythonInstance, StepFailure, build_model, run
from phfmu.cli import main
from phfmu.components.electrical.sources import voltage_source
from phfmu.components.mechanical.translational import mass
from phfmu.network.couplings.coupled import Coupled
from phfmu.network.members.engine_member import EngineMember
from phfmu.outcome.status import Status
from tests.wide import wide


def said(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str]:
    capsys.readouterr()
    code = main(words)
    out, err = capsys.readouterr()
    return code, out + err


def failure(status: Status = Status.NO_CONVERGENCE, h: float = 0.01, **facts) -> StepFailure:
    return StepFailure(status, "model", 1.0, h, **facts)


def test_remedies_follow_from_the_facts() -> None:
    """A smaller step is advised where none was tried, and never where smaller ones failed or longer ones worked."""
    from phfmu.outcome.status import remedy

    blunt = failure(residual=3.0, floor=1e-13, update=0.5)
    assert "substeps down to 0.01 s failed too" in remedy(blunt)
    cut = failure(residual=3.0, update=0.5)
    cut.asked, cut.longest = 1e-6, 0.1
    assert "steps of 0.1 s were solved" in remedy(cut) and "onto the grid" in remedy(cut)
    loose = failure(residual=2.5e-14, floor=1.6e-19, update=0.1)
    assert "hardly determined" in remedy(loose)
    assert "start values" in remedy(failure(h=0.0, residual=1.0))
    assert "take a smaller step" in remedy(failure(joined=True, composable=True, history=(1.0, 0.3, 0.05)))
    stuck = remedy(failure(joined=True, composable=True, history=(1.0, 0.9, 0.95)))
    assert "stopped shrinking" in stuck and "smaller step" not in stuck
    assert "Next: " + remedy(blunt) in str(blunt)


def test_a_network_with_units_is_not_told_to_compose_them() -> None:
    """A unit is known by its ports: only declared members make one model."""
    from phfmu import ELECTRICAL, PHDAE, Port
    from phfmu.components.electrical import resistor, rlc_load
    from phfmu.outcome.status import remedy

    for history in (1.0, 0.3, 0.05), (1.0, 0.9, 0.95):
        told = [remedy(failure(joined=True, composable=c, history=history)) for c in (True, False)]
        assert "--coupling monolithic" in told[0] and "--coupling" not in told[1] and told[1]
    net = Network("net")
    net.add("a", resistor(1.0))
    net.add("b", rlc_load(1.0, 1.0, 1.0))
    assert net.composable
    net.add("unit", PHDAE("unit", ports=(Port("p", ELECTRICAL, "effort", {}),)))
    assert not net.composable


#: units of other tools say it themselves, and events have reasons of their own
OTHERS = (Status.OK, Status.UNIT, Status.EVENT)


@pytest.mark.parametrize("status", [s for s in Status if s not in OTHERS])
def test_every_outcome_has_a_remedy(status: Status) -> None:
    assert ". Next: " in str(failure(status)) and ". Next: " in str(failure(status, h=0.0))


def test_a_run_adds_what_it_had_solved(monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps of 0.1 s work; the one of 1e-3 s before an event is refused: no word of smaller steps."""
    model = build_model(mass(1.0, k=4.0, q=1.0))
    instance = PythonInstance(model)
    solves = instance._solves
    solve = solves._solve

    def refuse(s, h, u):
        if h < 0.01:
            monkeypatch.setattr("phfmu.engine.reference.solves.DEPTH", 0)
            outcome = solve(s, h, u)
            outcome.status = Status.NO_CONVERGENCE
            return outcome
        return solve(s, h, u)

    monkeypatch.setattr(solves, "_solve", refuse)
    with pytest.raises(StepFailure, match=r"steps of 0\.1 s were solved before this one of 0\.001 s"):
        run(Monolithic(model, instance), Options(stop=1.0, step=0.1, events=[Event(0.501, "m", 1.0)]))


def test_joined_ideal_sources_are_named_with_what_helps() -> None:
    """Two ideal voltage sources at one node: nothing determines its voltage; `phfmu check` would not say why."""
    net = Network("short")
    for name in ("a", "b"):
        net.add(name, voltage_source(1.0))
    net.junction("node", ["a.terminal", "b.terminal"])
    models = {n: build_model(d) for n, d in net.members.items()}
    members = [EngineMember(n, m, PythonInstance(m)) for n, m in models.items()]
    with pytest.raises(StepFailure, match="junction row of .*ideal sources joined"):
        run(Coupled(net, members), Options(stop=0.1, step=0.01))


@pytest.mark.parametrize("option", ["--rtol", "--dense"])
def test_what_needs_one_model_says_what_it_has(capsys, option: str) -> None:
    code, text = said(
        capsys,
        "run",
        "oscillator",
        "--coupling",
        "newton",
        "--engine",
        "python",
        option,
        "1" if option != "--rtol" else "1e-3",
    )
    assert (
        code == 2
        and f"leave out {option}, or leave out --coupling, --member and --parts" in text
        and "--engine fmu" not in text
    )


def test_adaptive_runs_refuse_restarts_that_let_constraints_drift(capsys) -> None:
    """Radau steps leave g = 0; with fixed steps that was refused, with --rtol it was done in silence."""
    for steps in ([], ["--rtol", "1e-4"]):
        code, text = said(
            capsys, "run", "four_particle", "--engine", "python", "--stop", "0.02", "--restart", "2", *steps
        )
        assert code == 2 and "constraints drift" in text and "--restart 0" in text


def test_no_message_names_an_option_that_does_not_exist() -> None:
    """--engine is not chosen for one member."""
    for path in (Path(__file__).parents[2] / "phfmu").rglob("*.py"):
        assert "--engine native for" not in path.read_text(), path


@pytest.mark.parametrize("engine", wide(["fmu", "python"], "python"))
def test_newton_says_its_order(capsys, compiler, engine) -> None:
    """Members keep theirs, also as units."""
    words = ("run", "oscillator", "--stop", "0.02", "--coupling", "newton", "--engine", engine, "--order", "4")
    code, text = said(capsys, *words)
    assert code == 0 and f"order 4, {engine} engine, newton" in text and "inputs held" not in text


def test_info_says_what_a_junction_exchanges(capsys) -> None:
    info = said(capsys, "info", "smib")[1]
    assert "--order, composed and with --coupling newton" in info
    assert "junction bus1: gen.terminal, line.a" in info and "newton: k values and a pair of impulses" in info
    assert "newton: k values, order 2k\n" in info
    assert "--coupling newton" not in said(capsys, "info", "mass")[1]


def test_members_that_start_off_their_constraints_are_told_what_works(capsys, tmp_path) -> None:
    """--project is refused for coupled members, so it is not the advice."""
    file = tmp_path / "m.py"
    file.write_text(
        "from phfmu import Network\nfrom phfmu.components.mechanical.translational import mass\n"
        "def net():\n    n = Network('net')\n    n.add('a', mass(v=0.3))\n    n.add('b', mass())\n"
        "    n.junction('joint', ['a.flange', 'b.flange'], kind='1')\n    return n\n"
    )
    code, text = said(capsys, "run", f"{file}:net", "--coupling", "newton", "--engine", "python")
    assert code == 2 and "--coupling monolithic" in text and "--project" in text
