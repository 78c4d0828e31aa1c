"""The compiled master: rows and books of members called back, steps in blocks of any length, refused steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from phfmu import (
    PHDAE,
    TRANSLATIONAL,
    Coupled,
    NativeInstance,
    Network,
    Options,
    Port,
    PythonInstance,
    Scene,
    StepFailure,
    energy,
    run,
    state,
)
from phfmu.components.mechanical.translational import mass, spring
from phfmu.components.scenes.drive import drive
from phfmu.components.scenes.electrical.ladder import ladder
from phfmu.components.scenes.electrical.smib import smib
from phfmu.components.scenes.electrical.two_machine import two_machine
from phfmu.components.scenes.mechanical.oscillator import oscillator
from phfmu.network.couplings.compiled.threads import worth
from phfmu.network.couplings.coupling import Coupling
from phfmu.network.couplings.newton import Newton, newton
from phfmu.network.couplings.unconverged import HalvingPolicy
from phfmu.network.interface.coupled_members import CoupledMembers
from phfmu.outcome.steps import Steps
from phfmu.signals import CONSTRAINT
from phfmu.studies.bench.apart import coupling as coupling_bench
from phfmu.studies.bench.apart import networks as apart_bench
from tests.network.both_loops import SAME, called_back, members
from tests.wide import slow, wide

LIMIT = 1e-11  # of extrapolated starts: these are within 7e-12 of the composed model's
BOOKS = ("stored", "dissipated", "supplied", "pairs")


def both(net: Any, k: int, chosen: Callable[[CoupledMembers], Coupling] = newton) -> list[Coupled]:
    """Stepped by the master, then called back."""
    out = [called_back(Coupled(net, members(net, k), chosen), called) for called in (False, True)]
    assert not out[0].master.calls
    return out


def faulted() -> Scene:
    return two_machine(t_fault=4e-4, t_clear=12e-4)


def torque() -> Scene:
    scene = smib()
    return replace(scene, events=(replace(scene.events[0], t=3e-3),))


def line() -> Scene:
    scene = ladder(2)
    return replace(scene, events=(replace(scene.events[0], t=1e-3),))


SCENES: dict[Callable[[], Scene], tuple[float, int]] = {
    torque: (1e-3, 8), faulted: (2e-4, 10), line: (1e-4, 20), drive: (1e-3, 20), oscillator: (1e-2, 20),
}  # fmt: skip
QUICK = ((torque, 2), (drive, 1), (oscillator, 3))
CASES = [
    pytest.param(make, k, marks=() if (make, k) in QUICK else pytest.mark.slow, id=f"{make.__name__}-{k}")
    for make in SCENES
    for k in (1, 2, 3)
]


@pytest.mark.parametrize(("make", "k"), CASES)
def test_rows_and_books_are_those_of_members_called_back(make: Callable[[], Scene], k: int) -> None:
    """Through the scene's events; energies relative to those in play.

    The row of the start has limits of ever shorter steps, extrapolated, where flows at a node are hidden: to `LIMIT`.
    """
    scene = make()
    h, n = SCENES[make]
    net: Any = scene.system
    options = Options(stop=n * h, step=h, events=scene.events)
    steppers = both(net, k)
    one, two = (run(s, options) for s in steppers)
    assert np.array_equal(one.time, two.time)
    energy = max(np.abs(two.column(f"{m}.energy.stored")).max() for m in net.members)
    for name in two.names:
        a, b = one.column(name), two.column(name)
        size = energy if ".energy" in f".{name}" else size_of(two, steppers[1], name)
        assert np.abs(a - b)[1:].max() <= SAME * size and abs(a[0] - b[0]) <= LIMIT * size, name
    a, b = one.ledger.summary(), two.ledger.summary()
    assert a.closed and b.closed
    for x, y in zip(a.components, b.components, strict=True):
        assert [x.stored, x.dissipated, x.supplied] == pytest.approx(
            [y.stored, y.dissipated, y.supplied], abs=SAME * energy
        )
    # where rows end at rounding a step may take one trial more by the roundings of another machine; without the
    # continuation of the steps before each takes more
    assert one.iterations <= two.iterations + n // 2


def size_of(result: Any, stepper: Coupled, name: str) -> float:
    """The largest of the columns of that name, of any member; of sums that are zero, what they are made of."""
    if "constraint" in name:
        return float(np.abs(stepper.joined.end_outputs()).max())
    same = [n for n in result.names if kind_of(n) == kind_of(name)]
    return float(max(np.abs(result.column(n)).max() for n in same))


def kind_of(name: str) -> str:
    return name.partition("[")[0].rpartition(".")[2].partition("_")[0]


@pytest.mark.parametrize(
    ("engine", "called"), [(NativeInstance, False), slow((NativeInstance, True)), slow((PythonInstance, True))]
)
def test_currents_at_ends_of_steps_sum_to_rounding(engine: Any, called: bool) -> None:
    """100 kA, through fault and clearing: one more impulse, in the books like all, leaves units of their rounding (1.5e-11 A)."""
    scene = faulted()
    net: Any = scene.system
    stepper = called_back(Coupled(net, members(net, 2, engine)), called)
    result = run(stepper, Options(stop=2e-3, step=2e-4, events=scene.events))
    assert max(v for n, v in result.worst.items() if n.startswith(CONSTRAINT + "velocity.bus1")) <= 1e-10
    summary = result.ledger.summary()
    assert summary.closed and result.iterations <= 30


@pytest.mark.parametrize("k", [1, 2])
def test_held_values_too(k: int) -> None:
    """The rules of `Newton`, which takes one value a step of members of any order."""
    net: Any = smib().system
    one, two = (s.advance(0.0, 1e-4, 8) for s in both(net, k, lambda _: Newton()))
    assert one.iterations is not None
    assert np.abs(one.iterations - np.array(two.iterations)).max() <= 1  # rounding decides whether one more is needed
    scale = np.abs(two.H).sum()
    assert np.abs(one.H - two.H).max() <= SAME * scale
    assert all(np.abs(getattr(one, b) - getattr(two, b)).max() <= SAME * scale for b in BOOKS)


@pytest.mark.parametrize("stiffness", [1e2, 1e6, 1e10])
def test_stiff_springs_are_accepted_by_the_same_rules(stiffness: float) -> None:
    """Two equal masses whose spring hardly acts: what is left is rounding, and compiled code says so itself."""
    net = Network("twins")
    for name in "ab":
        net.add(name, mass(1.0, k=4 * np.pi**2, q=1.0))
    net.add("s", spring(stiffness))
    net.connect("a.flange", "s.a", name="left")
    net.connect("b.flange", "s.b", name="right")
    stepper = Coupled(net, members(net, 1))
    stepper.check_start()
    steps = stepper.advance(0.0, 0.1, 400)
    assert stepper.master.taken == 400
    H = steps.H.sum(axis=1)
    assert np.abs(H / H[0] - 1).max() <= 1e-12


@pytest.mark.parametrize("k", [1, 2])
def test_steps_start_from_what_the_last_ones_missed(k: int) -> None:
    """A third trial is not needed any more once three steps are known: smib turns by 4.5 degrees a step."""
    net: Any = smib().system
    stepper = Coupled(net, members(net, k))
    stepper.check_start()
    iterations = stepper.advance(0.0, 2.5e-4, 40).iterations
    assert iterations is not None and iterations[5:].mean() <= 2.2 < 3.0 <= iterations[0]


def test_long_steps_take_three_trials() -> None:
    """smib turning by 18 degrees a step, once the polynomial through the last steps is known; and steps after are no worse."""
    net: Any = smib().system
    stepper = Coupled(net, members(net, 1))
    stepper.check_start()
    stepper.advance(0.0, 1e-3, 600)
    iterations = stepper.advance(0.0, 1e-3, 300, 600).iterations
    assert iterations is not None and iterations.max() <= 4 and iterations.mean() <= 3.3


def test_derivatives_are_taken_along_what_is_joined() -> None:
    """Not along impulses at ports elsewhere: of the machine's 5 and the line's 6 ports that take some, 3 are at the bare node."""
    net: Any = smib().system
    stepper = Coupled(net, members(net, 1))
    parts = {p.member.name: p for p in stepper.master.found.parts}
    assert {n: (len(p.inputs), p.kicks, len(p.kicked)) for n, p in parts.items()} == {
        "gen": (3, 5, 3),
        "line": (6, 6, 3),
        "grid": (3, 0, 0),
    }
    assert [p.directions for p in parts.values()] == [9, 12, 3]


@pytest.mark.parametrize("make", [lambda: smib().system, slow(lambda: coupling_bench.star(40))], ids=["smib", "star"])
def test_threads_change_no_bit(make: Callable[[], Any]) -> None:
    """However many step the members, more than there are processors too; their rows, books, trials and tests."""
    found = []
    for threads in (1, 2, 3):
        stepper = apart_bench.coupled(make(), 2, threads=threads)
        stepper.check_start()
        found.append(stepper.advance(0.0, 1e-3, 30))
        made = stepper.master
        assert made.taken == 30 and made.threads == threads
    for other in found[1:]:
        for name in ("signals", "H", "iterations", "accepted_by", *BOOKS):
            assert np.array_equal(getattr(found[0], name), getattr(other, name)), name


def test_threads_are_started_where_they_pay() -> None:
    """Not for trials below 50 us, for few steps, or where one member takes nearly all of the time."""
    us = 1e-6
    assert worth(np.full(40, 5 * us), 1000, 8) == 8 and worth(np.full(3, 50 * us), 1000, 8) == 3
    assert worth(np.full(40, us), 1000, 8) == 1
    assert worth(np.full(40, 5 * us), 4, 8) == 1
    assert worth(np.array([100 * us, us, us]), 1000, 8) == 1
    stepper = Coupled(pulled(), members(pulled(), 1))
    stepper.check_start()
    stepper.advance(0.0, 1e-3, 10)
    assert stepper.master.threads == 1


@pytest.mark.parametrize("k", wide([1, 2], 2))
def test_members_with_steps_of_their_own(k: int) -> None:
    """Three internal steps of the machine, two of the line: rows and books are those of members called back."""
    net: Any = smib().system
    found = []
    for called in (False, True):
        own = members(net, k)
        for m in own:
            m.parts = {"gen": 3, "line": 2}.get(m.name, 1)
        stepper = called_back(Coupled(net, own), called)
        stepper.check_start()
        found.append(stepper.advance(0.0, 1e-3, 8))
    one, two = found
    scale = np.abs(two.H).sum()
    assert np.abs(one.H - two.H).max() <= SAME * scale
    assert all(np.abs(getattr(one, b) - getattr(two, b)).max() <= SAME * scale for b in BOOKS)


def test_blocks_of_any_length_give_the_same_bits() -> None:
    net: Any = smib().system
    found: list[Steps] = []
    for blocks in ((12,), (1, 4, 7)):
        stepper = Coupled(net, members(net, 2))
        stepper.check_start()
        first, parts = 0, []
        for n in blocks:
            parts.append(stepper.advance(0.0, 1e-3, n, first))
            first += n
        found.append(Steps.joined(parts))
    assert np.array_equal(found[0].signals, found[1].signals) and np.array_equal(found[0].pairs, found[1].pairs)


def pulled() -> Network:
    """A mass drawn to a place where there is no force any more: no solution beyond e = 1."""
    e = state("e", unit="m")
    net = Network("pulled")
    net.add("body", mass(1.0))
    end = Port("end", TRANSLATIONAL, "flow", {e: 1.0})
    net.add("pull", PHDAE("pull", (e,), energies=(energy(ca.log(1.0 - e.sx)),), ports=(end,)))
    net.connect("body.flange", "pull.end", name="joint")
    return net


@pytest.mark.parametrize("k", [1, 2])
def test_a_step_that_fails_leaves_members_where_they_were(k: int) -> None:
    """With the error of the member; then a shorter step is taken."""
    texts = []
    for stepper in both(pulled(), k):
        stepper.check_start()
        stepper.advance(0.0, 0.05, 3)
        H, states, last, first = stepper.energies(), stepper.joined.states(), stepper.last, 3
        with pytest.raises(StepFailure) as caught:
            for first in range(3, 100):
                H, states, last = stepper.energies(), stepper.joined.states(), stepper.last
                stepper.advance(0.0, 0.05, 1, first)
        texts.append(f"{caught.value.status} {caught.value.time} {caught.value.h} {caught.value.equation}")
        assert stepper.joined.states() == states and stepper.last is last and np.array_equal(stepper.energies(), H)
        assert len(stepper.advance(first * 0.05, 1e-6, 1).H) == 1
    assert texts[0] == texts[1]


def test_steps_before_one_that_fails_are_kept() -> None:
    """In a run, with the words of the member."""
    found = []
    for stepper in both(pulled(), 2):
        kept: list[Any] = []
        with pytest.raises(StepFailure) as caught:
            run(stepper, Options(stop=5.0, step=0.05, keep=lambda *rows, kept=kept: kept.append(rows)))
        found.append((np.concatenate([t for t, *_ in kept]), np.concatenate([v for _, v, _ in kept]), caught.value))
    (t, a, failed), (t2, b, failed2) = found
    assert 5 < len(t) < 100 and np.array_equal(t, t2)
    assert np.abs(a - b).max() <= 1e-9 * np.abs(b).max()  # the motion is unstable
    assert (failed.time, failed.status, failed.equation) == (failed2.time, failed2.status, failed2.equation)


def test_a_step_that_is_refused_is_taken_in_halves() -> None:
    """The polynomials of the steps before are too far off for so few trials; a quarter of the step is near enough."""
    net: Any = smib().system
    stepper = Coupled(net, members(net, 2), lambda joined: HalvingPolicy(newton(joined)))
    stepper.check_start()
    stepper.advance(0.0, 1e-3, 3)
    stepper.master.rules.iterations = 2
    steps = stepper.advance(0.0, 4e-3, 1, 1)
    assert steps.accepted_by is not None and steps.accepted_by[0] == "halved"
    assert stepper.joined.members[0].instance.time == pytest.approx(8e-3)  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.parametrize("slow_one", [1, 2])
def test_the_faster_number_of_threads_goes_on(slow_one: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where threads could pay, some steps by one and by two tell which; the rows are those of one thread."""
    from phfmu.network.couplings.compiled import threads as pace

    monkeypatch.setattr(pace, "worth", lambda *_: 2)
    monkeypatch.setattr(pace, "processors", lambda: 2)
    runs = []
    for threads in (1, None):
        stepper = apart_bench.coupled(coupling_bench.ring(4), 1, threads=threads)
        stepper.check_start()
        made: Any = stepper.master
        runs.append([stepper.advance(0.0, 1e-3, 60)])
        if threads is None:
            assert set(made.thread_number._taken) == {1, 2}
            made.thread_number._taken = {slow_one: 2.0, 3 - slow_one: 1.0}
        runs[-1].append(stepper.advance(0.0, 1e-3, 40, 60))
        assert made.threads == (3 - slow_one if threads is None else 1)
    for one, chosen in zip(*runs, strict=True):
        for name in ("signals", "H", "iterations", "accepted_by", *BOOKS):
            assert np.array_equal(getattr(one, name), getattr(chosen, name)), name
