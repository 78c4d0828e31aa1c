"""State events of members that are stepped apart: inside their steps, booked at each member, of order 2 with held inputs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from phfmu import (
    Collocated,
    Coupled,
    EngineMember,
    Event,
    FMUInstance,
    FMUMember,
    Monolithic,
    NativeInstance,
    Network,
    Options,
    build_model,
    export,
    run,
)
from phfmu.audit import AuditWriter
from phfmu.cli import main
from phfmu.components.electrical.switches import diode
from phfmu.components.library import build
from phfmu.components.mechanical.contacts import bumper
from phfmu.components.mechanical.translational import mass
from phfmu.components.scenes.electrical.breaker_opening import breaker_opening
from phfmu.engine.switched import stepped
from phfmu.fmu.export.variables import FMUError
from phfmu.network.couplings.gauss_seidel import GaussSeidel
from phfmu.network.couplings.newton import Newton, newton
from phfmu.outcome.status import EventRefused
from tests.wide import slow, wide

OPENED, STOP, CHOP, L = 0.0203, 0.03, 0.5, 0.01
EVENTS = (Event(OPENED, "line.command", 0.0),)
#: states that say all: what the capacitors keep after the last pole has opened
KEPT = ["load.charge[1]", "load.charge[2]", "load.charge[3]"]


@pytest.fixture(scope="module")
def network() -> Any:
    return breaker_opening(OPENED, chop=CHOP).system


def apart(network: Any, k: int = 1, coupling: Any = newton) -> Coupled:
    models = {n: build_model(d, Collocated(k)) for n, d in network.declared.items()}
    return Coupled(network, [EngineMember(n, m, NativeInstance(m)) for n, m in models.items()], coupling)


@pytest.fixture(scope="module")
def reference(network: Any) -> Any:
    model = build_model(network.compose(), Collocated(3))
    return run(Monolithic(model, NativeInstance(model)), Options(stop=STOP, step=2e-5, events=EVENTS))


@pytest.mark.parametrize("k", wide([1, 2]))
def test_events_inside_a_member_keep_order_two(network: Any, reference: Any, k: int) -> None:
    """Members of order 2 and 4 with held inputs: slope 2 in states and times of events, ledgers and junctions closed."""
    expected = np.array([reference.column(n)[-1] for n in KEPT])
    times = [float(note.split()[2]) for note in reference.notes if "chop" in note]
    errors, late = [], []
    for h in (4e-4, 2e-4, 1e-4):
        result = run(apart(network, k, Newton()), Options(stop=STOP, step=h, events=EVENTS))
        errors.append(np.abs([result.column(n)[-1] for n in KEPT] - expected).max())
        summary = result.ledger.summary()
        assert summary.closed and summary.events == {"parameter": 1, "state": 3}
        notes = [note for note in result.notes if "chop" in note]
        assert ["pole1" in notes[0], "pole3" in notes[1], "pole2" in notes[2]] == [True] * 3
        late.append(np.abs(np.array([float(note.split()[2]) for note in notes]) - times).max())
        jumps = {c.component: c.jumps for c in summary.components if c.jumps}
        assert jumps == {"line": pytest.approx(-3 * L * CHOP**2 / 2, rel=1e-9)}  # L i^2/2 of each pole
    slopes = np.log2(np.array([errors[:-1], late[:-1]]) / [errors[1:], late[1:]])
    assert (np.abs(slopes[:, -1] - 2) < 0.2).all(), slopes


@pytest.mark.parametrize(("k", "steps"), [slow((2, (4e-4, 2e-4))), (3, (8e-4, 4e-4))])
def test_all_land_together_with_node_values_and_keep_order_2k(
    network: Any, reference: Any, k: int, steps: tuple[float, float]
) -> None:
    """The composed run to rounding, its rows before and after events too; times of events and states of order 2k."""
    expected = np.array([reference.column(n)[-1] for n in KEPT])
    model, errors = build_model(network.compose(), Collocated(k)), []
    for h in steps:
        options = Options(stop=STOP, step=h, events=EVENTS)
        coupled = apart(network, k)
        assert coupled.lands
        result, whole = run(coupled, options), run(Monolithic(model, NativeInstance(model)), options)
        errors.append(np.abs([result.column(n)[-1] for n in KEPT] - expected).max())
        np.testing.assert_allclose(result.time, whole.time, rtol=1e-13)
        for name in (*KEPT, "line.flux[2]"):
            np.testing.assert_allclose(
                result.column(name), whole.column(name), atol=1e-12 * np.abs(whole.column(name)).max()
            )
        told, other = result.ledger.summary(), whole.ledger.summary()
        assert told.closed and told.events == other.events == {"parameter": 1, "state": 3}
        jumps = [{c.component: c.jumps for c in s.components if c.jumps} for s in (told, other)]
        assert jumps[0] == {"line": pytest.approx(jumps[1]["line"], rel=1e-12)}
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2 * k, abs=0.3)


def test_an_event_that_is_refused_leaves_all_members_at_the_last_step(network: Any) -> None:
    """A row for the refusal, all members at one time."""
    declared = dict(network.declared)
    line = declared["line"]
    events = tuple(replace(e, jump=e.jump and replace(e.jump, most=1e-3)) for e in line.state_events)
    declared["line"] = replace(line, state_events=events)
    models = {n: build_model(d, Collocated(2)) for n, d in declared.items()}
    members: list[Any] = [EngineMember(n, m, NativeInstance(m)) for n, m in models.items()]
    with pytest.raises(EventRefused, match="pole1.chop' would jump with"):
        run(Coupled(network, members), Options(stop=STOP, step=4e-4, events=EVENTS))
    assert len({m.instance.time for m in members}) == 1


@pytest.mark.slow
def test_a_unit_is_what_a_member_is(network: Any, tmp_path: Path) -> None:
    """A breaker that is a unit gives what it gives as a member of an engine, in the run and in the audit."""
    options = Options(stop=STOP, step=2.5e-4, events=EVENTS)
    native = run(apart(network), options)
    members: list[Any] = []
    for name, d in network.declared.items():
        model = build_model(d, Collocated(1))
        if name != "line":
            members.append(EngineMember(name, model, NativeInstance(model)))
            continue
        (path,) = export(model, tmp_path, ("3.0",), step=2.5e-4, tunable=["command"])
        members.append(FMUMember(name, FMUInstance(path)))
    mixed = run(Coupled(network, members), options)
    for name in (*KEPT, "line.flux[1]"):
        scale = np.abs(native.column(name)).max()
        np.testing.assert_allclose(mixed.column(name), native.column(name), atol=1e-10 * scale)
    summary = mixed.ledger.summary()
    assert summary.closed and summary.events == native.ledger.summary().events == {"parameter": 1, "state": 3}
    jumps = {c.component: c.jumps for c in summary.components if c.jumps}
    assert jumps == {"line": pytest.approx(-3 * L * CHOP**2 / 2, rel=1e-9)}
    assert any("line: 1 state event in the unit, lost 0.00125 J" in note for note in mixed.notes)


def test_the_audit_has_a_row_for_each_event_of_a_member(network: Any, tmp_path: Path, capsys: Any) -> None:
    """With time, member, energy and loss; the file closes when it is read again."""
    with AuditWriter(tmp_path / "a.parquet") as sink:
        run(apart(network), Options(stop=STOP, step=2.5e-4, events=EVENTS, sink=sink))
    rows = [r for r in pq.read_table(tmp_path / "a.parquet").to_pylist() if r["row"] == "event"]
    state = [r for r in rows if r["kind"] == "state"]
    assert [r["component"] for r in state] == ["line"] * 3
    assert [r["message"] for r in state] == [f"pole{i}.chop, closed[{i}] = 0" for i in (1, 3, 2)]
    assert all(r["lost"] == -r["energy_jump"] == pytest.approx(L * CHOP**2 / 2, rel=1e-9) for r in state)
    assert main(["audit", str(tmp_path / "a.parquet")]) == 0
    assert "VIOLATED" not in capsys.readouterr().out


@pytest.mark.slow
def test_steps_that_are_halved_book_the_events_of_both_halves(network: Any) -> None:
    """Explicit exchange books them as well; what it makes at its junctions is told there."""
    models = {n: build_model(d, Collocated(1)) for n, d in network.declared.items()}
    members: list[Any] = [EngineMember(n, m, NativeInstance(m)) for n, m in models.items()]
    result = run(Coupled(network, members, GaussSeidel()), Options(stop=STOP, step=1e-5, events=EVENTS))
    summary = result.ledger.summary()
    assert summary.events["state"] == 3
    assert all(c.verdict != "VIOLATED" for c in summary.components)


def test_run_by_command(capsys: Any) -> None:
    assert main(["run", "breaker_opening", "--coupling", "newton", "--stop", "0.03"]) == 0
    out = capsys.readouterr().out
    assert "3 state" in out and "VIOLATED" not in out


def test_ideal_switches_between_inputs_are_refused_by_name(tmp_path: Path) -> None:
    """As units, and as members that step in turn: none of their modes could be left."""
    model = build_model(diode())
    net = build("rectifier").system
    members: list[Any] = [
        EngineMember(n, m, stepped(m, NativeInstance))
        for n, m in ((n, build_model(d)) for n, d in net.declared.items())
    ]
    with pytest.raises(
        ValueError,
        match="member 'bridge' has ideal switches .* between inputs.*; leave out --coupling, so that the network is composed",
    ):
        Coupled(net, members, Newton())
    with pytest.raises(FMUError, match="has ideal switches .* between inputs"):
        export(model, tmp_path, ("3.0",), step=1e-3)


def test_a_jump_that_a_rigid_link_shares_is_refused_by_name_where_a_member_lands_inside():
    """Composed both bodies are thrown back and lose (1 - e^2)/2 3 kg v^2; one of two internal steps lands inside, alone."""
    net = Network("linked")
    net.add("hit", bumper(2.0, e=0.5, gap=0.3, v=-1.0))
    net.add("other", mass(1.0, d=1e-9, v=-1.0))
    net.junction("link", ["hit.flange", "other.flange"], kind="1")
    composed = build_model(net.compose(), Collocated(2))
    result = run(Monolithic(composed, NativeInstance(composed)), Options(stop=0.4, step=0.1))
    assert -sum(c.jumps or 0.0 for c in result.ledger.summary().components) == pytest.approx(0.75 * 1.5, rel=1e-8)
    models = {n: build_model(d) for n, d in net.declared.items()}
    members: list[Any] = [EngineMember(n, m, NativeInstance(m), parts=2) for n, m in models.items()]
    apart = Coupled(net, members)
    with pytest.raises(EventRefused, match="hit at t = 0.2.* s: the jump of 'hits', .* junction ties to other members"):
        run(apart, Options(stop=0.7, step=0.2))
    assert [m.instance.time for m in members] == [0.2, 0.2], "all are back where the step began"
