"""What is not a declaration, or hardly one: accepted where it is clear, else one error with the remedy."""

from __future__ import annotations

import importlib
import math
import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from phfmu import (
    ELECTRICAL,
    PHDAE,
    Event,
    Holonomic,
    NativeInstance,
    Network,
    Options,
    Port,
    PythonInstance,
    Scene,
    algebraic,
    build_model,
    check,
    damping,
    energy,
    export,
    grid,
    observable,
    parameter,
    run,
    skew,
    state,
    sweep,
)
from phfmu.cli import main
from phfmu.components.electrical.machines.dc_motor import dc_motor
from phfmu.declare.error import DeclarationError
from phfmu.declare.variable import VariableKind
from phfmu.fmu.export.description import ExportedUnit
from phfmu.network.check_scene import check_scene


def refused(call: Any, *words: str) -> None:
    with pytest.raises(DeclarationError) as caught:
        call()
    assert all(w in str(caught.value) for w in words), caught.value


def model(**changes: Any) -> PHDAE:
    x = state("x", start=1.0)
    return replace(PHDAE("m", states=(x,), energies=(energy(x**2 / 2),), dissipation=(damping(x, 1.0),)), **changes)


def value(expr: Any, v: Any, at: Any) -> np.ndarray:
    return np.array(ca.Function("f", [v.sx], [expr])(at))


def test_functions_of_numpy_take_variables():
    x, v = state("x"), state("v", 2)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for f in (np.cos, np.exp, np.sqrt, np.arctan, np.abs):
            assert np.allclose(value(f(x), x, 0.7), f(0.7))
            assert np.allclose(value(f(v), v, [0.7, 0.2]).ravel(), f([0.7, 0.2]))
        assert np.allclose(value(np.array([1.0, 2.0]) * v, v, [3, 4]).ravel(), [3, 8])
        assert np.allclose(value(np.array([[0.0, 1.0], [2.0, 0.0]]) @ v, v, [3, 4]).ravel(), [4, 6])
        assert np.allclose(value(np.float64(2.0) - x, x, 0.5), 1.5)
        assert np.allclose(value(np.maximum(x, 2.0), x, 0.5), 2.0)
    refused(lambda: np.heaviside(x, 1.0), "numpy.heaviside", "such as x")
    refused(lambda: math.cos(x), "'x': is a symbol", "casadi.cos(x.sx)")


def test_functions_of_numpy_take_expressions_without_a_notice() -> None:
    code = "import numpy, phfmu; q = phfmu.state('q'); print(numpy.exp(q / 2))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert (done.stdout, done.stderr) == ("exp((q/2))\n", "")


def test_kinds_of_variables_are_typed_and_read_as_words():
    kinds = [make("x").kind for make in (state, algebraic)] + [parameter("p", 1.0).kind]
    assert kinds == [VariableKind.STATE, VariableKind.ALGEBRAIC, VariableKind.PARAMETER]
    assert all(type(k) is VariableKind for k in kinds) and "state algebraic parameter".split() == kinds


def test_starts_are_numbers():
    refused(lambda: state("x", start="one"), "x: start = 'one'; give a number")
    refused(lambda: state("x", 2, start=None), "x: start = None", "each of the 2 entries")
    bad = model().mapped(lambda v: replace(v, start=(math.nan,)), lambda p: p)
    refused(lambda: build_model(bad), "the start of x is nan", "give a finite number")


def test_parts_of_a_declaration_are_lists_of_what_they_should_be():
    x = state("x")
    refused(lambda: PHDAE("m", states=(x)), "states is one Variable", "write states=(.. ,)")
    refused(lambda: PHDAE("m", states=(x,), energies=energy(x**2)), "energies is one Energy")
    refused(lambda: PHDAE("m", states=("x",)), "entry 1 of states is the str 'x'", "make it with state(..)")
    refused(lambda: PHDAE("m", states=(x,), energies=(x**2,)), "entry 1 of energies is the SX", "energy(..)")
    port = Port("p", ELECTRICAL, "effort", {x: 1.0})
    refused(lambda: PHDAE("m", states=(x,), ports=port), "ports is one Port")
    assert PHDAE("m", states=[x], energies=[energy(x**2)]).states == (x,)


def test_where_a_declaration_is_wanted():
    net = Network("n")
    for call, name in (check, "check"), (build_model, "build_model"):
        got = f"{name}: needs a declaration (PHDAE), got the str 'dc_motor'"
        refused(lambda call=call: call("dc_motor"), got, "phfmu.target.load('dc_motor')")
        got = "got the PosixPath" if sys.platform != "win32" else "got the"
        refused(lambda call=call: call(Path("a.py")), got, "load('a.py')")
        refused(lambda call=call: call(dc_motor), "call the function")
        refused(lambda call=call: call(net), "compose the network first")


def test_what_only_leads_to_a_model_or_stepper_is_named_with_the_way_there():
    motor, wanted = dc_motor(), "needs a declaration (PHDAE), got the str 'motor.py'"
    refused(lambda: Scene("s", "motor.py", 1.0, 0.1), f"scene s: {wanted}", "load('motor.py')")
    refused(lambda: sweep("motor.py", grid({"J": [1.0]}), ["max(i)"]), f"sweep: {wanted}")
    for call, words in (
        (lambda: PythonInstance(motor), "PythonInstance takes a model, got the PHDAE 'dc_motor'; build it: build_model("),
        (lambda: NativeInstance(motor), "NativeInstance takes a model, got the PHDAE 'dc_motor'"),
        (lambda: PythonInstance("motor.py"), "build_model(phfmu.target.load('motor.py'))"),
        (lambda: run(motor, Options(stop=1.0, step=0.1)), "got the PHDAE 'dc_motor'; make one: Monolithic("),
        (lambda: run("motor.py", Options(stop=1.0, step=0.1)), "run takes a stepper, got the str 'motor.py'"),
    ):  # fmt: skip
        with pytest.raises(TypeError) as caught:
            call()
        assert words in str(caught.value)


def test_symbols_have_no_order_and_have_a_magnitude():
    x = state("flux")
    for call in (lambda: max(x, 0), lambda: x > 0, lambda: 1.0 <= x):
        refused(call, "'flux': is a symbol", "casadi.if_else(flux.sx > .., a, b), casadi.fmax")
    assert str(abs(x)) == "fabs(flux)"


def test_an_export_takes_the_model_which_carries_its_declaration(tmp_path):
    motor = dc_motor()
    model = build_model(motor)
    pair = "leave the declaration out, the model carries it"
    for call, words in (
        (lambda: export(motor, model, tmp_path, step=1.0), f"export takes a model first, got the PHDAE 'dc_motor'; {pair}"),
        (lambda: export(motor, model, tmp_path, ("3.0",), step=1.0), pair),
        (lambda: ExportedUnit(motor, model, 1.0), f"Unit takes a model first, got the PHDAE 'dc_motor'; {pair}"),
        (lambda: export(motor, tmp_path, step=1.0), "build_model(declaration)"),
        (lambda: export("dc_motor", tmp_path, step=1.0), "got the str 'dc_motor'; build it: build_model(declaration)"),
    ):  # fmt: skip
        with pytest.raises(TypeError) as caught:
            call()
        assert words in str(caught.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["", "  ", "m" * 201, "a\0b", "../a", "a\\b", "two\nlines"])
def test_names_that_no_file_can_have(name, tmp_path):
    (found,) = check(model(name=name))
    assert found.rule == "name" and found.remedy.startswith("give it a short name")
    if len(name.strip()) in (0, 201):  # of the others export makes one
        with pytest.raises(RuntimeError, match="its name"):
            export(build_model(model(name=name)), tmp_path, step=0.1)
        assert not list(tmp_path.iterdir())


def pendulum(mass: Any) -> PHDAE:
    q, v, lam = state("q", 2, start=(1.0, 0.0)), state("v", 2), algebraic("lam")
    return PHDAE("p", states=(q, v), algebraics=(lam,), energies=(energy(ca.sumsqr(v.sx)), energy(19.62 * q[1])),
                 E={v: mass}, structure=(skew(q, v, 1.0),), constraints=(Holonomic(lam, (ca.sumsqr(q.sx) - 1) / 2),))  # fmt: skip


@pytest.mark.parametrize(
    "mass", [np.diag([2.0, 2.0]), [[2.0, 0.0], [0.0, 2.0]], ca.DM([[2, 0], [0, 2]]), ca.densify(2 * ca.SX.eye(2))],
    ids=["numpy", "lists", "DM", "SX"],
)  # fmt: skip
def test_a_full_matrix_that_is_diagonal_is_diagonal(mass):
    ends = []
    for E in (2.0, mass):
        assert check(pendulum(E)) == []
        unit = PythonInstance(build_model(pendulum(E)))
        unit.do_step(0.0, 0.01)
        ends.append(unit.x)
    assert np.array_equal(*ends)


@pytest.mark.parametrize("name", ["json", "numpy", "casadi", "phfmu"])
def test_a_model_file_may_be_called_like_a_module(name, tmp_path, capsys):
    path = tmp_path / f"{name}.py"
    path.write_text("from phfmu.components.electrical.machines.dc_motor import dc_motor as m\n")
    before = importlib.import_module(name)
    assert main(["run", f"{path}:m", "--stop", "1e-3", "--step", "1e-3", "--engine", "python", "--quiet"]) == 0
    assert sys.modules[name] is before and capsys.readouterr().err == ""


CAPACITORS = """
from phfmu import ELECTRICAL, PHDAE, Network, Port, energy, parameter, state
def capacitor(q):
    charge, C = state("charge", unit="C", start=q, nominal=0.01), parameter("C", 1e-3, unit="F")
    port = Port("terminal", ELECTRICAL, "flow", {charge: 1.0})
    return PHDAE("capacitor", states=(charge,), parameters=(C,), energies=(energy(charge**2 / (2 * C)),), ports=(port,))
def tank():
    net = Network("tank")
    net.add("left", capacitor(0.02)), net.add("right", capacitor(0.01))
    net.junction("node", ["left.terminal", "right.terminal"])
    return net
"""


def test_two_capacitors_at_different_voltages_are_told_in_volts(tmp_path, capsys):
    (tmp_path / "c.py").write_text(CAPACITORS)
    target = f"{tmp_path / 'c.py'}:tank"
    for line, code in (f"check {target}", 1), (f"run {target}", 2), (f"run {target} --coupling newton", 2):
        assert main(line.split() + ["--engine", "python"] * line.startswith("run")) == code
        said = "".join(capsys.readouterr())
        assert "v of left.terminal and right.terminal differ by 10 V" in said  # 0.02 C and 0.01 C at 1 mF


def test_events_of_a_scene_are_checked(tmp_path, capsys):
    events = [(0.0, "R", 0.5), (0.01, "terminal.w", 1), (0.01, "flux", 1), (0.01, "d", math.nan), (9.0, "R", -1.0)]
    scene = Scene("s", dc_motor(), 1.0, 0.01, tuple(Event(*e) for e in events))
    assert check(scene.declaration()) == []
    first, second, third = check_scene(scene)
    assert "'terminal.w' is no parameter or free input; did you mean terminal.v" in str(first)
    assert "'flux' is a state, which events do not set" in str(second) and "t = 0.01 s" in third.entry
    assert "not finite" in third.reason and {p.rule for p in (first, second, third)} == {"event"}
    (found,) = check_scene(Scene("s", dc_motor(), 1.0, math.nan))
    assert "step = nan s" in found.reason
    late = check_scene(Scene("s", dc_motor(), 10.0, 0.01, (Event(9.0, "R", -1.0),)))
    assert [p.rule for p in late] == ["limit", "passivity"] and "after the event R = -1 at t = 9 s" in late[0].reason
    (tmp_path / "s.py").write_text(
        "from phfmu import Event, Scene\nfrom phfmu.components.electrical.machines.dc_motor import dc_motor\n"
        "def s(): return Scene('s', dc_motor(), 1.0, 0.01, (Event(0.1, 'Rr', 1.0),))\n"
    )
    assert main(["check", f"{tmp_path / 's.py'}:s"]) == 1
    assert "'Rr' is no parameter or free input; did you mean R" in capsys.readouterr().out


def test_parameters_survive_what_numpy_gives():
    p = parameter("p", np.float64(2.0), min=np.float64(0.0))
    assert p.start == (2.0,) and p.min == (0.0,)


def test_star_import_brings_all_public_names() -> None:
    names: dict[str, object] = {}
    exec("from phfmu import *", names)
    assert {"PHDAE", "Port", "ELECTRICAL", "state", "parameter", "energy", "check", "build_model"} <= names.keys()


def test_entries_that_a_variable_does_not_have():
    refused(
        lambda: state("v", 2, start=(1.0, 2.0, 3.0)), "v: start has 3 entries, the variable has 2", "for each entry"
    )
    refused(lambda: state("v", 2).part(1, 2), "v: has 2 entries, not 2 .. 3", "within them")


# -- ports: columns, size, which of the pair is given ---------------------------------------------------------------------


def vector() -> PHDAE:
    """Three equal coils and no port."""
    flux = state("flux", 3)
    return PHDAE("m", states=(flux,), energies=(energy(ca.sumsqr(flux.sx) / 2),))


def test_a_port_without_its_columns_is_told_with_an_example() -> None:
    port: Any = Port
    refused(lambda: port("terminal", ELECTRICAL, "effort"), "port 'terminal'", '"effort", {flux: 1.0})', "{} is for")
    for columns in (state("flux"), [(state("flux"), 1.0)], 1.0):
        refused(lambda c=columns: port("terminal", ELECTRICAL, "effort", c), type(columns).__name__, "{flux: 1.0}")
    refused(lambda: port("terminal", ELECTRICAL, "v", {}), "given = 'v'", "'effort' is v, 'flow' is i")
    refused(lambda: port("terminal", "electrical", "effort", {}), "'electrical' is no Domain", "ELECTRICAL")


@pytest.mark.parametrize(
    ("columns", "size", "words"),
    [
        (1.0, None, "is 1 x 1, expected 3 x 1; give the port size=3 (a pair for each entry of 'flux')"),
        ([1.0, 1.0], None, "is 2 x 1, expected 3 x 1; give the port size=3"),
        ([1.0, 1.0, 1.0], 3, "is 3 x 1, expected 3 x 3; the port has 3 pairs (size=3) and 'flux' 3 entries"),
    ],
)
def test_columns_that_do_not_fit_the_size_of_a_port(columns: Any, size: int | None, words: str) -> None:
    m = vector()
    ports = (Port("terminal", ELECTRICAL, "effort", {m.states[0]: columns}, size=size),)
    (problem,) = (p for p in check(replace(m, ports=ports)) if p.rule == "shape")
    assert words in str(problem)


@pytest.mark.parametrize(
    ("elements", "words"),
    [
        (("a", "b"), "2 elements (a, b) name 3 entries; give a list with one name for each entry"),
        ("abc", "give a list with one name for each entry"),
        (("a", "a", "b"), "'a' is no name of an element"),
        (("a", "b]", "c"), "'b]' is no name of an element"),
    ],
)
def test_names_of_elements_that_do_not_fit(elements: Any, words: str) -> None:
    for made in (
        lambda: state("flux", 3, elements=elements),
        lambda: Port("terminal", ELECTRICAL, "effort", {}, size=3, elements=elements),
        lambda: observable("i", ca.SX(3, 1), elements=elements),
    ):
        refused(made, words)


def test_skew_turns_from_its_second_variable_to_its_first() -> None:
    """a' = n b, b' = -n a: clockwise where a points right and b up, with the rate n."""
    a, b = state("a"), state("b", start=1.0)
    energies = (energy((a**2 + b**2) / 2),)
    unit = PythonInstance(build_model(PHDAE("m", states=(a, b), energies=energies, structure=(skew(a, b, 0.5),))))
    for k in range(1000):
        unit.do_step(k * 1e-3, 1e-3)
    assert unit.x == pytest.approx([math.sin(0.5), math.cos(0.5)], abs=1e-6)
