"""Runs side by side: to the last bit those of each run by itself, whatever happens to one of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from phfmu import PHDAE, Collocated, Event, NativeInstance, Options, Scene, block, energy, grid, parameter, skew, state
from phfmu.components.library import build
from phfmu.schemes.named import named_scheme
from phfmu.sweeps import lanes, native_runs
from phfmu.sweeps.lanes import LANES
from phfmu.sweeps.native_runs import NativeRuns
from phfmu.sweeps.outcome import RunOutcomes
from phfmu.sweeps.recipe import Recipe
from phfmu.sweeps.runs import sweep
from phfmu.sweeps.task import ModelTask
from tests.wide import wide


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Side by side from the first step on, and with any number of nodes."""
    monkeypatch.setattr(native_runs, "PAYS", 0)
    monkeypatch.setattr(lanes, "EARNS", 0)
    monkeypatch.setattr(lanes, "NODES", 3)


def growing() -> PHDAE:
    """x' = a x^2 from 1: without bound at t = 1/a, and steps close to it have to be halved."""
    x, a = state("x", start=1.0), parameter("a", 0.1)
    return PHDAE(
        "grows", (x,), parameters=(a,), energies=(energy(0.5 * x.sx**2),), dissipation=(block((x,), -a.sx * x.sx),)
    )


def sprung() -> PHDAE:
    """A mass on a spring that is hard where k is large, with a damper: Newton's method takes more iterations for some."""
    q, p, k = state("q", start=0.3), state("p", start=1.0), parameter("k", 1.0)
    return PHDAE(
        "sprung", (q, p), parameters=(k,), energies=(energy(2.0 * q.sx**2 + k.sx * q.sx**4), energy(0.25 * p.sx**2)),
        structure=(skew(q, p, 1.0),), dissipation=(block((p,), 0.3),),
    )  # fmt: skip


@dataclass(frozen=True)
class Both:
    """Runs side by side, and each by itself."""

    together: RunOutcomes
    alone: RunOutcomes
    steps: int

    @property
    def inside(self) -> float:
        """Part of the steps that was taken with others."""
        return self.together.inside / self.steps

    def require_same(self) -> None:
        a, b = self.together, self.alone
        assert a.errors == b.errors and b.inside == 0
        for name in ("values", "steps", "ledger"):
            assert getattr(a, name).tobytes() == getattr(b, name).tobytes(), name


def task(target: PHDAE | Scene, name: str, measures: tuple[str, ...], order: int, options: Options | None) -> ModelTask:
    d = target.declaration() if isinstance(target, Scene) else target
    return Recipe(target, (name,), measures, options, named_scheme(d, order=order), "native").task()


def both(of: ModelTask, values: np.ndarray) -> Both:
    rows = np.ascontiguousarray(values, float)[:, None]
    alone, together = NativeRuns(of, lanes=False).take(rows), NativeRuns(of).take(rows)
    return Both(together, alone, int(alone.steps.sum()))


ORDERS = (2, 4, 6)
#: scene -> what varies, what is measured, s
SCENES = {
    "oscillator": ("mass1.k", ("max(mass1.q)", "rms(mass*.v)", "last(energy.stored)"), 0.5),
    "two_machine": ("line.R", ("peak(line.flux[1])", "mean(energy.stored)", "tmax(line.flux[2])"), 0.02),
    "dc_motor": ("R", ("last(flux)", "mean(shaft.speed_step)"), 0.05),
}


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("name", wide(SCENES, "oscillator"))
def test_runs_side_by_side_are_those_of_each_by_itself(name: str, order: int, compiler: None) -> None:
    """Also a number of runs that is no multiple of the lanes; nearly all steps but the first are taken together."""
    varied, measures, stop = SCENES[name]
    found = build(name)
    d = found.declaration() if isinstance(found, Scene) else found
    step = found.step if isinstance(found, Scene) else 1e-3
    start = next(p.start[0] for p in d.parameters if varied in p.names())
    of = task(found, varied, measures, order, Options(stop=stop, step=step))
    result = both(of, start * np.linspace(0.9, 1.2, 2 * LANES + 3))
    result.require_same()
    assert result.inside > 0.9


@pytest.mark.parametrize("order", ORDERS)
def test_newton_takes_its_own_iterations_in_each_run(order: int, compiler: None) -> None:
    """Springs of 1e-2 to 1e3: matrices are kept in some runs where others take new ones, and some end sooner."""
    of = task(sprung(), "k", ("last(q)", "last(p)", "min(energy.stored)"), order, Options(stop=5.0, step=0.05))
    result = both(of, np.logspace(-2, 3, LANES + 5))
    result.require_same()
    assert result.inside > 0.9


@pytest.mark.parametrize(("order", "near"), [(2, 0.49), (4, 0.499), (6, 0.499)])
def test_steps_that_are_halved_and_runs_that_end_with_an_error(order: int, near: float, compiler: None) -> None:
    """x' = a x^2 up to t = 2: with a < 1/2 it is reached, and where a is little less by halved steps; else never."""
    of = task(growing(), "a", ("last(x)", "max(energy.stored)"), order, Options(stop=2.0, step=0.1))
    values = np.array([0.1, near, 0.2, 0.9, 0.3, near, 0.05, 0.4, 0.44, 0.6, near])
    one = NativeInstance(of.model)
    one.set_parameters([near])
    one.run(0.0, 0.1, 20)
    assert one.counts["substeps"] > 0
    result = both(of, values)
    result.require_same()
    assert [bool(e) for e in result.together.errors] == (values > 0.5).tolist()
    assert 0.5 < result.inside < 0.99


def test_events_change_parameters_and_inputs_of_all(compiler: None) -> None:
    """A stiffness that is doubled, which is energy brought in, and steps of another length up to an event off the grid."""
    scene = Scene("struck", sprung(), 3.0, 0.05, (Event(1.0, "k", 2.0), Event(2.013, "k", 1.0)))
    of = Recipe(scene, ("p",), ("last(q)", "max(energy.stored)"), None, Collocated(1), "native").task()
    result = both(of, np.linspace(0.5, 1.5, LANES))
    result.require_same()
    assert result.inside > 0.8


#: models of constrained particles and bodies -> what varies, by which factors, step in s, least part of steps inside
CONSTRAINED = {
    "four_particle": ("k13", (0.9, 1.2), 0.01, 0.98),
    "chain": ("m[1]", (0.8, 1.3), 0.01, 0.98),
    "pendulum": ("m[1]", (0.8, 1.3), 0.01, 0.98),
    "slider_crank": ("m[1]", (0.9, 1.1), 1e-3, 0.98),
    "four_bar": ("m[1]", (0.8, 1.3), 0.01, 0.5),  # close to where it can fold, rows are nearly dependent
    "heavy_top": ("m[1]", (0.9, 1.1), 0.01, 0.9),  # light degrees of freedom
    "rope_bridge": ("m[1]", (0.9, 1.1), 1e-3, 0.98),  # beyond the size up to which loops of one run are written out
}
WIDE = wide(CONSTRAINED, "four_particle", "chain", "pendulum", "four_bar")


def constrained(name: str, order: int, steps: int, runs: int) -> Both:
    varied, (low, high), h, _ = CONSTRAINED[name]
    d = build(name)
    start = next(v for p in d.parameters for n, v in zip(p.names(), p.start, strict=True) if n == varied)
    measures = (f"max({d.states[0].names()[0]})", "rms(v)", "last(energy.stored)")
    of = task(d, varied, measures, order, Options(stop=steps * h, step=h))
    return both(of, start * np.linspace(low, high, runs))


@pytest.mark.parametrize("order", (2, 6))
@pytest.mark.parametrize("name", WIDE)
def test_the_schur_stepper_side_by_side_is_that_of_each_run(name: str, order: int, compiler: None) -> None:
    """Sweeps end sooner in some runs than in others; a number of runs of which some are stepped alone, too few for vectors."""
    result = constrained(name, order, 100, 2 * LANES)
    result.require_same()
    assert not any(result.together.errors)
    assert result.inside > CONSTRAINED[name][-1]
    rest = constrained(name, order, 30, LANES + LANES // 2)
    rest.require_same()
    assert 0.4 < rest.inside < 0.7


@pytest.mark.parametrize("order", (2, 6))
def test_springs_that_are_stiff_in_some_runs(order: int, compiler: None) -> None:
    """Stresses of stiff springs are unknowns of their own: in all runs, or in four of eight, and too few are alike then."""
    of = task(build("four_particle"), "k13", ("max(v[1])", "last(energy.stored)"), order, Options(stop=1.0, step=0.02))
    for low, high in ((50.0, 60.0), (5e6, 5e7), (50.0, 5e7)):
        result = both(of, np.geomspace(low, high, LANES))
        result.require_same()
        if high < 1e6 < low or high < 100.0:
            assert result.inside > 0.9
    if order == 6:  # at order 2 the other spring is stiff enough for all
        assert result.inside < 0.5


@pytest.mark.parametrize("order", (2, 6))
def test_one_run_of_particles_ends_with_an_error_and_the_others_go_on(order: int, compiler: None) -> None:
    """Dampers that give energy without bound in two runs: longer sweeps, halved steps, and none at last."""
    of = task(build("four_particle"), "eta0", ("max(v[1])", "last(energy.stored)"), order, Options(stop=3.0, step=0.01))
    values = np.array([0.1, 0.2, -20.0, 0.3, 0.4, 0.5, -10.0, 0.7])
    result = both(of, values)
    result.require_same()
    assert [bool(e) for e in result.together.errors] == (values < 0.0).tolist()
    assert result.inside > 0.95


def test_steps_that_are_not_solved_side_by_side(compiler: None) -> None:
    """Long steps of a chain whose last mass is far from the others: sweeps do not contract in some runs."""
    of = task(build("chain"), "m[10]", ("max(v[2])",), 2, Options(stop=2.0, step=0.05))
    result = both(of, np.geomspace(1e-2, 1e2, 2 * LANES))
    result.require_same()
    assert 0.3 < result.inside < 0.9


def test_constraints_that_newtons_method_has_are_stepped_run_by_run(compiler: None) -> None:
    of = task(build("andrews"), "m[1]", ("max(v[1])",), 2, Options(stop=1e-3, step=1e-5))
    result = both(of, 0.043 * np.linspace(0.9, 1.1, LANES))
    result.require_same()
    assert result.inside == 0.0
    assert result.together.alone == "Newton's method with 27 constraints that may come to rest"


def test_a_sweep_says_why_steps_are_taken_run_by_run(compiler: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lanes, "NODES", 1)
    runs, options = grid({"k13": np.linspace(40.0, 60.0, LANES)}), Options(stop=0.1, step=0.01)
    notes = list[str]()
    for measure, order in (("max(v[1])", 6), ("max(lambda_end[1])", 2)):
        d = build("four_particle")
        scheme = named_scheme(d, order=order)
        sweep(d, runs, [measure], options=options, scheme=scheme, jobs=1, told=notes.append)
    assert notes == [
        "steps are taken run by run: the Schur stepper of 3 nodes fills the vectors of the processor with one run",
        "steps are taken run by run: a measure of values at an instant is solved for in each step of a run",
    ]


def test_a_sweep_tells_what_was_taken_side_by_side_and_can_do_without(compiler: None) -> None:
    runs, options = grid({"k": np.linspace(1.0, 2.0, 3 * LANES + 1)}), Options(stop=1.0, step=0.05)
    notes, none = list[str](), list[str]()
    tables = [
        sweep(sprung(), runs, ["last(q)"], options=options, jobs=2, told=notes.append),
        sweep(sprung(), runs, ["last(q)"], options=options, jobs=1, lanes=False, told=none.append),
    ]
    assert tables[0].equals(tables[1])
    assert not none and notes == [
        f"{(3 * LANES + 1) * 19} of {(3 * LANES + 1) * 20} steps side by side, {LANES} runs at a time"
    ]
