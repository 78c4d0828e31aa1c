"""Reactances and time constants of a machine from a short circuit with noise, which Kundur's equations made."""

from __future__ import annotations

import numpy as np
import pytest

from phfmu import NativeInstance, Options, build_model, run
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.studies.bench.fits import (
    EVERY,
    LOADED,
    MEASURED,
    NOISE,
    SHORT,
    STEP,
    STOP,
    UNLOADED,
    ShortCircuitFits,
    integrated,
    machine,
    pairs,
)

pytestmark = [pytest.mark.usefixtures("compiler"), pytest.mark.slow]


def test_eight_values_come_back_within_three_errors() -> None:
    fits = ShortCircuitFits(LOADED)
    for seed in range(2):
        fitted = fits.exact(seed)
        assert max(map(abs, fitted.off.values())) <= 3.0, fitted.off
        assert fitted.found.residual == pytest.approx(NOISE, rel=0.04) and fitted.found.undetermined == ()
        assert pairs(fitted.found) == [] and fitted.found.misfit == {}


def test_without_load_one_pair_stays_together() -> None:
    """The q axis sees rated frequency alone, where xq/Tq20 counts: neither of both comes back, their quotient does."""
    found = ShortCircuitFits(UNLOADED).exact(0).found
    (pair,) = pairs(found)
    assert set(pair[:2]) == {"xq", "Tq20"} and pair[2] > 0.99
    assert found.errors["Tq20"] > 0.3 * found.values["Tq20"] and found.errors["xq2"] < 0.01 * found.values["xq2"]


def test_measurements_are_those_of_the_machine_to_the_order_of_its_steps() -> None:
    """Half the step, a quarter of the difference."""
    model, rows, off = build_model(machine(LOADED)), integrated(LOADED)[1], []
    for h in (STEP, STEP / 2):
        stepper = Monolithic(model, NativeInstance(model))
        for name, value in SHORT.items():
            stepper.set_value(name, value)
        result = run(stepper, Options(stop=STOP, step=h))
        own = np.column_stack([result.column(m) for m in MEASURED])[:: round(EVERY / h)]
        off.append(float(np.max(np.abs(own - rows) / np.abs(rows).max(axis=0))))
    assert off[0] < 2e-3 and off[0] / off[1] == pytest.approx(4.0, rel=0.1)
