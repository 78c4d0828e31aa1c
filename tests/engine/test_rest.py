"""Redundant constraints in motion and momentary loss of rank: the motion and its balance, both engines."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
import pytest

import phfmu.discretise.model as planned
import phfmu.terms.rank as at_rest
from phfmu import NativeInstance, Options, PythonInstance
from phfmu.discretise.model import Model
from phfmu.engine.reference.evaluate import Evaluator
from phfmu.fmu.export.export import export
from phfmu.fmu.importer.reader import FMUInstance
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.runs.loop import run
from phfmu.studies.stress.mechanisms import bricard, bricard_reference, doubled, frame, hinge
from phfmu.terms.rank import Dependence
from tests.engine.mechanisms import windows
from tests.engine.runs_at_rest import errors, model
from tests.wide import wide

MECHANISMS = {"frame": frame, "doubled": doubled, "hinge": hinge}


@pytest.mark.parametrize("order", wide([2, 6], 2))
@pytest.mark.parametrize("name", wide(MECHANISMS, "frame"))
def test_redundant_bars_and_pins_cost_no_accuracy(name: str, order: int) -> None:
    m = model(MECHANISMS[name](), order)
    g, w, energy = errors(NativeInstance(m), 0.01, 200)
    assert g <= 1e-14 and w <= 1e-13 and energy <= 2e-12
    python, native = PythonInstance(m), NativeInstance(m)
    assert np.abs(python.run(0.0, 0.01, 5, ("x",))["x"] - native.run(0.0, 0.01, 5, ("x",))["x"]).max() <= 1e-13
    for block in ("a", "a_end"):
        assert python.signal(block) == pytest.approx(native.signal(block), rel=1e-10, abs=1e-10)


@pytest.mark.parametrize(
    ("name", "order"),
    wide(product(MECHANISMS, (2, 6)), ("frame", 2)),
)
def test_short_steps_cost_no_accuracy(name: str, order: int) -> None:
    """2000 steps.  The chord stops at 1e-15 of the velocities; what that leaves in the energy adds up, some 1e-17 a step."""
    m = model(MECHANISMS[name](), order)
    assert m.step.schur is not None
    g, w, energy = errors(NativeInstance(m), 0.001, 2000)
    assert g <= 1e-14 and w <= 1e-13 and energy <= 2e-11
    g, w, energy = errors(NativeInstance(replace(m, step=replace(m.step, schur=None))), 0.001, 2000)
    assert g <= 1e-14 and w <= 1e-13 and energy <= 2e-12


@pytest.mark.slow
def test_node_rows_at_rest_have_order_4_and_their_mean_holds() -> None:
    """Bricard, order 6: where rows depend on each other on the manifold only, those of the nodes are not implied."""
    m = model(bricard()[0], 6)
    plan, evaluator = m.step, Evaluator(m.step)
    rests = plan.hold.rests
    (rows,) = (list(rows) for rows, r in zip(plan.hold.rows, rests, strict=True) if r)
    evaluator.rests = np.zeros_like(rests)
    nodes = []
    for h in (0.04, 0.02, 0.01):
        instance, missed = NativeInstance(m), []
        for k in range(round(0.4 / h)):
            x = np.append(instance.x, instance.time)
            instance.do_step(k * h, h)
            missed.append(evaluator.residual(x, np.append(instance.unknowns, h), m.p0, h)[rows])
        assert instance.counts["exchanged"] == 0
        assert np.abs(np.array(missed)[:, : plan.k] @ plan.weights).max() <= 1e-14
        assert np.abs(np.array(missed)[:, plan.k]).max() <= 1e-14
        nodes.append(np.abs(missed).max())
    assert np.all(np.abs(np.diff(np.log2(nodes)) + 4.0) <= 0.2)


@pytest.mark.parametrize("order", wide([2, 6], 2))
def test_bricards_mechanism_moves_on_its_manifold(order: int) -> None:
    """Of 39 rows one is redundant, but only where the others hold."""
    m = model(bricard()[0], order)
    g, w, energy = errors(NativeInstance(m), 0.01, 400)
    assert g <= 1e-14 and w <= 1e-13 and energy <= 1e-13
    instance = NativeInstance(m)
    instance.run(0.0, 0.02, 50)
    error = np.abs(instance.x[:12] - bricard_reference(1.0)).max()
    assert error <= {2: 1e-3, 6: 1e-10}[order]


@pytest.fixture(scope="module")
def ill_chosen() -> Model:
    """Of Bricard's rows one rests whose share in the dependence passes through zero after 0.9 s."""
    found = at_rest.dependences
    with pytest.MonkeyPatch.context() as patch:
        # a plan of the same declaration that another test still holds was made without this choice
        patch.setattr(planned, "_PLANNED", {})
        patch.setattr(at_rest, "dependences", lambda *of: [Dependence(d.rows, d.rows[1:2]) for d in found(*of)])
        return model(bricard()[0], 2)


@pytest.mark.slow
@pytest.mark.parametrize("steps", wide([120, 400], 120))
def test_a_row_that_loses_its_share_is_exchanged(ill_chosen: Model, steps: int) -> None:
    instance = NativeInstance(ill_chosen)
    g, w, energy = errors(instance, 0.01, steps)
    assert instance.counts["exchanged"] == 1 and instance.counts["woken"] == 0
    assert g <= 1e-14 and w <= 1e-13 and energy <= 1e-13
    (change,) = instance.rest_changes
    (rested,) = np.array(ill_chosen.hold_names)[ill_chosen.step.hold.rests]
    assert change.needed == rested and 0.9 < change.time < 1.1
    instance.reset()
    assert not instance.rest_changes


@pytest.mark.slow
def test_a_run_tells_when_which_row_rests(ill_chosen: Model) -> None:
    """By multiplier and by the name of the declaration; what a refused trial step changed is not told."""
    instance = NativeInstance(ill_chosen)
    saved = instance.get_state()
    instance.run(0.0, 0.01, 120)
    instance.set_state(saved)
    result = run(Monolithic(ill_chosen, instance), Options(stop=1.2, step=0.01))
    (change,) = instance.rest_changes
    assert change.number == 1 and change.needed is not None and re.fullmatch(r"lambda\[\d+\] \(bar .*\)", change.needed)
    text = f"at t = {change.time:.6g} s {change.rests} rests instead of {change.needed}"
    assert result.notes[-2:] == ("redundant constraints: 1 change; the motion does not depend on which rests", text)
    assert not any(
        "redundant" in n for n in run(Monolithic(ill_chosen, instance), Options(t0=1.2, stop=1.3, step=0.01)).notes
    )


@pytest.mark.slow
def test_an_exchange_is_reversible(ill_chosen: Model) -> None:
    instance = NativeInstance(ill_chosen)
    instance.run(0.0, 0.01, 60)
    start = instance.x
    instance.run(0.6, 0.01, 75)
    instance.run(1.35, -0.01, 75)
    assert instance.counts["exchanged"] == 1
    assert np.abs(instance.x - start).max() <= 1e-13


@pytest.mark.parametrize("read", wide([False, True], True))
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
    assert python.rest_changes == native.rest_changes
    assert np.abs(rows[0]["x"] - rows[1]["x"]).max() <= 1e-13
    assert rows[0]["a"] == pytest.approx(rows[1]["a"], rel=1e-9, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("version", wide(["2.0", "3.0"], "3.0"))
def test_units_exchange_like_the_native_engine(ill_chosen: Model, tmp_path: Path, version: str) -> None:
    """Saved before the exchange and restored, the same bits follow."""
    native = NativeInstance(ill_chosen)
    native.run(0.0, 0.01, 110)
    for path in export(ill_chosen, tmp_path, (version,), step=0.01):
        with FMUInstance(path) as unit:
            for n in range(80):
                unit.do_step(0.01 * n, 0.01)
            saved, ends = unit.get_state(), []
            for _ in range(2):
                unit.set_state(saved)
                for n in range(80, 110):
                    unit.do_step(0.01 * n, 0.01)
                ends.append(np.array([unit.values()[f"q[{i + 1}]"] for i in range(39)]))
        assert np.array_equal(ends[0], ends[1])
        assert np.abs(ends[0] - native.x[:39]).max() <= 1e-13


# -- momentary loss of rank --------------------------------------------------------------------------------------


STEPS = (0.0005, 0.001, 0.002, 0.0025, 0.004, 0.005, 0.00625, 0.008, 0.01, 0.0125, 0.016)


@cache
def cranks(order: int, schur: bool) -> NativeInstance:
    """With the Schur stepper or without."""
    m = model(windows(2), order)
    return NativeInstance(m if schur else replace(m, step=replace(m.step, schur=None)))


@pytest.mark.parametrize("h", wide(STEPS, 0.016))
@pytest.mark.parametrize("schur", [True, False])
@pytest.mark.parametrize("order", wide([2, 6], 2))
def test_parallel_cranks_pass_flat_positions_without_halving(order: int, schur: bool, h: float) -> None:
    """20 s, twice a turn flat; the cranks follow one another.  The Schur stepper stops at its own tolerance."""
    instance = cranks(order, schur)
    instance.reset()
    g, w, energy = errors(instance, h, round(20.0 / h))
    q = instance.x[:6].reshape(3, 2) - [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]
    assert np.abs(q - q[0]).max() <= 1e-6
    if schur:
        assert g <= 1e-12 and w <= 2e-11 and energy <= 1e-10
    else:
        assert g <= 1e-14 and w <= 1e-13 and energy <= 1e-12


@pytest.mark.parametrize("order", wide([2, 6], 2))
def test_rows_come_back_where_the_rank_rises(order: int) -> None:
    """A start flat, where two of five rows are redundant for an instant; one crank is pulled, so all bars work."""
    m = model(windows(2, np.pi / 2, pull=50.0), order)
    assert np.sum(m.step.hold.rests) == 2
    native, python = NativeInstance(m), PythonInstance(m)
    g, w, energy = errors(native, 0.002, 500)
    assert native.counts["woken"] == 2
    assert g <= 1e-14 and w <= 1e-13 and energy <= 2e-12
    native.reset()
    x = [e.run(0.0, 0.002, 5, ("x",))["x"] for e in (native, python)]
    assert python.counts["woken"] == 2 and np.abs(x[0] - x[1]).max() <= 1e-12
    assert python.rest_changes == native.rest_changes
    assert [str(c) for c in native.rest_changes] == [
        f"at t = 0.002 s {name} is needed again" for name, r in zip(m.hold_names, m.step.hold.rests, strict=True) if r
    ]
