"""Machines coupled at order 2k against solutions of another method; events, starts, the way back, members that say less."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from reference_tools import read

from phfmu import (
    ELECTRICAL,
    PHDAE,
    Anderson,
    Collocated,
    Coupled,
    EngineMember,
    Event,
    Monolithic,
    NativeInstance,
    Network,
    Options,
    Port,
    PythonInstance,
    StepFailure,
    build_model,
    damping,
    energy,
    export,
    run,
    skew,
    state,
)
from phfmu.cli import main
from phfmu.components.electrical.rl_line import rl_line
from phfmu.components.scenes.electrical.smib import smib
from phfmu.components.scenes.electrical.two_machine import two_machine
from phfmu.fmu.importer.reader import FMUInstance
from phfmu.network.couplings.choice.partitioned_network import PartitionedNetwork
from phfmu.network.interface.unknowns import InterfaceUnknowns
from phfmu.network.members.consistent import InconsistentState
from phfmu.network.members.fmu_member import FMUMember
from phfmu.network.members.node_values import InstanceNodes, node_values
from phfmu.outcome.status import Status
from phfmu.signals import CONSTRAINT
from phfmu.terms.bare import bare_nodes
from phfmu.terms.extraction.extract import extract
from tests.network.test_coupled_units import states_differ
from tests.schemes.bare_scenes import RATED, STOP, lumped, mean_voltage, saturable
from tests.wide import slow

pytestmark = pytest.mark.usefixtures("compiler")


def couple(net: Network, k: int, engine: Any = NativeInstance) -> Coupled:
    members = []
    for name, d in net.members.items():
        model = build_model(replace(d, name=name), Collocated(k))
        members.append(EngineMember(name, model, engine(model)))
    return Coupled(net, members)


# -- against solutions of the circuit without a node -----------------------------------------------------------


def errors(k: int, h: float) -> tuple[float, float, float]:
    """smib, torque + 10 % at t = 0: currents relative to the rated peak, mean node voltage [V], sum of currents [A] at ends."""
    net: Any = smib().system
    apart = couple(net, k)
    (torque,) = (s.start for s in net.members["gen"].ports if s.name == "shaft")
    apart.set_value("gen.shaft.torque", 1.1 * float(np.asarray(torque)))
    apart.check_start()
    apart.prepare(0.0, h)
    rows = apart.advance(0.0, h, round(STOP / h)).signals
    columns = {n: rows[:, i] for i, n in enumerate(apart.names)}
    I = [columns[f"gen.I[{j}]"][-1] for j in (1, 2, 3)]
    v = [columns[f"bus1.v[{j}]"][-1] for j in (1, 2, 3)]
    left = max(np.max(np.abs(columns[n])) for n in apart.names if n.startswith(CONSTRAINT + "velocity.bus1"))
    reference = lumped()[0](STOP)  # type: ignore[operator]
    return float(np.max(np.abs(I - reference)) / RATED), float(np.max(np.abs(v - mean_voltage(h)))), float(left)


@pytest.mark.parametrize(("k", "steps"), [slow((1, (5e-4, 2.5e-4))), (2, (5e-4, 2.5e-4)), slow((3, (2e-3, 1e-3)))])
def test_smib_has_order_2k_in_currents_and_node_voltage(k: int, steps: tuple[float, ...]) -> None:
    found = np.array([errors(k, h) for h in steps])
    slopes = np.log2(found[0, :2] / found[1, :2])
    assert slopes == pytest.approx([2 * k, 2 * k], abs=0.2)
    assert found[:, 2].max() <= 1e-9


@pytest.mark.slow
@pytest.mark.parametrize(("k", "steps"), [(1, (1e-4, 5e-5)), (2, (2e-4, 1e-4)), (3, (2e-4, 1e-4))])
def test_two_machines_have_order_2k_through_fault_and_clearing(k: int, steps: tuple[float, ...]) -> None:
    """Against a solution in abc flux by another method, fault at 0.02 s, clearing at 0.06 s."""
    scene, ref = two_machine(t_fault=0.02, t_clear=0.06, stop=0.1), read("two_machine_early")
    t = ref["time"][(ref["time"] <= 0.1) & (ref["time"] > 0.0)]
    found = []
    for h in steps:
        net: Any = scene.system
        r = run(couple(net, k), Options(stop=0.1, step=h, events=scene.events))
        assert max(v for n, v in r.worst.items() if n.startswith(CONSTRAINT + "velocity.bus1")) <= 1e-9
        assert r.ledger.summary().closed
        on = [s for s in t if abs(s / h - round(s / h)) < 1e-6]
        rows = [int(np.argmin(np.abs(r.time - s))) for s in on]
        places = [int(np.argmin(np.abs(ref["time"] - s))) for s in on]
        gap = [np.max(np.abs(r.column(f"m1.I[{j}]")[rows] - ref[f"I1[{j}]"][places])) for j in (1, 2, 3)]
        found.append(max(gap) / np.max(np.abs(ref["I1[1]"])))
    assert np.log2(found[0] / found[1]) == pytest.approx(2 * k, abs=0.35)


@pytest.mark.parametrize("k", [1, 2, pytest.param(3, marks=pytest.mark.slow)])
def test_there_and_back(k: int) -> None:
    """The impulses of a step back are those of the step, so that all states are where they were."""
    net: Any = smib().system
    apart = couple(net, k)
    apart.set_value("gen.shaft.torque", 1.1e6)
    apart.check_start()
    h, n = 1e-3, 10
    nominal = [np.array([x for v in m.model.declaration.states for x in v.nominal]) for m in apart.joined.members]
    before = [m.instance.x for m in apart.joined.members]
    apart.advance(0.0, h, n)
    away = [m.instance.x for m in apart.joined.members]
    apart.advance(n * h, -h, n)
    for m, x0, x1, size in zip(apart.joined.members, before, away, nominal, strict=True):
        assert np.max(np.abs(m.instance.x - x0) / np.maximum(size, np.abs(x0)), initial=0.0) <= 1e-12
        if len(x0) > 3:
            assert np.max(np.abs(x1 - x0) / size) > 1e-4


# -- events and starts -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("engine", "k"), [(NativeInstance, 2), slow((PythonInstance, 1))])
def test_an_event_at_a_node_of_states_moves_them_as_the_composed_model_does(engine: Any, k: int) -> None:
    """The line's inductance falls: one impulse makes the currents sum to zero again, its energy is an event of each member."""
    scene = smib()
    net: Any = scene.system
    L = next(float(v.start[0]) for v in net.members["line"].parameters if v.name == "L")
    options = Options(stop=0.01, step=1e-3, events=[Event(0.005, "line.L", 0.9 * L)])
    model = build_model(scene.declaration(), Collocated(k))
    one = run(Monolithic(model, NativeInstance(model)), options)
    two = run(couple(net, k, engine), options)
    assert states_differ(scene.declaration(), one, two) <= 1e-12
    for result in (one, two):
        assert result.ledger.summary().closed and result.ledger.summary().events == {"parameter": 1, "reprojection": 1}
        assert "left hidden constraints violated; energy changed by -7" in result.notes[0]
    assert max(v for n, v in two.worst.items() if n.startswith(CONSTRAINT + "velocity.bus1")) <= 1e-8
    jump = [float(r.notes[0].partition("changed by ")[2].partition(" J")[0]) for r in (one, two)]
    assert jump[0] == pytest.approx(jump[1], rel=1e-8)


def test_the_energy_of_such_an_impulse_is_that_of_the_formula() -> None:
    """-c.S^-1 c / 2, with the matrix and the sums of the members; units cannot be moved, which is said."""
    net: Any = smib().system
    x = net.members["line"]
    net.members["line"] = x.with_starts({n: v * 1.05 for n, v in _starts(x).items() if n.startswith("flux")})
    apart = couple(net, 2)
    with pytest.raises(InconsistentState, match="joined flows of states must sum to zero"):
        apart.check_start()
    exchange = InterfaceUnknowns(apart.joined)
    columns = exchange.offered
    S = np.zeros((len(columns),) * 2)
    for s in exchange.shares:
        if s.kicked:
            S[np.ix_(s.bare, s.bare)] += s.Q.T @ s.values.jump() @ s.Q
    c = (apart.joined.end_outputs() @ apart.joined.face.P)[columns]
    H = apart.energies()
    found = apart.project_start(0.0)
    assert found.energy == pytest.approx(-c @ np.linalg.solve(S, c) / 2, rel=1e-6)
    assert (apart.energies() - H).sum() == found.energy and abs(found.energy) > 1.0
    assert max(abs(v) for v in found.after.values()) <= 1e-9 * np.abs(c).max()
    apart.check_start()
    with pytest.raises(ValueError, match="cannot be projected"):
        apart.project_start(0.0, ("gen.flux",))


def _starts(declaration: Any) -> dict[str, float]:
    return {n: float(x) for v in declaration.states for n, x in zip(v.names(), v.start, strict=True)}


# -- who takes no impulses -----------------------------------------------------------------------------------------


def turning(name: str) -> PHDAE:
    """An isotropic coil of two axes that turns with its angle; three phases without a neutral: no zero sequence."""
    psi, theta = state("psi", 2, unit="Wb", start=[0.01, 0.0]), state("theta", unit="rad", start=0.3)
    p = state("p", unit="J.s", start=20.0, nominal=20.0)
    angles = [theta.sx - 2 * np.pi * j / 3 for j in range(3)]
    park = np.sqrt(2 / 3) * ca.vertcat(
        ca.horzcat(*(ca.cos(a) for a in angles)), -ca.horzcat(*(ca.sin(a) for a in angles))
    )
    return PHDAE(
        name, (psi, theta, p), energies=(energy(ca.sumsqr(psi.sx) / 2e-3), energy(p.sx**2 / 0.2)),
        structure=(skew(theta, p, 1.0),), dissipation=(damping(psi, 0.1),),
        ports=(Port("terminal", ELECTRICAL, "effort", {psi: park}, 3),),
    )  # fmt: skip


@pytest.mark.parametrize("stop", [0.51, pytest.param(5.0, marks=pytest.mark.slow)])
def test_the_energy_of_a_rotor_does_not_excuse_what_a_junction_creates(stop: float) -> None:
    """2e9 J in the rotor, 44 kJ through the terminal in a step, whose input jumps at 0.5 s: iterations that stall go on."""
    scene = smib()
    models = {name: build_model(replace(d, name=name)) for name, d in scene.system.members.items()}
    members = [EngineMember(name, m, NativeInstance(m)) for name, m in models.items()]
    result = run(Coupled(scene.system, members, Anderson()), Options(stop=stop, step=1e-4, events=scene.events))
    assert result.ledger.summary().closed, result.ledger.summary().worst
    assert result.iterations / result.steps <= 8.0


def test_an_isolated_neutral_gets_no_impulses_composed_and_apart() -> None:
    """The matrix of two coils without zero sequence is singular: one rule says so for both."""
    net = Network("star")
    net.add("a", turning("a"))
    net.add("b", turning("b"))
    net.junction("bus", ["a.terminal", "b.terminal"])
    nodes = bare_nodes(extract(net.compose()))
    assert {n.remedy for n in nodes} == {"none"} and "isolated neutral" in nodes[0].reason
    assert (
        PartitionedNetwork(net)
        .exchanged()["bus"]
        .endswith("no impulses (its inductance matrix is singular (isolated neutral))")
    )
    exchange = InterfaceUnknowns(couple(net, 2, PythonInstance).joined)
    assert exchange.bare == [] and len(exchange.offered) == 3
    grounded = Network("grounded")  # a line with a zero sequence beside one of them: the matrix is regular
    grounded.add("a", turning("a"))
    grounded.add("line", rl_line(0.1, 1e-3, v=10.0))
    grounded.junction("bus", ["a.terminal", "line.a"])
    assert {n.remedy for n in bare_nodes(extract(grounded.compose()))} == {"pair"}
    assert len(InterfaceUnknowns(couple(grounded, 2, PythonInstance).joined).bare) == 3


def test_saturated_branches_exchange_values_only_and_say_why() -> None:
    """Composed they are projected; apart the energy stays exact and the sum of currents is met by the nodes."""
    net = Network("saturated")
    net.add("a", saturable("a", 1.0, 1.0))
    net.add("b", saturable("b", 0.5, -0.6))
    net.junction("bus", ["a.p", "b.p"])
    assert {n.remedy for n in bare_nodes(extract(net.compose()))} == {"projection"}
    words = PartitionedNetwork(net).exchanged()["bus"]
    assert "no impulses" in words and "not quadratic" in words
    drive = Event(0.0, "a.drive.v", 5.0)
    sums = []
    for h in (0.1, 0.05):
        apart = couple(net, 1, PythonInstance)
        assert InterfaceUnknowns(apart.joined).bare == []
        r = run(apart, Options(stop=1.0, step=h, events=[drive], project=True))
        assert r.ledger.summary().closed and max(abs(v) for v in r.projection.after.values()) <= 1e-14
        sums.append(max(v for n, v in r.worst.items() if n.startswith(CONSTRAINT)))
    assert sums[1] < sums[0] / 3


# -- members that say less ---------------------------------------------------------------------------------------


class Silent:
    """An instance whose derivatives are refused, as after more halved internal steps than are kept."""

    def __init__(self, instance: Any):
        self._instance, self.asked = instance, 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._instance, name)

    def node_sensitivity(self, *_: Any, **__: Any) -> Any:
        self.asked += 1
        raise StepFailure(Status.NO_SENSITIVITY, "gen", 0.0, 0.0)


@pytest.mark.parametrize("unit", [slow(False), True], ids=["engine", "unit"])
def test_members_without_derivatives_are_differenced(unit: bool, tmp_path: Any) -> None:
    """Differences with rollback stand in for the derivatives: the run is the composed one."""
    scene = smib()
    net: Any = scene.system
    apart = couple(net, 2, PythonInstance)
    members = apart.joined.members
    if unit:
        model = build_model(replace(net.members["gen"], name="gen"), Collocated(2))
        (path,) = export(model, tmp_path, ("3.0",), step=1e-3, node_inputs=True)
        members = [FMUMember("gen", FMUInstance(path, name="gen", isolate=60.0)), *members[1:]]
        apart = Coupled(net, members)
    gen = apart.coupling.exchange.shares[0].values  # type: ignore[attr-defined]
    assert isinstance(gen, InstanceNodes) and gen.member.name == "gen"
    gen._instance = silent = Silent(gen._instance)
    options = Options(stop=5e-3, step=1e-3, events=[Event(2e-3, "gen.shaft.torque", 2e6)])
    whole = build_model(scene.declaration(), Collocated(2))
    one = run(Monolithic(whole, NativeInstance(whole)), options)
    two = run(apart, options)
    assert silent.asked >= 5 and states_differ(scene.declaration(), one, two) <= 1e-12
    assert node_values(gen.member).rule.k == 2


def test_info_says_what_is_exchanged_and_the_order_that_follows(capsys: Any) -> None:
    assert main(["info", "smib"]) == 0
    text = capsys.readouterr().out
    assert "newton: k values and a pair of impulses, order 2k" in text
    assert "newton: k values, order 2k" in text
