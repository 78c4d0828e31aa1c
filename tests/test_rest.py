"""Redundant constraints in motion and momentary loss of rank: the motion, its balance, the forces given, both engines."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import phfmu.discretise.rest as at_rest
from phfmu import Collocated, NativeInstance, PythonInstance, build_model
from phfmu.discretise.model import Model
from phfmu.discretise.rank import Dependence
from tests.mechanisms import bricard, bricard_reference, doubled, frame, hinge

ENGINES = (PythonInstance, NativeInstance)
MECHANISMS = {"frame": frame, "doubled": doubled, "hinge": hinge}


def model(declaration: Any, order: int) -> Model:
    return build_model(declaration, Collocated(order // 2, two_level=True, name="two-level"))


def errors(instance: Any, h: float, steps: int, t: float = 0.0) -> tuple[float, float, float]:
    """Largest |g|, |Dg v| and change of H over a run; no step is halved."""
    before = instance.counts["substeps"]
    rows = instance.run(t, h, steps, ("signals", "energy"))
    checks = instance.model.checks
    values = np.abs(rows["signals"][:, instance.layout["observables"]][:, -len(checks) :])
    position = np.array([c.level == "position" for c in checks])
    assert instance.counts["substeps"] == before
    return values[:, position].max(), values[:, ~position].max(), np.ptp(rows["energy"])


@pytest.mark.parametrize("order", [2, 6])
@pytest.mark.parametrize("name", MECHANISMS)
def test_redundant_bars_and_pins_cost_no_accuracy(name: str, order: int) -> None:
    m = model(MECHANISMS[name](), order)
    g, w, energy = errors(NativeInstance(m), 0.01, 200)
    assert g <= 1e-14 and w <= 1e-13 and energy <= 2e-12
    python, native = PythonInstance(m), NativeInstance(m)
    assert np.abs(python.run(0.0, 0.01, 5, ("x",))["x"] - native.run(0.0, 0.01, 5, ("x",))["x"]).max() <= 1e-13
    for block in ("a", "a_end"):
        assert python.signal(block) == pytest.approx(native.signal(block), rel=1e-10, abs=1e-10)


@pytest.fixture(scope="module")
def closed() -> dict[int, Model]:
    """Bricard's mechanism: of 39 rows one is redundant, but only where the others hold."""
    return {order: model(bricard()[0], order) for order in (2, 6)}


@pytest.mark.parametrize("order", [2, 6])
def test_bricards_mechanism_moves_on_its_manifold(closed: dict[int, Model], order: int) -> None:
    g, w, energy = errors(NativeInstance(closed[order]), 0.01, 400)
    assert g <= 1e-14 and w <= 1e-13 and energy <= 1e-13
    instance = NativeInstance(closed[order])
    instance.run(0.0, 0.02, 50)
    error = np.abs(instance.x[:12] - bricard_reference(1.0)).max()
    assert error <= {2: 1e-3, 6: 1e-10}[order]


@pytest.fixture(scope="module")
def ill_chosen() -> Model:
    """Of Bricard's rows one rests whose share in the dependence passes through zero after 0.9 s."""
    found = at_rest.dependences
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(at_rest, "dependences", lambda j: [Dependence(d.rows, d.rows[1:2]) for d in found(j)])
        return model(bricard()[0], 6)


def test_a_row_that_loses_its_share_is_exchanged(ill_chosen: Model) -> None:
    instance = NativeInstance(ill_chosen)
    g, w, energy = errors(instance, 0.01, 400)
    assert instance.counts["exchanged"] == 1 and instance.counts["woken"] == 0
    assert g <= 1e-14 and w <= 1e-13 and energy <= 1e-13


def test_an_exchange_is_reversible(ill_chosen: Model) -> None:
    instance = NativeInstance(ill_chosen)
    instance.run(0.0, 0.01, 60)
    start = instance.x
    instance.run(0.6, 0.01, 75)
    instance.run(1.35, -0.01, 75)
    assert instance.counts["exchanged"] == 1
    assert np.abs(instance.x - start).max() <= 1e-13


@pytest.mark.parametrize("read", [False, True])
def test_states_saved_before_an_exchange_continue_bit_by_bit(ill_chosen: Model, read: bool) -> None:
    instance, other = NativeInstance(ill_chosen), NativeInstance(ill_chosen)
    instance.run(0.0, 0.01, 80)
    saved = instance.get_state()
    record = ("x", "a", "signals") if read else ("x", "a")
    first = instance.run(0.8, 0.01, 40, record)
    late = instance.get_state()
    for restored in (other, instance):
        restored.set_state(saved)
        again = restored.run(0.8, 0.01, 40, record)
        assert all(np.array_equal(first[name], again[name]) for name in record)
        assert restored.get_state() == late
    assert instance.counts["exchanged"] == 2


def test_engines_exchange_alike(ill_chosen: Model) -> None:
    python, native = PythonInstance(ill_chosen), NativeInstance(ill_chosen)
    native.run(0.0, 0.01, 90)
    python.set_x(native.time, native.x)
    python.initialise()
    native.set_x(native.time, native.x)
    native.initialise()
    rows = [e.run(0.9, 0.01, 6, ("x", "a")) for e in (python, native)]
    assert python.counts["exchanged"] == native.counts["exchanged"] == 1
    assert np.abs(rows[0]["x"] - rows[1]["x"]).max() <= 1e-13
    assert rows[0]["a"] == pytest.approx(rows[1]["a"], rel=1e-9, abs=1e-9)
