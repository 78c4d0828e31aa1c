"""Networks: the algebra of junctions, and members stepped apart that give the composed model."""

from __future__ import annotations

from dataclasses import replace
from itertools import chain, cycle, product, repeat
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phfmu import (
    PHDAE,
    Collocated,
    Network,
    Options,
    StepFailure,
    build_model,
    export,
    run,
)
from phfmu.components.electrical.rl_line import rl_line
from phfmu.components.electrical.rlc_load import rlc_load
from phfmu.components.mechanical.translational import mass, spring
from phfmu.components.scenes.drive import drive
from phfmu.components.scenes.electrical.smib import smib
from phfmu.components.scenes.electrical.two_machine import two_machine
from phfmu.components.scenes.mechanical.oscillator import oscillator
from phfmu.fmu.importer.reader import FMUInstance
from phfmu.network.couplings.coupled import Coupled
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.network.junction import ConnectionError
from phfmu.network.members.consistent import InconsistentState
from phfmu.network.members.engine_member import EngineMember
from phfmu.network.members.fmu_member import FMUMember
from phfmu.outcome.status import Status
from phfmu.runs.result import Result
from tests.engines import BY_NAME
from tests.wide import wide

PHASES = (1.0, -0.5, -0.5)


def member(name: str, declaration: PHDAE, kind: str, folder: Any = None, step: float = 0.01) -> Any:
    """A member of a coupled network: stepped in Python, in compiled code, or as an exported unit."""
    own = replace(declaration, name=name)
    model = build_model(own)
    if kind != "fmu":
        return EngineMember(name, model, BY_NAME[kind](model))
    (path,) = export(model, folder, versions=("3.0",), step=step)
    return FMUMember(name, FMUInstance(path))


def couple(net: Network, kinds: str = "python", folder: Any = None, step: float = 0.01) -> Coupled:
    """Members in turn of the kinds."""
    kind = cycle(kinds.split())
    return Coupled(net, [member(n, d, next(kind), folder, step) for n, d in net.members.items()])


def composed(net: Network, engine: str = "python", impulses: bool = True) -> Monolithic:
    """One model; without impulses at bare nodes where coupled members do not exchange them."""
    model = build_model(net.compose(), Collocated(1, impulses=impulses))
    return Monolithic(model, BY_NAME[engine](model))


def joined(members: dict[str, PHDAE], *junctions: tuple[str, ...], kind: Any = None) -> Network:
    """Members and their junctions ("name", "member.port", ...)."""
    net = Network("net")
    for name, declaration in members.items():
        net.add(name, declaration)
    for name, *ports in junctions:
        net.junction(name, ports, kind=kind)
    return net


def both(net: Network, stop: float = 0.2, step: float = 0.01) -> tuple[Result, Result]:
    """The network composed and coupled; the states agree and the ledgers close."""
    one, two = (run(s, Options(stop=stop, step=step)) for s in (composed(net), couple(net)))
    same(net, one, two, 1e-10)
    return one, two


def same(net: Network, one: Result, two: Result, rtol: float) -> None:
    """Columns of both agree after the start; values at the end of a step that follow held inputs may differ."""
    d = net.compose()
    ends = {n.partition("[")[0] for p in d.ports for n in p.output_names()} | {o.name for o in d.observables}
    groups: dict[str, list[str]] = {}
    for n in set(one.names) & set(two.names):
        base = n.partition("[")[0]
        if base not in ends and not n.startswith("constraint.") and not base.endswith(("_end", "energy.residual")):
            groups.setdefault("energy" if ".energy" in n else base, []).append(n)
    assert {v.name for v in (*d.states, *d.algebraics)} <= set(groups) and np.array_equal(one.time, two.time)
    for group, names in groups.items():
        a, b = (np.array([r.column(n) for n in names]) for r in (one, two))
        assert np.abs(a - b)[:, 1:].max() <= rtol * np.abs(a).max() + 1e-13, group


def closes(result: Result, rtol: float = 1e-11) -> None:
    """Components close, and junctions with what is unexplained account for the network."""
    s = result.ledger.summary()
    net = s.network
    scale = max(abs(p.supplied) for p in s.ports) + sum(abs(c.H_end) for c in s.components)
    assert all(c.worst_relative <= rtol for c in s.components)
    assert net.junction_residual == pytest.approx(sum(j.residual for j in s.junctions), abs=1e-14 * scale)
    balance = net.stored + (net.dissipated or 0.0) - (net.external or 0.0)
    assert balance == pytest.approx(net.junction_residual + net.unexplained, abs=1e-14 * scale)
    assert abs(net.unexplained) <= rtol * scale and abs(net.junction_residual) <= 1e-9 * scale


# -- junctions -----------------------------------------------------------------------------------------------


def test_rigid_link_of_two_masses() -> None:
    """Both are given their force: the force in the link is the multiplier."""
    m1, m2, k = 1.0, 2.0, 10.0
    net = joined({"a": mass(m1, k=k, q=0.1, v=0.3), "b": mass(m2, v=0.3)}, ("link", "a.flange", "b.flange"))
    declaration = net.compose()
    assert [v.name for v in declaration.algebraics] == ["link.velocity", "a.flange.force", "b.flange.force"]
    for result in both(net, stop=1.0):
        t, w = result.time, np.sqrt(k / (m1 + m2))
        q = 0.1 * np.cos(w * t) + 0.3 / w * np.sin(w * t)
        assert np.allclose(result.column("a.q"), q, rtol=0, atol=1e-4)
        assert np.allclose(result.column("a.v"), result.column("b.v"), rtol=0, atol=1e-13)
        force, middle = result.column("b.flange.force")[1:], (q[1:] + q[:-1]) / 2
        assert np.allclose(force, -result.column("a.flange.force")[1:], rtol=1e-12)
        assert np.allclose(force, -k * m2 / (m1 + m2) * middle, rtol=0, atol=1e-3)
        closes(result)


@pytest.mark.parametrize(
    "net, words",
    [
        (joined({"a": mass(v=0.3), "b": mass()}, ("link", "a.flange", "b.flange")),
         ("0.3", "flange.force", "link.velocity")),
        (joined({"a": rl_line(1.0, 0.1, i=PHASES), "b": rl_line(1.0, 0.1)}, ("bus", "a.b", "b.a")),
         ("0.5", "bus.v[3]", "bus.v[3]")),
        (joined({"a": rlc_load(C=1.0, v=PHASES), "b": rlc_load(C=1.0), "r": rlc_load(R=1.0)},
                ("bus", "a.terminal", "b.terminal", "r.terminal")), ("0.5", "terminal.i[2]", "bus.v[2]")),
    ],
    ids=["inelastic", "Kirchhoff", "capacitors"],
)  # fmt: skip
def test_inconsistent_starts_are_refused(net: Network, words: tuple[str, str, str]) -> None:
    number, composed_name, coupled_name = words
    for stepper, name in ((composed(net), composed_name), (couple(net), coupled_name)):
        before = stepper.energies()
        with pytest.raises(InconsistentState, match="net: inconsistent start") as refusal:
            run(stepper, Options(stop=0.1, step=0.01))
        assert name in str(refusal.value) and number in str(refusal.value) and "change the start" in str(refusal.value)
        assert np.array_equal(stepper.energies(), before)


@pytest.mark.parametrize("what", wide(["line", "capacitor", "both"], "both"))
def test_resistors_at_a_bus(what: str) -> None:
    """Three resistors with an inductive line, a capacitor, or both: the parallel resistance decides."""
    parts = {f"r{i}": rlc_load(R=float(i)) for i in (1, 2, 3)}
    R, L, C = 6 / 11, 0.1, 0.2
    if what != "capacitor":
        parts["l"] = rl_line(0.5, L, i=PHASES)
    if what != "line":
        parts["c"] = rlc_load(C=C, v=PHASES)
    net = joined(parts, ("bus", *(f"{n}.b" if n == "l" else f"{n}.terminal" for n in parts)))
    for result in both(net, stop=0.1, step=2e-3):
        t = result.time
        if what == "line":
            assert np.allclose(result.column("l.i[1]"), np.exp(-(0.5 + R) / L * t), rtol=0, atol=1e-4)
        if what == "capacitor":
            assert np.allclose(result.column("c.v[1]"), np.exp(-t / (R * C)), rtol=0, atol=1e-4)
        v = result.column("bus.v[1]")[1:]
        total = sum(result.column(f"r{i}.terminal.i_step[1]")[1:] for i in (1, 2, 3))
        assert np.allclose(total, v / R, rtol=1e-11)
        closes(result)


def test_a_member_joined_to_itself() -> None:
    """Both ends of a line at one bus: its current decays by its own resistance, and the bus does not see it."""
    parts = {"l": rl_line(0.5, 0.1, i=PHASES), "c": rlc_load(R=2.0, C=0.1, v=(3.0, 0.0, 1.0))}
    net = joined(parts, ("bus", "l.a", "l.b", "c.terminal"))
    for result in both(net):
        decay = np.exp(-5 * result.time)
        assert np.allclose(result.column("l.i[1]"), decay, rtol=0, atol=1e-4)
        assert np.allclose(result.column("c.v[1]"), 3 * decay, rtol=0, atol=3e-4)
        closes(result)


def test_an_uncoupled_part() -> None:
    """A member without a connection, and a second pair, run beside the first."""
    net = joined({"a": mass(1.0, q=0.2), "s": spring(4.0, elongation=0.2), "alone": mass(2.0, k=8.0, q=1.0),
                  "b": mass(1.0, v=1.0), "z": spring(9.0)},
                 ("one", "a.flange", "s.b"), ("two", "b.flange", "z.b"))  # fmt: skip
    for result in both(net, stop=0.5):
        assert np.allclose(result.column("alone.q"), np.cos(2 * result.time), rtol=0, atol=1e-4)
        assert np.allclose(result.column("b.v"), np.cos(3 * result.time), rtol=0, atol=2e-4)
        assert result.ledger.summary().network.stored == pytest.approx(0.0, abs=1e-13)
        closes(result)


def test_junctions_that_cannot_be_made() -> None:
    net = joined({"a": mass(), "b": mass(), "s": spring()}, ("left", "a.flange", "s.a"))
    wrong = {"needs at least two": ["s.b"], "joins s.b to itself": ["s.b", "s.b"], "no member 'c'": ["c.x", "s.b"]}
    for words, ports in (wrong | {"joined at 'left' already": ["b.flange", "s.a"]}).items():
        with pytest.raises(ConnectionError, match=words):
            net.junction("right", ports)
    for name, words in (("left", "taken"), ("a", "taken"), ("new joint", "letter")):
        with pytest.raises(ConnectionError, match=words):
            net.junction(name, ["b.flange", "s.b"])
    assert len(net.junctions) == 1


# -- composed and coupled ------------------------------------------------------------------------------------


SCENES = {
    "oscillator": (oscillator, 1.0, 0.01),
    "drive": (drive, 0.02, 1e-4),
    "smib": (smib, 0.005, 1e-4),
    "two_machine": (lambda: two_machine(t_fault=0.01, t_clear=0.02015), 0.025, 2e-4),
}
MIXED = "native python fmu"
WAYS = [*product(SCENES, ("native", MIXED)), ("oscillator", "python"), ("drive", "python")]
QUICK = [
    ("oscillator", "native"),
    ("drive", "native"),
    ("two_machine", "native"),
    ("smib", MIXED),
]


@pytest.mark.parametrize("name, kinds", wide(WAYS, *QUICK))
def test_coupled_is_composed(name: str, kinds: str, tmp_path: Path) -> None:
    """Members in Python, compiled, and as units in one network; events fall between the grid points.

    A unit that is exported without impulses takes none at a bare node: then the composed model does without them too.
    """
    make, stop, step = SCENES[name]
    scene, net = make(), make().system
    apart = couple(net, kinds, tmp_path, step)
    units = {m.name for m in apart.joined.members if isinstance(m, FMUMember)}
    held = any(e.member in units for j in net.junctions if j.name == "bus1" for e in j.ends)
    mono = run(composed(net, "native", not held), Options(stop=stop, step=step, events=scene.events))
    two = run(apart, Options(stop=stop, step=step, events=scene.events))
    same(net, mono, two, 1e-10)
    for result in (mono, two):
        closes(result)
    assert two.iterations <= 4 * two.steps


def test_names() -> None:
    """Columns are those of the composed model: what junctions add stands among the algebraic variables."""
    net: Any = smib().system
    d, stepper = net.compose(), couple(net, "native")
    junction = [f"{v}[{i}]" for v in ("bus1.v", "bus2.v", "grid.terminal.i") for i in (1, 2, 3)]
    assert [n for v in d.algebraics for n in v.names() if n in junction] == junction
    assert d.junctions == (("bus1", ("gen.terminal", "line.a")), ("bus2", ("line.b", "grid.terminal")))
    assert stepper.names == composed(net, "native").names
    assert stepper.names[-3:] == [f"constraint.velocity.bus1.v[{i}]" for i in (1, 2, 3)]
    shown = {"gen.terminal.i_step[1]", "gen.I[1]", "line.flux[3]", "grid.source.energy", "gen.energy.stored"}
    assert shown <= set(composed(net, "native").names) and shown <= set(stepper.names)
    assert len(set(stepper.names)) == len(stepper.names) == len(stepper.read())
    assert {"gen.shaft.torque", "gen.J"} <= set(stepper.settable())
    for name, words in (("gen.terminal.v", "fed by a junction"), ("gen.JJ", "did you mean gen.J"), ("q", "no param")):
        with pytest.raises(KeyError, match=words):
            stepper.set_value(name, 1.0)


# -- steps that fail, and members that say less --------------------------------------------------------------


def bits(stepper: Coupled) -> list[Any]:
    """Everything that the members and the junctions hold."""
    first, second, third = stepper.joined.members
    python, unit = second.get_state(), third.unit
    return [first.get_state(), [np.array(python.x).tobytes(), python.carry.tobytes(), python.w.tobytes(), python.t],
            unit.serialize(unit.get_state()), unit.time, stepper.last.xi.tobytes()]  # fmt: skip


@pytest.mark.parametrize("error", [StepFailure(Status.NO_CONVERGENCE, "spring12", 0.2, 0.01), ValueError("not finite")])
@pytest.mark.parametrize("trial", [1, 2])
def test_rollback(tmp_path: Path, error: Exception, trial: int) -> None:
    """After a member failed in any trial of a step, all are bitwise where they were, and can go on."""
    kinds, net = "native python fmu", oscillator().system
    stepper, twin = couple(net, kinds, tmp_path), couple(net, kinds, tmp_path)
    for k in range(5):
        stepper.advance(k * 0.01, 0.01, 1)
    before, called = bits(stepper), stepper.joined.members[1]
    sound, left = called.do_step, chain(repeat(None, trial - 1), repeat(error))

    def stubborn(t: float, h: float) -> None:
        sound(t, h)
        if refusal := next(left):
            raise refusal

    called.do_step = stubborn
    with pytest.raises(type(error), match=str(error)[:8]):
        stepper.advance(0.05, 0.01, 1)
    assert bits(stepper) == before
    called.do_step = sound
    stepper.advance(0.05, 0.01, 1)
    for k in range(6):
        twin.advance(k * 0.01, 0.01, 1)
    assert bits(twin) == bits(stepper)


def test_finite_differences(tmp_path: Path) -> None:
    """Units without derivatives: differences stand in, and the ledger is exact.  Two internal steps have derivatives."""
    net = drive().system
    stepper = couple(net, "fmu", tmp_path, step=5e-5)
    stepper.advance(0.0, 1e-4, 1)
    assert np.isfinite(stepper.joined.members[0].unit.sensitivity()).all()
    stepper = couple(net, "fmu", tmp_path, step=5e-5)
    for unit in (m.unit for m in stepper.joined.members):
        unit.interface = replace(unit.interface, derivatives=False)
    with pytest.raises(StepFailure, match="sensitivity"):
        stepper.joined.members[0].unit.sensitivity()
    result = run(stepper, Options(stop=0.01, step=1e-4))
    closes(result)
    fine = run(composed(net, "native"), Options(stop=0.01, step=5e-5))
    assert result.column("load.w")[-1] == pytest.approx(fine.column("load.w")[-1], rel=1e-4)
