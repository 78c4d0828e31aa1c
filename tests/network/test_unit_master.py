"""Units of this package in the compiled master: rows and books of the same units called back, refusals, crashes, events."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from phfmu import (
    StepFailure,
)
from phfmu.components.mechanical.contacts import bumper
from phfmu.components.scenes.drive import drive
from phfmu.components.scenes.electrical.smib import smib
from phfmu.components.scenes.electrical.two_machine import two_machine
from phfmu.components.scenes.mechanical.oscillator import oscillator
from phfmu.components.scenes.mechanical.speed_control import speed_control
from phfmu.components.scenes.mechanical.stops import buffer
from phfmu.network.members.fmu_member import FMUMember
from phfmu.outcome.steps import Steps
from phfmu.signals import CONSTRAINT
from tests.network.both_loops import SAME, called_back
from tests.network.test_master import BOOKS, pulled
from tests.network.unit_members import MIXED
from tests.wide import slow

pytestmark = pytest.mark.usefixtures("compiler")


SCENES = {oscillator: 1e-2, drive: 1e-3, smib: 1e-3, two_machine: 2e-4, speed_control: 1e-3}
QUICK = ((oscillator, MIXED, 1), (smib, MIXED, 2))
CASES = [
    pytest.param(make, kinds, k, marks=() if (make, kinds, k) in QUICK else pytest.mark.slow)
    for make in SCENES
    for kinds in ("fmi2", "fmi3", MIXED)
    for k in (1, 2, 3)
]


@pytest.mark.parametrize(("make", "kinds", "k"), CASES)
def test_rows_and_books_are_those_of_units_called_back(made: Any, make: Any, kinds: str, k: int) -> None:
    """To rounding: the factors of the interface matrix are sparse ones, and trials start from the same continuations."""
    net, h = make().system, SCENES[make]
    one, two = (called_back(made(net, kinds, k, h), called) for called in (False, True))
    steps = []
    for stepper in (one, two):
        stepper.check_start()
        stepper.prepare(0.0, h)
        steps.append(stepper.advance(0.0, h, 12))
    assert not one.master.calls and two.master.calls
    a, b = steps
    scale = np.abs(b.H).sum(axis=1).max()
    assert np.abs(a.H - b.H).max() <= SAME * scale
    assert all(np.abs(getattr(a, n) - getattr(b, n)).max() <= SAME * scale for n in (*BOOKS, "numerical", "moved"))
    assert np.abs(a.signals - b.signals).max() <= SAME * max(np.abs(b.signals).max(), scale)
    assert sum(a.iterations) <= sum(b.iterations) + 3
    now = [m.unit for s in (one, two) for m in s.joined.members if isinstance(m, FMUMember)]
    assert {u.time for u in now} == {12 * h} and np.abs(one.read() - two.read()).max() <= SAME * max(
        np.abs(two.read()).max(), scale
    )
    c, d = (s.advance(0.0, h, 3, 12) for s in (one, two))
    assert np.abs(c.H - d.H).max() <= SAME * scale


@pytest.mark.parametrize(
    ("make", "port", "k"), [(smib, "terminal", 2), (oscillator, "flange", 2), slow((oscillator, "flange", 1))]
)
def test_ports_that_count_outward_and_arrays(made: Any, make: Any, port: str, k: int) -> None:
    """Currents of the machine, given forces of the mass: energies are those of units that count inward, bit for bit."""
    found = []
    for written in ({}, {"arrays": True, "outward": [port]}):
        stepper = made(make().system, "fmi3 native native", k, SCENES[make], written=written)
        stepper.check_start()
        stepper.prepare(0.0, SCENES[make])
        found.append(stepper.advance(0.0, SCENES[make], 6))
        values = stepper.joined.members[0].unit._values
        assert stepper.master.taken == 6 and np.append(values.input_sign, values.output_sign).min() == (
            -1 if written else 1
        )
        assert any(v.size for v in values.interface.variables.values()) is (bool(written) and make is smib)
    assert all(np.array_equal(getattr(found[0], n), getattr(found[1], n)) for n in ("H", "iterations", *BOOKS))


@pytest.mark.parametrize("kinds", ["fmi2", "fmi3"])
def test_a_step_that_fails_leaves_units_where_they_were(made: Any, kinds: str) -> None:
    """With the words of the unit; then a shorter step is taken."""
    texts = []
    for called in (False, True):
        stepper = called_back(made(pulled(), kinds, 1, 0.05), called)
        stepper.check_start()
        stepper.advance(0.0, 0.05, 3)
        H, first = stepper.energies(), 3
        with pytest.raises(StepFailure) as caught:
            for first in range(3, 100):
                H, values = stepper.energies(), stepper.read()
                stepper.advance(0.0, 0.05, 1, first)
        said, _, rest = str(caught.value).partition(
            "answers"
        )  # how often the unit has halved depends on what it tried before
        texts.append((said, rest.rpartition("Next:")[2]))
        assert np.array_equal(stepper.energies(), H) and np.array_equal(stepper.read(), values)
        assert all(m.unit.time == pytest.approx(first * 0.05) for m in stepper.joined.members)
        assert len(stepper.advance(first * 0.05, 1e-6, 1).H) == 1
    assert texts[0] == texts[1]


@pytest.mark.parametrize("kinds", [slow("fmi2"), "fmi3", slow(MIXED)])
def test_threads_and_blocks_change_no_bit(made: Any, kinds: str) -> None:
    found = []
    for blocks, threads in (((12,), 1), ((1, 4, 7), 1), ((12,), 2)):
        stepper = made(oscillator().system, kinds, 2, 1e-2, threads=threads)
        stepper.check_start()
        first, rows = 0, []
        for n in blocks:
            rows.append(stepper.advance(0.0, 1e-2, n, first).signals)
            first += n
        assert stepper.master.taken == 12 and stepper.master.threads == threads
        found.append(np.concatenate(rows))
    assert np.array_equal(found[0], found[1]) and np.array_equal(found[0], found[2])


def test_units_in_processes_of_their_own_are_called_back(made: Any) -> None:
    """With the rows of the same units in this process."""
    rows = []
    for isolate in (60.0, None):
        stepper = made(oscillator().system, MIXED, 1, 1e-2, isolate=isolate)
        stepper.check_start()
        rows.append(stepper.advance(0.0, 1e-2, 2))
        assert stepper.master.calls == bool(isolate)
    assert np.abs(rows[0].H - rows[1].H).max() <= SAME * np.abs(rows[1].H).sum()


# -- events ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kinds", "h"), [("fmi3", 0.01), slow(("fmi2", 0.01)), slow((MIXED.replace("native", "fmi2"), 0.02))]
)
def test_steps_with_state_events_in_a_unit_are_told(made: Any, kinds: str, h: float) -> None:
    """A body that bounces on its bumper: what has an impact has no derivative, and tells what happened."""
    found, steps = [], round(0.5 / h)
    for called in (False, True):
        stepper = called_back(made(buffer().system, kinds, 1, h), called)
        stepper.check_start()
        stepper.prepare(0.0, h)
        parts = [stepper.advance(0.0, h, 1, i) for i in range(steps // 2)]
        parts.append(stepper.advance(0.0, h, steps - steps // 2, steps // 2))
        found.append(Steps.joined(parts))
    one, two = found
    assert np.abs(one.H - two.H).max() <= 1e-9 * np.abs(two.H).max()  # impacts make rounding grow
    (a, b) = ([e for e in s.events or ()] for s in found)
    assert 2 <= len(a) == len(b)


def test_events_of_a_unit_that_nothing_is_joined_to_are_told(made: Any) -> None:
    """Its steps need no derivative, which would be refused: what it books of events is looked at after each of them."""
    net: Any = oscillator().system
    net.add("ball", bumper(1.0, gap=0.055, v=-1.0))
    stepper = made(net, "native native native fmi3", 1, 1e-2)
    stepper.check_start()
    stepper.prepare(0.0, 1e-2)
    steps = stepper.advance(0.0, 1e-2, 10)
    assert [k for k, _ in steps.events] == [5]
    (_, told), *_ = steps.events
    assert told.lost.sum() == pytest.approx(0.75 * 0.5, rel=1e-12)


@pytest.mark.slow
def test_currents_of_units_at_ends_of_steps_sum_to_rounding(made: Any) -> None:
    """One more impulse, for which a unit takes the step again: 1.5e-11 A of 100 kA, without it 5e-10 A."""
    stepper = made(two_machine().system, "fmi3", 2, 2e-4)
    stepper.check_start()
    stepper.prepare(0.0, 2e-4)
    steps = stepper.advance(0.0, 2e-4, 20)
    sums = [i for i, n in enumerate(stepper.names) if n.startswith(CONSTRAINT + "velocity.bus1")]
    assert stepper.master.taken == 20 and np.abs(steps.signals[:, sums]).max() <= 1e-10
