"""The way back over steps of constrained particles by the factor of the Schur stepper: the bars of the sparse one, those forward,
those of differences of whole runs."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import Any

import numpy as np
import pytest

from phfmu.components.mechanical.chain import chain
from phfmu.components.mechanical.four_particle import four_particle
from phfmu.discretise.model import Model, build_model, default_scheme
from phfmu.engine.native.native import NativeInstance
from phfmu.engine.native.reverse import NativeReverse, NativeTape, RowBars
from phfmu.studies.stress.mechanisms import doubled, frame
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
}  # fmt: skip
CASES = list(product(MODELS, (2, 6)))


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
    way = NativeReverse(model, instance._made, 2, schur)
    way.bars.x[:, : model.step.nx] = np.random.default_rng(3).normal(size=(2, model.step.nx))
    way.back(rows, instance.parameters, np.arange(len(rows), dtype=np.int32), np.ones(len(rows)), NOTHING)
    return way


def agree(one: NativeReverse, other: NativeReverse, part: float = 1e-11) -> None:
    for a, b in zip(one.bars.all, other.bars.all, strict=True):
        assert np.abs(a - b).max(initial=0.0) <= part * np.abs(b).max(initial=0.0)


@pytest.mark.parametrize(("name", "order"), wide(CASES, ("chain", 6), ("stiff springs", 2)))
def test_the_schur_factor_gives_the_bars_of_the_sparse_one(name: str, order: int) -> None:
    """By states, parameters and inputs, in every step."""
    model, h = of_model(name, order)
    instance, rows = taped(model, h)
    one, other = (back(model, instance, rows, schur) for schur in (True, False))
    assert (one.by_schur, other.by_schur) == (2 * len(rows), 0)
    assert max(np.abs(bar).max(initial=0.0) for bar in other.bars.all) > 0.1
    agree(one, other)
