"""Derivatives of runs through state events: against differences of whole runs, a closed form, forward against backwards."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import phfmu as ph
from phfmu import Event, Guard, NativeInstance, Options, StateEvent, build_model, default_scheme, gradient, run
from phfmu.components.library import build
from phfmu.derivatives.taped import TapedSteps
from phfmu.engine.switched import stepped
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.outcome.status import NoDerivative
from tests.derivatives.test_reverse import declared, differ, differences, known
from tests.wide import wide

pytestmark = pytest.mark.usefixtures("compiler")

#: target, measures, what it is derived by, stop, step, events.  Differences begin at the orders that the schemes have.
CASES: dict[str, tuple[list[str], list[str], float, float, tuple[Event, ...]]] = {
    # three impacts, restitution and start among what moves them
    "bouncing_ball": (
        ["last(q)", "q@1.234", "integral(p^2)", "mean(energy.stored)"], ["m", "g", "e", "q", "p"], 2.0, 0.02, (),
    ),
    # impacts that pile up, rest, release; a spring that presses the body on its contact
    "buffer": (
        ["last(body.q)", "integral(body.q^2)", "mean(body.v)"], ["body.m", "body.e", "spring.k"], 2.0, 0.01,
        (Event(1.0, "spring.a.velocity", 0.1),),
    ),
    "two_point_control": (["last(energy.stored)", "integral(energy.stored)"], ["rotor.J", "relay.upper"], 2.0, 0.02, ()),
    # three poles that open at their current zeros, with jumps of what is left
    "breaker_opening": (
        ["last(energy.stored)", "rms(energy.stored)", "last(energy.dissipated)"],
        ["grid.amplitude", "grid.omega", "grid.phase", "line.R", "line.L", "load.R", "load.C"], 0.04, 2.5e-4,
        (Event(0.0204, "line.command", 0.0),),
    ),
    # an exciter that goes to the limit of its field voltage, and leaves it
    "sexs": (
        ["last(Efd)", "integral(Efd^2)", "Efd_pu@0.155"], ["K", "TA", "TE", "EMAX", "Vref"], 1.0, 0.01,
        (Event(0.1, "V", 0.5), Event(0.5, "V", 1.1)),
    ),
    # ideal switches: an impact that two bodies go on from together, until they part
    "hard_stop": (
        ["last(energy.stored)", "integral(energy.stored)", "last(other.v)"], ["wagon.m", "spring.k", "other.m", "stop.gap"],
        0.5, 0.01, (),
    ),
    # diodes that commutate, both of a pair conducting
    "rectifier": (["last(energy.stored)", "integral(energy.stored)"], ["grid.L", "load.R", "load.L"], 0.03, 2.5e-4, ()),
    # a switch that is closed and opened at given times, with the loss of its slip
    "clutch_engagement": (
        ["last(energy.stored)", "integral(energy.stored)"], ["driver.J", "driver.d", "load.J"], 0.5, 5e-3,
        (Event(0.1, "clutch.engaged", 1.0), Event(0.3, "clutch.engaged", 0.0)),
    ),
}  # fmt: skip
RUNS = [(name, order) for name in CASES for order in (2, 4, 6)]


def instance_of(model: Any) -> Any:
    return stepped(model, NativeInstance)


def of_case(name: str, order: int) -> tuple[Any, Any, Options]:
    _, _, stop, h, events = CASES[name]
    d = declared(name)
    return d, build_model(d, default_scheme(d, order)), Options(stop=stop, step=h, events=events)


def happened(model: Any, options: Options) -> int:
    found = list[float]()
    run(Monolithic(model, instance_of(model)), replace(options, happened=lambda t, _: found.append(t)))
    return len(found)


@pytest.mark.parametrize(
    ("name", "order"), wide(RUNS, ("bouncing_ball", 2), ("buffer", 4), ("breaker_opening", 6), ("hard_stop", 4))
)
def test_events_are_differences_of_runs(name: str, order: int) -> None:
    """Forward and backwards, by what moves instants and jumps.  Differences of 1e-4 hold the sequence of events and the grid
    steps that they fall into; Newton's acceptance and their rounding leave 1e-8 of the largest derivative."""
    measures, by = CASES[name][:2]
    d, model, options = of_case(name, order)
    assert happened(model, options) >= 2
    forward, back = (gradient(model, instance_of(model), options, measures, by, mode=m) for m in ("forward", "reverse"))
    sizes = np.array([abs(known(d)[n]) or 1.0 for n in by])
    np.testing.assert_array_equal(forward.values, back.values)
    assert differ(forward.slopes, back.slopes, sizes) < 1e-11
    assert differ(back.slopes, differences(d, order, options, measures, by, 1e-4), sizes) < 1e-7


@pytest.mark.parametrize(
    ("name", "order"), wide([n for n in RUNS if n[0] != "two_point_control"], ("buffer", 2), ("rectifier", 2))
)
def test_all_parameters_forward_and_backwards(name: str, order: int) -> None:
    """By every parameter that no event sets, and every start."""
    d, model, options = of_case(name, order)
    sides = {s.mode_name for s in d.switches}
    by = [n for n in known(d) if n not in {*d.modes, *sides}]
    forward, back = (
        gradient(model, instance_of(model), options, CASES[name][0], by, mode=m) for m in ("forward", "reverse")
    )
    sizes = np.array([abs(known(d)[n]) or 1.0 for n in by])
    assert np.isfinite(back.slopes).all() and np.abs(back.slopes).max() > 0
    assert differ(forward.slopes, back.slopes, sizes) < 1e-11


@pytest.mark.parametrize("order", [2, 4, 6])
@pytest.mark.parametrize("mode", ["forward", "reverse"])
def test_a_ball_has_its_closed_form(order: int, mode: str) -> None:
    """After the first impact at T = sqrt(2 q/g) with v = g T: q(t) = e v (t - T) - g (t - T)^2/2, of any order."""
    d = build("bouncing_ball").declaration()
    model = build_model(d, default_scheme(d, order))
    q, g, e, t = 1.0, 9.81, 0.8, 0.9
    T, v = np.sqrt(2 * q / g), np.sqrt(2 * q * g)
    s = t - T
    by_T = -e * v + g * s
    exact = [e * np.sqrt(g / (2 * q)) * s + by_T * T / (2 * q), e * T / 2 * s - s**2 / 2 - by_T * T / (2 * g), v * s]
    found = gradient(model, instance_of(model), Options(stop=t, step=0.02), ["last(q)"], ["q", "g", "e"], mode=mode)
    # an instant that is landed on is rounded to 2 eps of its time, and so is what follows from it
    np.testing.assert_allclose(found.slopes[0], exact, rtol=1e-13)


@pytest.mark.slow
def test_a_box_on_a_floor() -> None:
    """Corners with restitution and a skin that gives way, on a rigid body of redundant coordinates."""
    d = build("box_on_floor")
    by = ["corner1.restitution", "corner1.stiffness"]
    model, options = build_model(d), Options(stop=0.3, step=0.01)
    measures = ["last(energy.stored)", "integral(energy.stored)"]
    assert happened(model, options) >= 1
    found = gradient(model, instance_of(model), options, measures, by, mode="reverse")
    sizes = np.array([abs(known(d)[n]) for n in by])
    # the Schur sweep accepts at 1e-9
    assert differ(found.slopes, differences(d, 2, options, measures, by, 1e-5), sizes) < 1e-7


@pytest.mark.parametrize("name", ["buffer", "hard_stop"])
def test_little_memory_runs_again(name: str) -> None:
    _, model, options = of_case(name, 2)
    measured, by = {"buffer": ("body.q", ["body.e", "spring.k"]), "hard_stop": ("other.v", ["wagon.m", "stop.gap"])}[
        name
    ]
    found = []
    for memory in (10**9, 1):
        taped = TapedSteps(model, instance_of(model), by, memory)
        result = run(taped, replace(options, events=(*options.events, Event(0.2, "spring.a.velocity", 0.0))))
        weights = {measured: np.linspace(0.0, 1.0, len(result.time))}
        found.append(taped.slopes([weights]))
        assert (taped.again > 0) == (memory == 1)
    np.testing.assert_array_equal(*found)


def test_rows_at_events_tell_how_their_times_move() -> None:
    """d(time)/d(q) of a ball is T/(2 q) at the first impact, 0 at rows of the grid."""
    from phfmu.derivatives.sensitive import SensitiveSteps

    d = build("bouncing_ball").declaration()
    model = build_model(d)
    found = run(SensitiveSteps(model, instance_of(model), ["q"], ["q"]), Options(stop=0.5, step=0.02))
    T, moved = np.sqrt(2.0 / 9.81), found.column("d(time)/d(q)")
    at = np.abs(found.time - T) < 1e-9
    assert at.sum() == 2  # before and after it
    np.testing.assert_allclose(moved[at], T / 2.0, rtol=1e-13)
    assert not moved[~at].any()


# -- what has none --------------------------------------------------------------------------------------------------------


def together(other: float) -> Any:
    """Two points fall side by side, 1 m and `other` times that high, each with its own gravity; each stops the fall of both."""
    q, r = ph.state("q", unit="m", start=1.0), ph.state("r", unit="m", start=other)
    p, s = ph.state("p", unit="kg.m/s"), ph.state("s", unit="kg.m/s")
    a, b = ph.parameter("a", 9.81, unit="m/s2"), ph.parameter("b", 9.81 * other, unit="m/s2")
    left, right = ph.parameter("left", 1.0), ph.parameter("right", 1.0)
    return ph.PHDAE(
        "pair", states=(q, r, p, s), parameters=(a, b, left, right),
        energies=(ph.energy(p**2 / 2 + s**2 / 2), ph.energy(a * q + b * r)),
        structure=(ph.skew(q, p, left), ph.skew(r, s, right)),
        state_events=(
            StateEvent(Guard("low.q", q, -1, unit="m"), when={"left": 1.0}, sets={"left": 0.5}),
            StateEvent(Guard("low.r", r, -1, unit="m"), when={"right": 1.0}, sets={"right": 0.5}),
        ),
    )  # fmt: skip


@pytest.mark.parametrize("mode", ["forward", "reverse"])
def test_an_order_that_follows_from_values_is_refused(mode: str) -> None:
    d = together(1.0)
    model, options = build_model(d), Options(stop=0.6, step=0.02)
    with pytest.raises(
        NoDerivative, match=r"low\.q and low\.r at t = 0\.4515\d* s has no derivative.*in an order"
    ) as told:
        gradient(model, instance_of(model), options, ["last(q)"], ["q", "a"], mode=mode)
    assert told.value.t == pytest.approx(np.sqrt(2.0 / 9.81), rel=1e-12)


@pytest.mark.parametrize("mode", ["forward", "reverse"])
def test_events_that_stay_together_are_derived(mode: str) -> None:
    """By what moves both alike."""
    x = ph.state("x", start=1.0, unit="m")
    y, m = ph.state("y", unit="kg.m/s"), ph.parameter("m", 2.0, unit="kg")
    one, two = ph.parameter("one", 1.0), ph.parameter("two", 1.0)
    d = ph.PHDAE(
        "twice", states=(x, y), parameters=(m, one, two), energies=(ph.energy(y**2 / (2 * m) + 5.0 * x),),
        structure=(ph.skew(x, y, 0.5 * (one + two)),),
        state_events=(
            StateEvent(Guard("first", x, -1, unit="m"), when={"one": 1.0}, sets={"one": 0.5}),
            StateEvent(Guard("second", 3.0 * x, -1, unit="m"), when={"two": 1.0}, sets={"two": 0.5}),
        ),
    )  # fmt: skip
    model, options, by = build_model(d), Options(stop=1.2, step=0.02), ["x", "m"]
    found = gradient(model, instance_of(model), options, ["last(x)", "last(y)"], by, mode=mode)
    other = differences(d, 2, options, ["last(x)", "last(y)"], by, 1e-4)
    assert differ(found.slopes, other, np.array([1.0, 2.0])) < 1e-7


@pytest.mark.parametrize("mode", ["forward", "reverse"])
def test_piles_and_close_orders_are_told(mode: str) -> None:
    d, model, options = of_case("buffer", 2)
    found = gradient(model, instance_of(model), options, ["last(body.q)"], ["body.e"], mode=mode)
    assert any(line.startswith("body.hits at t = 0.57") and "pile up" in line for line in found.notes)
    d = together(1.0 + 1e-9)
    model = build_model(d.with_starts({"b": 9.81}))
    found = gradient(model, instance_of(model), Options(stop=0.6, step=0.02), ["last(q)"], ["q"], mode=mode)
    assert any("low.q at t = 0.4515" in line and "another order" in line for line in found.notes)


def test_a_change_by_data_is_no_value() -> None:
    d, model, options = of_case("buffer", 2)
    with pytest.raises(ValueError, match=r"derivatives are told of equal steps; leave out --rtol"):
        gradient(model, instance_of(model), Options(stop=0.1, step=0.01, rtol=1e-6), ["last(body.q)"], ["body.e"])
