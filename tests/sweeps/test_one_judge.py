"""A sweep judges as a run does: one rule, which runtime/judge.h of the audit holds."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import phfmu as ph
from phfmu import PHDAE, NativeInstance, Options, Scene, block, energy, sweep
from phfmu.audit.judge import FLOOR, HEADER, PARTS, RUN, ULPS
from phfmu.components.library import build
from phfmu.sweeps.design import Design
from phfmu.sweeps.general_runs import GeneralRuns
from phfmu.sweeps.native_runs import NativeRuns, fits
from phfmu.sweeps.recipe import Recipe
from phfmu.sweeps.task import Task
from tests.wide import wide

pytestmark = pytest.mark.usefixtures("compiler")
SCENES = ("oscillator", "drive", "speed_control", "smib", "smib_hydro", "smib_folded", "ladder", "two_machine")
COMPONENTS = ("four_particle", "mass_spring", "chain", "net", "heavy_top")
STEPS = 200


def tasks(target: Scene | PHDAE, names: tuple[str, ...], step: float) -> Task:
    options = Options(stop=STEPS * step, step=step)
    return Recipe(target, names, ("max(energy.stored)",), options, None, "native").task()


def by_both(task: Task, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The shares of what is allowed: of the compiled loop, and of the run loop."""
    assert fits(task)
    return NativeRuns(task).take(rows).ledger, GeneralRuns(task, NativeInstance).take(rows).ledger


@pytest.mark.parametrize("name", wide((*SCENES, *COMPONENTS), "four_particle", "drive"))
def test_the_share_of_what_is_allowed_is_that_of_the_run(name: str) -> None:
    found = build(name)
    d = found.declaration() if isinstance(found, Scene) else found
    v = next(v for v in (*d.parameters, *d.states) if v.start[0])
    scene = replace(found, events=()) if isinstance(found, Scene) else found
    task = tasks(scene, (v.names()[0],), found.step if isinstance(found, Scene) else 1e-3)
    swept, ran = by_both(task, v.start[0] * np.array([[1.0], [1.001]]))
    assert (ran < 1.0).all()
    # residuals are rounding, and between steps only the run loop solves for values of the present time
    assert ((swept <= 2.0 * ran) & (ran <= 2.0 * swept)).all(), (swept, ran)


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
    assert swept == pytest.approx(ran, rel=1e-3)


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
    assert (FLOOR, ULPS, PARTS, RUN) == (1024.0, 64.0, 4.0, 4.0)
    assert all(
        f"PH_{name} {value:g}\n" in HEADER.read_text()
        for name, value in (("FLOOR", FLOOR), ("ULPS", ULPS), ("PARTS", PARTS), ("RUN", RUN))
    )
