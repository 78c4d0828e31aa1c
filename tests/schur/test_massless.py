"""Directions without mass in the Schur stepper: rows of their own, and the same solution as the sparse Newton."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from phfmu.components.mechanical.mechanisms import bricard
from phfmu.discretise.model import build_model, default_scheme
from phfmu.engine.native.native import NativeInstance
from phfmu.schur.elimination import FactorPattern

#: sides of the rods: thin ones have directors without mass, the others some of 1e-7 of the largest mass
SECTIONS = (0.0, 1e-3)


def both(section: float, order: int) -> tuple[Any, NativeInstance, NativeInstance]:
    """The model of Bricard's linkage, and instances of it with and without the Schur stepper."""
    declaration = bricard(section=section)
    model = build_model(declaration, default_scheme(declaration, order))
    return model, NativeInstance(model), NativeInstance(replace(model, step=replace(model.step, schur=None)))


@pytest.mark.parametrize("section", SECTIONS)
@pytest.mark.parametrize("order", [2, 6])
def test_light_directions_keep_the_schur_stepper_and_its_solution(section: float, order: int) -> None:
    """Equations that are missed by rounding leave states equal to rounding, multipliers to rounding over h."""
    model, fast, newton = both(section, order)
    assert len(model.step.schur.light) == 30  # two directors of five rods
    for k in range(40):
        fast.do_step(0.02 * k, 0.02)
        newton.do_step(0.02 * k, 0.02)
        assert np.abs(fast.unknowns - newton.unknowns).max() <= 1e-9
        assert fast.row() == pytest.approx(newton.row(), abs=1e-9)
    assert fast.counts["schur"] == fast.counts["solves"] == 40
    assert fast.counts["sweeps"] <= 9 * 40
    assert newton.counts["schur"] == 0
    assert np.abs(fast.x - newton.x).max() <= 1e-12


def test_back_and_forth_over_light_directions_leads_to_the_start() -> None:
    """The scheme is symmetric, so is what the sweeps converge to."""
    _, instance, _ = both(0.0, 6)
    start = instance.x.copy()
    for k in range(30):
        instance.do_step(0.02 * k, 0.02)
    for k in range(30, 0, -1):
        instance.do_step(0.02 * k, -0.02)
    assert instance.counts["schur"] == 60
    assert np.abs(instance.x - start).max() <= 1e-12


def test_rows_of_light_directions_come_behind_those_that_they_share_an_entry_with() -> None:
    """Their diagonal is zero until then."""
    rows = [[(d, 2 * r + i, 1.0) for i, d in enumerate((r, r + 1))] for r in range(8)]
    light = [1, 4, 7]
    order = list(FactorPattern(rows, light, 16).order)
    assert sorted(order) == list(range(11))
    for i, d in enumerate(light):
        assert all(order.index(8 + i) > order.index(r) for r in (d - 1, d))
