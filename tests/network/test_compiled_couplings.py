"""Couplings in the compiled master: the unknowns, rows and books of their files in Python, with and without repeated steps."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phfmu import (
    Anderson,
    Collocated,
    Coupled,
    GaussSeidel,
    Jacobi,
    Monolithic,
    NativeInstance,
    Network,
    Options,
    StepFailure,
    build_model,
    run,
)
from phfmu.components.mechanical.translational import damper, mass, spring
from phfmu.components.scenes.drive import drive
from phfmu.components.scenes.electrical.smib import smib
from phfmu.components.scenes.electrical.two_machine import two_machine
from phfmu.components.scenes.mechanical.oscillator import oscillator
from phfmu.network.couplings.coupling import Coupling
from phfmu.network.couplings.newton import Newton
from phfmu.network.couplings.unconverged import POLICIES
from phfmu.outcome.status import Status
from phfmu.outcome.steps import Steps
from phfmu.studies.bench.apart import coupling as coupling_bench
from tests.network.both_loops import SAME, called_back, members
from tests.network.test_master import BOOKS, pulled
from tests.network.unit_members import MIXED, unit_members
from tests.wide import slow

pytestmark = pytest.mark.usefixtures("compiler")

IN_TURN: tuple[Callable[[], Coupling], ...] = (GaussSeidel, Jacobi)
ALL: tuple[Callable[[], Coupling], ...] = (Anderson, *IN_TURN)


def resistive() -> Network:
    """Feedthrough: two dampers, and a mass between them, so that members' outputs follow each other at an instant."""
    net = Network("resistive")
    net.add("m", mass(1.0, k=3.0, q=0.1))
    net.add("far", mass(2.0))
    net.add("s", spring(40.0, d=0.7, elongation=0.1))
    net.add("d", damper(0.8))
    net.add("e", damper(0.3))
    net.add("end", spring(11.0, elongation=-0.05))
    net.junction("near", ["m.flange", "s.a", "d.a"])
    net.junction("away", ["far.flange", "s.b", "d.b", "e.a", "end.a"])
    net.add("last", mass(0.5))
    net.junction("third", ["last.flange", "e.b", "end.b"])
    return net


def begun(net: Any, coupling: Coupling, compiled: bool, k: int = 1, h: float = 1e-3, **how: Any) -> Coupled:
    stepper = called_back(Coupled(net, members(net, k), coupling, **how), not compiled)
    stepper.check_start()
    stepper.prepare(0.0, h)
    return stepper


def advanced(pair: tuple[Coupled, Coupled], h: float, n: int, first: int = 0) -> tuple[Steps, Steps]:
    return pair[0].advance(0.0, h, n, first), pair[1].advance(0.0, h, n, first)


def pair(net: Any, make: Callable[[], Coupling], k: int = 1, h: float = 1e-3) -> tuple[Coupled, Coupled]:
    """Stepped by the master, and called back."""
    return begun(net, make(), True, k, h), begun(net, make(), False, k, h)


def require_alike(one: Steps, two: Steps, same: float = SAME) -> None:
    scale = np.abs(two.H).sum(axis=1).max()
    assert np.abs(one.H - two.H).max() <= same * scale
    assert all(np.abs(getattr(one, n) - getattr(two, n)).max() <= same * scale for n in (*BOOKS, "numerical", "moved"))
    assert np.abs(one.signals - two.signals).max() <= same * max(np.abs(two.signals).max(), scale)


NETWORKS: dict[str, tuple[Callable[[], Any], float]] = {
    "oscillator": (lambda: oscillator().system, 1e-2),
    "drive": (lambda: drive().system, 1e-3),
    "resistive": (resistive, 1e-2),
    "ring": (lambda: coupling_bench.ring(5), 1e-2),
    "star": (lambda: coupling_bench.star(4), 1e-2),
}
CASES = [(n, make, k) for n in NETWORKS for make in ALL for k in (1, 2)]
QUICK = [c for c in CASES if c[0] in ("drive", "resistive") and c[2] == 1]


@pytest.mark.parametrize(("name", "make", "k"), [c if c in QUICK else slow(c) for c in CASES])
def test_rows_and_books_are_those_of_members_called_back(name: str, make: Callable[[], Coupling], k: int) -> None:
    """What steps once is the same to the last bit where sums of two outputs are all that is solved at an instant."""
    net, h = NETWORKS[name][0](), NETWORKS[name][1]
    one, two = pair(net, make, k, h)
    a, b = advanced((one, two), h, 60)
    assert not one.master.calls and two.master.calls
    require_alike(a, b, 1e-13 if make in IN_TURN else SAME)
    if make in IN_TURN:
        assert a.spent == b.spent == 0
        assert name not in ("oscillator", "drive") or k > 1 or np.array_equal(a.H, b.H)
    else:
        assert abs(a.spent - b.spent) <= 12
    require_alike(*advanced((one, two), h, 5, 60))


@pytest.mark.parametrize("make", ALL)
@pytest.mark.parametrize(("kinds", "name"), [(MIXED, "drive"), slow(("fmi2", "drive")), slow(("fmi3", "oscillator"))])
def test_units_too(tmp_path: Path, make: Callable[[], Coupling], kinds: str, name: str) -> None:
    """Of both versions and beside native members; units have come to the end, and go on from there."""
    net, h = NETWORKS[name][0](), NETWORKS[name][1]
    with unit_members(tmp_path) as made:
        one, two = (called_back(made(net, kinds, 1, h, coupling=make()), called) for called in (False, True))
        for stepper in (one, two):
            stepper.check_start()
            stepper.prepare(0.0, h)
        found = advanced((one, two), h, 12)
        assert not one.master.calls and two.master.calls
        require_alike(*found)
        assert np.abs(one.read() - two.read()).max() <= SAME * np.abs(found[1].signals).max()
        require_alike(*advanced((one, two), h, 3, 12))


@pytest.mark.parametrize("make", ALL)
def test_blocks_of_any_length_give_the_same_bits(make: Callable[[], Coupling]) -> None:
    """Of all that members tell; the rows of the ends are solved for in blocks."""
    net, found, told = resistive(), list[Steps](), list[int]()
    for blocks in ((12,), (1, 4, 7)):
        stepper, first, parts = begun(net, make(), True), 0, []
        for n in blocks:
            parts.append(stepper.advance(0.0, 1e-3, n, first))
            first += n
        found.append(Steps.joined(parts))
        told = [i for i, n in enumerate(stepper.names) if n not in stepper._sums.names]
    assert np.array_equal(found[0].signals[:, told], found[1].signals[:, told]) and np.array_equal(
        found[0].pairs, found[1].pairs
    )


@pytest.mark.parametrize("make", ALL)
def test_threads_change_no_bit(make: Callable[[], Coupling]) -> None:
    found = [begun(coupling_bench.star(12), make(), True, threads=n).advance(0.0, 1e-3, 30) for n in (1, 3)]
    for name in ("signals", "H", "iterations", *BOOKS):
        assert np.array_equal(getattr(found[0], name), getattr(found[1], name)), name


@pytest.mark.parametrize("make", IN_TURN)
def test_a_matrix_that_no_longer_contracts_is_taken_anew(make: Callable[[], Coupling]) -> None:
    """A damper becomes a hundred times as strong between two blocks, and what follows is that of members called back."""
    one, two = pair(resistive(), make)
    require_alike(*advanced((one, two), 1e-3, 5))
    for s in (one, two):
        assert s.set_value("d.d", 80.0) == "parameter"
    a, b = advanced((one, two), 1e-3, 20, 5)
    assert one.master.taken == 25
    require_alike(a, b)


@pytest.mark.parametrize("make", ALL)
def test_free_inputs_follow_data(make: Callable[[], Coupling]) -> None:
    """In the middle of steps, which is what is held; also in the equations of the instants."""
    t = np.linspace(0.0, 0.02, 5)
    rows = {"time": t, "motor.terminal.v": 12.0 + 9e3 * t**2}
    found = []
    for compiled in (True, False):
        net: Any = drive().system
        stepper = called_back(Coupled(net, members(net, 1), make()), not compiled)
        found.append(run(stepper, Options(stop=0.02, step=1e-3), inputs=rows, interpolate="cubic"))
        assert not compiled or (stepper.master.taken == 20)
    one, two = (r.values if hasattr(r, "values") else r for r in found)
    assert np.abs(one - two).max() <= SAME * np.abs(two).max()


@pytest.mark.parametrize("make", ALL)
def test_a_step_goes_on_from_an_earlier_solution(make: Callable[[], Coupling]) -> None:
    """Members brought back, and the solution of that time: the same bits once more."""
    stepper = begun(oscillator().system, make(), True, h=1e-2)
    stepper.advance(0.0, 1e-2, 10)
    states, last = stepper.joined.states(), stepper.last
    rows = []
    for _ in range(2):
        stepper.joined.restore(states)
        stepper.last = last
        rows.append(stepper.advance(0.0, 1e-2, 3, 10).signals)
    assert np.array_equal(rows[0], rows[1])


@pytest.mark.parametrize("make", IN_TURN)
def test_a_run_that_gains_too_much_stops_at_the_same_step(make: Callable[[], Coupling]) -> None:
    """With its words, at the last step within the limit, however many steps a block has."""
    found = []
    for compiled in (True, False):
        stepper = begun(oscillator().system, make(), compiled, h=0.12)
        with pytest.raises(StepFailure) as caught:
            stepper.advance(0.0, 0.12, 3000)
        kept = caught.value.recorded["steps"]
        found.append((caught.value.status, caught.value.time, str(caught.value), len(kept.H)))
        assert stepper.energies().sum() == pytest.approx(kept.H[-1].sum(), rel=1e-12)
    assert found[0][0] is Status.GROWTH and found[0] == found[1]


@pytest.mark.parametrize("make", ALL)
def test_a_step_that_fails_is_refused_with_the_words_of_the_member(make: Callable[[], Coupling]) -> None:
    found = []
    for compiled in (True, False):
        stepper = begun(pulled(), make(), compiled, h=0.05)
        with pytest.raises(StepFailure) as caught:
            stepper.advance(0.0, 0.05, 200)
        failure, end = caught.value, stepper.joined.members[0].instance.time  # pyright: ignore[reportAttributeAccessIssue]
        steps = len(failure.recorded["steps"].H) if failure.recorded else 0
        found.append((failure.status, failure.component, steps))
        assert end == pytest.approx(0.05 * steps)
    assert found[0] == found[1]


@pytest.mark.parametrize("policy", ["halve", "accept"])
def test_policies_for_steps_that_do_not_converge(policy: str) -> None:
    """Anderson's iterations end after two trials: a step is kept as it is, or taken in ever shorter parts."""
    stepper = begun(smib().system, POLICIES[policy](Anderson()), True, h=2e-5)
    stepper.advance(0.0, 2e-5, 10)
    stepper.master.rules.iterations = 2
    before = stepper.joined.states()
    if policy == "halve":
        with pytest.raises(StepFailure, match="halved 10 times"):
            stepper.advance(0.0, 2e-5, 3, 10)
        assert stepper.joined.states() == before
        return
    steps = stepper.advance(0.0, 2e-5, 3, 10)
    assert steps.accepted_by is not None and set(steps.accepted_by) == {"unconverged"} and (steps.iterations == 2).all()


SCENES: dict[Callable[[], Any], tuple[float, int]] = {oscillator: (1e-2, 1000), drive: (1e-3, 4000)}


@pytest.mark.parametrize("make", ALL)
@pytest.mark.parametrize("scene", [oscillator, slow(drive)])
def test_orders_against_the_composed_model(scene: Callable[[], Any], make: Callable[[], Coupling]) -> None:
    """Ten times as long as the scene says for those that hold energy: order 2 of Anderson's, 1 of what steps once."""
    made, order = scene(), make().order
    names = [f"{m}.{v.name}" for m, d in made.system.declared.items() for v in d.states]
    stop = made.stop * (10 if order == 2 else 0.1)
    h0 = SCENES[scene][0] / (1 if order == 2 else 8)
    errors = []
    for h in (h0, h0 / 2, h0 / 4):
        n = round(stop / h)
        apart = begun(made.system, make(), True, 1, h)
        model = build_model(made.system.compose(), Collocated(3))
        whole = Monolithic(model, NativeInstance(model))
        rows = []
        for s in (apart, whole):
            s.check_start()
            steps = s.advance(0.0, h, n)
            rows.append(steps.signals[:, [s.names.index(x) for x in names]])
        scale = np.abs(rows[1]).max(axis=0)
        errors.append(float((np.abs(rows[0] - rows[1]) / scale).max()))
    assert np.log2(np.array(errors[:-1]) / errors[1:]) == pytest.approx([order, order], abs=0.25)


def test_ports_of_a_machine_take_the_same_energy_by_each_iteration() -> None:
    """smib and two_machine with held values, Anderson's and Newton's: one solution, whatever finds it."""
    for make, h in ((smib, 2e-5), (two_machine, 1e-5)):
        found = [begun(make().system, c(), True, h=h).advance(0.0, h, 200) for c in (Anderson, Newton)]
        pairs = [np.abs(s.pairs).sum(axis=0) for s in found]
        assert np.abs(pairs[0] - pairs[1]).max() <= 1e-9 * pairs[1].max()
        require_alike(found[0], found[1], 1e-8)
