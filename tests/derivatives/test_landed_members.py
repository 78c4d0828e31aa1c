"""Derivatives through state events of members that land together: those of the composed run, differences, and what is refused."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phfmu import (
    Coupled,
    NativeInstance,
    Network,
    Options,
    PythonInstance,
    RunFunction,
    build_model,
    default_scheme,
    gradient,
    run,
)
from phfmu.cli import main
from phfmu.components.mechanical.translational import mass
from phfmu.components.scenes.electrical.breaker_opening import breaker_opening
from phfmu.components.scenes.mechanical.stops import buffer
from phfmu.derivatives.apart.sensitive_members import SensitiveMembers
from phfmu.derivatives.sensitive import SensitiveSteps
from phfmu.network.couplings.newton import newton
from phfmu.network.scene import Scene
from phfmu.signals import derivative_name
from tests.derivatives.apart_runs import differ, members
from tests.derivatives.differences import largest
from tests.events.test_shared_jumps import ball
from tests.wide import longer, wide

BODY = ["body.m", "spring.k", "body.e", "body.q"]


def network(scene: Scene) -> Network:
    assert isinstance(scene.system, Network)
    return scene.system


def columns(result: Any, names: Sequence[str]) -> np.ndarray:
    return np.column_stack([result.column(n) for n in names])


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize(
    ("scene", "by", "stop", "order", "engine"),
    [
        (buffer, BODY, 1.2, 4, NativeInstance),
        (breaker_opening, ["line.R", "line.L", "load.C"], 0.03, 6, NativeInstance),
        *longer(
            [
                (scene, by, stop, order, engine)
                for scene, by, stop in ((buffer, BODY, 1.2), (breaker_opening, ["line.R", "line.L", "load.C"], 0.03))
                for order in (4, 6)
                for engine in (NativeInstance, PythonInstance)
            ],
            (buffer, BODY, 1.2, 6, PythonInstance),
        ),
    ],
)
def test_they_are_those_of_the_composed_run(
    scene: Any, by: Sequence[str], stop: float, order: int, engine: Any
) -> None:
    """Over 27 impacts up to rest and release, and over three poles that open; values and derivatives of what both tell alike."""
    made = scene()
    whole, options = network(made).compose(), Options(stop=stop, step=made.step, events=made.events)
    stepper = SensitiveMembers(Coupled(network(made), members(network(made), order, engine), newton), by)
    found = run(stepper, options)
    model = build_model(whole, default_scheme(whole, order))
    composed = run(SensitiveSteps(model, NativeInstance(model), by), options)
    assert len(found.time) == len(composed.time)
    size = largest(composed)
    states = [n for v in whole.states for n in v.names()]
    kept = ["time", *states, *(q for q in stepper.derived_names if q.endswith(".energy.stored"))]
    for q in kept:
        for n in by:
            own, other = (r.column(derivative_name(q, n)) for r in (found, composed))
            least = 1e-4 * (size[composed.units[composed.names.index(q)]] if q != "time" else 1e-3)
            assert np.abs(own - other).max() <= 1e-9 * max(np.abs(other).max(), least), (q, n)


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize(
    ("scene", "by", "stop"),
    wide(
        [
            (buffer, ("body.m",), 0.35),
            (breaker_opening, ("line.R",), 0.027),
            (lambda: breaker_opening(forced=True), ("line.L",), 0.027),
        ],
        (buffer, ("body.m",), 0.35),
    ),
)
def test_all_columns_are_the_differences_of_coupled_runs(scene: Any, by: Sequence[str], stop: float) -> None:
    """Rows before and after events, at instants that move, too."""
    made = scene()
    options = Options(stop=stop, step=2 * made.step, events=made.events)
    errors = differ(network(made), by, options, lambda n: members(n, 4), newton)
    assert {k: e for k, e in errors.items() if e > 1e-7} == {}


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("order", [2, pytest.param(4, marks=pytest.mark.long)])
def test_a_jump_moves_what_is_linked_to_its_member(order: int) -> None:
    """Linked rigidly, two bodies hit the wall as one, whose impulse is that of the composed declaration; at order 2, too."""
    net = Network("linked")
    net.add("ball", ball(1.0, 0.5, 0.1))
    net.add("m", mass(2.0, k=3.0, q=0.1))
    net.junction("link", ["ball.flange", "m.flange"])
    options = Options(stop=0.2, step=0.02, project=True)
    errors = differ(net, ["m.m", "m.k"], options, lambda n: members(n, order), newton)
    assert {k: e for k, e in errors.items() if e > 1e-7} == {}


@pytest.mark.usefixtures("compiler")
def test_a_run_as_a_function_starts_anew() -> None:
    """Measures at instants between rows, of extremes and integrals count that rows at events move; events are found again."""
    net, options = network(buffer()), Options(stop=0.48, step=0.01)
    of = ["body.q@end", "integral(spring.a.force^2)", "body.energy.stored@0.3333"]
    f = RunFunction(net, Coupled(net, members(net, 4), newton), options, of, BODY[:3])
    begin = f.start[0]
    first, slopes = f(begin), f.jacobian(begin)
    model = build_model(net.compose(), default_scheme(net.compose(), 4))
    composed = gradient(model, NativeInstance(model), options, of, BODY[:3], mode="forward")
    assert slopes == pytest.approx(composed.slopes, rel=1e-9, abs=1e-10)
    assert f(begin).tolist() == first.tolist()
    found = gradient(net, Coupled(net, members(net, 4), newton), options, of[:1], BODY[:3])
    assert found.mode == "forward"  # the other way would cost less
    assert found.slopes == pytest.approx(slopes[:1], rel=1e-12)


# -- the command line ----------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("compiler")
def test_a_fit_finds_restitution_and_stiffness(tmp_path: Path) -> None:
    data, to = tmp_path / "data.csv", tmp_path / "fit.json"
    common = ["--coupling", "newton", "--order", "4", "--stop", "0.4"]
    made = ["--set", "spring.k=210", "--set", "body.e=0.55", "--signals", "body.q"]
    assert main(["run", "buffer", *common, *made, "-o", str(data)]) == 0
    text = data.read_text().splitlines()
    data.write_text("\n".join([text[0], *text[1::7]]) + "\n")
    free = ["--free", "spring.k,body.e", "--measure", "body.q"]
    assert main(["fit", "buffer", str(data), *free, *common, "-o", str(to)]) == 0
    values = json.loads(to.read_text())["values"]
    assert (values["spring.k"], values["body.e"]) == pytest.approx((210.0, 0.55), rel=1e-6)


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["buffer", "--order", "2"], "take --coupling newton and --order 4"),
        (["buffer", "--order", "4", "--coupling", "gauss-seidel"], "happen inside its own steps"),
        (["rectifier", "--order", "4"], "has ideal switches"),
    ],
)
def test_what_has_none_is_refused(options: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    name = {"buffer": "body.m", "rectifier": "load.C"}[options[0]]
    assert main(["run", options[0], "--coupling", "newton", *options[1:], "--sensitivity", name, "--stop", "0.1"]) == 2
    assert said in capsys.readouterr().err


@pytest.mark.usefixtures("compiler")
def test_backwards_is_refused() -> None:
    net = network(buffer())
    coupled = Coupled(net, members(net, 4), newton)
    with pytest.raises(ValueError, match="take mode forward"):
        gradient(net, coupled, Options(stop=0.2, step=0.01), ["body.q@end"], ["body.m"], mode="reverse")
