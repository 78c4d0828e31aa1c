"""Derivatives of members stepped apart: those of the composed steps, differences of coupled runs, and what has none."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phfmu import (
    Event,
    NativeInstance,
    Options,
    PythonInstance,
    RunFunction,
    build_model,
    default_scheme,
    gradient,
    run,
)
from phfmu.cli import main
from phfmu.cli.settings import with_settings
from phfmu.components.library import build
from phfmu.derivatives.apart.sensitive_members import SensitiveMembers
from phfmu.derivatives.sensitive import SensitiveSteps
from phfmu.network.couplings.anderson import Anderson
from phfmu.network.couplings.coupled import Coupled
from phfmu.network.couplings.newton import Newton, newton
from phfmu.network.network import Network
from phfmu.results.file import open_result
from phfmu.signals import derivative_name
from tests.derivatives.apart_runs import differ, members, rounding
from tests.derivatives.differences import largest, richardson
from tests.wide import wide

#: scene, what it is derived by, steps, their length, what is set within the run
CASES: dict[str, tuple[list[str], int, float, tuple[Event, ...]]] = {
    "oscillator": (["mass1.m", "spring12.k", "mass1.q", "mass2.v"], 40, 1e-2, ()),
    "smib": (["gen.J", "gen.Ra", "gen.shaft.torque", "gen.psi[1]"], 10, 1e-3, (Event(5e-3, "gen.field.v", 500.0),)),
    "two_machine": (["m1.J", "line.R"], 5, 1e-3, ()),
    "speed_control": (["controller.x", "controller.kp", "rotor.J"], 8, 2e-3, ()),
}  # fmt: skip


def scene(name: str) -> tuple[Network, Options]:
    _, n, h, events = CASES[name]
    network = build(name).system
    assert isinstance(network, Network)
    return network, Options(stop=n * h, step=h, events=events, project=name in ("smib", "two_machine"))


def follows_ends(column: str) -> bool:
    """Values at ends of steps, where members apart have the polynomial of what they exchange."""
    base = column.rpartition("[")[0] if column.endswith("]") else column
    return not (base.endswith("_step") or ".energy" in base or base.startswith(("energy", "bus", "left", "right")))


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize(
    ("name", "order", "engine"),
    wide(
        [
            ("oscillator", 4, PythonInstance), ("oscillator", 6, NativeInstance), ("smib", 2, NativeInstance),
            ("two_machine", 4, NativeInstance), ("speed_control", 2, NativeInstance), ("smib", 6, NativeInstance),
            ("smib", 2, PythonInstance),
        ],
        ("oscillator", 4, PythonInstance), ("oscillator", 6, NativeInstance), ("smib", 2, NativeInstance),
        ("two_machine", 4, NativeInstance), ("speed_control", 2, NativeInstance),
    ),
)  # fmt: skip
def test_they_are_those_of_the_composed_steps(name: str, order: int, engine: Any) -> None:
    """The interface is solved to about 1e-12 of its terms, so that what both have in common differs by little more."""
    network, options = scene(name)
    by, whole = CASES[name][0], network.compose()
    stepper = SensitiveMembers(Coupled(network, members(network, order, engine), newton), by)
    found = run(stepper, options)
    model = build_model(whole, default_scheme(whole, order))
    composed = run(SensitiveSteps(model, engine(model), by), options)
    size, states = largest(composed), {n for v in whole.states for n in v.names()}
    compared = [q for q in stepper.derived_names if q in states or not (follows_ends(q) or rounding(q))]
    assert states <= set(compared)
    errors = {}
    for q in compared:
        for n in by:
            own, other = (r.column(derivative_name(q, n)) for r in (found, composed))
            least = 1e-4 * size[composed.units[composed.names.index(q)]]
            errors[q, n] = float(np.abs(own - other).max() / max(np.abs(other).max(), least, 1e-12))
    assert {k: e for k, e in errors.items() if e > 1e-9} == {}


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("name", ["oscillator", "speed_control", *wide(["two_machine"])])
def test_all_columns_are_the_differences_of_coupled_runs(name: str) -> None:
    network, options = scene(name)
    by = CASES[name][0][:2]
    errors = differ(network, by, options, lambda n: members(n, 4), newton)
    assert {k: e for k, e in errors.items() if e > 2e-7} == {}


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize(("coupling", "accuracy"), [(lambda _: Newton(), 2e-7), (lambda _: Anderson(), 1e-5)])
def test_held_values_and_members_of_other_orders(coupling: Any, accuracy: float) -> None:
    """One value a step where members take k: the step is another one than the composed, and has derivatives of its own.

    Anderson's iteration ends where rows are nearly rounding of their terms, which differences of sums that nearly cancel enlarge.
    """
    network, options = scene("oscillator")
    orders = {"mass1": 2, "mass2": 6, "spring12": 4}
    errors = differ(network, ["spring12.k", "mass1.q"], options, lambda n: members(n, orders=orders), coupling)
    assert {k: e for k, e in errors.items() if e > accuracy} == {}


@pytest.mark.usefixtures("compiler")
def test_members_of_other_orders_exchange_what_the_least_takes() -> None:
    network, options = scene("oscillator")
    orders = {"mass1": 2, "mass2": 6, "spring12": 4}
    errors = differ(network, ["mass1.m", "spring12.k"], options, lambda n: members(n, orders=orders), newton)
    assert {k: e for k, e in errors.items() if e > 2e-7} == {}


# -- the command line ----------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("compiler")
def test_run_writes_them(tmp_path: Path) -> None:
    apart, composed = tmp_path / "apart.csv", tmp_path / "composed.csv"
    common = [
        "run",
        "oscillator",
        "--sensitivity",
        "mass1.m,spring12.k",
        "--stop",
        "0.1",
        "--step",
        "0.01",
        "--signals",
        "mass*",
    ]
    assert main([*common, "--coupling", "newton", "-o", str(apart)]) == 0
    assert main([*common, "-o", str(composed)]) == 0
    one, two = (open_result(p) for p in (apart, composed))
    name = derivative_name("mass2.q", "spring12.k")
    assert np.abs(two.column(name)).max() > 1e-3
    assert one.column(name) == pytest.approx(two.column(name), rel=1e-9, abs=1e-12)


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["speed_control", "--coupling", "jacobi", "--sensitivity", "rotor.J"], "signals that are held"),
        (["oscillator", "--coupling", "newton", "--unconverged", "halve", "--sensitivity", "mass1.m"], "--unconverged"),
        (["oscillator", "--coupling", "newton", "--sensitivity", "mass1.nix"], "no parameter, state or input 'mass1.nix'"),
        (["oscillator", "--coupling", "newton", "--parts", "mass1=2", "--sensitivity", "mass1.m"], "member 'mass1' takes 2"),
        (["speed_control", "--coupling", "anderson", "--sensitivity", "rotor.J"], "signals that are held"),
        (["breaker_opening", "--coupling", "newton", "--sensitivity", "line.R"], "member 'line' has state events"),
        (["smib", "--coupling", "newton", "--sensitivity", "gen.J", "--signals", "bus1.v_end[1]"], "bus1.v_end[1] is told"),
    ],
)  # fmt: skip
def test_what_has_none_is_refused(options: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", *options, "--stop", "1e-3"]) == 2
    assert said in capsys.readouterr().err


def test_one_row_of_a_plan_is_no_row_of_observables(tmp_path: Path) -> None:
    """A body by itself: its plan at an instant has its velocity alone; stored energy m v^2/2."""
    to = tmp_path / "mass.csv"
    given = ["--set", "v=3", "--sensitivity", "m", "--stop", "0.02", "--step", "0.01", "--engine", "python"]
    assert main(["run", "mass", *given, "-o", str(to)]) == 0
    assert open_result(to).column("d(energy.stored)/d(m)") == pytest.approx(np.full(3, 4.5))


# -- measures, backwards, fits -------------------------------------------------------------------------------------------

MEASURES = {
    "oscillator": ["mass2.q@end", "integral(mass1.v^2)", "spring12.a.energy@end", "rms(left.velocity)", "mass1.q@0.123"],
    "speed_control": ["controller.error@end", "mean(actuator.source.power)", "rms(shaft.speed)"],
    "smib": ["max(gen.shaft.speed)", "integral(bus1.v[1]^2)", "gen.energy.stored@end", "energy.dissipated@end",
             "gen.terminal.i[1]@0.0085"],
}  # fmt: skip


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize(
    ("name", "order", "engine"),
    [
        ("oscillator", 4, NativeInstance), ("oscillator", 2, PythonInstance), ("speed_control", 4, NativeInstance),
        *wide([("smib", 2, NativeInstance)]),
    ],
)  # fmt: skip
def test_backwards_is_forward(name: str, order: int, engine: Any) -> None:
    """Both go through the same linearisations, so that they differ by rounding; what is set within the run has its end."""
    network, options = scene(name)
    by = CASES[name][0]
    one, two = (
        gradient(
            network, Coupled(network, members(network, order, engine), newton), options, MEASURES[name], by, mode=mode
        )
        for mode in ("forward", "reverse")
    )
    assert (one.mode, two.mode) == ("forward", "reverse")
    assert two.values.tolist() == one.values.tolist()
    assert (np.abs(one.slopes).max(axis=1) > 0).all()
    assert two.slopes == pytest.approx(one.slopes, rel=1e-10, abs=float(1e-12 * np.abs(one.slopes).max()))
    if name == "speed_control":  # its measures are of values at ends of steps, where the composed model has others
        return
    whole = build_model(network.compose(), default_scheme(network.compose(), order))
    composed = gradient(whole, engine(whole), options, MEASURES[name][:3], by, mode="forward")
    assert one.slopes[:3] == pytest.approx(composed.slopes, rel=1e-7, abs=float(1e-10 * np.abs(composed.slopes).max()))


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("mode", ["forward", "reverse"])
def test_an_event_ends_what_follows_from_a_parameter(mode: Any) -> None:
    """A stiffness that is set halfway acts up to there: the derivative is that of the run whose second half has it fixed."""
    network, options = scene("oscillator")
    options = replace(options, events=(Event(0.2, "spring12.k", 30.0),))

    def coupled(k: float) -> Coupled:
        other = with_settings(network, {"spring12.k": k})
        return Coupled(other, members(other, 4), newton)

    found = gradient(network, coupled(20.0), options, ["mass1.q@end"], ["spring12.k"], mode=mode)
    slope = richardson(lambda k: run(coupled(k), options).column("mass1.q")[-1:], 20.0, 0.02)
    assert found.slopes[0, 0] == pytest.approx(slope[0], rel=1e-8)


@pytest.mark.usefixtures("compiler")
def test_a_run_as_a_function_starts_anew() -> None:
    network, options = scene("oscillator")
    coupled = Coupled(network, members(network, 4), newton)
    f = RunFunction(network, coupled, options, ["mass2.q@end", "mass1.v@end"], ["spring12.k", "mass1.q"])
    begin = f.start[0]
    first = f(begin)

    def along(i: int) -> np.ndarray:
        return richardson(lambda v: f(np.where(np.arange(2) == i, v, begin)), begin[i], 1e-3 * abs(begin[i] or 1.0))

    slopes = np.column_stack([along(0), along(1)])
    assert f.jacobian(begin) == pytest.approx(slopes, rel=1e-8, abs=1e-10)
    assert f(begin).tolist() == first.tolist()


@pytest.mark.usefixtures("compiler")
def test_a_fit_of_members_apart_finds_what_made_the_data(tmp_path: Path) -> None:
    data, to = tmp_path / "data.csv", tmp_path / "fit.json"
    common = ["--step", "0.01", "--stop", "0.5"]
    made = ["--set", "mass1.m=1.04", "--set", "spring12.k=151", "--signals", "mass*.q"]
    assert main(["run", "oscillator", "--coupling", "newton", *common, *made, "-o", str(data)]) == 0
    free = ["--free", "mass1.m,spring12.k", "--measure", "mass1.q,mass2.q", "--coupling", "newton"]
    assert main(["fit", "oscillator", str(data), *free, *common, "-o", str(to)]) == 0
    values = json.loads(to.read_text())["values"]
    assert values["mass1.m"] == pytest.approx(1.04, rel=1e-7)
    assert values["spring12.k"] == pytest.approx(151.0, rel=1e-7)
