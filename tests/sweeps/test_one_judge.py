"""A sweep takes the steps of a run and judges them as a run does: one rule, which judge.h of the runtime holds."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import phfmu as ph
from phfmu import PHDAE, Monolithic, NativeInstance, Options, Scene, block, energy, run, sweep
from phfmu.audit.judge import DEFAULT_RTOL, DEVIATIONS, HEADER, PARTS, REACH_ULPS, ULPS
from phfmu.components.library import GRIDS, LIBRARY, build
from phfmu.sweeps.design import Design
from phfmu.sweeps.general_runs import GeneralRuns, of_model
from phfmu.sweeps.native_runs import NativeRuns, fits
from phfmu.sweeps.recipe import Recipe
from phfmu.sweeps.task import ModelTask

pytestmark = pytest.mark.usefixtures("compiler")
STEPS = 200
#: that a sweep takes in compiled code: no state events, no switches, not too large
SWEPT = [name for name in LIBRARY if name not in GRIDS]


def tasks(target: Scene | PHDAE, names: tuple[str, ...], step: float) -> ModelTask:
    """Measured are states: stored energies are sums of their changes in a sweep."""
    d = target.declaration() if isinstance(target, Scene) else target
    measured = tuple(f"last({n})" for v in d.states for n in v.names())
    return Recipe(target, names, measured, Options(stop=STEPS * step, step=step), None, "native").task()


def by_both(task: ModelTask, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The shares of what is allowed: of the compiled loop, and of the run loop."""
    assert fits(task)
    return NativeRuns(task).take(rows).ledger, GeneralRuns(task, of_model(task, NativeInstance)).take(rows).ledger


def swept_and_run(name: str) -> None:
    found = build(name)
    d = found.declaration() if isinstance(found, Scene) else found
    first = next((v for v in (*d.parameters, *d.states) if v.n), None)
    if first is None or d.state_events or d.switches or not d.energies:
        pytest.skip("no state, or events that are landed on")
    task = tasks(found, (first.names()[0],), found.step if isinstance(found, Scene) else 1e-3)
    if not fits(task):
        pytest.skip("its events change what of H is constant, or it restarts")
    start = first.start[0] or 1e-3
    swept, share = NativeRuns(task), []
    for row in np.array([[start], [1.001 * start]]):
        one, other = swept.take(row[None]), GeneralRuns(task, of_model(task, NativeInstance)).take(row[None])
        assert one.errors == other.errors
        assert (one.steps == other.steps).all() and np.array_equal(one.values, other.values, equal_nan=True)
        assert one.ledger == pytest.approx(other.ledger, rel=1e-12, abs=0.0)
        share.append(float(one.ledger[0]))
    if not first.start[0]:
        return
    plain = run(Monolithic(task.model, NativeInstance(task.model)), task.options).ledger.summary()
    assert share[0] == pytest.approx(plain.share, rel=1e-12, abs=0.0)
    assert (share[0] <= 1.0) == plain.closed


TELLING = ("four_particle", "drive", "ladder")


@pytest.mark.parametrize("name", TELLING)
def test_the_share_of_what_is_allowed_is_that_of_the_run(name: str) -> None:
    """To the digits that rounding leaves of a quotient: both take the same steps, to the bit."""
    swept_and_run(name)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in SWEPT if name not in TELLING])
def test_all_of_the_library_is_swept_with_the_numbers_of_its_runs(name: str) -> None:
    swept_and_run(name)


def wrong(skew: float, loss: float = 0.0) -> PHDAE:
    """An oscillator whose J makes energy, or that dissipates less than nothing, beside a constant in H."""
    x, y, c = ph.state("x", start=1.0), ph.state("y"), ph.parameter("c", 0.0)
    J = ca.SX([[skew, 1.0], [-1.0, 0.0]])
    H = energy(x.sx**2 / 2 + y.sx**2 / 2 + c.sx)
    R = (block([x], ca.SX(-loss)),) if loss else ()
    return PHDAE("wrong", states=(x, y), parameters=(c,), energies=(H,), structure=(block([x, y], J),), dissipation=R)


@pytest.mark.parametrize(("skew", "loss"), [(1e-4, 0.0), (0.0, 1e-3), (1e-9, 0.0)])
def test_energy_that_is_made_is_told_by_both_with_one_number(skew: float, loss: float) -> None:
    swept, ran = by_both(tasks(wrong(skew, loss), ("c",), 1e-3), np.array([[0.0], [1e4], [1e12]]))
    assert (ran > 1.0).all()
    assert swept == pytest.approx(ran, rel=1e-9)


def test_what_only_the_sum_over_the_run_shows_is_told_by_both() -> None:
    """1e12 J in a state that holds them hide what a step makes, not what 40000 steps do."""
    d = wrong(1e-4)
    w = ph.state("w", start=1e6)
    d = replace(
        d, states=(*d.states, w), energies=(replace(d.energies[0], expr=5e3 * d.energies[0].expr), energy(w.sx**2))
    )
    options = Options(stop=40.0, step=1e-3)
    task = Recipe(d, ("c",), ("last(energy.stored)",), options, None, "native").task()
    swept, ran = by_both(task, np.zeros((1, 1)))
    assert ran[0] > 1.0
    assert swept == pytest.approx(ran, rel=1e-3)


def test_the_table_tells_the_larger_of_both() -> None:
    found = sweep(wrong(1e-4), Design(("c",), np.array([[0.0]])), ["last(x)"], options=Options(stop=1.0, step=0.01))
    assert found["ledger"][0].as_py() > 1.0


def test_the_constants_of_the_rule_stand_in_one_header() -> None:
    assert (DEFAULT_RTOL, REACH_ULPS, ULPS, PARTS, DEVIATIONS) == (1e-11, 1024.0, 64.0, 4.0, 4.0)
    assert all(
        f"PH_{name} {value:g}\n" in HEADER.read_text()
        for name, value in (
            ("RTOL", DEFAULT_RTOL),
            ("REACH_ULPS", REACH_ULPS),
            ("ULPS", ULPS),
            ("PARTS", PARTS),
            ("DEVIATIONS", DEVIATIONS),
        )
    )
