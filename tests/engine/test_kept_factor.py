"""Factors kept over steps: fewer of them, the same motion, and restored states that go on bit for bit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from phfmu import TRANSLATIONAL, Collocated, NativeInstance, Port, PythonInstance, build_model
from phfmu.components.mechanical.net import net
from phfmu.components.scenes.electrical.wscc9 import wscc9_steady
from phfmu.engine.build.derived import factor_values

H = 1e-3


@pytest.fixture(scope="module")
def sheet() -> Any:
    d = net(6)
    v = d.states[1]
    push = Port("push", TRANSLATIONAL, "effort", {v: np.eye(v.n)[-1]})
    model = build_model(replace(d, ports=(push,)), Collocated(1))
    assert factor_values(model.step)["keep_most"] > 0
    return model


def steps(instance: Any, first: int, n: int) -> None:
    for i in range(first, first + n):
        instance.do_step(i * H, H)


def test_factors_are_kept_and_the_motion_is_that_of_factors_of_their_own(sheet: Any) -> None:
    one, other = NativeInstance(sheet), PythonInstance(sheet)
    for instance in (one, other):
        steps(instance, 0, 100)
    assert one.counts["factored"] < 50
    np.testing.assert_allclose(one.x, other.x, rtol=0.0, atol=1e-12 * np.abs(other.x).max())


@pytest.mark.parametrize("before", [3, 40])
def test_a_restored_state_goes_on_bit_for_bit(sheet: Any, before: int) -> None:
    """In the instance that saved it, which has another factor by now, and in a new one."""
    instance, new = NativeInstance(sheet), NativeInstance(sheet)
    steps(instance, 0, before)
    kept = instance.get_state()
    rows = []
    steps(instance, before, 30)
    rows.append(instance.row())
    for other in (instance, new):
        other.set_state(kept)
        steps(other, before, 30)
        rows.append(other.row())
    np.testing.assert_array_equal(rows[0], rows[1])
    np.testing.assert_array_equal(rows[0], rows[2])


def test_sensitivities_that_are_read_change_nothing(sheet: Any) -> None:
    read, plain = NativeInstance(sheet), NativeInstance(sheet)
    for i in range(20):
        for instance in (read, plain):
            instance.do_step(i * H, H)
        assert read.sensitivity() != 0.0
    np.testing.assert_array_equal(read.row(), plain.row())


def test_turning_machines_have_factors_of_their_own() -> None:
    instance = NativeInstance(build_model(wscc9_steady().declaration(), Collocated(1)))
    instance.run(0.0, 5e-5, 400, record=())
    assert instance.counts["factored"] >= 390 and instance.counts["iterations"] <= 2.1 * 400
