"""Derivatives of runs through units of this package: those of their declarations, differences of runs, and what has none."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phfmu import Coupled, Event, Network, Options, RunFunction, Table, fit, gradient, run
from phfmu.cli import main
from phfmu.components.library import build
from phfmu.derivatives.apart.sensitive_members import SensitiveMembers
from phfmu.derivatives.fits.fit import Experiment
from phfmu.network.couplings.gauss_seidel import GaussSeidel
from phfmu.network.couplings.jacobi import Jacobi
from phfmu.network.couplings.newton import Newton, newton
from phfmu.results.file import open_result
from phfmu.signals import derivative_name
from tests.derivatives.apart_runs import members
from tests.derivatives.differences import largest, richardson
from tests.fmu import foreign
from tests.network.test_explicit import resistive
from tests.network.unit_members import MIXED, SIDECAR, unit_members
from tests.wide import wide

pytestmark = pytest.mark.usefixtures("compiler")

COUPLINGS: dict[str, Any] = {
    "newton": newton,
    "held": lambda _: Newton(),
    "gauss-seidel": lambda _: GaussSeidel(),
    "jacobi": lambda _: Jacobi(),
}
#: names derived by, measures, events, step
SCENES: dict[str, tuple[list[str], list[str], tuple[Event, ...], float]] = {
    "oscillator": (["mass1.m", "spring12.k", "mass1.q", "mass2.v"],
                   ["mass2.q@end", "integral(mass1.v^2)", "spring12.a.energy@end"], (), 1e-2),
    "resistive": (["d.d", "m.q", "s.k", "m.m"], ["m.q@end", "rms(near.velocity)", "mean(s.a.force)"], (), 2e-2),
    "smib": (["gen.J", "gen.Ra", "gen.shaft.torque"], ["gen.theta@end", "gen.shaft.speed@end", "gen.terminal.i[1]@0.0075"],
             (Event(5e-3, "gen.field.v", 500.0),), 1e-3),
    "two_machine": (["m1.J", "line.R"], ["m2.theta@end", "load.terminal.energy@end"], (), 1e-3),
}  # fmt: skip
ONE = "fmi3 native"
CASES = [
    ("oscillator", "fmi3", 1, "newton"), ("oscillator", MIXED, 2, "newton"), ("oscillator", "fmi2", 3, "newton"),
    ("oscillator", "fmi3", 2, "held"), ("oscillator", MIXED, 2, "gauss-seidel"), ("resistive", "fmi3", 1, "jacobi"),
    ("resistive", MIXED, 2, "gauss-seidel"), ("resistive", "fmi2", 1, "gauss-seidel"), ("resistive", ONE, 3, "newton"),
    ("smib", "fmi3", 1, "held"), ("smib", ONE, 1, "held"), ("smib", "fmi2", 2, "held"), ("two_machine", "fmi3", 1, "held"),
    ("two_machine", ONE, 2, "held"), ("smib", "fmi3", 1, "newton"), ("smib", ONE, 2, "newton"), ("smib", "fmi2", 3, "newton"),
    ("two_machine", "fmi3", 2, "newton"), ("two_machine", MIXED, 3, "newton"),
]  # fmt: skip
FEW = (("oscillator", MIXED, 2, "newton"), ("resistive", "fmi3", 1, "jacobi"), ("smib", ONE, 2, "newton"))


def asked(coupling: str) -> dict[str, Any]:
    """How members are joined; where values are held they take no impulses at bare nodes."""
    return {"coupling": COUPLINGS[coupling]} | ({"written": {"impulses": False}} if coupling == "held" else {})


def scene(name: str, n: int = 10) -> tuple[Network, Options]:
    _, _, events, h = SCENES[name]
    network = resistive() if name == "resistive" else build(name).system
    assert isinstance(network, Network)
    return network, Options(stop=n * h, step=h, events=events)


@pytest.mark.parametrize(("name", "kinds", "k", "coupling"), wide(CASES, *FEW))
def test_they_are_those_of_the_declarations(name: str, kinds: str, k: int, coupling: str, tmp_path: Path) -> None:
    """Units take the steps of the native engine, so that derivatives differ by rounding: 1e-12 of the largest of a unit of
    measurement, which is what is left where columns are sums that cancel."""
    network, options = scene(name)
    by, measures, _, _ = SCENES[name]
    with unit_members(tmp_path) as make:
        how = asked(coupling)
        stepper = SensitiveMembers(make(network, kinds, k, options.step, **how), by)
        found = run(stepper, options)
        own = run(SensitiveMembers(Coupled(network, members(network, 2 * k), COUPLINGS[coupling]), by), options)
        assert len(stepper.derived_names) > 10
        values = largest(own)
        for q in stepper.derived_names:
            size = values[own.units[own.names.index(q)]]
            for n in by:
                one, two = (r.column(derivative_name(q, n))[1:] for r in (found, own))
                start = 1e-12 * size / max(abs(stepper.known.start.get(n, 1.0)), 1e-3)
                assert np.abs(one - two).max() <= 1e-12 * np.abs(two).max() + start, (q, n)
        ways = [
            gradient(network, make(network, kinds, k, options.step, **how), options, measures, by, mode=mode)
            for mode in ("forward", "reverse")
        ]
        assert [w.mode for w in ways] == ["forward", "reverse"]
        assert ways[1].values.tolist() == ways[0].values.tolist()
        assert (np.abs(ways[0].slopes).max(axis=1) > 0).all()
        rounding = 1e-12 * np.abs(ways[0].slopes).max(axis=1, keepdims=True)
        assert (np.abs(ways[1].slopes - ways[0].slopes) <= 1e-11 * np.abs(ways[0].slopes) + rounding).all()


@pytest.mark.parametrize(
    ("name", "kinds", "k", "coupling"),
    wide(
        [("oscillator", MIXED, 2, "newton"), ("resistive", "fmi3", 1, "jacobi"), ("resistive", MIXED, 2, "gauss-seidel"),
         ("smib", "fmi3", 1, "held"), ("two_machine", "fmi3", 2, "newton"), ("smib", "fmi2", 2, "newton")],
        ("oscillator", MIXED, 2, "newton"), ("resistive", MIXED, 2, "gauss-seidel"),
    ),
)  # fmt: skip
def test_they_are_differences_of_runs(name: str, kinds: str, k: int, coupling: str, tmp_path: Path) -> None:
    """Runs that begin anew with other values, as in a fit; the first of them is the run of fresh members, to the bit."""
    network, options = scene(name)
    by, measures, _, _ = SCENES[name]
    with unit_members(tmp_path) as make:
        how = asked(coupling)

        def fresh() -> Coupled:
            return make(network, kinds, k, options.step, **how)

        f = RunFunction(network, fresh(), options, measures, by)
        begin = f.start[0]
        assert f(begin).tolist() == gradient(network, fresh(), options, measures, by).values.tolist()
        for i, base in enumerate(begin):
            slopes = richardson(
                lambda v, i=i: f(np.where(np.arange(len(begin)) == i, v, begin)), base, 1e-2 * (abs(base) or 1.0)
            )
            J = f.jacobian(begin)
            scale = np.abs(f(begin)) / (abs(base) or 1.0)
            assert (np.abs(J[:, i] - slopes) <= 1e-7 * np.abs(slopes) + 1e-10 * scale).all(), by[i]


def test_an_event_ends_what_follows_from_a_tunable_parameter(tmp_path: Path) -> None:
    """A stiffness of a unit that is set halfway acts up to there."""
    network, options = scene("oscillator")
    options = Options(stop=0.1, step=1e-2, events=(Event(0.05, "spring12.k", 30.0),))
    with unit_members(tmp_path) as make:
        made = make(network, "native native fmi3", 2, options.step, coupling=newton, written={"tunable": ["k"]})
        own = Coupled(network, members(network, 4), newton)
        one, two = (gradient(network, m, options, ["mass1.q@end"], ["spring12.k"], mode="forward") for m in (made, own))
        assert one.slopes == pytest.approx(two.slopes, rel=1e-11)


def test_a_row_of_the_start_without_derivatives_is_told(tmp_path: Path) -> None:
    """Voltages at a node of inductors are no matter of the instant: what follows them is not derived at the start."""
    network, options = scene("smib")
    with unit_members(tmp_path) as make:
        data = run(make(network, ONE, 1, options.step, coupling=newton), options)
        table = Table(["bus1.v[1]"], data.time, data.column("bus1.v[1]")[:, None], ["V"])
        for first, said in ((0, "bus1.v\\[1\\] has no derivative in the row of the start"), (1, "")):
            some = Table(table.names, table.time[first:], table.values[first:], table.units)
            apart = make(network, ONE, 1, options.step, coupling=newton)
            tries = [Experiment("data", some, options)]
            if said:
                with pytest.raises(ValueError, match=said):
                    fit(network, apart, tries, ["gen.J"], ["bus1.v[1]"])
            else:
                found = fit(network, apart, tries, ["gen.J"], ["bus1.v[1]"])
                assert found.residual < 1e-9
        for mode in ("forward", "reverse"):
            apart = make(network, ONE, 1, options.step, coupling=newton)
            with pytest.raises(ValueError, match="has no derivative in the row of the start"):
                gradient(network, apart, options, ["integral(bus1.v[1]^2)"], ["gen.J"], mode=mode)


# -- the command line ----------------------------------------------------------------------------------------------------

NET = """
from phfmu import Network, Scene
from phfmu.components.mechanical.translational import mass


def net():
    net = Network("net")
    net.add("one", mass(2.0, q=0.3, v=0.5))
    net.add("two", mass(1.0, q=0.1))
    net.add("link", "{unit}")
    net.junction("a", ["one.flange", "link.a"])
    net.junction("b", ["two.flange", "link.b"])
    return Scene("net", net, stop=0.5, step=0.01)
"""


def test_run_and_fit_take_a_unit(tmp_path: Path) -> None:
    assert main(["export", "spring", "-o", str(tmp_path), "--fmi", "3", "--step", "0.01"]) == 0
    (tmp_path / "net.py").write_text(NET.format(unit="spring_fmi3.fmu"))
    target, data, to = f"{tmp_path}/net.py:net", tmp_path / "data.csv", tmp_path / "fit.json"
    out = tmp_path / "out.csv"
    assert main(["run", target, "--coupling", "newton", "--sensitivity", "link.k,one.q", "-o", str(out)]) == 0
    slope = open_result(out).column(derivative_name("two.q", "link.k"))
    assert np.abs(slope).max() > 0 and np.isfinite(slope).all()
    made = ["--set", "one.m=2.1", "--set", "link.k=150", "--signals", "*.q"]
    assert main(["run", target, *made, "-o", str(data)]) == 0
    free = ["--free", "link.k,one.m", "--measure", "one.q,two.q", "--coupling", "newton"]
    assert main(["fit", target, str(data), *free, "-o", str(to), "--quiet"]) == 0
    values = json.loads(to.read_text())["values"]
    assert values == pytest.approx({"link.k": 150.0, "one.m": 2.1}, rel=1e-8)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--sensitivity", "link.nix"], "no parameter, free input or state 'link.nix'"),
        (["--sensitivity", "link.k", "--signals", "link.energy.stored"], "the unit 'link' tells no derivative of"),
    ],
)  # fmt: skip
def test_what_has_none_is_refused(
    options: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", "spring", "-o", str(tmp_path), "--fmi", "3", "--step", "0.01"]) == 0
    (tmp_path / "net.py").write_text(NET.format(unit="spring_fmi3.fmu"))
    assert main(["run", f"{tmp_path}/net.py:net", "--coupling", "newton", *options]) == 2
    assert said in capsys.readouterr().err


def test_a_start_off_its_constraints_is_told(tmp_path: Path) -> None:
    """Currents at a node of inductors follow the fluxes alone: a run that derives by an inductance would leave the node."""
    network, options = scene("smib")
    with unit_members(tmp_path) as make:
        apart = make(network, ONE, 1, options.step, coupling=COUPLINGS["held"], written={"impulses": False})
        with pytest.raises(ValueError, match="with gen.Ld the start leaves sums of outputs at junctions"):
            run(SensitiveMembers(apart, ["gen.Ld"]), options)


@pytest.mark.parametrize("version", wide(["2.0", "3.0"], "3.0"))
def test_a_unit_of_another_tool_is_refused_with_what_it_lacks(
    tmp_path: Path, version: str, capsys: pytest.CaptureFixture[str]
) -> None:
    attribute = {"2.0": "providesDirectionalDerivative", "3.0": "providesDirectionalDerivatives"}[version]
    (tmp_path / "net.py").write_text(NET.format(unit="pump.fmu").replace('"link.a"', '"link.flange"').replace(
        '    net.junction("b", ["two.flange", "link.b"])\n', ""))  # fmt: skip
    (tmp_path / "pump.ports.toml").write_text(SIDECAR)
    for abilities, said in (
        ("", "link: it tells no directional derivatives"),
        (f'{attribute}="true"', "not of states, which may be hidden"),
    ):
        foreign.mass(tmp_path / "pump.fmu", version, abilities=abilities)
        assert main(["run", f"{tmp_path}/net.py:net", "--sensitivity", "one.m", "--stop", "0.1"]) == 2
        assert said in capsys.readouterr().err


@pytest.mark.parametrize("how", wide([{"outward": ["terminal"]}, {"arrays": True}], {"outward": ["terminal"]}))
def test_signs_and_arrays_change_nothing(how: dict[str, Any], tmp_path: Path) -> None:
    """A unit whose currents count out of it, or whose vector ports are arrays, of FMI 3.0."""
    network, options = scene("smib")
    by, measures = SCENES["smib"][0], ["gen.theta@end", "integral(line.a.i[1]^2)", "gen.terminal.energy@end"]
    with unit_members(tmp_path) as make:
        own = Coupled(network, members(network, 4), newton)
        one, two = (
            gradient(network, m, options, measures, by)
            for m in (make(network, ONE, 2, options.step, coupling=newton, written=how), own)
        )
        assert one.slopes == pytest.approx(two.slopes, rel=1e-11)
