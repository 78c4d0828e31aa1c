"""Derivatives of runs backwards: against those forward, against differences of whole runs, and whatever a run has."""

from __future__ import annotations

from collections.abc import Sequence
from random import Random
from typing import Any

import numpy as np
import pytest

import phfmu as ph
from phfmu import Event, NativeInstance, Options, PythonInstance, build_model, default_scheme, gradient, run
from phfmu.components.library import build
from phfmu.derivatives.measured import RunMeasure, SumOfSquares, run_measures
from phfmu.derivatives.taped import TapedSteps
from phfmu.engine.switched import stepped
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.network.members.columns import SignalColumns
from tests.derivatives.differences import largest, richardson
from tests.derivatives.test_tangents import SCENES
from tests.wide import wide

pytestmark = pytest.mark.usefixtures("compiler")

#: target, measures, steps, their length, events
CASES: dict[str, tuple[list[str], int, float, tuple[Event, ...]]] = {
    "dc_motor": (
        [
            "max(terminal.i)", "rms(terminal.i)", "last(energy.dissipated)", "integral(terminal.i^2)",
            "sin(terminal.i) - 2*shaft.speed@end", "terminal.i@0.0333", "first(terminal.i)", "mean(energy.stored)",
        ],
        60, 1e-3, (Event(0.0, "terminal.v", 12.0), Event(0.03, "d", 1e-4)),
    ),
    "oscillator": (["last(energy.stored)", "integral(mass1.v * mass2.v)", "min(mass2.q)"], 60, 1e-2, ()),
    "smib": (
        ["peak(gen.I[1])", "gen.field.energy@end", "last(line.energy.dissipated)", "mean(bus1.v[1])", "max(gen.p)"],
        40, 1e-3, (Event(0.01, "gen.shaft.torque", 2e6),),
    ),
    "ladder": (
        ["last(energy.dissipated)", "max(gen1.p)", "mean(line1.flux[1])"], 20, 1e-4, (Event(1e-3, "gen1.shaft.torque", 2e6),),
    ),
    "four_particle": (["peak(q[7])", "last(energy.dissipated)", "rms(v[1])", "max(lambda[1])"], 30, 1e-2, ()),
    "drive": (["last(energy.dissipated)"], 40, 1e-4, ()),
}  # fmt: skip
PULL = ph.Domain("pull", "f", "N", "v", "m/s", "flow")
RUNS = [(name, order) for name in CASES for order in (2, 4, 6) if (name, order) != ("four_particle", 4)]


def declared(name: str) -> Any:
    found = build(name)
    return found.declaration() if isinstance(found, ph.Scene) else found


def known(d: Any) -> dict[str, float]:
    return {n: x for v in (*d.parameters, *d.states) for n, x in zip(v.names(), v.start, strict=True)}


def of_case(name: str, order: int) -> tuple[Any, Any, Options, list[str]]:
    measures, n, h, events = CASES[name]
    d = declared(name)
    return d, build_model(d, default_scheme(d, order)), Options(stop=n * h, step=h, events=events), measures


def differ(one: np.ndarray, other: np.ndarray, size: np.ndarray) -> float:
    """The largest difference of slopes (measures x names), as a part of the largest of a measure by a value of this size."""
    scaled = np.abs(one) * size
    return float((np.abs(one - other) * size / np.maximum(scaled.max(axis=1, keepdims=True), 1e-300)).max())


@pytest.mark.parametrize(("name", "order"), wide(RUNS, ("dc_motor", 4), ("smib", 2)))
def test_backwards_is_forward(name: str, order: int) -> None:
    """By all parameters, and all starts."""
    d, model, options, measures = of_case(name, order)
    by = [n for n in known(d) if n not in d.modes]
    forward, reverse = (
        gradient(model, NativeInstance(model), options, measures, by, mode=m) for m in ("forward", "reverse")
    )
    assert (forward.mode, reverse.mode) == ("forward", "reverse") and forward.names == reverse.names
    np.testing.assert_array_equal(forward.values, reverse.values)
    sizes = np.array([abs(known(d)[n]) or 1.0 for n in by])
    assert np.abs(forward.slopes).max() > 0
    assert differ(forward.slopes, reverse.slopes, sizes) < 1e-11


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_every_scene_backwards_is_forward(name: str) -> None:
    """Twenty steps; columns that do not follow a name but by rounding are of no account."""
    scene = build(name)
    d = scene.declaration()
    if d.state_events or d.switches:
        pytest.skip(f"{name} has state events: test_event_gradients.py")
    model = build_model(d)
    layout = NativeInstance(model).layout
    by = Random(2).sample([n for n in known(d) if n not in d.modes], 6)
    columns = [c for c in SignalColumns(model, layout).names if not c.startswith("constraint.")]
    columns = Random(3).sample([c for c in columns if not c.endswith((".residual", ".gap"))], 8)
    of = [f"{kind}({c})" for c in columns for kind in ("last", "mean")]
    events = tuple(e for e in scene.events if e.t < 20 * scene.step)
    options = Options(stop=20 * scene.step, step=scene.step, events=events, project=True)
    a, b = (gradient(model, NativeInstance(model), options, of, by, mode=m) for m in ("forward", "reverse"))
    sizes = np.array([abs(known(d)[n]) or 1.0 for n in by])
    plain = run(Monolithic(model, NativeInstance(model)), options)
    most = largest(plain)
    kind = np.repeat([most[plain.units[plain.names.index(c)]] for c in columns], 2)
    rounding = np.abs(a.slopes * sizes).max(axis=1) <= 1e-9 * kind + 1e-12
    assert differ(a.slopes[~rounding], b.slopes[~rounding], sizes) < 1e-11


def differences(
    d: Any, order: int, options: Options, measures: Sequence[str | RunMeasure], by: Sequence[str], part: float
) -> np.ndarray:
    columns = []
    for name in by:

        def values(x: float, name: str = name) -> np.ndarray:
            m = build_model(d.with_starts({name: x}), default_scheme(d, order))
            r = run(Monolithic(m, stepped(m, NativeInstance)), options)
            found = {n: r.column(n) for n in r.names}
            return np.array([w.value(r.time, found) for w in run_measures(measures, r.names)])

        columns.append(richardson(values, known(d)[name], part * (abs(known(d)[name]) or 1.0)))
    return np.column_stack(columns)


BY = {
    "dc_motor": ["R", "L", "k"], "oscillator": ["mass1.m", "mass1.q"], "smib": ["gen.J", "gen.R_f", "grid.phase"],
    "ladder": ["gen1.J", "grid.amplitude"], "four_particle": ["k13", "alpha"], "drive": ["motor.R", "load.J"],
}  # fmt: skip


@pytest.mark.parametrize(("name", "order"), wide(RUNS, ("dc_motor", 2), ("oscillator", 4)))
def test_backwards_is_the_difference_of_runs(name: str, order: int) -> None:
    d, model, options, measures = of_case(name, order)
    measures = [m for m in measures if not m.startswith(("max", "min", "peak"))]
    found = gradient(model, NativeInstance(model), options, measures, BY[name], mode="reverse")
    sizes = np.array([abs(known(d)[n]) or 1.0 for n in BY[name]])
    # differences of constrained particles see the acceptance of the Schur sweep
    most = 1e-6 if name == "four_particle" else 1e-7
    assert differ(differences(d, order, options, measures, BY[name], 1e-3), found.slopes, sizes) < most


def growing() -> Any:
    """x' = a x^2 + u: near its pole steps are halved."""
    x, a = ph.state("x", start=1.0), ph.parameter("a", 1.0)
    push = ph.Port("push", PULL, "effort", {x: 1.0})
    return ph.PHDAE(
        "grows", (x,), energies=(ph.energy(0.5 * x.sx**2),), dissipation=(ph.block((x,), -a.sx * x.sx),), ports=(push,),
        parameters=(a,),
    )  # fmt: skip


def test_steps_that_were_halved_have_derivatives_backwards() -> None:
    d = growing()
    model = build_model(d)
    options, measures = Options(stop=0.8, step=0.4), ["last(x)", "last(energy.dissipated)", "mean(push.v)"]
    instance = NativeInstance(model)
    found = gradient(model, instance, options, measures, ["a", "x", "push.f"], mode="reverse")
    assert instance.counts["substeps"] > 0
    slopes = differences(d, 2, options, measures, ["a", "x"], 1e-5)
    assert differ(slopes, found.slopes[:, :2], np.ones(2)) < 1e-7


@pytest.mark.parametrize("name", ["dc_motor", "smib", "four_particle"])
def test_stretches_that_are_run_again_are_the_same_steps(name: str) -> None:
    """Without memory for the tape, all stretches but the last one, those with values at instants included."""
    d, model, options, measures = of_case(name, 2)
    by, found = [n for n in known(d) if n not in d.modes], []
    cut = [Event(0.4 * options.stop, n, known(d)[n]) for n in BY[name][:1]]
    options = ph.Options(stop=options.stop, step=options.step, events=(*options.events, *cut))
    for memory in (10**9, 0):
        found.append(gradient(model, NativeInstance(model), options, measures, by, mode="reverse", memory=memory))
    assert differ(found[0].slopes, found[1].slopes, np.array([abs(known(d)[n]) or 1.0 for n in by])) < 1e-12
    assert (found[0].slopes[:, by.index(BY[name][0])] != 0).any()
    steps = TapedSteps(model, NativeInstance(model), by)
    run(steps, options)
    for leg in steps.legs:
        kept = leg.kept
        steps.take_again(leg.call)
        assert kept is not None and leg.kept is not None and leg.kept is not kept
        np.testing.assert_array_equal(kept.rows, leg.kept.rows)


def test_only_the_last_stretch_is_kept_without_memory() -> None:
    d, model, options, _ = of_case("smib", 2)
    steps = TapedSteps(model, NativeInstance(model), ["gen.J"], 0)
    result = run(steps, options)
    assert [leg.kept is None for leg in steps.legs] == [True] * (len(steps.legs) - 1) + [False]
    weights = {"energy.dissipated": np.eye(1, len(result.time), len(result.time) - 1)[0]}
    assert steps.slopes([weights]).shape == (1, 1) and steps.again == len(steps.legs) - 1 > 0


def test_a_value_that_an_event_sets_counts_up_to_there() -> None:
    d, model, options, _ = of_case("dc_motor", 4)
    options = Options(stop=0.05, step=1e-3, events=(Event(0.0, "terminal.v", 12.0), Event(0.02, "R", 0.6)))
    a, b = (
        gradient(model, NativeInstance(model), options, ["last(terminal.i)"], ["R", "L"], mode=m)
        for m in ("forward", "reverse")
    )
    np.testing.assert_allclose(a.slopes, b.slopes, rtol=1e-10)


def test_held_inputs_and_starts_on_constraints() -> None:
    d = declared("smib")
    model = build_model(d)
    options = Options(stop=0.02, step=1e-3, project=True)
    by, of = ["line.L", "gen.Ld", "gen.shaft.torque", "gen.theta"], ["last(gen.p)", "last(energy.dissipated)"]
    a, b = (gradient(model, NativeInstance(model), options, of, by, mode=m) for m in ("forward", "reverse"))
    np.testing.assert_allclose(a.slopes, b.slopes, rtol=1e-8)


def test_sums_of_squares_against_data() -> None:
    d, model, options, _ = of_case("dc_motor", 2)
    t = np.linspace(0.0, options.stop, 23)
    data = np.where(np.arange(23) == 5, np.nan, 1.0 + t)
    of = [SumOfSquares("terminal.i", t, data, 0.1)]
    found = gradient(model, NativeInstance(model), options, of, ["R", "L", "k"], mode="reverse")
    assert found.measures == ("squares(terminal.i)",) and found.values[0] > 0
    assert differ(differences(d, 2, options, of, ["R", "L", "k"], 1e-3), found.slopes, np.ones(3)) < 1e-7


def test_the_way_that_costs_less_is_taken() -> None:
    d, model, options, measures = of_case("dc_motor", 2)
    assert gradient(model, NativeInstance(model), options, measures[:1], ["R", "L"]).mode == "reverse"
    assert gradient(model, PythonInstance(model), options, measures[:1], ["R", "L"]).mode == "forward"
    with pytest.raises(ValueError, match="in compiled code only"):
        gradient(model, PythonInstance(model), options, measures[:1], ["R"], mode="reverse")
    with pytest.raises(ValueError, match="mode 'backward': expected auto, forward, reverse"):
        gradient(model, NativeInstance(model), options, measures[:1], ["R"], mode="backward")  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("integral(terminal.j)", "no signal 'terminal.j'"),
        ("last(terminal.i + )", "expected arithmetic on signals"),
        ("terminal.i@7", "not within the run"),
        ("3@end", "it names no signal"),
        ("last(open(terminal.i))", "expected arithmetic on signals"),
    ],
)
def test_what_is_no_measure_is_told(text: str, told: str) -> None:
    model = build_model(build("dc_motor"))
    with pytest.raises((ValueError, KeyError), match=told.replace("+", r"\+")):
        gradient(model, NativeInstance(model), Options(stop=0.01, step=1e-3), [text], ["R"], mode="reverse")


def test_interpreted_kernels_go_back_too() -> None:
    d, model, options, measures = of_case("smib", 2)
    by = ["gen.J", "line.L"]
    found = [
        gradient(model, NativeInstance(model, kernels=kind), options, measures, by, mode="reverse").slopes
        for kind in ("compiled", "interpreted")
    ]
    np.testing.assert_allclose(*found, rtol=1e-13)
