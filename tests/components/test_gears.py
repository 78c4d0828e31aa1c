"""Gears, belts and racks beside the one equation of their reduced inertia; the car axis beside its published solution."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mechanism_reference import CAR_AXIS

from phfmu import (
    FMUInstance,
    Monolithic,
    NativeInstance,
    Options,
    PythonInstance,
    build_model,
    check,
    default_scheme,
    export,
    run,
)
from phfmu.components.mechanical.mechanisms import box_on_floor, car_axis, gear_train, rope_bridge
from phfmu.components.mechanical.multibody import Mechanism
from phfmu.network.couplings.unit import FMUStepper
from tests.wide import longer, wide

G = 9.81


def ran(declaration: Any, order: int, step: float, stop: float, engine: Any = NativeInstance) -> Any:
    model = build_model(declaration, default_scheme(declaration, order))
    return run(Monolithic(model, engine(model)), Options(stop=stop, step=step))


def wheels(planar: bool) -> Mechanism:
    """A motor, a wheel twice as large that turns against it, and a rack."""
    m = Mechanism("wheels", planar=planar, gravity=(0.0,) * (2 if planar else 3))
    one, two = (m.body(n, 1.0, j if planar else (j / 2, j / 2, j)) for n, j in (("one", 0.02), ("two", 0.1)))
    rack = m.body("rack", 1.5, 0.01 if planar else (0.01,) * 3)
    a = m.joint("revolute", "a", None, one, motor=True, damping=0.01)
    b = m.joint("revolute", "b", None, two, at_a=(0.3, 0.0) if planar else (0.3, 0.0, 0.0))
    c = m.joint("prismatic", "c", None, rack, axis=(1, 0) if planar else (1, 0, 0), damping=0.4)
    m.gear("mesh", a, b, -0.5)
    m.gear("pinion", b, c, 0.2)
    assert m.mobility().freedom == 1 and not m.mobility().redundant
    m.assemble(speeds={"a": 3.0})
    return m


@pytest.mark.parametrize("planar", wide([True, False], True))
@pytest.mark.parametrize("order, step, most", [(2, 2e-3, 0.01), (6, 0.01, 1e-7)])
def test_wheels_and_rack_turn_as_one(planar: bool, order: int, step: float, most: float) -> None:
    inertia, friction, torque = 0.02 + 0.25 * 0.1 + 0.01 * 1.5, 0.01 + 0.01 * 0.4, 1.5
    found = ran(wheels(planar).build().with_starts({"a.torque": torque}), order, step, 1.0)
    exact = torque / friction + (3.0 - torque / friction) * np.exp(-friction / inertia * found.time)
    speed = found.column("a.rate")
    assert np.abs(speed - exact).max() <= most
    assert np.abs(found.column("b.rate") + 0.5 * speed).max() <= 1e-12
    assert np.abs(found.column("c.rate") + 0.1 * speed).max() <= 1e-12
    rise = (torque - friction * exact[-1]) / inertia  # of the first wheel
    assert found.column("pinion.force")[-1] == pytest.approx(1.5 * -0.1 * rise - 0.4 * 0.1 * exact[-1], abs=300 * most)
    assert found.ledger.summary().closed
    assert found.ledger.summary().ports[0].supplied == pytest.approx(
        0.5 * inertia * (speed[-1] ** 2 - 9.0) + friction * np.trapezoid(exact**2, found.time), rel=1e-3
    )


@pytest.mark.parametrize("engine", wide([NativeInstance, PythonInstance], PythonInstance))
def test_the_gear_train_lifts_its_load(engine: Any) -> None:
    found = ran(gear_train(), 6, 1e-3, 0.5, engine)
    inertia = 2e-5 + 1e-3 / 9 + 2e-4 * 4 / 9 + 2.0 * 0.02**2
    push = 0.2 - 2.0 * G * 0.02 * np.sin(0.3)
    exact = push / 1e-4 * (1.0 - np.exp(-1e-4 / inertia * found.time))
    assert np.abs(found.column("motor.rate") - exact).max() <= 1e-8
    assert np.abs(found.column("lift.rate") - 0.02 * exact).max() <= 1e-9


def test_what_is_no_gear_is_refused() -> None:
    m = wheels(True)
    a, b, c = m.joints
    for made, words in (
        (lambda: m.gear("x", a, a, 2.0), "between two joints"),
        (lambda: m.gear("x", a, b, 0.0), "finite and not zero"),
        (lambda: m.gear("mesh", a, c, 1.0), "two parts called 'mesh'"),
        (lambda: m.gear("x", a, wheels(True).joints[1], 1.0), "joint 'b' is no joint of wheels"),
        (lambda: m.assemble(speeds={"a": 1.0, "b": 1.0}), "do not suit each other: (gear 'mesh'|joint '[ab]') misses"),
    ):
        with pytest.raises(ValueError, match=words):
            made()
    m.bodies[0].angular_velocity[2] = 5.0
    with pytest.raises(ValueError, match="velocities at the start open gear 'mesh' at 1"):
        m.build()


@pytest.mark.parametrize("order, step, most", [(2, 1e-3, 4e-4), (6, 2.5e-3, 1e-10)])
def test_car_axis_beside_the_published_solution(order: int, step: float, most: float) -> None:
    declaration = car_axis()
    assert not check(declaration)
    found = ran(declaration, order, step, 3.0)
    ends = [found.column(name)[-1] for name in ("left[1]", "left[2]", "right[1]", "right[2]")]
    assert np.abs(np.subtract(ends, CAR_AXIS)).max() <= most
    total = found.ledger.summary()
    assert total.closed and abs(total.network.unexplained) <= 1e-15


def test_a_rope_bridge_swings_and_its_ropes_keep_their_length() -> None:
    """2 (n + 1) segments in a row of n bodies; 40 planks are planned within seconds."""
    found = ran(rope_bridge(4), 6, 5e-3, 5.0)
    total = found.ledger.summary()
    assert total.closed and total.network.unexplained == pytest.approx(0.0, abs=1e-10)
    ends = np.array([[found.column(f"plank{i}.position[{k}]") for k in (1, 2, 3)] for i in (1, 2)])
    across = np.array([[found.column(f"plank{i}.direction[{k}]") for k in (1, 2, 3)] for i in (1, 2)])
    gaps = ends[1] + 0.5 * across[1] - ends[0] - 0.5 * across[0]
    lengths = np.sqrt((gaps**2).sum(axis=0))
    assert np.abs(lengths - lengths[0]).max() <= 1e-10 and np.ptp(ends[0][1]) > 0.1
    build_model(rope_bridge(40), default_scheme(rope_bridge(40), 6))


SHORT = [(gear_train, 1e-3, 0.5), (car_axis, 2e-3, 1.0), (rope_bridge, 5e-3, 0.5), (box_on_floor, 2e-3, 1.0)]
LONG = [(gear_train, 1e-3, 5.0), (car_axis, 1e-3, 30.0), (rope_bridge, 5e-3, 50.0), (box_on_floor, 2e-3, 30.0)]


@pytest.mark.parametrize(
    ("version", "order"), longer([(v, k) for v in ("2.0", "3.0") for k in (2, 6)], ("2.0", 2), ("3.0", 6))
)
@pytest.mark.parametrize(("made", "step", "stop"), SHORT)
def test_units_of_mechanisms_are_their_runs(
    made: Any, step: float, stop: float, version: str, order: int, tmp_path: Any
) -> None:
    declaration = made()
    model = build_model(declaration, default_scheme(declaration, order))
    (path,) = export(model, tmp_path, (version,), step=step)
    unit = run(FMUStepper(FMUInstance(path)), Options(stop=stop, step=step))
    own = run(Monolithic(model, NativeInstance(model)), Options(stop=stop, step=step))
    names = [n for n in own.names if n in unit.names and n[:2] in ("q[", "v[", "en")]
    assert len(names) > 4 and unit.ledger.summary().closed
    most = 1e-11 if declaration.state_events else 0.0  # the clock of a host rounds the rest of a step after an event
    for name in names:  # a run has rows at events too
        assert own.column(name)[-1] == pytest.approx(unit.column(name)[-1], rel=most, abs=most), name


@pytest.mark.slow
@pytest.mark.parametrize(("made", "step", "stop"), LONG)
@pytest.mark.parametrize("order", [2, 6])
def test_mechanisms_run_ten_times_as_long(made: Any, step: float, stop: float, order: int) -> None:
    assert ran(made(), order, step, stop).ledger.summary().closed


def test_impulses_pass_the_counters_of_a_gear() -> None:
    """Which have no mass: wheels of 0.1 kg.m2 that turn at -2 are one of 0.5, thrown back as one; or by ends that give way."""
    from phfmu.components.mechanical.multibody import Compliance, Limits, Mechanism

    def geared(**ends: Any) -> Mechanism:
        m = Mechanism("geared", planar=True)
        a, b = m.body("a", 1.0, 0.1), m.body("b", 1.0, 0.1, position=(1.0, 0.0))
        j = m.joint("revolute", "j", None, a, at=(0.0, 0.0), **ends)
        m.gear("w", j, m.joint("revolute", "k", None, b, at=(1.0, 0.0)), -2.0)
        m.assemble(speeds={"j": 2.0})
        return m

    hard = ran(geared(limits=(-1.0, 0.5), restitution=0.5).build(), 6, 1e-2, 0.6)
    assert hard.ledger.summary().closed and hard.ledger.summary().events["state"] == 1
    assert hard.column("j.rate")[-1] == pytest.approx(-1.0, abs=1e-12)
    assert hard.column("k.rate")[-1] == pytest.approx(2.0, abs=1e-12)
    assert np.ptp(hard.column("energy.stored")) == pytest.approx(0.5 * 0.5 * (4.0 - 1.0), abs=1e-12)
    result = ran(geared(limits=Limits(-1.0, 0.5, compliance=Compliance(1e3))).build(), 6, 1e-3, 0.6)
    assert result.ledger.summary().closed
    assert result.column("j.rate")[-1] == pytest.approx(-2.0, abs=1e-3)
    assert result.column("k.rate")[-1] == pytest.approx(4.0, abs=2e-3)
