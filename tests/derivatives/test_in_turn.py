"""Derivatives of members that step once, in turn or all at once: differences of runs, both ways, the limit of short steps."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phfmu import Coupled, Event, NativeInstance, Network, Options, PythonInstance, gradient, run
from phfmu.cli import main
from phfmu.cli.settings import with_settings
from phfmu.components.library import build
from phfmu.derivatives.apart.sensitive_members import SensitiveMembers
from phfmu.network.couplings.gauss_seidel import GaussSeidel
from phfmu.network.couplings.jacobi import Jacobi
from phfmu.network.couplings.newton import newton
from phfmu.results.file import open_result
from phfmu.signals import derivative_name
from tests.derivatives.apart_runs import differ, members
from tests.derivatives.differences import richardson
from tests.network.test_explicit import resistive
from tests.wide import longer

BY = {"oscillator": ["spring12.k", "mass1.q", "mass1.m"], "resistive": ["d.d", "m.q", "s.k", "m.m"]}
MEASURES = {
    "oscillator": ["mass2.q@end", "integral(mass1.v^2)", "spring12.a.energy@end", "rms(left.velocity)"],
    "resistive": ["m.q@end", "rms(near.velocity)", "d.energy.dissipated@end", "mean(s.a.force)"],
}


def network(name: str) -> Network:
    found = resistive() if name == "resistive" else build(name).system
    assert isinstance(found, Network)
    return found


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize(
    ("name", "order", "engine", "coupling"),
    [
        ("oscillator", 4, NativeInstance, GaussSeidel), ("resistive", 2, NativeInstance, GaussSeidel),
        *longer(
            [
                (name, order, engine, coupling)
                for name in BY
                for order in (2, 4, 6)
                for engine in (NativeInstance, PythonInstance)
                for coupling in (GaussSeidel, Jacobi)
            ],
            ("resistive", 4, PythonInstance, Jacobi),
        ),
    ],
)  # fmt: skip
def test_all_columns_are_the_differences_of_coupled_runs(name: str, order: int, engine: Any, coupling: Any) -> None:
    """The junctions of `resistive` have feedthrough, so that their unknowns follow from one another at each instant."""
    options = Options(stop=0.1, step=0.02)
    errors = differ(network(name), BY[name][:2], options, lambda n: members(n, order, engine), lambda _: coupling())
    assert {k: e for k, e in errors.items() if e > 1e-7} == {}


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize(
    ("name", "coupling"), [("oscillator", Jacobi), ("resistive", GaussSeidel), ("resistive", Jacobi)]
)
def test_backwards_is_forward(name: str, coupling: Any) -> None:
    options = Options(stop=0.4, step=0.02)
    one, two = (
        gradient(
            network(name), Coupled(network(name), members(network(name), 4), coupling()), options, MEASURES[name],
            BY[name], mode=mode,
        )
        for mode in ("forward", "reverse")
    )  # fmt: skip
    assert two.values.tolist() == one.values.tolist()
    assert (np.abs(one.slopes).max(axis=1) > 0).all()
    assert two.slopes == pytest.approx(one.slopes, rel=1e-11, abs=float(1e-13 * np.abs(one.slopes).max()))


@pytest.mark.usefixtures("compiler")
def test_values_are_those_of_a_run_without_derivatives() -> None:
    """Instants are looked at again after each step, which leaves no trace."""
    options = Options(stop=0.8, step=0.02)
    plain = run(Coupled(resistive(), members(resistive(), 4), GaussSeidel()), options)
    found = run(
        SensitiveMembers(Coupled(resistive(), members(resistive(), 4), GaussSeidel()), BY["resistive"]), options
    )
    own = np.column_stack([found.column(n) for n in plain.names])
    assert own.tolist() == plain.values.tolist()


@pytest.mark.slow
@pytest.mark.usefixtures("compiler")
def test_they_follow_the_sequence_of_members() -> None:
    """Another sequence gives other steps, with derivatives of their own."""
    options, found = Options(stop=0.1, step=0.02), list[Any]()
    for sequence in (["m", "far", "s", "d"], ["s", "d", "far", "m"]):
        coupling = GaussSeidel(sequence)
        errors = differ(resistive(), ["s.k"], options, members, lambda _, c=coupling: c)
        assert {k: e for k, e in errors.items() if e > 1e-7} == {}
        coupled = Coupled(resistive(), members(resistive()), coupling)
        found.append(gradient(resistive(), coupled, options, ["m.q@end"], ["s.k"]).slopes[0, 0])
    assert abs(found[0] - found[1]) > 1e-3 * abs(found[0])


@pytest.mark.usefixtures("compiler")
def test_they_approach_those_of_steps_that_solve_the_junctions() -> None:
    """With order 1, as the steps do."""

    def slope(coupling: Any, h: float) -> float:
        coupled = Coupled(resistive(), members(resistive()), coupling)
        return gradient(resistive(), coupled, Options(stop=0.2, step=h), ["m.q@end"], ["s.k"]).slopes[0, 0]

    exact = slope(newton, 0.01)
    errors = [abs(slope(GaussSeidel(), h) - exact) for h in (0.02, 0.01, 0.005)]
    assert np.diff(np.log2(errors)) == pytest.approx([-1.0, -1.0], abs=0.25)


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("mode", [pytest.param("forward", marks=pytest.mark.long), "reverse"])
def test_an_event_ends_what_follows_from_a_parameter(mode: Any) -> None:
    options = Options(stop=0.16, step=0.02, events=(Event(0.08, "s.k", 30.0),))

    def coupled(k: float) -> Coupled:
        net = with_settings(resistive(), {"s.k": k})
        return Coupled(net, members(net, 4), GaussSeidel())

    found = gradient(resistive(), coupled(40.0), options, ["m.q@end"], ["s.k"], mode=mode)
    slope = richardson(lambda k: run(coupled(k), options).column("m.q")[-1:], 40.0, 0.04)
    assert found.slopes[0, 0] == pytest.approx(slope[0], rel=1e-8)


# -- the command line ----------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("compiler")
def test_a_fit_finds_what_made_the_data(tmp_path: Path) -> None:
    data, to = tmp_path / "data.csv", tmp_path / "fit.json"
    common = ["--coupling", "gauss-seidel", "--step", "0.01", "--stop", "0.5"]
    made = ["--set", "mass1.m=1.04", "--set", "spring12.k=151", "--signals", "mass*.q"]
    assert main(["run", "oscillator", *common, *made, "-o", str(data)]) == 0
    free = ["--free", "mass1.m,spring12.k", "--measure", "mass1.q,mass2.q"]
    assert main(["fit", "oscillator", str(data), *free, *common, "-o", str(to)]) == 0
    values = json.loads(to.read_text())["values"]
    assert values["mass1.m"] == pytest.approx(1.04, rel=1e-7)
    assert values["spring12.k"] == pytest.approx(151.0, rel=1e-7)


@pytest.mark.usefixtures("compiler")
def test_run_writes_them_where_an_input_follows_data(tmp_path: Path) -> None:
    """A voltage that rises is held in the middle of each step, also at its instants."""
    data, to = tmp_path / "voltage.csv", tmp_path / "run.csv"
    data.write_text("time,motor.terminal.v\n0,0\n1,30\n")
    common = ["run", "drive", "--coupling", "gauss-seidel", "--input", str(data)]
    common += ["--interpolate", "linear", "--step", "0.001", "--stop", "0.03"]
    assert main([*common, "--sensitivity", "motor.R", "--signals", "motor.i", "-o", str(to)]) == 0
    own = open_result(to).column(derivative_name("motor.i", "motor.R"))

    def current(R: float) -> np.ndarray:
        assert main([*common, "--set", f"motor.R={R!r}", "--signals", "motor.i", "-o", str(to)]) == 0
        return open_result(to).column("motor.i")

    assert np.abs(own).max() > 1e-3
    assert own == pytest.approx(richardson(current, 0.4, 4e-4), rel=1e-7, abs=1e-9)
