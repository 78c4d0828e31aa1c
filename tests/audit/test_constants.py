"""Random models with a constant in H: made energy is told, whatever the constant; models that make none stay closed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest

import phfmu as ph
from phfmu import PHDAE, Collocated, NativeInstance, Options, block, build_model, energy
from phfmu.audit import AuditWriter, summarise
from phfmu.audit.violation import ViolationKind
from phfmu.cli import main
from phfmu.components.library import build
from phfmu.declare.energy import Energy
from phfmu.fmu.importer.reader import FMUInstance
from phfmu.network.as_unit.export import export_network
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.network.couplings.unit import FMUStepper
from phfmu.network.members.fmu_member import FMUMember
from phfmu.runs.loop import run
from tests.test_random_models import STRUCTURES, N, declaration
from tests.wide import turning, wide

pytestmark = pytest.mark.usefixtures("compiler")
#: how a constant is in H: by itself, in a term with states, as a function of it that has no value at zero, in an offset
HIDDEN = ("term", "summand", "logarithm", "offset")
CASES = wide([(s, how) for s in STRUCTURES for how in HIDDEN], ("ode", "summand"), ("index 1 varying", "offset"))
DRAWS = 6


def with_constant(how: str, first: Energy, x: ca.SX, c: ca.SX) -> tuple[Energy, ...]:
    """The first term with about c [J] in it; the motion is that of the model without."""
    if how == "term":
        return first, energy(c)
    if how == "summand":
        return (replace(first, expr=first.expr + c),)
    if how == "logarithm":
        return first, energy(c + 0.01 * ca.log(2 + x) + 0.01 * ca.log(1 / (2 + x)))
    offset = ca.sqrt(2 * c)  # (x + offset)^2 / 2 = c + offset x + x^2 / 2
    return (replace(first, expr=first.expr + (x + offset) ** 2 / 2 - offset * x - x**2 / 2),)


@cache
def model_of(name: str, how: str, order: int):
    """A random model with parameters `made`, the entry of J that is not skew, and `constant`."""
    d: PHDAE = declaration(name)
    made, constant = ph.parameter("made", 0.0), ph.parameter("constant", 0.0)
    (J,) = d.structure
    bump = ca.SX.zeros(*J.matrix.shape)
    bump[0, 2] = made.sx
    first, *others = d.energies
    energies = (*with_constant(how, first, d.states[0][0], constant.sx), *others)
    whole = replace(
        d,
        energies=energies,
        structure=(block(J.variables, J.matrix + bump),),
        parameters=(*d.parameters, made, constant),
    )
    return build_model(whole, Collocated(order // 2))


@dataclass(frozen=True)
class Draw:
    """Coefficients and starts of a random model, an entry that is not skew, and a constant in H [J]."""

    p: np.ndarray
    x: np.ndarray
    made: float
    constant: float


def drawn(rng: np.random.Generator) -> Draw:
    constant = 10.0 ** rng.uniform(4.0, 12.0)
    return Draw(rng.uniform(-1, 1, 150), rng.uniform(-1, 1, N), 10.0 ** rng.uniform(-5.0, 0.0), constant)


def summary(name: str, how: str, order: int, draw: Draw, *, sound: bool, steps: int = 200):
    """The ledger of a run, sound or with energy that is made."""
    model = model_of(name, how, order)
    instance = NativeInstance(model)
    instance.set_parameters(np.array([*draw.p, 0.0 if sound else draw.made, draw.constant]))
    instance.set_x(0.0, draw.x)
    instance.initialise()
    return run(Monolithic(model, instance), Options(stop=0.02 * steps, step=0.02)).ledger.summary()


@pytest.mark.parametrize(("name", "how"), CASES)
def test_a_constant_in_H_hides_no_made_energy_and_raises_no_alarm(name: str, how: str) -> None:
    rng, wrong = np.random.default_rng([list(STRUCTURES).index(name), HIDDEN.index(how)]), []
    order = (2, 4, 6)[rng.integers(3)]
    for _ in range(DRAWS):
        draw = drawn(rng)
        for sound in (True, False):
            found = summary(name, how, order, draw, sound=sound)
            if found.closed is not sound:
                wrong.append((sound, draw.constant, draw.made, found.share, found.violations))
    assert wrong == []


@pytest.mark.parametrize("order", wide([2, 4, 6], 2))
@pytest.mark.parametrize("how", ["composed", "apart", "file"])
def test_a_constant_that_an_event_brings_hides_no_made_energy(how: str, order: int, tmp_path) -> None:
    """1e12 J come into the term of the states, booked as a jump; J that is not skew from then on makes 0.3 J beside them."""
    for made in (0.0, 0.0025):
        x, y = ph.state("x", start=1.0), ph.state("y")
        store, gain = ph.parameter("store", 0.0), ph.parameter("gain", 0.0)
        J = ca.SX.zeros(2, 2)
        J[0, 1], J[1, 0], J[1, 1] = 1.0, -1.0, gain.sx
        H = energy(2.5 * (x.sx**2 + y.sx**2) + store.sx)
        d = PHDAE(
            "flywheel", states=(x, y), energies=(H,), structure=(block([x, y], J),), parameters=(store, gain)
        )  # fmt: skip
        model = build_model(d, Collocated(order // 2))
        stepper, prefix = Monolithic(model, NativeInstance(model)), ""
        if how == "apart":
            net = ph.Network("two")
            net.add("a", d)
            net.add("b", PHDAE("still", states=(z := ph.state("z", start=1.0),), energies=(energy(z.sx**2),)))
            models = {n: build_model(m, Collocated(order // 2)) for n, m in net.declared.items()}
            members: list[Any] = [ph.EngineMember(n, m, NativeInstance(m)) for n, m in models.items()]
            stepper, prefix = ph.Coupled(net, members), "a."
        sink = AuditWriter(tmp_path / f"{made}.audit.parquet") if how == "file" else None
        events = [ph.Event(0.5, f"{prefix}gain", made), ph.Event(0.5, f"{prefix}store", 1e12)]
        found = run(stepper, Options(stop=10.0, step=0.01, events=events, sink=sink)).ledger.summary()
        assert found.closed is (made == 0.0), found
        assert sum(c.jumps or 0.0 for c in found.components) == pytest.approx(1e12)
        if sink is not None:
            sink.close()
            assert summarise(tmp_path / f"{made}.audit.parquet").closed is (made == 0.0)


@pytest.mark.parametrize(("version", "how", "order"), wide(
    [(v, how, k) for v in ("2.0", "3.0") for how in ("alone", "coupled", "members inside") for k in (2, 4)],
    ("2.0", "alone", 2), ("3.0", "coupled", 4), ("3.0", "members inside", 4),
))  # fmt: skip
@pytest.mark.parametrize("store", ["start", "event"])
def test_a_unit_tells_its_constant(version: str, how: str, order: int, store: str, tmp_path) -> None:
    """5 J that a J that is not skew makes, beside 1e12 J that the unit is started with, or is given in the run."""
    x, y = ph.state("x", start=1.0), ph.state("y")
    constant, gain = ph.parameter("constant", 0.0), ph.parameter("gain", 0.0)
    J = ca.SX.zeros(2, 2)
    J[0, 1], J[1, 0], J[1, 1] = 1.0, -1.0, gain.sx
    d = PHDAE(
        "flywheel", states=(x, y), energies=(energy(2.5 * (x.sx**2 + y.sx**2) + constant.sx),),
        structure=(block([x, y], J),), parameters=(constant, gain),
    )  # fmt: skip
    scheme, names = Collocated(order // 2), ["constant", "gain"]
    if how == "members inside":
        inside = ph.Network("inside")
        inside.add("a", d)
        inside.add("b", PHDAE("still", states=(z := ph.state("z", start=1.0),), energies=(energy(z.sx**2),)))
        names = ["a.constant", "a.gain"]
        (path,) = export_network(inside, tmp_path, dict.fromkeys("ab", scheme), [version], step=0.01, tunable=names)
    else:
        (path,) = ph.export(build_model(d, scheme), tmp_path, [version], step=0.01, tunable=names)
    for made in (0.0, 0.0025):
        given = {names[0]: 1e12 if store == "start" else 0.0, names[1]: made}
        with FMUInstance(path, starts=given) as unit:
            stepper: Any = FMUStepper(unit)
            prefix = "unit." if how == "coupled" else ""
            if how == "coupled":
                net = ph.Network("two")
                net.add("unit", path)
                stepper = ph.Coupled(net, [FMUMember("unit", unit)])
            events = [ph.Event(0.5, prefix + names[0], 1e12)] if store == "event" else []
            found = run(stepper, Options(stop=10.0, step=0.01, events=events)).ledger.summary()
        assert found.closed is (made == 0.0), found


def test_units_without_a_constant_have_no_variable_for_it(tmp_path) -> None:
    (path,) = ph.export(build_model(build("smib").declaration()), tmp_path, ["3.0"], step=1e-4)
    with FMUInstance(path) as unit:
        assert "energy.constant" not in unit.interface.variables


def test_compiled_sweeps_leave_such_events_to_the_usual_loop() -> None:
    from phfmu.sweeps.native_runs import fits

    x, store, k = ph.state("x", start=1.0), ph.parameter("store", 0.0), ph.parameter("k", 1.0)
    d = PHDAE("held", states=(x,), energies=(energy(k.sx * x.sx**2), energy(store.sx)), parameters=(store, k))
    model = build_model(d)
    for name, taken in (("k", True), ("store", False)):
        options = Options(stop=1.0, step=0.1, events=[ph.Event(0.5, name, 2.0)])
        assert fits(SimpleNamespace(options=options, model=model)) is taken  # type: ignore[arg-type]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ode", "index 1 varying"])
def test_long_runs_beside_a_constant_stay_closed(name: str) -> None:
    """1e5 steps: what rounding adds up stays far below the bound on the sum."""
    found = summary(name, "summand", 2, drawn(np.random.default_rng(1)), sound=True, steps=100_000)
    assert found.closed, found.violations
    assert max(c.run_ratio for c in found.components) <= 0.1


def test_what_is_small_in_every_step_is_told_of_the_run() -> None:
    """Beside 1e12 J in a state that holds its energy, 1e-2 J of a step are rounding; what 1e5 steps make together is not."""
    x, y, w = ph.state("x", start=1.0), ph.state("y"), ph.state("w", start=1e6)
    J = ca.SX.zeros(3, 3)
    J[0, 1], J[1, 0], J[1, 1] = 1.0, -1.0, 1e-3
    energies = energy(50 * (x.sx**2 + y.sx**2)), energy(w.sx**2)
    model = build_model(PHDAE("flywheel", states=(x, y, w), energies=energies, structure=(block([x, y, w], J),)))
    found = run(Monolithic(model, NativeInstance(model)), Options(stop=10.0, step=1e-4)).ledger.summary()
    assert {v.kind for v in found.violations} == {ViolationKind.RUN, ViolationKind.UNEXPLAINED_RUN}, found
    assert found.components[0].worst_ratio < 0.5
    assert found.violations[0].size == pytest.approx(50 * (np.exp(1.0) - 1), rel=0.05)


#: scenes by how many times their stop: those of machines, which have thousands of steps, a part of it
LIBRARY = {
    **dict.fromkeys(("bouncing_ball", "buffer", "hard_stop", "clutch_engagement", "two_point_control"), 10.0),
    **dict.fromkeys(
        ("breaker_opening", "rectifier", "six_pulse", "bead", "oscillator", "drive", "speed_control"), 10.0
    ),
    **dict.fromkeys(("smib", "smib_folded", "ladder", "two_machine"), 0.3),
}


@pytest.mark.parametrize(("name", "order"), turning(LIBRARY, ["2", "4", "6"]))
def test_every_scene_of_the_library_stays_closed(name: str, order: str, capsys: pytest.CaptureFixture[str]) -> None:
    """A rotor with 2e9 J, springs under load, events: exit code 4 would be a false alarm."""
    assert main(["run", name, "--order", order, "--stop", str(LIBRARY[name] * build(name).stop)]) == 0, (
        capsys.readouterr().err
    )


def test_energies_without_digits_are_not_judged() -> None:
    """A swing of 1e-160 m: its energies are below the smallest number that has all its digits."""
    q, p = ph.state("q", unit="m", start=1e-160), ph.state("p", unit="kg.m/s", start=1e-162)
    H = energy(50 * q[0] ** 2 + p[0] ** 2 / 2)
    swing = PHDAE("swing", (q, p), energies=(H,), structure=(ph.skew(q, p, 1.0),))
    found = run(Monolithic(model := build_model(swing), NativeInstance(model)), Options(stop=10.0, step=0.1))
    assert found.ledger.summary().violations == []
