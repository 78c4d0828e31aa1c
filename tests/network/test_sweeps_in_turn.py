"""Couplings of one's own whose members step in turn, one sweep or two a step, beside the same written out member by member."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from phfmu import Coupled, EngineMember, NativeInstance, Network, Options, build_model, run
from phfmu.components.mechanical.translational import mass, spring
from phfmu.derivatives.apart.sensitive_members import SensitiveMembers
from phfmu.network.couplings.gauss_seidel import GaussSeidel
from phfmu.network.interface.instant import Instant
from phfmu.network.interface.joined import Joined

pytestmark = pytest.mark.usefixtures("compiler")
H, STEPS = 1e-3, 20


class Twice(GaussSeidel):
    """Every member twice in turn, the second time from the start of the step."""

    repeats = True

    def groups(self, joined: Joined) -> list[list[int]]:
        return 2 * super().groups(joined)


class Forgetful(GaussSeidel):
    """Leaves out the last member."""

    def groups(self, joined: Joined) -> list[list[int]]:
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
    net, instant = three(), Instant()
    joined = Joined(net, members(net))
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
