"""Signals between units of another tool: held, on a line through two samples, or iterated, against the exact motion."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from phfmu import Coupled, FMUInstance, Network, Options, StepFailure, run
from phfmu.cli import main
from phfmu.fmu.importer.unit_file import unit_file
from phfmu.network.couplings.choice.coupling_choice import choose
from phfmu.network.couplings.gauss_seidel import GaussSeidel
from phfmu.network.couplings.growth import SignalGrowth
from phfmu.network.couplings.jacobi import Jacobi
from phfmu.network.couplings.newton import newton
from phfmu.network.couplings.signals.sampled_signals import SignalExchange
from phfmu.network.members.fmu_member import FMUMember
from phfmu.network.wires import Wire
from phfmu.outcome.status import Status
from tests.fmu import foreign

Values = dict[str, float]
#: two systems in feedback that swing and decay
ONE: Values = {"a": -0.5, "b": 4.0, "c": 1.0, "d": 0.0, "x": 1.0}
TWO: Values = {"a": -1.0, "b": -6.0, "c": 1.0, "d": 0.0, "x": 0.5}


def pair(folder: Path, one: Values, two: Values, saves: bool = True) -> Network:
    """Each takes what the other sends."""
    net = Network("pair")
    for name, values in (("one", one), ("two", two)):
        path = foreign.unit(folder / f"{name}.fmu", "2.0", foreign.FIRST_ORDER, saves)
        net.add(name, unit_file(path).with_starts(values))
    net.signal("two.s", "one.r")
    net.signal("one.s", "two.r")
    return net


def ran(
    net: Network,
    h: float,
    signals: SignalExchange,
    stop: float = 2.0,
    coupling: Callable[..., Any] = newton,
    once_more: bool = False,
) -> Any:
    with ExitStack() as stack:
        units = [
            FMUMember(n, stack.enter_context(FMUInstance(f.path, starts=f.starts, start=0.0, name=n)), once_more)
            for n, f in net.units.items()
        ]
        return run(Coupled(net, list(units), coupling, signals=signals), Options(stop=stop, step=h))


def exact(one: Values, two: Values, t: float) -> np.ndarray:
    """x of both at t: with s = c x + d r and r = P s, P the swap, s = (1 - D P)^-1 C x."""
    A, B, C, D = (np.diag([one[k], two[k]]) for k in "abcd")
    P = np.array([[0.0, 1.0], [1.0, 0.0]])
    M = A + B @ P @ np.linalg.solve(np.eye(2) - D @ P, C)
    return expm(M * t) @ np.array([one["x"], two["x"]])


def missed(net: Network, one: Values, two: Values, h: float, signals: SignalExchange) -> float:
    result = ran(net, h, signals)
    found = np.array([result.column("one.x")[-1], result.column("two.x")[-1]])
    return float(np.abs(found - exact(one, two, 2.0)).max())


@pytest.mark.parametrize(("signals", "order"), [("held", 1), ("extrapolated", 2), ("agreed", 2)])
def test_orders(tmp_path: Path, signals: SignalExchange, order: int) -> None:
    net = pair(tmp_path, ONE, TWO)
    errors = [missed(net, ONE, TWO, h, signals) for h in (0.01, 0.005, 0.0025)]
    slopes = np.log2(errors[:-1]) - np.log2(errors[1:])
    assert np.all(np.abs(slopes - order) < 0.15), (errors, slopes)


def test_feedthrough_on_one_side_keeps_its_order(tmp_path: Path) -> None:
    one, two = ONE | {"d": 0.7}, TWO
    net = pair(tmp_path, one, two)
    errors = [missed(net, one, two, h, "agreed") for h in (0.01, 0.005)]
    assert 1.8 < np.log2(errors[0] / errors[1]) < 2.2 and errors[0] < 5e-3


def test_an_algebraic_loop_is_solved(tmp_path: Path) -> None:
    """Outputs follow inputs at once with a loop gain of -3: what is held grows threefold a step."""
    one, two = ONE | {"d": 1.5}, TWO | {"d": -2.0}
    net = pair(tmp_path, one, two)
    errors = [missed(net, one, two, h, "agreed") for h in (0.01, 0.005)]
    assert 1.8 < np.log2(errors[0] / errors[1]) < 2.2 and errors[0] < 5e-3
    result = ran(net, 0.01, "agreed")
    sent = result.column("one.s")[1:] - (result.column("one.x") + 1.5 * result.column("two.s"))[1:]
    assert np.abs(sent).max() < 1e-9
    for signals in ("held", "extrapolated"):
        assert missed(net, one, two, 0.01, signals) > 1e6


def test_units_that_take_the_accepted_step_once_more(tmp_path: Path) -> None:
    """They take it under the inputs that were agreed on, and send what these make of their outputs."""
    net = pair(tmp_path, ONE | {"d": 1.5}, TWO | {"d": -2.0})
    once, twice = (ran(net, 0.01, "agreed", once_more=more) for more in (False, True))
    for name in ("one.x", "one.s", "two.s"):
        np.testing.assert_allclose(twice.column(name), once.column(name), rtol=1e-8, atol=1e-9)


def test_large_gains_need_no_short_steps(tmp_path: Path) -> None:
    """A stiff loop: eigenvalues -0.75 +- 490i, steps of 0.02 s."""
    one, two = ONE | {"b": 4e2}, TWO | {"b": -6e2}
    net = pair(tmp_path, one, two)
    agreed = ran(net, 0.02, "agreed")
    assert np.abs(agreed.column("one.x")).max() < 2.0
    told = ran(net, 0.02, "extrapolated", stop=0.4).notes
    assert any("signal two.s -> one.r grows without bound" in line for line in told)
    assert not any("grows" in line for line in agreed.notes)


def test_couplings_differ(tmp_path: Path) -> None:
    """Only couplings that repeat steps iterate."""
    net = pair(tmp_path, ONE, TWO)
    ends = {
        name: ran(net, 0.05, signals, coupling=coupling).column("one.x")[-1]
        for name, signals, coupling in (
            ("newton", "agreed", newton),
            ("jacobi", "agreed", lambda _: Jacobi()),
            ("seidel", "agreed", lambda _: GaussSeidel()),
            ("held", "held", newton),
        )
    }
    assert ends["jacobi"] == ends["seidel"]
    assert len({round(v, 9) for v in ends.values()}) == 3


def test_a_loop_without_solution_is_named(tmp_path: Path) -> None:
    fixed = {"a": 0.0, "b": 0.0}
    net = pair(tmp_path, ONE | fixed | {"d": 2.0}, TWO | fixed | {"d": 0.5})
    with pytest.raises(StepFailure, match="signal two.s -> one.r|signal one.s -> two.r") as found:
        ran(net, 0.01, "agreed")
    assert found.value.status in (Status.SINGULAR, Status.NO_CONVERGENCE)
    assert "--signals-held" in str(found.value)


def test_steps_without_agreement_are_told_and_taken_from_the_samples(tmp_path: Path) -> None:
    fixed = {"a": 0.0, "b": 0.0}
    net = pair(tmp_path, ONE | fixed | {"d": 2.0}, TWO | fixed | {"d": 0.5})
    found, samples = (ran(net, 0.01, how, stop=0.1) for how in ("agreed-or-extrapolated", "extrapolated"))
    assert "signals did not agree in 10 steps, the first at t = 0 s: they were extrapolated there" in found.notes
    for name in ("one.s", "two.s"):
        np.testing.assert_array_equal(found.column(name), samples.column(name))


def test_growth_is_that_of_a_factor_a_step() -> None:
    """Powers of time, jumps and slow exponentials that end are not told."""
    t = np.arange(1, 20001) * 1e-3
    for values, told in (
        (np.exp(5.0 * t), True),
        ((-1.0) ** np.arange(20000) * np.exp(5.0 * t), True),
        (t, False),
        (1e-12 * t**4, False),
        (np.where(t < 10.0, 1e-9, 1e9), False),
        (np.minimum(1e-3 * np.exp(t), 1.0), False),
        (np.sin(40.0 * t), False),
    ):
        growth = SignalGrowth([Wire("a", "y", "b", "u")])
        for at, value in zip(t, values, strict=True):
            growth.watch(float(at), np.array([value]))
        assert bool(growth.told) is told, values[-1]


SCENE = """
from phfmu import Network
from phfmu.fmu.importer.unit_file import unit_file

def pair():
    net = Network("pair")
    for name, values in {values}.items():
        net.add(name, unit_file(name + ".fmu").with_starts(values))
    net.signal("two.s", "one.r")
    net.signal("one.s", "two.r")
    return net
"""


def test_command_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    one, two = ONE | {"d": 1.5}, TWO | {"d": -2.0}
    net = pair(tmp_path, one, two)
    Path("scene.py").write_text(SCENE.format(values={"one": one, "two": two}))
    line = ["run", "scene.py", "--stop", "0.5", "--step", "0.01"]
    heads = []
    newton, jacobi = ["--coupling", "newton"], ["--coupling", "jacobi"]
    for more in ([], ["--signals-held"], newton, [*newton, "--signals-held"], jacobi):
        assert main([*line, *more, "-o", "rows.csv"]) == 0
        heads.append(capsys.readouterr().out)
    first = [head.splitlines()[0] for head in heads]
    assert ["signals held" in h for h in first] == [False, True, False, True, False]
    assert ["signals iterated" in h for h in first] == [True, False, True, False, False]
    assert ["grows without bound" in h for h in heads] == [False, True, False, True, True]
    assert ["come back to them" in h for h in heads] == [True, False, False, False, False]
    assert main(["run", "oscillator", "--signals-held"]) == 2
    assert "--signals-held is for members that are stepped apart" in capsys.readouterr().err
    assert main(["run", "oscillator", "--coupling", "newton", "--signals-held"]) == 2
    assert "there are none" in capsys.readouterr().err
    assert main(["info", "scene.py"]) == 0 and len(net.units) == 2


RELAY_SCENE = """
from phfmu import Network
from phfmu.components.control import relay
from phfmu.fmu.importer.unit_file import unit_file

def thermostat():
    net = Network("thermostat")
    net.add("room", unit_file("room.fmu").with_starts({"a": -1.0, "b": 1.0, "c": 1.0, "x": 0.0}))
    net.add("relay", relay(0.4, 0.6, low=1.0, high=0.0))
    net.signal("room.s", "relay.measured")
    net.signal("relay.command", "room.r")
    return net
"""


@pytest.mark.slow
def test_a_relay_in_the_circle_switches_where_it_should(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """x' = r - x between 0.4 and 0.6: two arcs of ln(0.6/0.4)."""
    monkeypatch.chdir(tmp_path)
    foreign.unit(tmp_path / "room.fmu", "2.0", foreign.FIRST_ORDER, True)
    Path("scene.py").write_text(RELAY_SCENE)
    assert main(["run", "scene.py", "--stop", "5", "--step", "0.01", "-o", "rows.csv"]) == 0
    assert "signals iterated" in capsys.readouterr().out.splitlines()[0]
    names, *rows = Path("rows.csv").read_text().splitlines()
    x = np.array([float(row.split(",")[names.split(",").index("room.x")]) for row in rows])
    turns = np.flatnonzero(np.diff(np.sign(np.diff(x[100:]))) != 0)
    assert x.max() < 0.62 and x[100:].min() > 0.38
    assert np.diff(turns).mean() * 0.01 == pytest.approx(np.log(0.6 / 0.4), rel=0.05)


def test_units_that_cannot_go_back_are_not_iterated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    net = pair(tmp_path, ONE, TWO, saves=False)
    Path("scene.py").write_text(SCENE.format(values={"one": ONE, "two": TWO}))
    assert main(["run", "scene.py", "--stop", "0.1", "--step", "0.01", "--coupling", "newton"]) == 0
    told = capsys.readouterr().out
    assert "signals are not iterated: one, two cannot take steps back" in told
    assert "junctions make energy" not in choose(net).why and "no step can be repeated" in choose(net).why
