"""Communication steps with state events in them are told as one step: against landed steps one by one."""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np
import pytest

from phfmu import (
    PHDAE,
    TRANSLATIONAL,
    Collocated,
    Guard,
    Jump,
    NativeInstance,
    Port,
    StateEvent,
    StepFailure,
    build_model,
    damping,
    energy,
    skew,
    state,
)
from phfmu.outcome.status import EventRefused, Status

M, K, D, R, FORCE, H = 1.3, 7.0, 0.4, 0.15, 0.3, 0.25


def wall(most: float = np.inf, e: float = 0.8) -> PHDAE:
    """A driven, damped oscillator that hits a wall at q = 0."""
    q, p = state("q", unit="m", start=0.7), state("p", unit="kg.m/s", start=0.3)
    return PHDAE(
        "wall",
        states=(q, p),
        energies=(energy(p**2 / (2 * M)), energy(K / 2 * (q + D) ** 2)),
        structure=(skew(q, p, 1.0),),
        dissipation=(damping(p, R),),
        ports=(Port("push", TRANSLATIONAL, "flow", {p: 1.0}),),
        state_events=(StateEvent(Guard("wall", q, -1, unit="m"), jump=Jump({p: 1.0}, e, most=most)),),
    )


@pytest.fixture(scope="module")
def models() -> dict[int, Any]:
    return {k: build_model(wall(), Collocated(k)) for k in (1, 2)}


def pushed(model: Any, force: float = FORCE) -> Any:
    instance = NativeInstance(model)
    instance.set_input([force])
    return instance


@pytest.mark.parametrize("k", [1, 2])
def test_a_step_with_events_is_the_sum_of_its_landed_parts(models: dict[int, Any], k: int) -> None:
    """The same bits of states, and of what the parts told: energies add, means are weighted by length."""
    whole, parts = pushed(models[k]), pushed(models[k])
    seen, n = 0, 16
    for i in range(n):
        H0 = float(whole.signal("H").sum())
        whole.do_step(i * H, H)
        pieces = list(parts.land(i * H, H, 1, ("stored", "dissipated", "supplied", "pairs", "y_step")))
        rows = {
            name: np.concatenate([p.rows[name] for p in pieces if p.rows])
            for name in ("stored", "dissipated", "supplied", "pairs", "y_step")
        }
        lengths = np.concatenate([p.h for p in pieces])
        events = [p.happened for p in pieces if p.happened is not None]
        np.testing.assert_array_equal(whole.x, parts.x)
        assert whole.time == (i + 1) * H
        told = whole.ledger()
        for name in ("stored", "dissipated", "supplied", "pairs"):
            np.testing.assert_allclose(told[name], rows[name].sum(axis=0), rtol=1e-14)
        np.testing.assert_allclose(whole.output(), lengths @ rows["y_step"] / H, rtol=1e-13)
        assert H * FORCE * whole.output()[0] == pytest.approx(told["supplied"][0], rel=1e-13)
        assert [(e.t, e.events) for e in whole.happened] == [(e.t, e.events) for e in events]
        jumped = sum(float(e.energy.sum()) for e in whole.happened)
        change = float(whole.signal("H").sum()) - H0
        assert change == pytest.approx(float(told["stored"].sum()) + jumped, abs=1e-14)
        seen += len(events)
    assert seen >= 3


def test_run_lands_and_its_rows_are_those_of_its_steps(models: dict[int, Any]) -> None:
    """Its inputs, a row each step."""
    a, b = NativeInstance(models[2]), NativeInstance(models[2])
    inputs = np.linspace(-0.3, 0.3, 12)[:, None]
    rows = a.run(0.0, H, 12, ("x", "stored", "y_step", "energy", "signals", "counts"), inputs=inputs)
    found = []
    for i in range(12):
        b.set_input(inputs[i])
        b.do_step(i * H, H)
        found += b.happened
        np.testing.assert_array_equal(rows["x"][i], b.x)
        np.testing.assert_array_equal(rows["stored"][i], b.ledger()["stored"])
        np.testing.assert_array_equal(rows["energy"][i], b.signal("H"))
        np.testing.assert_array_equal(rows["signals"][i], np.concatenate(list(b.signals().values())))
    assert [e.t for e in a.happened] == [e.t for e in found] and len(found) > 1


def test_a_state_saved_before_an_event_gives_the_same_bits_after_it(models: dict[int, Any]) -> None:
    instance = pushed(models[2])
    while not instance.happened:
        before, t = instance.get_state(), instance.time
        instance.do_step(t, H)
    after = instance.signals()
    instance.do_step(instance.time, H)
    instance.set_state(before)
    instance.do_step(t, H)
    for name, values in instance.signals().items():
        np.testing.assert_array_equal(values, after[name])


def test_the_sensitivity_of_a_step_with_an_event_is_refused_and_without_one_is_right(models: dict[int, Any]) -> None:
    instance = pushed(models[1])
    seen = set()
    for i in range(12):
        before = instance.get_state()
        instance.do_step(i * H, H)
        happened = bool(instance.happened)
        seen.add(happened)
        if happened:
            with pytest.raises(StepFailure) as failure:
                instance.sensitivity()
            assert failure.value.status is Status.NO_SENSITIVITY
            continue
        S, ends = instance.sensitivity()[0, 0], []
        for force in (FORCE - 0.5, FORCE + 0.5):  # linear between events
            instance.set_state(before)
            instance.set_input([force])
            instance.do_step(i * H, H)
            ends.append(None if instance.happened else instance.output()[0])
        if None not in ends:
            assert S == pytest.approx(ends[1] - ends[0], rel=1e-9)
        instance.set_state(before)
        instance.set_input([FORCE])
        instance.do_step(i * H, H)
    assert seen == {False, True}


def test_a_refused_event_leaves_the_instance_where_the_step_began() -> None:
    """The first impact is faster than `most`."""
    instance = pushed(build_model(wall(most=0.1), Collocated(1)))
    with pytest.raises(EventRefused, match="'wall' would jump with"):
        for i in range(20):
            before = instance.signals()
            instance.do_step(i * H, H, 2)
    for name, values in instance.signals().items():
        if name != "residual":
            np.testing.assert_allclose(values, before[name], rtol=1e-14, atol=1e-15)


def test_steps_back_in_time_inputs_at_nodes_and_impulses_are_refused(models: dict[int, Any]) -> None:
    instance = pushed(models[2])
    instance.do_step(0.0, H)
    with pytest.raises(StepFailure, match="argument"):
        instance.do_step(H, -H)
    with pytest.raises(ValueError, match="impulses"):
        instance.set_impulses([0.0], [0.0])
    instance.set_node_inputs([[0.1], [0.2]])
    with pytest.raises(StepFailure, match="argument"):
        instance.do_step(H, H)


def test_internal_steps_and_slivers(models: dict[int, Any]) -> None:
    """Two internal steps are two steps; what rounding leaves of a clock is none."""
    two, one = pushed(models[2]), pushed(models[2])
    for i in range(8):
        two.do_step(i * H, H, 2)
        found = []
        for j in range(2):
            one.do_step(i * H + j * H / 2, H / 2)
            found += one.happened
        np.testing.assert_array_equal(two.x, one.x)
        assert [e.t for e in two.happened] == [e.t for e in found]
    x = two.x
    two.do_step(8 * H, 1e-16)
    np.testing.assert_array_equal(two.x, x)
    two.do_step(8 * H, 0.0)
    np.testing.assert_array_equal(two.x, x)
    assert sqrt(K / M) * 8 * H > 2  # several half periods
