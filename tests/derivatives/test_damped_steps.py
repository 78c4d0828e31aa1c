"""Derivatives through Radau IIA steps: as a scheme, and as the damped first steps after events, composed and apart."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import phfmu as ph
from phfmu import Event, NativeInstance, Options, PythonInstance, build_model, default_scheme, gradient, run
from phfmu.cli import main
from phfmu.cli.settings import with_settings
from phfmu.components.library import build
from phfmu.derivatives.apart.sensitive_members import SensitiveMembers
from phfmu.derivatives.sensitive import SensitiveSteps
from phfmu.network.couplings.coupled import Coupled
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.network.couplings.newton import newton
from phfmu.network.network import Network
from phfmu.results.file import open_result
from phfmu.runs.result import Result
from phfmu.schemes.radau import Radau
from phfmu.signals import derivative_name
from tests.derivatives.differences import richardson, worst
from tests.derivatives.test_apart import members
from tests.wide import wide

EVENTS = (Event(5e-3, "motor.terminal.v", 12.0), Event(0.012, "motor.terminal.v", -3.0))
BY = ["motor.R", "load.J"]
OF = ["energy.dissipated@end", "integral(motor.terminal.i^2)", "shaft.twist@0.0075"]
OPTIONS = Options(stop=0.02, step=1e-3, events=EVENTS, restart=2)


@pytest.mark.usefixtures("compiler")
def test_a_stiff_decay_has_the_derivatives_of_radau() -> None:
    """x' = -a x: Radau IIA of two stages multiplies by R(z) = (1 - z/3)/(1 + 2 z/3 + z^2/6), z = a h, far behind the pole."""
    a, h, n = 300.0, 0.05, 4
    x, rate = ph.state("x", start=2.0), ph.parameter("a", a)
    d = ph.PHDAE(
        "decay", states=(x,), energies=(ph.energy(x.sx**2 / 2),), dissipation=(ph.damping(x, rate),), parameters=(rate,)
    )
    model = build_model(d, Radau(2))
    z, k = a * h, np.arange(n + 1)
    under = 1 + 2 * z / 3 + z**2 / 6
    R = (1 - z / 3) / under
    slope = (-1 / 3 - R * (2 / 3 + z / 3)) / under
    for engine in (PythonInstance, NativeInstance):
        found = run(SensitiveSteps(model, engine(model), ["a", "x"]), Options(stop=n * h, step=h))
        np.testing.assert_allclose(found.column("d(x)/d(x)"), R**k, rtol=1e-11)
        np.testing.assert_allclose(found.column("d(x)/d(a)")[1:], (2.0 * k * R ** (k - 1.0) * slope * h)[1:], rtol=1e-9)


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize(("name", "order"), wide([("drive", 4), ("smib", 2)], ("drive", 4)))
def test_damped_steps_have_the_differences_of_runs(name: str, order: int) -> None:
    by, options = BY, OPTIONS
    if name == "smib":
        by, options = (
            ["gen.J", "line.R"],
            Options(stop=0.01, step=1e-3, events=(Event(4e-3, "gen.field.v", 500.0),), restart=2),
        )
    errors = worst(build(name).declaration(), by, options, order)
    assert {k: e for k, e in errors.items() if e > 1e-7} == {}


def _composed(engine: Any = NativeInstance, order: int = 2) -> tuple[Any, Any]:
    d = build("drive").declaration()
    model = build_model(d, default_scheme(d, order))
    return model, engine(model)


@pytest.mark.usefixtures("compiler")
def test_values_are_those_of_the_damped_run() -> None:
    model, instance = _composed()
    found, plain = run(SensitiveSteps(model, instance, BY), OPTIONS), run(Monolithic(*_composed()), OPTIONS)
    assert all(found.column(n).tolist() == plain.column(n).tolist() for n in plain.names)
    undamped = gradient(*_composed(), Options(stop=0.02, step=1e-3, events=EVENTS), OF, BY)
    damped = gradient(*_composed(), OPTIONS, OF, BY)
    assert (np.abs(damped.slopes - undamped.slopes) > 1e-7 * np.abs(damped.slopes)).any()


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("memory", [150_000_000, 0])
def test_backwards_is_forward_whatever_is_kept(memory: int) -> None:
    forward = gradient(*_composed(order=4), OPTIONS, OF, BY, mode="forward")
    reverse = gradient(*_composed(order=4), OPTIONS, OF, BY, mode="reverse", memory=memory)
    assert reverse.slopes == pytest.approx(forward.slopes, rel=1e-12)


def _apart(network: Network, order: int) -> Coupled:
    return Coupled(network, members(network, order), newton)


@pytest.mark.usefixtures("compiler")
def test_members_apart(order: int = 4) -> None:
    network = build("drive").system
    assert isinstance(network, Network)
    stepper = SensitiveMembers(_apart(network, order), BY)
    found = run(stepper, OPTIONS)

    def of(value: float) -> Result:
        return run(_apart(with_settings(network, {"motor.R": value}), order), OPTIONS)

    base = float(next(p for p in network.declared["motor"].parameters if p.name == "R").start[0])
    signals = ["motor.terminal.i", "load.energy.stored", "shaft.twist"]

    def values(v: float) -> np.ndarray:
        result = of(v)
        return np.array([result.column(s) for s in signals])

    slopes = richardson(values, base, 1e-3 * base)
    own = np.array([found.column(derivative_name(s, "motor.R")) for s in signals])
    assert own == pytest.approx(slopes, rel=1e-8, abs=1e-9 * np.abs(slopes).max())
    one, two = (gradient(network, _apart(network, order), OPTIONS, OF, BY, mode=m) for m in ("forward", "reverse"))
    assert two.slopes == pytest.approx(one.slopes, rel=1e-12)


def well() -> ph.PHDAE:
    """A body in two wells, pulled by a force: along the barrier a Radau step may gain energy."""
    q, p = ph.state("q", start=0.3), ph.state("p", start=0.2)
    k, r = ph.parameter("k", 30.0), ph.parameter("r", 0.01)
    return ph.PHDAE(
        "well", states=(q, p), parameters=(k, r), energies=(ph.energy(p.sx**2 / 2), ph.energy(k.sx * (q.sx**2 - 1) ** 2 / 4)),
        structure=(ph.skew(q, p, 1.0),), dissipation=(ph.damping(p, r),),
    )  # fmt: skip


@pytest.mark.usefixtures("compiler")
def test_steps_that_would_gain_are_derived_as_the_exact_ones_they_are() -> None:
    """Of the steps that were to be damped some are, some are taken by the exact scheme."""
    d = well()
    events = tuple(Event(0.5 * i, "r", 0.01 + 0.01 * i) for i in range(1, 4))
    options = Options(stop=2.0, step=0.05, events=events, restart=4)
    model = build_model(d)
    stepper = SensitiveSteps(model, NativeInstance(model), ["k", "q"])
    found = run(stepper, options)
    assert any("were taken by the energy-exact scheme" in n for n in found.notes)
    errors = worst(d, ["k", "q"], options, 2, part=1e-4)
    assert {k: e for k, e in errors.items() if e > 1e-7} == {}
    one, two = (
        gradient(model, NativeInstance(model), options, ["q@end", "rms(p)"], ["k", "q"], mode=m)
        for m in ("forward", "reverse")
    )
    assert two.slopes == pytest.approx(one.slopes, rel=1e-11)


@pytest.mark.usefixtures("compiler")
def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    common = ["run", "drive", "--restart", "2", "--sensitivity", "motor.R", "--stop", "0.02", "--step", "1e-3"]
    data = tmp_path / "voltage.csv"
    data.write_text("time,motor.terminal.v\n0,0\n0.005,12\n")
    common += ["--input", str(data), "--signals", "shaft.twist"]
    one, two = tmp_path / "one.csv", tmp_path / "two.csv"
    assert main([*common, "-o", str(one)]) == 0
    assert main([*common, "--coupling", "newton", "-o", str(two)]) == 0
    name = derivative_name("shaft.twist", "motor.R")
    slopes = open_result(one).column(name)
    assert np.abs(slopes).max() > 0
    assert open_result(two).column(name) == pytest.approx(slopes, rel=1e-3)
    capsys.readouterr()
    assert main(["run", "buffer", "--sensitivity", "body.e", "--restart", "4"]) == 2
    assert "derivatives through state events are told of steps that are not damped" in capsys.readouterr().err
