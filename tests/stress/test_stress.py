"""The stress command: verdicts, exit codes, and the cases that once failed."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from phfmu import StepFailure
from phfmu.cli import main
from phfmu.outcome.status import remedy
from phfmu.studies.stress import events, linkage, machine, matrix, near, particles
from phfmu.studies.stress.case import StressCase, StressOutcome, Verdict, answer, not_supported, refused
from phfmu.studies.stress.members import coupled, couplings, crash, units
from phfmu.studies.stress.report import page, tally
from phfmu.words import counted
from tests.engines import ENGINES
from tests.wide import wide


def case(measure):
    return StressCase("t", "n", "c", measure)


def test_verdicts():
    def broken():
        raise RuntimeError("words")

    lines = [answer(case(m)) for m in (
        lambda: StressOutcome("a", True), lambda: StressOutcome("b", False), not_supported("no wheel"), broken)]  # fmt: skip
    assert [x.verdict for x in lines] == [Verdict.PASS, Verdict.FAIL, Verdict.NOT_SUPPORTED, Verdict.FAIL]
    assert lines[3].happened == "RuntimeError: words" and lines[2].happened == "no wheel"
    assert tally(lines) == "1 pass, 2 fail, 1 not supported"
    assert page(lines, "").count("| FAIL |") == 2


def test_what_is_at_rest_is_counted_apart(capsys):
    """A mass at rest meets every criterion about steps; only the refusals of bad values were put to the test."""
    assert main(["stress", "mass"]) == 0
    said = capsys.readouterr().out
    assert "at rest        mass: h = 0: at rest: nothing was tested" in said and "8 at rest" in said.splitlines()[-1]
    assert "pass           mass: an input that is not a number" in said
    still = answer(case(lambda: StressOutcome("too much", False, tested=False)))
    assert still.verdict is Verdict.FAIL  # what fails at rest fails
    moving = answer(case(lambda: StressOutcome("fine", True)))
    assert moving.verdict is Verdict.PASS


def test_a_port_joined_to_itself_is_told_so():
    """The case expects the words, so it fails if the advice is that of another mistake."""
    from phfmu import Network
    from phfmu.components.mechanical.translational import spring

    net = Network("net")
    net.add("s", spring(1.0))
    for join in (lambda: net.connect("s.a", "s.a"), lambda: net.junction("j", ["s.a", "s.b", "s.a"])):
        with pytest.raises(ValueError, match=r"s\.a.*to itself|joins s\.a to itself") as found:
            join()
        assert "junction(" not in str(found.value)  # a junction of one port is no way out
    (own,) = [c for c in coupled.CASES if c.name == "a port joined to itself"]
    assert own.measure().holds and "itself" in own.measure().happened


def test_every_refusal_expects_words():
    """A case that takes any error for the one it asks for cannot fail."""
    with pytest.raises(TypeError):
        refused(lambda: 1 / 0, ZeroDivisionError)  # pyright: ignore[reportCallIssue]
    assert not machine.impossible("Ra = 0", J=0.0).holds
    chosen = [c for c in (*machine.CASES, *coupled.CASES) if "refused" in c.criterion]
    assert len(chosen) >= 9 and all(c.measure().holds for c in chosen)


def test_a_port_alone_at_a_junction_is_not_sent_round_in_circles():
    from phfmu import Network
    from phfmu.components.mechanical.translational import spring

    net = Network("net")
    net.add("s", spring(1.0))
    with pytest.raises(ValueError, match="to itself.*name the port of another element"):
        net.junction("j", ["s.a", "s.a"])


@pytest.mark.parametrize("name", ["kundur555_1q", "krause_hydro325"])
def test_cases_of_the_machine_follow_its_data(name, monkeypatch):
    """Rated speed, voltage and the changes come from the data set and the component, not from numbers of one machine."""
    from phfmu.components.electrical.machines.machine_data import machine_set

    monkeypatch.setattr(machine, "MACHINE", name)
    data, model = machine_set(name), machine.machine()
    values = {
        v.name: v.start for v in (*machine.scaled(model, {"p": 2.0, "Ra": 1e-6, "psi": 0.0}).states, *model.parameters)
    }
    assert values["p"][0] == pytest.approx(2 * data.J_electrical * data.omega, rel=1e-12)
    assert not any(values["psi"])
    changed = {v.name: v.start[0] for v in machine.scaled(model, {"Ra": 1e-6}).parameters}
    assert changed["Ra"] == pytest.approx(1e-6 * data.Ra, rel=1e-12) and changed["R_f"] == data.R_rotor[0]
    period = round(1 / (data.fn * machine.H))  # steps
    unit = SimpleNamespace(model=SimpleNamespace(u0=np.zeros(5)))
    a = machine.voltages(unit, 6 * period, 0.5)[:, 0]
    assert a.max() == pytest.approx(0.5 * data.Vn_rms_ll * (2 / 3) ** 0.5, rel=1e-3)
    assert np.count_nonzero(np.diff(np.sign(a))) == 12  # six periods of the rated frequency


def test_refused_asks_for_the_error_and_its_words():
    def bad():
        raise ValueError("m1 and m2 differ")

    assert refused(bad, ValueError, "m1").holds and not refused(bad, ValueError, "m3").holds
    assert not refused(lambda: None, ValueError, "m1").holds
    with pytest.raises(ValueError, match="differ"):
        refused(bad, KeyError, "m1")


TARGETS = ["oscillator", "rigid_link", "bouncing_ball", "rectifier", "buck"]


@pytest.mark.parametrize("name", wide(TARGETS, "oscillator", "rigid_link"))
def test_command_runs_one_target(name, tmp_path, capsys):
    assert main(["stress", name, "-o", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert f"pass           {name}: " in said and "FAIL" not in said
    text = (tmp_path / "stress.md").read_text()
    assert f"phfmu stress {name}" in text and f"## {name}" in text


def test_a_failed_criterion_is_exit_code_1(monkeypatch, capsys):
    monkeypatch.setattr(matrix, "cases", lambda target: [case(lambda: StressOutcome("too much", False))])
    assert main(["stress"]) == 1
    assert "FAIL           t: n: too much  [c]" in capsys.readouterr().out


def test_long_cases_wait_for_their_option(monkeypatch, capsys):
    late = StressCase("t", "n", "c", lambda: StressOutcome("done", True), long=True)
    monkeypatch.setattr(matrix, "cases", lambda target: [late])
    assert main(["stress"]) == 0 and "done" not in capsys.readouterr().out
    assert main(["stress", "--long"]) == 0 and "done" in capsys.readouterr().out


@pytest.mark.parametrize("target", ["no_such_thing", "some.fmu"])
def test_bad_targets(target, capsys):
    assert main(["stress", target]) == 2
    assert target.split(".")[0] in capsys.readouterr().err


def test_flat_linkage_keeps_its_branch():
    found = linkage.flat(2, 0.002, 2)
    assert found.holds, found.happened


@pytest.mark.parametrize("name", wide(["frame", "doubled", "hinge"]))
def test_redundant_constraints_are_supported(name):
    found = [answer(c) for c in matrix.cases(name)]
    assert {line.verdict for line in found} == {Verdict.PASS} and len(found) == 4


@pytest.mark.slow
def test_rows_that_rest_take_the_way_back():
    cases = {c.name: c for c in matrix.cases("bricard")}
    back = answer(cases["150 steps of 0.01 s and back, order 6"])
    assert len(cases) == 14 and back.verdict is Verdict.PASS, back.happened


@pytest.mark.parametrize("k", [1e8, 1e10])
def test_stiff_members_that_hardly_act_are_coupled(k):
    found = coupled.stiff(k)
    assert found.holds, found.happened


def test_large_steps_and_light_particles():
    for found in (particles.large(20.0), particles.fast(100.0), particles.stiffness(1e12, 1e-6)):
        assert found.holds, found.happened


def test_vanishing_masses_tend_to_the_motion_without_them():
    for found in (particles.mass_limit(), particles.limit(1e-15)):
        assert found.holds, found.happened


def test_sweeps_and_iterations_are_counted_apart():
    assert "sweeps a step" in particles.mass(1.0).happened and "iterations" not in particles.mass(1.0).happened
    assert "sweeps" not in particles.mass(1e-9).happened
    assert [counted(n, "line search") for n in (1, 2)] == ["1 line search", "2 line searches"]


def test_projection_moves_no_further_than_the_start_was_off():
    found = particles.off_manifold(True)
    assert found.holds and "5.0e-04 m" in found.happened


@pytest.mark.slow
@pytest.mark.parametrize("m", [1e-12, 1e-15])
def test_engines_agree_on_vanishing_masses(m):
    from phfmu.discretise.model import build_model
    from phfmu.schemes.named import named_scheme

    declaration = particles.four(m_1=m, eta0=0.0)
    model = build_model(declaration, named_scheme(declaration, "auto", 2, "per-term"))
    one, two = (engine(model).run(0.0, 0.01, 300, ("x",))["x"] for engine in ENGINES)
    assert np.abs(one - two)[:, :12].max() <= 1e-9


@pytest.mark.slow
def test_whole_matrix():
    lines = [answer(c) for c in matrix.cases(None) if not c.long]
    assert [x.case.name for x in lines if x.verdict is Verdict.FAIL] == []


EVENTS = tuple(c for c in events.CASES if not c.long)
CASES = (*couplings.CASES, *near.CASES, *units.CASES, *EVENTS)
#: cases with these words have another one beside them without
REPEATED = (
    "gauss-seidel", "1e+04 N/m", "1e+08 N/m", "FMI 2.0", "FMI 3.0, h = 0.04 s", "another step every time",
)  # fmt: skip


@pytest.mark.parametrize(
    "given",
    wide(CASES, *(c for c in CASES if not any(words in c.name for words in REPEATED))),
    ids=lambda c: f"{c.target}: {c.name}",
)
def test_couplings_units_and_events_at_their_limits(given):
    line = answer(given)
    assert line.verdict is Verdict.PASS, line.happened


@pytest.mark.slow
@pytest.mark.parametrize("given", crash.CASES, ids=lambda c: c.name)
def test_coupled_runs_that_end_early_are_recovered(given):
    line = answer(given)
    assert line.verdict in (Verdict.PASS, Verdict.NOT_SUPPORTED), line.happened


def test_a_unit_whose_steps_do_not_repeat_is_named_only_if_it_lies():
    """The lie begins at 0.25 s: every step before is kept, all members are back, the advice is not a shorter step."""
    with pytest.raises(StepFailure) as failure:
        units.lied_to(units.CHANCE_LATE)
    found = failure.value
    assert found.time == pytest.approx(0.25) and found.unsteady.startswith("pump does not restore its state")
    assert "smaller step" not in str(found) and "gauss-seidel" in remedy(found)
    honest, told = units.lied_to(units.HONEST)
    assert not told and honest.steps == 50


def test_an_honest_unit_is_not_blamed_for_an_iteration_that_is_given_up(monkeypatch):
    monkeypatch.setattr("phfmu.network.couplings.compiled.solvers.NewtonSolver.iterations", 1)
    with pytest.raises(StepFailure) as failure:
        units.lied_to(units.HONEST)
    assert not failure.value.unsteady and "restore" not in str(failure.value)


def test_a_star_moves_as_one_spring():
    found = coupled.star(40)
    assert found.holds, found.happened


def test_a_constraint_that_hardly_acts_is_not_taken_for_held():
    """At 1e-7 its force is made of rounding: the ledger says so, and only a case that asks for that passes."""
    assert near.between(1e-7, True).holds and not near.between(1e-7, False).holds
