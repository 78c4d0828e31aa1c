"""State events in declarations, networks, audits and results; what does not go with them is refused by name."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from phfmu import (
    PHDAE,
    TRANSLATIONAL,
    Collocated,
    DeclarationError,
    Guard,
    Jump,
    Monolithic,
    NativeInstance,
    Network,
    Options,
    Port,
    StateEvent,
    SystemTransformation,
    build_model,
    check,
    energy,
    parameter,
    run,
    skew,
    state,
)
from phfmu.audit import AuditWriter
from phfmu.cli import main
from phfmu.components.library import build
from phfmu.components.mechanical.translational import spring
from phfmu.engine.build.codegen import kernel_table
from phfmu.engine.model import kernels

Q, P = state("q", unit="m", start=1.0), state("p", unit="kg.m/s", start=-3.0)
M, K = parameter("m", 1.0, unit="kg"), parameter("k", 1.0, unit="N/m")
W = parameter("w", (1.0, 0.0), 2)
EVENT = StateEvent(Guard("floor", Q, -1, unit="m"), when={"w[1]": 1.0}, sets={"w[2]": 2.0}, jump=Jump({P: 1.0}, 0.5))


def body(*events: StateEvent, **changes) -> PHDAE:
    """A free mass with a port."""
    return replace(
        PHDAE(
            "body", states=(Q, P), parameters=(W, M, K), energies=(energy(P**2 / (2 * M)), energy(0.5 * K * Q**2)),
            structure=(skew(Q, P, 1.0),), ports=(Port("flange", TRANSLATIONAL, "effort", {P: 1.0}),),
            state_events=events or (EVENT,),
        ),
        **changes,
    )  # fmt: skip


def test_a_sound_declaration_has_no_problems():
    assert check(body(), strict=True) == []


@pytest.mark.parametrize(
    ("event", "says"),
    [
        (replace(EVENT, sets={"v[2]": 1.0}), "'v[2]' is no scalar parameter; did you mean w[2]"),
        (replace(EVENT, when={"w": 1.0}), "'w' is no scalar parameter; did you mean w[1], w[2]"),
        (replace(EVENT, sets={"w[1]": np.nan}), "the value is nan"),
        (replace(EVENT, jump=Jump({P: 1.0}, 1.5)), "restitution: is 1.5"),
        (replace(EVENT, jump=Jump({P: 1.0}, most=-1.0)), "most = -1"),
        (replace(EVENT, jump=Jump({P: [1.0, 2.0]})), "is 2 x 1, expected 1 x 1"),
        (replace(EVENT, guard=replace(EVENT.guard, direction=2)), "direction = 2"),
        (replace(EVENT, guard=replace(EVENT.guard, nominal=0.0)), "nominal = 0"),
        (replace(EVENT, guard=replace(EVENT.guard, unit="meter")), "meter"),
        (
            replace(EVENT, guard=replace(EVENT.guard, expr=state("q"))),
            "is the symbol of another variable of the same name",
        ),
        (replace(EVENT, jump=Jump({W: 1.0})), "stands on 'w'"),
        (replace(EVENT, jump=Jump({P: 1.0}, owner="b")), "its owner 'b' is not a member"),
    ],
)
def test_the_check_names_what_is_wrong(event, says):
    assert any(says in str(p) for p in check(body(event))), [str(p) for p in check(body(event))]


def test_a_guard_in_another_unit_is_a_warning():
    problems = check(body(replace(EVENT, guard=replace(EVENT.guard, unit="m/s"))), strict=True)
    assert [p.rule for p in problems] == ["dimension"] and "guard 'floor'" in problems[0].entry


@pytest.mark.parametrize(
    ("declaration", "says"),
    [
        (lambda: body(energies=(energy(W.sx[1] * P**2 / 2), energy(Q**2 / 2))), "is in the energy or in E"),
        (lambda: body(energies=(energy(P**4 / 4), energy(Q**2 / 2))), "not quadratic"),
        (lambda: body(replace(EVENT, jump=Jump({P: P}))), "changes as it moves states"),
        (lambda: body(replace(EVENT, jump=Jump({P: 0.0}))), "moves no state"),
        (lambda: body(energies=(energy(Q**2 / 2),)), "store no energy"),
    ],
)
def test_jumps_without_a_closed_form_are_refused(declaration, says):
    with pytest.raises(DeclarationError, match=says):
        build_model(declaration(), Collocated(1))


def cart() -> Network:
    """The body on a spring."""
    net = Network("cart")
    net.add("body", body())
    net.add("spring", spring(3.0))
    net.connect("body.flange", "spring.b", name="joint")
    return net


def test_events_of_a_network_carry_the_names_of_their_members(tmp_path: Path):
    declaration = cart().compose()
    (event,) = declaration.state_events
    assert (event.guard.name, dict(event.when), dict(event.sets)) == (
        "body.floor",
        {"body.w[1]": 1.0},
        {"body.w[2]": 2.0},
    )
    assert declaration.modes == ["body.w[2]"]
    model = build_model(declaration)
    with AuditWriter(tmp_path / "a.parquet") as sink:
        result = run(Monolithic(model, NativeInstance(model)), Options(stop=2.0, step=0.05, sink=sink))
    assert result.ledger.summary().closed
    mode = result.column("body.w[2]")
    assert set(mode) == {0.0, 2.0} and mode[-1] == 2.0
    (at,) = np.flatnonzero(np.diff(result.time) == 0)  # a row before and one after
    v = result.column("body.p")
    assert v[at + 1] == pytest.approx(-0.5 * v[at], rel=1e-14) and mode[at] == 0.0 and mode[at + 1] == 2.0
    rows = pq.read_table(tmp_path / "a.parquet").to_pylist()
    (row,) = (r for r in rows if r["row"] == "event")
    assert (row["kind"], row["component"], row["message"]) == ("state", "body", "body.floor, body.w[2] = 2")
    lost = 0.75 * v[at] ** 2 / 2
    assert row["lost"] == pytest.approx(lost, rel=1e-13) and row["energy_jump"] == -row["lost"]


def test_steps_by_the_energy_of_junctions_are_refused():
    model = build_model(body())
    with pytest.raises(ValueError, match="--ecco does not go with state events"):
        run(Monolithic(model, NativeInstance(model)), Options(stop=1.0, step=0.1, ecco=1e-3))


def test_other_variables_are_refused():
    r = state("r", unit="m")
    with pytest.raises(DeclarationError, match="has state events"):
        SystemTransformation(phi={Q: 2 * r}, new=(r,))(body())


def test_an_instance_without_state_events_says_so():
    model = build_model(replace(body(), state_events=()))
    with pytest.raises(ValueError, match="has no state events: use run"):
        NativeInstance(model).land(0.0, 0.1, 1)


def test_what_has_no_guard_pays_nothing():
    """The same plans and the same C without events as of a model that never had any; guards are kernels beside them."""
    plain, guarded = build_model(replace(body(), state_events=())), build_model(body())
    assert plain.events is None and guarded.events is not None
    tables = [kernel_table([g.kernel for g in (*m.step.groups, *m.instant.groups)]) for m in (plain, guarded)]
    assert kernel_table(kernels(plain)).text == tables[0].text
    assert [g.kernel for g in plain.step.groups] == [g.kernel for g in guarded.step.groups]
    assert plain.step.nw == guarded.step.nw and plain.observable_names == ()
    assert guarded.observable_names == ("w[2]",)  # its mode


def test_run_prints_the_bounces(capsys):
    assert main(["run", "bouncing_ball", "--stop", "2"]) == 0
    out = capsys.readouterr().out
    assert "t = 0.451523640986 s: floor, lost 3.5316 J" in out and "events: 3 state" in out


def test_a_ball_is_the_library_scene():
    assert check(build("bouncing_ball").declaration(), strict=True) == []


def test_info_lists_state_events(capsys):
    assert main(["info", "bouncing_ball"]) == 0
    assert "falls through zero with flight = 1: p jumps; comes to rest: flight = 0" in capsys.readouterr().out


ENDLESS = """
from dataclasses import replace
from phfmu.components.library import build
def endless():
    ball = build("bouncing_ball").declaration()
    return replace(ball, state_events=tuple(replace(e, rest={}) for e in ball.state_events))
"""


def test_a_refused_event_ends_a_run_with_what_was_before_it(tmp_path: Path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "models.py").write_text(ENDLESS)
    run_it = ["run", "models.py:endless", "--stop", "5", "--step", "0.02", "--audit", "a.parquet"]
    assert main([*run_it, "--order", "4"]) == 3
    said = capsys.readouterr().err
    assert "100 events fall into one step, the last 'floor'" in said and "StateEvent(rest=..)" in said
    rows = pq.read_table("a.parquet").to_pylist()
    kinds = [r["kind"] for r in rows if r["row"] == "event"]
    assert kinds.count("state") >= 100 and kinds[-1] == "nonconverged"
    assert rows[-1]["t0"] == pytest.approx(9 * np.sqrt(2 / 9.81), abs=1e-9)


def test_inputs_and_parameters_that_change_meet_events():
    """A force turned on by a time event; the grid ends there, and a mode it makes true is set at once."""
    from phfmu import Event

    late = StateEvent(Guard("late", W.sx[0] - 3.0, 1), when={"w[2]": 0.0}, sets={"w[2]": 5.0})
    model = build_model(body(late))
    events = (Event(0.13, "flange.force", 1.0), Event(0.21, "w[1]", 4.0))
    result = run(Monolithic(model, NativeInstance(model)), Options(stop=0.5, step=0.1, events=events))
    mode = result.column("w[2]")
    (at,) = np.flatnonzero(np.diff(mode))
    assert result.time[at + 1] == 0.21 and mode[at + 1] == 5.0
    assert result.ledger.summary().events == {"input": 1, "parameter": 1, "state": 1}
