"""The derivative of one step by its length and its start, against differences: what events whose instants move are made of."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from phfmu import NativeInstance, build_model, default_scheme
from phfmu.engine.native.reverse import NativeReverse, NativeTape, RowBars
from tests.derivatives.differences import richardson
from tests.derivatives.test_reverse import CASES, RUNS, declared
from tests.wide import wide

pytestmark = pytest.mark.usefixtures("compiler")

#: what a row tells of a step, in the order of its bars
TOLD = ("x", "a", "y_step", "energy", "dissipated")


def after(instance: Any, state: Any, t: float, x: np.ndarray, h: float, parts: int) -> tuple[np.ndarray, np.ndarray]:
    """[x | a | y_step | energy | dissipated] after a step in equal parts, and its tape; means over the whole step."""
    instance.set_state(state)
    instance.set_x(t, x)
    instance.initialise()
    means = []
    with NativeTape(instance, parts) as tape:
        for i in range(parts):
            instance.step_exactly(t + i * h / parts, h / parts)
            means.append([instance.signal(n).copy() for n in ("a", "y_step")])
    a, y = (np.mean([m[i] for m in means], axis=0) for i in range(2))
    ends = [instance.signal(n).copy() for n in TOLD]
    return np.concatenate([ends[0], a, y, *ends[3:]]), tape.rows.copy()


@pytest.mark.parametrize("parts", [1, 2])
@pytest.mark.parametrize(("name", "order"), wide(RUNS, ("dc_motor", 4), ("smib", 2), ("four_particle", 6)))
def test_a_step_by_its_length_and_start(name: str, order: int, parts: int) -> None:
    d = declared(name)
    model = build_model(d, default_scheme(d, order))
    instance, h, t = NativeInstance(model), CASES[name][2], 0.013
    instance.set_input(np.linspace(1.0, 2.0, model.step.nu))
    for i in range(5):  # away from a start at rest
        instance.do_step(i * h, h)
    x, state, nx = instance.x.copy(), instance.get_state(), model.step.nx
    whole, rows = after(instance, state, t, x, h, parts)
    weights = np.random.default_rng(3).normal(size=len(whole)) / np.maximum(np.abs(whole), 1e-3)
    back = NativeReverse(model, instance._native_model, 1)
    # the row tells sums since the start; before the step they follow from none of this
    told = RowBars(np.array([0], np.int32), weights[None, None])
    of_row, part = np.zeros(parts, np.int32), np.full(parts, 1.0 / parts)
    back.back(rows, instance.parameters, of_row, part, told, moves=True)
    by_length, by_start = float(back.bars.h[0, 0]), float(back.bars.x[0, nx])
    found = [
        richardson(lambda v: np.array([weights @ after(instance, state, t, x, v, parts)[0]]), h, 1e-2 * h),
        richardson(lambda v: np.array([weights @ after(instance, state, v, x, h, parts)[0]]), t, 1e-2 * h),
    ]
    # differences resolve 1e-7 of a derivative: rounding of the sums over the step of the difference
    size = float(np.abs(weights * whole).sum()) / h
    most = 1e-6 if name == "four_particle" else 1e-8
    assert abs(by_length) > 1e-6 * size
    assert abs(by_length - found[0][0]) < most * size
    assert abs(by_start - found[1][0]) < most * size
