"""Members with internal steps of their own, and members of other engines, in one coupled run."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from phfmu import Collocated, Coupled, EngineMember, NativeInstance, Options, build_model, run
from phfmu.cli import main
from phfmu.components.mechanical.translational import mass, spring
from phfmu.network.network import Network
from tests.engines import ENGINES
from tests.network.test_coupled_2k import exact, nonlinear
from tests.wide import slow


def last(k: int, h: float, engine: Any = NativeInstance, **parts: int) -> tuple[np.ndarray, Any]:
    """States at the end of 1 s, and the result."""
    net: Any = nonlinear()
    models = {n: build_model(d, Collocated(k)) for n, d in net.members.items()}
    members: list[Any] = [EngineMember(n, m, engine(m), parts.get(n, 1)) for n, m in models.items()]
    result = run(Coupled(net, members), Options(stop=1.0, step=h))
    return np.array([result.column(n)[-1] for n in ("body.q", "body.v", "spring.x")]), result


@pytest.mark.parametrize(
    ("k", "parts", "order"),
    [
        slow((1, {"spring": 3}, 2)),
        (2, {"spring": 4}, 4),
        slow((2, {"body": 3}, 4)),
        slow((3, {"body": 2, "spring": 3}, 6)),
    ],
)
def test_the_order_is_kept_with_internal_steps(k: int, parts: dict[str, int], order: int) -> None:
    """Slopes 2, 4, 6 against a solution of high accuracy; the ledger closes, parts or not."""
    reference = exact(1.0)
    errors = []
    for h in (0.2, 0.1, 0.05) if k < 3 else (0.25, 0.125):
        found, result = last(k, h, **parts)
        errors.append(np.abs(found - reference).max())
        assert result.ledger.summary().closed
    assert -np.diff(np.log2(errors))[-1] == pytest.approx(order, abs=0.2)


def test_internal_steps_are_those_of_the_engine_in_both_engines() -> None:
    one, two = (last(2, 0.1, engine, spring=4)[0] for engine in ENGINES)
    assert np.abs(one - two).max() <= 1e-13


@pytest.mark.slow
def test_a_member_a_thousand_times_faster_closes_its_ledger() -> None:
    """Case 12: 1 : 1000."""
    net: Any = Network("fast")
    net.add("m", mass(1.0, k=1.0, q=1.0))
    net.add("light", mass(1e-3))
    net.add("s", spring(1e3, elongation=-1.0))
    net.connect("m.flange", "s.a", name="left")
    net.connect("light.flange", "s.b", name="right")
    models = {n: build_model(d) for n, d in net.members.items()}
    parts = {"light": 1000, "s": 1000}
    members: list[Any] = [EngineMember(n, m, NativeInstance(m), parts.get(n, 1)) for n, m in models.items()]
    result = run(Coupled(net, members), Options(stop=2.0, step=0.01))
    s = result.ledger.summary()
    assert s.closed and s.network is not None
    assert abs(s.network.stored) <= 1e-11 * 500.0


def states(path: Any) -> np.ndarray:
    table = np.genfromtxt(path, delimiter=",", names=True, deletechars="")
    return np.array([table[n] for n in ("mass1.q", "mass1.v", "mass2.q", "spring12.e")])


def test_engines_are_chosen_for_each_member(tmp_path: Any, capsys: pytest.CaptureFixture[str]) -> None:
    """A unit, a compiled member and one in Python together are the composed model, at order 2 and 4."""
    common = ("run", "oscillator", "--stop", "0.2")
    mixed = ("--member", "mass1=fmu", "--member", "mass2=python", "--fmi", "2.0")
    for order in ("2", "4"):
        found = []
        for name, more in (("one", ()), ("two", mixed)):
            path = tmp_path / f"{name}{order}.csv"
            assert main([*common, "--order", order, *more, "-o", str(path)]) == 0
            found.append(states(path))
        out = capsys.readouterr().out
        assert "native engine (mass1: fmu, mass2: python)" in out
        assert "coupling newton: members have engines or steps of their own" in out
        assert np.abs(found[0] - found[1]).max() <= 1e-12


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--member mass9=fmu", "no member 'mass9'; did you mean"),
        ("--member mass1=fmux", "no such engine; did you mean fmu?"),
        ("--member mass1", "expected NAME=ENGINE"),
        ("--parts mass1=0", "a number of internal steps from 1"),
        ("--parts mass1=2 --parts mass1=3", "--parts mass1=2 already"),
        ("--threads 0 --coupling newton", "expected a number of threads from 1"),
        ("--threads 2", "for members that are stepped apart (--coupling newton)"),
        ("--parts mass1=2 --coupling monolithic", "for members of a network that are stepped apart"),
    ],
)
def test_what_does_not_fit_is_told(words: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "oscillator", *words.split()]) == 2
    assert said in capsys.readouterr().err


def test_parts_of_a_unit_are_compiled_in(tmp_path: Any, capsys: pytest.CaptureFixture[str]) -> None:
    """As a unit or as a member of an engine, four steps in each are the same motion."""
    common = ("run", "oscillator", "--stop", "0.2", "--step", "0.02", "--parts", "spring12=4", "--order", "4")
    found = []
    for name, more in (("one", ()), ("two", ("--member", "spring12=fmu"))):
        path = tmp_path / f"{name}.csv"
        assert main([*common, *more, "-o", str(path)]) == 0
        found.append(states(path))
    assert "spring12: 4 steps in each" in capsys.readouterr().out
    assert np.abs(found[0] - found[1]).max() <= 1e-12
