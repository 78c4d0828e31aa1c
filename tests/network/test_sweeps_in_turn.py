"""Couplings of one's own whose members step in turn, one sweep or two a step, beside the same written out member by member."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phfmu import Collocated, Coupled, EngineMember, FMUInstance, NativeInstance, Network, Options, build_model, run
from phfmu.cli import main
from phfmu.components.mechanical.translational import mass, spring
from phfmu.derivatives.apart.sensitive_members import SensitiveMembers
from phfmu.network.as_unit.export import export_network
from phfmu.network.couplings.coupling_table import COUPLINGS
from phfmu.network.couplings.gauss_seidel import GaussSeidel
from phfmu.network.couplings.unit import FMUStepper
from phfmu.network.interface.coupled_members import CoupledMembers
from phfmu.network.interface.instant import InstantSolver
from tests.network.test_coupling_choice import mixed

pytestmark = pytest.mark.usefixtures("compiler")
H, STEPS = 1e-3, 20


class Twice(GaussSeidel):
    """Every member twice in turn, the second time from the start of the step."""

    repeats = True

    def groups(self, joined: CoupledMembers) -> list[list[int]]:
        return 2 * super().groups(joined)


class Forgetful(GaussSeidel):
    """Leaves out the last member."""

    def groups(self, joined: CoupledMembers) -> list[list[int]]:
        return super().groups(joined)[:-1]


class Unsaid(Twice):
    repeats = False


def three() -> Network:
    net = Network("three")
    net.add("a", mass(1.0, q=0.0))
    net.add("s", spring(400.0, elongation=0.5))
    net.add("b", mass(2.0, q=0.0))
    net.connect("a.flange", "s.a", name="left")
    net.connect("b.flange", "s.b", name="right")
    return net


def members(net: Network) -> list[EngineMember]:
    models = {name: build_model(part) for name, part in net.members.items()}
    return [EngineMember(name, model, NativeInstance(model)) for name, model in models.items()]


def written_out(coupling: Any) -> np.ndarray:
    net, instant = three(), InstantSolver()
    joined = CoupledMembers(net, members(net))
    xi = np.zeros(len(joined.face.names))
    joined.begin(xi)
    for k in range(STEPS):
        kept = joined.states()
        for place, (i,) in enumerate(coupling.groups(joined)):
            xi = instant.solve(joined, xi, k * H)
            if place >= len(joined.members):
                joined.members[i].set_state(kept[i])
            joined.members[i].set_input(joined.inputs(xi)[joined.places[i]])
            joined.members[i].do_step(k * H, H)
    return joined.energies()


@pytest.mark.parametrize("coupling", [Twice(), GaussSeidel(("b", "a", "s"))], ids=["twice", "once"])
def test_groups_step_as_written_out(coupling: Any) -> None:
    net = three()
    apart = Coupled(net, members(net), coupling)
    summary = run(apart, Options(stop=STEPS * H, step=H)).ledger.summary()
    assert apart.energies() == pytest.approx(written_out(coupling), rel=1e-12)
    assert {j.verdict for j in summary.junctions} == {"loose"} and abs(summary.network.unexplained) < 1e-13


@pytest.mark.parametrize(
    ("coupling", "said"),
    [
        (Forgetful(), "do not have each of 3 members once in a sweep"),
        (Unsaid(), "2 times, and it says that it repeats no step"),
    ],
    ids=["forgetful", "unsaid"],
)
def test_groups_that_are_no_sweeps_are_refused(coupling: Any, said: str) -> None:
    net = three()
    with pytest.raises(ValueError, match=said):
        run(Coupled(net, members(net), coupling), Options(stop=H, step=H))


def test_further_sweeps_have_no_derivatives() -> None:
    net = three()
    with pytest.raises(ValueError, match="Twice, which takes each step more than once"):
        SensitiveMembers(Coupled(net, members(net), Twice()), ["a.m"])


def test_a_unit_that_cannot_go_back_is_stepped_last_of_two_sweeps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """No rows are solved, of which its junction could tell a part: what it makes is told whole."""
    row = replace(COUPLINGS["gauss-seidel"], name="twice", needs="steps back", where=f"{Twice.__module__}.Twice")
    monkeypatch.setitem(COUPLINGS, "twice", row)
    assert main(["run", str(mixed(tmp_path, "3.0", saves=False)), "--coupling", "twice", "--stop", "0.05"]) == 0
    said = capsys.readouterr().out
    assert "it is stepped last" in said and "loose" in said and "VIOLATED" not in said


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_two_sweeps_as_one_unit_have_the_bits_of_the_run(
    version: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The unit begins where outputs give the junctions, as the run does."""
    row = replace(COUPLINGS["gauss-seidel"], name="twice", needs="steps back", where=f"{Twice.__module__}.Twice")
    monkeypatch.setitem(COUPLINGS, "twice", row)
    net, schemes = three(), {name: Collocated(1) for name in "asb"}
    (path,) = export_network(net, tmp_path, schemes, (version,), step=H, coupling="twice")
    want = run(Coupled(net, members(net), Twice()), Options(stop=STEPS * H, step=H)).column("a.q")
    with FMUInstance(path) as unit:
        whole = run(FMUStepper(unit), Options(stop=STEPS * H, step=H)).column("a.q")
    assert whole.tolist() == want.tolist()
