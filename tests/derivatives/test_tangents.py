"""Derivatives beside the columns of a run: against differences of whole runs, a closed form, and what has none."""

from __future__ import annotations

from random import Random
from typing import Any

import numpy as np
import pytest

import phfmu as ph
from phfmu import Event, NativeInstance, Options, PythonInstance, build_model, run
from phfmu.cli import main
from phfmu.components.library import LIBRARY, build
from phfmu.derivatives.by import IndependentVariables
from phfmu.derivatives.sensitive import SensitiveSteps
from phfmu.derivatives.tangents import RunTangents
from phfmu.discretise.start import project_start
from phfmu.engine.switched import stepped
from phfmu.results.file import open_result
from tests.derivatives.differences import richardson, worst
from tests.wide import wide

#: target, what it is derived by, steps, their length, events
CASES: dict[str, tuple[list[str], int, float, tuple[Event, ...]]] = {
    "dc_motor": (
        ["R", "L", "k", "flux", "shaft.torque"], 60, 1e-3, (Event(0.0, "terminal.v", 12.0), Event(0.03, "d", 1e-4)),
    ),
    "oscillator": (["mass1.m", "spring12.k", "mass1.q", "mass2.v"], 60, 1e-2, ()),
    "smib": (["gen.J", "gen.Ra", "gen.shaft.torque"], 30, 1e-3, (Event(0.01, "gen.field.v", 500.0),)),
    "ladder": (["gen1.J", "grid.amplitude"], 20, 1e-4, (Event(1e-3, "gen1.shaft.torque", 2e6),)),
    "four_particle": (["k13", "alpha", "eta0"], 30, 1e-2, ()),
    "drive": (["motor.R", "load.J"], 40, 1e-4, ()),
}  # fmt: skip
#: of the differences: Newton's acceptance, and for constrained particles that of the Schur sweep
ACCURACY = {"four_particle": 1e-6}


def declared(name: str) -> Any:
    found = build(name)
    return found.declaration() if isinstance(found, ph.Scene) else found


RUNS = [(name, order) for name in CASES for order in (2, 4, 6) if (name, order) != ("four_particle", 4)]


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize(("name", "order"), wide(RUNS, ("dc_motor", 4), ("smib", 2)))
def test_columns_are_the_differences_of_runs(name: str, order: int) -> None:
    by, n, h, events = CASES[name]
    errors = worst(declared(name), by, Options(stop=n * h, step=h, events=events), order)
    assert {by for _, by in errors} == set(by)
    bad = {k: e for k, e in errors.items() if e > ACCURACY.get(name, 1e-7)}
    assert bad == {}


#: scenes of a hundred members and more
LARGE = ("wecc240", "grid", "ieee39", "new_england")
SCENES = [n for n, (kind, *_) in LIBRARY.items() if kind == "scene" and n not in LARGE]
#: mechanisms whose start is assembled, which does not fit other parameters
ASSEMBLED = ("engine", "panda", "robot_arm")


@pytest.mark.slow
@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("name", [n for n in SCENES if n not in ASSEMBLED])
def test_every_scene_by_some_of_its_parameters(name: str) -> None:
    """Twenty steps, all columns; differences of columns that hardly follow a parameter are rounding of the columns.

    Instants of state events that fall on a row's time, as a chopper's do, give two rows there and none beside: steps are odd.
    """
    scene = build(name)
    d = scene.declaration()
    held = {*d.modes, *(s.mode_name for s in d.switches)}
    known = [n for v in d.parameters for n, x in zip(v.names(), v.start, strict=True) if x and n not in held]
    by = Random(1).sample(known, min(4, len(known)))
    step = 0.97 * scene.step if d.state_events else scene.step
    events = tuple(e for e in scene.events if e.t < 20 * step)
    options = Options(stop=20 * step, step=step, events=events, project=True)
    errors = worst(d, by, options, 2, lambda model: stepped(model, NativeInstance))
    assert {k: e for k, e in errors.items() if e > 2e-6} == {}


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("engine", [PythonInstance, NativeInstance])
def test_a_decay_has_the_derivatives_of_its_step_map(engine: Any) -> None:
    """x' = -a x by the midpoint rule: x_n = r^n x_0, r = (1 - z)/(1 + z), z = a h/2; dx_n/da = -n x_n h/(1 - z^2)."""
    a, h, n = 3.0, 0.05, 40
    x, rate = ph.state("x", start=2.0), ph.parameter("a", a)
    d = ph.PHDAE(
        "decay", states=(x,), energies=(ph.energy(x.sx**2 / 2),), dissipation=(ph.damping(x, rate),), parameters=(rate,)
    )
    model = build_model(d)
    found = run(SensitiveSteps(model, engine(model), ["a", "x"]), Options(stop=n * h, step=h))
    z, k = a * h / 2, np.arange(n + 1)
    exact = 2.0 * ((1 - z) / (1 + z)) ** k
    np.testing.assert_allclose(found.column("x"), exact, rtol=1e-12)
    np.testing.assert_allclose(found.column("d(x)/d(a)"), -k * exact * h / (1 - z**2), rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(found.column("d(x)/d(x)"), exact / 2.0, rtol=1e-12)
    np.testing.assert_allclose(found.column("d(energy.stored)/d(x)"), exact**2 / 2.0, rtol=1e-12)
    np.testing.assert_allclose(found.column("d(energy.dissipated)/d(x)"), 2.0 - exact**2 / 2.0, rtol=1e-9, atol=1e-13)


@pytest.mark.usefixtures("compiler")
def test_a_parameter_that_an_event_sets_counts_up_to_there() -> None:
    events = (Event(0.0, "terminal.v", 12.0), Event(0.02, "R", 0.6))
    errors = worst(build("dc_motor"), ["R"], Options(stop=0.05, step=1e-3, events=events), 2)
    assert max(errors.values()) < 1e-7


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize(("name", "by"), [("smib", ["line.L", "gen.Ld"]), ("four_particle", ["q[1]"])])
def test_a_start_on_its_constraints_moves_with_them(name: str, by: list[str]) -> None:
    """Currents at the node of smib depend on the line's inductance, particles hang on bars: starts are those of --project."""
    events = (Event(0.01, "gen.shaft.torque", 2e6),) if name == "smib" else ()
    errors = worst(declared(name), by, Options(stop=0.02, step=1e-3, project=True, events=events), 2, part=1e-4)
    assert {k: e for k, e in errors.items() if e > 1e-6} == {}


@pytest.mark.parametrize("moved", [False, True])
def test_tangents_of_a_projected_start(moved: bool) -> None:
    """Against differences of projections, also of a start that the projection has moved."""
    model = build_model(declared("pendulum"))
    names = [n for v in model.declaration.parameters for n in v.names()]
    by = IndependentVariables.of(model.declaration, ["bar.length", "q[1]"])
    given = model.x0 + (np.array([0.03, 0.01, 0.2, 0.0]) if moved else 0.0)
    start = project_start(model, given).x if moved else given
    tangents = RunTangents(model, by)
    instance = PythonInstance(model)
    instance.set_x(0.0, start)
    instance.initialise()
    found = tangents.at_start(0.0, given, start, model.u0, model.p0, instance.signal("a_end"))["x"][0]
    p, i = model.p0, names.index("bar.length")

    def by_length(length: float) -> np.ndarray:
        own = p.copy()
        own[i] = length
        return project_start(model, given, p=own).x

    def by_place(q: float) -> np.ndarray:
        return project_start(model, np.array([q, *given[1:]])).x

    assert np.abs(found[:, 0] - richardson(by_length, p[i], 1e-3)).max() < 1e-9
    assert np.abs(found[:, 1] - richardson(by_place, given[0], 1e-3)).max() < 1e-9


def test_units_and_names() -> None:
    model = build_model(build("dc_motor"))
    stepper = SensitiveSteps(model, PythonInstance(model), ["R", "terminal.v", "flux"], ["terminal.i"])
    assert stepper.names[-3:] == ["d(terminal.i)/d(R)", "d(terminal.i)/d(terminal.v)", "d(terminal.i)/d(flux)"]
    assert [stepper.units[n] for n in stepper.names[-3:]] == ["A/(ohm)", "A/(V)", "A/(Wb)"]


REFUSED = {
    "buffer": (
        ["--sensitivity", "body.e", "--restart", "4"],
        "told of steps that are not damped",
    ),
    "clutch": (["--sensitivity", "engaged", "--stop", "0.01", "--step", "1e-3"], "is the mode of an ideal switch"),
    "smib": (["--sensitivity", "gen.Q"], "no parameter, state or input 'gen.Q'"),
    "dc_motor": (["--sensitivity", "R", "--rtol", "1e-3"], "--sensitivity and --rtol do not go together"),
    "drive": (["--sensitivity", "load.J", "--scheme", "gradient-pair"], "has no derivatives here"),
}


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("name", REFUSED)
def test_what_has_no_derivative_is_refused_by_name(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    words, told = REFUSED[name]
    assert main(["run", name, *words]) == 2
    assert told in capsys.readouterr().err


@pytest.mark.usefixtures("compiler")
def test_the_command_writes_columns_of_the_signals_it_keeps(tmp_path: Any) -> None:
    out = tmp_path / "o.parquet"
    words = ["--set", "terminal.v=12", "--stop", "0.01", "--step", "1e-3", "--sensitivity", "R,L", "--quiet"]
    assert main(["run", "dc_motor", *words, "--signals", "terminal.i", "-o", str(out)]) == 0
    table = open_result(out)
    assert table.names == ["terminal.i", "d(terminal.i)/d(R)", "d(terminal.i)/d(L)"]
    assert table.unit("d(terminal.i)/d(L)") == "A/(H)" and np.all(table.column("d(terminal.i)/d(R)")[1:] < 0)


def test_a_step_in_parts_and_a_driven_input_are_told() -> None:
    model = build_model(build("dc_motor"))
    stepper = SensitiveSteps(model, PythonInstance(model), ["terminal.v"])
    with pytest.raises(ValueError, match="terminal.v is set within the run"):
        run(stepper, Options(stop=0.01, step=1e-3, events=(Event(0.004, "terminal.v", 3.0),)))


def test_large_plans_are_factored_sparse(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same derivatives, from sparse factors of each step."""
    model = build_model(build("oscillator").declaration(), ph.Collocated(2))
    options, found = Options(stop=0.3, step=1e-2), []
    for full in (160, 0):
        monkeypatch.setattr("phfmu.derivatives.plan_function.FULL", full)
        found.append(
            run(SensitiveSteps(model, PythonInstance(model), ["mass1.m", "spring12.k", "mass1.q"]), options).values
        )
    assert np.abs(found[0] - found[1]).max() <= 1e-12 * np.abs(found[0]).max()
