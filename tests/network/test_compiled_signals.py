"""Signals that are held over a step in the compiled master: samples, held values and notes of the loop in Python."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phfmu import (
    Anderson,
    Collocated,
    Coupled,
    EngineMember,
    GaussSeidel,
    Jacobi,
    NativeInstance,
    Network,
    StepFailure,
    build_model,
)
from phfmu.components.mechanical.translational import mass, spring
from phfmu.components.scenes.mechanical.speed_control import speed_control
from phfmu.network.couplings.coupling import Coupling
from phfmu.network.couplings.newton import Newton
from tests.network.both_loops import called_back
from tests.network.governed import governed, lag
from tests.network.test_compiled_couplings import advanced, require_alike
from tests.network.unit_members import unit_members
from tests.wide import slow

pytestmark = pytest.mark.usefixtures("compiler")


def stepper(
    net: Network, make: Callable[[], Coupling], compiled: bool, h: float, ports: bool = True, **how: Any
) -> Coupled:
    """`ports`: members take signals by ports, else by parameters."""
    models = {
        n: build_model(replace(d, name=n), Collocated(1))
        for n, d in (net.separate() if ports else net.declared).items()
    }
    own: list[Any] = [EngineMember(n, m, NativeInstance(m)) for n, m in models.items()]
    made = called_back(Coupled(net, own, make(), **how), not compiled)
    made.check_start()
    made.prepare(0.0, h)
    disturb(made)
    return made


def disturb(made: Coupled) -> None:
    """What moves a network that starts at rest."""
    for name, value in {"rotor.b.torque": -5.0, "governor.reference": 378.0}.items():
        if name in made.inputs():
            made.set_value(name, value)


def servo() -> Network:
    """A controller that holds the speed of a rotor, and beside it a mass on a spring: signals and a junction that is solved."""
    net: Network = speed_control().system  # pyright: ignore[reportAssignmentType]
    net.add("m", mass(1.0, v=0.3))
    net.add("s", spring(40.0, elongation=0.1))
    net.connect("m.flange", "s.a", name="joint")
    return net


NETWORKS: dict[str, tuple[Callable[[], Network], float, tuple[Callable[[], Coupling], ...]]] = {
    "servo": (servo, 1e-3, (Newton, Anderson, GaussSeidel, Jacobi)),
    "governed": (lambda: governed(), 2e-5, (Newton, Anderson)),
    "folded": (lambda: governed(True), 2e-5, (Newton, Anderson, GaussSeidel, Jacobi)),
}
CASES = [(n, make, how) for n, (_, _, makes) in NETWORKS.items() for make in makes for how in ("extrapolated", "held")]


@pytest.mark.parametrize("ports", [True, slow(False)])
@pytest.mark.parametrize(("name", "make", "how"), [c if c[0] != "governed" else slow(c) for c in CASES])
def test_rows_and_books_are_those_of_members_called_back(name: str, make: Any, how: Any, ports: bool) -> None:
    """Through blocks and beyond: what was sampled last is known to both."""
    net, h = NETWORKS[name][0](), NETWORKS[name][1]
    one, two = (stepper(net, make, c, h, ports, signals=how) for c in (True, False))
    for n, first in ((1, 0), (20, 1), (9, 21)):
        a, b = advanced((one, two), h, n, first)
        require_alike(a, b, 1e-10 if make is Anderson else 1e-12)
    assert not one.master.calls and two.master.calls
    states = [s._signals.state() for s in (one, two)]
    assert (
        np.abs(states[0][0] - states[1][0]).max() <= 1e-9 * np.abs(states[1][0]).max() and states[0][2] == states[1][2]
    )
    moved = [n for n in ("rotor.w", "gen.Te", "controller.command") if n in one.names]
    assert all(np.ptp(a.signals[:, one.names.index(n)]) > 0 for n in moved) and moved


@pytest.mark.parametrize("make", [GaussSeidel, slow(Jacobi), slow(Anderson)])
@pytest.mark.parametrize("kinds", ["fmi3 native", slow("fmi2 native"), slow("fmi3 native fmi2")])
def test_signals_of_units_are_sampled_and_set_too(tmp_path: Path, kinds: str, make: Callable[[], Coupling]) -> None:
    net, h = servo(), 1e-3
    with unit_members(tmp_path) as made:
        one, two = (called_back(made(net, kinds, 1, h, coupling=make()), c) for c in (False, True))
        for s in (one, two):
            s.check_start()
            s.prepare(0.0, h)
            disturb(s)
        a, b = advanced((one, two), h, 12)
        require_alike(a, b, 1e-12)
        assert not one.master.calls and two.master.calls
        assert np.ptp(a.signals[:, one.names.index("controller.command")]) > 0.01


def test_a_signal_that_grows_is_told_by_both_loops() -> None:
    """A loop of held signals with a gain that is too large for the step: the same line, with the same times."""
    found = []
    for compiled in (True, False):
        net = Network("loop")
        net.add("a", replace(lag("a", 400.0, 1e-2, 0.0, 1.0, "V", "V"), name="a"))
        net.add("b", replace(lag("b", 400.0, 1e-2, 0.0, 1.0, "V", "V"), name="b"))
        net.signal("a.out", "b.measured")
        net.signal("b.out", "a.measured", factor=-1.0)
        made = stepper(net, Jacobi, compiled, 1e-2)
        try:
            made.advance(0.0, 1e-2, 60)
        except StepFailure:
            pass
        found.append(made.notes())
    assert found[0] and found[0] == found[1] and "grows without bound" in found[0][0]


def test_refused_steps_leave_samples_where_they_were() -> None:
    """The same step is taken from the same samples when it is asked for again."""
    one, two = (stepper(governed(), Anderson, c, 2e-5) for c in (True, False))
    advanced((one, two), 2e-5, 10)
    usual, one.master.rules.iterations = one.master.rules.iterations, 1
    with pytest.raises(StepFailure):
        one.advance(0.0, 2e-5, 3, 10)
    one.master.rules.iterations = usual
    require_alike(*advanced((one, two), 2e-5, 3, 10), 1e-10)
