"""Two masses on ever stiffer springs: evaluations a step, energy, and long runs of couplings that repeat steps."""

from __future__ import annotations

from dataclasses import replace
from math import cos, pi
from typing import Any

import numpy as np
import pytest

from phfmu import Anderson, Collocated, Coupled, EngineMember, NativeInstance, Network, Options, build_model, run
from phfmu.components.mechanical.translational import mass, spring
from phfmu.network.couplings.newton import Newton, newton
from tests.wide import wide

ITERATED = {"anderson": lambda _: Anderson(), "held": lambda _: Newton(), "nodes": newton}
#: stiffness k12 in N/m, step in s, most trials a step of Anderson's acceleration and of Newton's method
LADDER = [(k, h) for h in (1e-3, 1e-2, 1e-1) for k in (16 * pi**2, 1e4, 1e6, 1e8, 1e10)]


def ladder(k12: float) -> Any:
    net = Network("ladder")
    net.add("mass1", mass(1.0, k=4 * pi**2, q=1.0))
    net.add("mass2", mass(1.0, k=4 * pi**2))
    net.add("spring12", spring(k12, elongation=-1.0))
    net.connect("mass1.flange", "spring12.a", name="left")
    net.connect("mass2.flange", "spring12.b", name="right")
    return net


def coupled(net: Any, coupling: Any, nodes: int = 1) -> Coupled:
    models = [build_model(replace(part, name=name), Collocated(nodes)) for name, part in net.members.items()]
    return Coupled(net, [EngineMember(m.name, m, NativeInstance(m)) for m in models], coupling)


@pytest.mark.parametrize("kind", ITERATED)
@pytest.mark.parametrize(("k12", "h"), wide(LADDER, (16 * pi**2, 1e-1), (1e6, 1e-2), (1e10, 1e-1)))
def test_steps_converge_at_any_stiffness_with_the_energy_kept(k12: float, h: float, kind: str) -> None:
    """A plain fixed point would diverge above about k12 = 2 m / h^2, in 12 of the 15 cases."""
    result = run(coupled(ladder(k12), ITERATED[kind]), Options(stop=40 * h, step=h))
    s = result.ledger.summary()
    H0 = sum(c.H_start for c in s.components)
    assert H0 == pytest.approx(2 * pi**2 + k12 / 2)
    assert s.network is not None and abs(s.network.stored) <= 1e-12 * H0
    assert abs(s.network.stored - sum(j.residual for j in s.junctions)) <= 1e-13 * H0
    assert result.iterations / result.steps <= {"anderson": 9.0, "held": 4.5, "nodes": 4.5}[kind]


@pytest.mark.parametrize("kind", ITERATED)
def test_without_stiffness_a_step_takes_two_trials(kind: str) -> None:
    """Linear members: Newton's matrix is exact, and Anderson's differences of earlier steps tell all of it."""
    result = run(coupled(ladder(16 * pi**2), ITERATED[kind]), Options(stop=1.0, step=0.01))
    assert result.iterations / result.steps <= 2.2
    q1 = result.column("mass1.q")
    exact = np.array([(cos(2 * pi * t) + cos(6 * pi * t)) / 2 for t in result.time])
    assert abs(q1 - exact).max() == pytest.approx(2.598e-2, rel=1e-3)


@pytest.mark.parametrize(("h", "off"), [(0.04, 3.591e-1), (0.02, 1.022e-1), (0.01, 2.598e-2), (0.005, 6.514e-3)])
def test_the_error_of_held_values_is_of_order_two(h: float, off: float) -> None:
    """Numbers of a separate program; the frequencies are those of the closed-form solution."""
    result = run(coupled(ladder(16 * pi**2), ITERATED["held"]), Options(stop=1.0, step=h))
    exact = (np.cos(2 * pi * result.time) + np.cos(6 * pi * result.time)) / 2
    assert abs(result.column("mass1.q") - exact).max() == pytest.approx(off, rel=1e-3)


def equal_pair(k12: float) -> Any:
    """Two equal masses that start together: the spring between carries nothing but rounding."""
    net = Network("pair")
    net.add("one", mass(1.0, k=4 * pi**2, q=1.0))
    net.add("two", mass(1.0, k=4 * pi**2, q=1.0))
    net.add("s", spring(k12))
    net.connect("one.flange", "s.a", name="left")
    net.connect("two.flange", "s.b", name="right")
    return net


@pytest.mark.parametrize(("kind", "nodes"), [("held", 1), ("nodes", 1), ("nodes", 2), ("nodes", 3)])
@pytest.mark.parametrize("stop", [120.0, pytest.param(1000.0, marks=pytest.mark.slow)])
def test_a_stiff_spring_without_force_goes_on(kind: str, nodes: int, stop: float) -> None:
    """1e6 N/m at 0.1 s: the rows are rounding at zero crossings; a step that is never accepted would end the run.

    What is zero at one node of a step has the rounding of the others; the junctions pass the rounding of the spring on.
    """
    result = run(coupled(equal_pair(1e6), ITERATED[kind], nodes), Options(stop=stop, step=0.1))
    s = result.ledger.summary()
    assert result.steps == round(stop / 0.1)
    assert s.closed, s.worst
    assert s.network is not None and abs(s.network.stored) <= 1e-11 * 4 * pi**2
    assert result.iterations / result.steps <= 3.5


@pytest.mark.slow
@pytest.mark.parametrize(("k12", "drift"), [(16 * pi**2, 1e-11), (1e8, 1e-10)])
def test_of_20_000_steps_the_energy_is_kept(k12: float, drift: float) -> None:
    result = run(coupled(ladder(k12), ITERATED["held"]), Options(stop=200.0, step=0.01))
    s = result.ledger.summary()
    assert s.network is not None
    assert abs(s.network.stored) <= drift * sum(c.H_start for c in s.components)


@pytest.mark.parametrize("kind", ITERATED)
def test_a_rigid_link_is_no_fixed_point_and_yet_solved(kind: str) -> None:
    """Masses of 1 kg (10 N/m to ground) and 2 kg that move as one: the force between them is a multiplier."""
    net = Network("link")
    net.add("one", mass(1.0, k=10.0, v=1.0))
    net.add("two", mass(2.0, v=1.0))
    net.junction("link", ["one.flange", "two.flange"])
    result = run(coupled(net, ITERATED[kind]), Options(stop=5.0, step=0.01))
    v, other = result.column("one.v"), result.column("two.v")
    assert np.abs(v - other).max() <= 1e-13
    H = 0.5 * v**2 + other**2 + 5.0 * result.column("one.q") ** 2
    assert np.abs(H - H[0]).max() <= 1e-12 * H[0]
    turned = 2 * np.arctan(np.sqrt(10.0 / 3.0) * 0.01 / 2)  # by a step of the midpoint rule
    assert np.abs(v - np.cos(turned * np.arange(len(v)))).max() <= 1e-11
