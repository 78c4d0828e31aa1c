"""The way back over steps of constrained particles by the factor of the Schur stepper: the bars of the sparse one, those forward,
those of differences of whole runs."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import Any

import numpy as np
import pytest

from phfmu import Event, Options, gradient
from phfmu.components.mechanical.chain import chain
from phfmu.components.mechanical.four_particle import four_particle
from phfmu.components.mechanical.mechanisms import bricard
from phfmu.discretise.model import Model, build_model, default_scheme
from phfmu.engine.native.native import NativeInstance
from phfmu.engine.native.reverse import NativeReverse, NativeTape, RowBars
from phfmu.studies.stress.mechanisms import doubled, frame
from tests.derivatives.test_reverse import differ, differences, known
from tests.schur.test_schur import charges, pushed, tangle
from tests.wide import wide

pytestmark = pytest.mark.usefixtures("compiler")

NOTHING = RowBars(np.zeros(0, np.int32), np.zeros((0, 2, 1)))
STEPS = 24


def braced(n: int) -> Any:
    return chain(n, damping=0.5, bending=1.0, port=True)


#: declaration, step
MODELS: dict[str, tuple[Callable[[], Any], float]] = {
    "four_particle": (four_particle, 1e-2),
    "stiff springs": (lambda: four_particle().with_starts({"k24": 1e6}), 1e-2),
    "long steps": (four_particle, 5e-2),
    "chain": (lambda: braced(6), 1e-2),
    "springs of given length": (lambda: pushed().build(), 1e-2),
    "charges": (lambda: charges(True).build(), 1e-2),
    "tangle": (lambda: tangle(11).build(), 5e-3),
    "redundant rows": (frame, 1e-2),
    "redundant bars": (doubled, 1e-2),
    "directions without mass": (lambda: bricard(section=0.0), 2e-2),
}  # fmt: skip
CASES = [case for case in product(MODELS, (2, 6)) if case != ("directions without mass", 6)]


def of_model(name: str, order: int) -> tuple[Model, float]:
    declared, h = MODELS[name]
    d = declared()
    return build_model(d, default_scheme(d, order)), h


def taped(model: Model, h: float, n: int = STEPS) -> tuple[NativeInstance, np.ndarray]:
    """Steps with inputs that change."""
    instance = NativeInstance(model, kernels="compiled")
    tape = NativeTape(instance, 4 * n)
    with tape:
        for i in range(n):
            instance.set_input(np.sin(0.3 * i + np.arange(model.step.nu)))
            instance.do_step(i * h, h)
    return instance, tape.rows.copy()


def back(model: Model, instance: NativeInstance, rows: np.ndarray, schur: bool = True) -> NativeReverse:
    """Two measures of the last states at once."""
    way = NativeReverse(model, instance._native_model, 2, schur)
    way.bars.x[:, : model.step.nx] = np.random.default_rng(3).normal(size=(2, model.step.nx))
    way.back(rows, instance.parameters, np.arange(len(rows), dtype=np.int32), np.ones(len(rows)), NOTHING)
    return way


def agree(one: NativeReverse, other: NativeReverse, part: float = 1e-11) -> None:
    for a, b in zip(one.bars.all, other.bars.all, strict=True):
        assert np.abs(a - b).max(initial=0.0) <= part * np.abs(b).max(initial=0.0)


@pytest.mark.parametrize(("name", "order"), wide(CASES, ("four_particle", 6), ("stiff springs", 6)))
def test_the_schur_factor_gives_the_bars_of_the_sparse_one(name: str, order: int) -> None:
    """By states, parameters and inputs, in every step."""
    model, h = of_model(name, order)
    instance, rows = taped(model, h)
    one, other = (back(model, instance, rows, schur) for schur in (True, False))
    assert (one.by_schur, other.by_schur) == (2 * len(rows), 0)
    assert max(np.abs(bar).max(initial=0.0) for bar in other.bars.all) > 0.1
    agree(one, other)


@pytest.mark.slow
@pytest.mark.parametrize("order", [2, 6])
def test_where_it_does_not_converge_the_sparse_one_takes_turns(order: int) -> None:
    """Links that turn far in a step."""
    d = braced(6)
    model = build_model(d, default_scheme(d, order))
    instance, rows = taped(model, 0.15)
    one, other = (back(model, instance, rows, schur) for schur in (True, False))
    assert 0 < one.by_schur < 2 * len(rows)
    agree(one, other)


#: what is read of rows, of ends of steps, and of sums over the run
MEASURES = [
    "last(energy.dissipated)", "last(tip.energy)", "max(lambda[1])", "rms(tip.velocity_step[3])", "mean(energy.stored)",
    "q[6]@0.1333",
]  # fmt: skip


@pytest.mark.parametrize("order", wide([2, 6]))
def test_measures_of_a_chain_backwards_are_those_forward(order: int) -> None:
    """By all parameters, starts and forces at the tip."""
    d = braced(4)
    model = build_model(d, default_scheme(d, order))
    options = Options(stop=0.2, step=1e-2, events=(Event(0.0, "tip.force[3]", 2.0), Event(0.1, "tip.force[3]", -1.0)))
    by = [*known(d), "tip.force[1]"]
    forward, reverse = (
        gradient(model, NativeInstance(model), options, MEASURES, by, mode=m) for m in ("forward", "reverse")
    )
    sizes = np.array([abs(known(d).get(n, 1.0)) or 1.0 for n in by])
    assert differ(forward.slopes, reverse.slopes, sizes) < 1e-11


@pytest.mark.slow
@pytest.mark.parametrize("order", [2, 6])
def test_a_chain_backwards_is_what_differences_of_runs_say(order: int) -> None:
    """With a force at the tip: without it hardly anything moves along z, and its differences are Newton's acceptance."""
    d, by = braced(4), ["m[2]", "damping"]
    model = build_model(d, default_scheme(d, order))
    options = Options(stop=0.2, step=1e-2, events=(Event(0.0, "tip.force[3]", 2.0),))
    found = gradient(model, NativeInstance(model), options, MEASURES, by, mode="reverse")
    sizes = np.array([abs(known(d)[n]) or 1.0 for n in by])
    assert differ(found.slopes, differences(d, order, options, MEASURES, by, 1e-3), sizes) < 1e-7
