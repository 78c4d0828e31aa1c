"""Explicit couplings: members that step once, what their junctions make of it, and where that ends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phfmu import Coupled, EngineMember, NativeInstance, Network, Options, StepFailure, build_model, run
from phfmu.cli import main
from phfmu.components.mechanical.translational import damper, mass, spring
from phfmu.components.scenes.electrical.smib import smib
from phfmu.components.scenes.mechanical.oscillator import oscillator
from phfmu.network.couplings.gauss_seidel import GaussSeidel, usual_sequence
from phfmu.network.couplings.jacobi import Jacobi
from phfmu.outcome.status import Status


def members(net: Network) -> list[Any]:
    models = [build_model(replace(part, name=name)) for name, part in net.members.items()]
    return [EngineMember(m.name, m, NativeInstance(m)) for m in models]


def coupled(net: Network, coupling: Any, h: float, stop: float = 1.0) -> Any:
    return run(Coupled(net, members(net), coupling), Options(stop=stop, step=h))


def energy_off(result: Any) -> float:
    """max |H - H0| / H0 of the oscillator, from its states."""
    q1, v1, q2, v2, e = (result.column(n) for n in ("mass1.q", "mass1.v", "mass2.q", "mass2.v", "spring12.e"))
    H = 0.5 * (v1**2 + v2**2) + 2 * np.pi**2 * (q1**2 + q2**2) + 8 * np.pi**2 * e**2
    assert H[0] == pytest.approx(10 * np.pi**2)
    return float(np.abs(H - H[0]).max() / H[0])


@pytest.mark.parametrize(
    ("coupling", "h", "off"),
    [
        (Jacobi, 0.04, 2.2e4),
        (Jacobi, 0.01, 19.0),
        pytest.param(Jacobi, 0.001, 0.33, marks=pytest.mark.slow),
        (GaussSeidel, 0.04, 0.48),
        (GaussSeidel, 0.01, 0.083),
        pytest.param(GaussSeidel, 0.001, 0.0076, marks=pytest.mark.slow),
    ],
)
def test_the_oscillator_in_three_gains_what_it_gains_elsewhere(coupling: Any, h: float, off: float) -> None:
    """Against a separate program with implicit midpoint members and end-point outputs; to the two digits it gave."""
    net: Any = oscillator().system
    assert energy_off(coupled(net, coupling(), h)) == pytest.approx(off, rel=0.02)


def resistive() -> Network:
    """Feedthrough: a damper between a mass and a spring, and a free force."""
    net = Network("resistive")
    net.add("m", mass(1.0, k=3.0, q=0.1))
    net.add("far", mass(2.0))
    net.add("s", spring(40.0, d=0.7, elongation=0.1))
    net.add("d", damper(0.8))
    net.junction("near", ["m.flange", "s.a", "d.a"])
    net.junction("end", ["far.flange", "s.b", "d.b"])
    return net


def test_junctions_with_feedthrough_are_solved_at_each_instant() -> None:
    """The composed model is approached with order 1, and the books tell every joule on the way."""
    net = resistive()
    exact = coupled(net, _newton, 1e-3).column("m.q")[-1]
    errors = []
    for h in (0.01, 0.005, 0.0025):
        result = coupled(net, Jacobi(), h)
        n = result.ledger.summary().network
        assert abs(n.stored + n.dissipated - n.junction_residual) <= 1e-12 * n.dissipated
        errors.append(abs(result.column("m.q")[-1] - exact))
    assert np.diff(np.log2(errors)) == pytest.approx([-1.0, -1.0], abs=0.25)


def _newton(joined: Any) -> Any:
    from phfmu.network.couplings.newton import newton

    return newton(joined)


def test_a_run_that_gains_too_much_is_stopped_with_advice() -> None:
    net: Any = oscillator().system
    stepper = Coupled(net, members(net), Jacobi())
    with pytest.raises(StepFailure) as caught:
        run(stepper, Options(stop=10.0, step=0.04))
    failure = caught.value
    assert failure.status is Status.GROWTH and 1.0 < failure.time < 2.0
    assert all(word in str(failure) for word in ("98.7 J at the start", "smaller step", "newton or monolithic"))
    H = stepper.energies().sum()
    assert 1e3 < H / 98.7 <= 1e6, "members are back at the last accepted step"


def test_what_is_supplied_from_outside_is_no_runaway() -> None:
    """From rest, by a force of 1 N: more than 1e6 times the energy at the start, which is zero."""
    net = Network("pushed")
    net.add("m", mass(1.0))
    net.add("a", mass(1.0))
    net.add("s", spring(1.0))
    net.connect("m.flange", "s.a", name="joint")
    net.connect("a.flange", "s.b", name="other")
    net.members["n"] = replace(mass(1.0), name="n")
    stepper = Coupled(net, members(net), GaussSeidel())
    stepper.set_value("n.flange.force", 1.0)
    assert run(stepper, Options(stop=0.1, step=0.01)).steps == 10


def test_a_node_that_no_output_gives_is_refused() -> None:
    net: Any = smib().system
    with pytest.raises(ValueError, match=r"no output gives bus1\.v\[1\], .*--coupling newton"):
        coupled(net, Jacobi(), 1e-3, 1e-2)


def test_members_that_take_efforts_come_first_and_the_order_is_free() -> None:
    net: Any = oscillator().system
    assert usual_sequence(net) == ("mass1", "mass2", "spring12")
    one, two = (coupled(net, GaussSeidel(s), 0.01) for s in (None, ("spring12", "mass2", "mass1")))
    assert abs(one.column("spring12.e") - two.column("spring12.e")).max() > 1e-4
    with pytest.raises(ValueError, match="it lacks spring12"):
        coupled(net, GaussSeidel(("mass1", "mass2")), 0.01)


def test_units_that_cannot_go_back_are_stepped_once() -> None:
    """No state is asked of them."""

    class Forward(EngineMember):
        saves = False

        def get_state(self) -> Any:
            raise AssertionError("asked for a state")

    net: Any = oscillator().system
    own: list[Any] = [Forward(m.name, m.model, m.instance) for m in members(net)]
    result = run(Coupled(net, own, GaussSeidel()), Options(stop=0.1, step=0.01))
    assert result.steps == 10


Said = Callable[..., tuple[int, str]]


@pytest.fixture
def said(capsys: pytest.CaptureFixture[str]) -> Said:
    def call(*words: str) -> tuple[int, str]:
        code = main([str(w) for w in words])
        out = capsys.readouterr()
        return code, out.out + out.err

    return call


def test_the_command_line(said: Said, tmp_path: Path) -> None:
    """Order, sequence and verdict are printed; the audit says the same again; what junctions made is no violation."""
    log = tmp_path / "a.parquet"
    code, text = said("run", "oscillator", "--coupling", "gauss-seidel", "--audit", log)
    assert code == 0
    assert "order 1 (members of order 2" in text and "gauss-seidel coupling (mass1, mass2, spring12)" in text
    assert "loose" in text and "VIOLATED" not in text
    code, again = said("audit", log)
    tables = [shown.split("junction  ")[1].split("\nwarning")[0].strip() for shown in (text, again)]
    assert code == 0 and tables[0] == tables[1]
    code, text = said(
        "run", "oscillator", "--coupling", "gauss-seidel", "--sequence", "spring12,mass1,mass2", "--stop", ".1"
    )
    assert code == 0 and "(spring12, mass1, mass2)" in text
    code, text = said("run", "oscillator", "--coupling", "jacobi", "--step", "0.04", "--stop", "3")
    assert code == 3 and "grows without bound" in text
    code, text = said("run", "oscillator", "--coupling", "newton", "--sequence", "mass1,mass2,spring12")
    assert code == 2 and "is for gauss-seidel" in text
    code, text = said("run", "oscillator", "--coupling", "jacobi", "--order", "4", "--stop", "0.1")
    assert code == 0 and "--order 4 is that of the members" in text and "order 1" in text


def test_steps_follow_the_energy_of_junctions_on_the_command_line(said: Said) -> None:
    short = ("run", "oscillator", "--coupling", "gauss-seidel", "--stop", "0.1")
    code, text = said(*short, "--ecco", "0.1", "--max-step", "0.02")
    assert code == 0 and "ecco 0.1, steps" in text
    for wrong, words in (
        (("run", "oscillator", "--ecco", "0.1"), "add --coupling gauss-seidel or jacobi"),
        ((*short, "--ecco", "0.1", "--rtol", "1e-3"), "leave out --rtol"),
        ((*short, "--ecco", "-1"), "expected a positive tolerance"),
        ((*short, "--ecco", "1", "--min-step", "1", "--max-step", "0.1"), "expected 0 <= min <= max"),
    ):
        code, text = said(*wrong)
        assert code == 2 and words in text, wrong
