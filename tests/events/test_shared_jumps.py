"""Jumps that junctions share between members stepped apart: the impulses of all in one system, as in the composed model."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phfmu import (
    PHDAE,
    TRANSLATIONAL,
    Collocated,
    Coupled,
    EngineMember,
    Event,
    FMUInstance,
    FMUMember,
    Guard,
    Jump,
    Monolithic,
    NativeInstance,
    Network,
    Options,
    Port,
    StateEvent,
    build_model,
    damping,
    energy,
    export,
    run,
    skew,
    state,
    time,
)
from phfmu.components.electrical.branches import rl_branch
from phfmu.components.electrical.breaker import breaker
from phfmu.components.mechanical.contacts import bumper
from phfmu.components.mechanical.translational import mass
from phfmu.network.interface.shared_jumps import SharedJumps
from phfmu.outcome.status import EventRefused
from tests.wide import wide

CASES = wide((1, 2, 3), 1, 2)


def ball(m: float, e: float, gap: float, law: Any = "unilateral", most: float = np.inf, v: float = -1.0) -> PHDAE:
    """A body before a wall; a force acts on it at its flange."""
    q, speed = state("q", unit="m", start=gap), state("v", unit="m/s", start=v)
    jump = Jump({speed: 1.0}, e, law=law, most=most)
    return PHDAE(
        "ball",
        states=(q, speed),
        energies=(energy(m * speed**2 / 2),),
        E={speed: m},
        structure=(skew(q, speed, 1.0),),
        ports=(Port("flange", TRANSLATIONAL, "effort", {speed: 1.0}),),
        state_events=(StateEvent(Guard("hits", q, -1, unit="m"), jump=jump),),
    )


def linked(*bodies: PHDAE) -> Network:
    """Bodies that are one through a rigid link."""
    net = Network("linked")
    for i, body in enumerate(bodies):
        net.add(f"b{i}", body)
    net.junction("link", [f"b{i}.{body.ports[0].name}" for i, body in enumerate(bodies)], kind="1")
    return net


def both(net: Network, k: int, options: Options) -> tuple[Any, Any]:
    """The run of the composed model, and of its members stepped apart."""
    composed = build_model(net.compose(), Collocated(k))
    models = {n: build_model(d, Collocated(k)) for n, d in net.declared.items()}
    apart = Coupled(net, [EngineMember(n, m, NativeInstance(m)) for n, m in models.items()])
    assert apart.lands
    return run(Monolithic(composed, NativeInstance(composed)), options), run(apart, options)


def lost(result: Any) -> dict[str, float]:
    """By component what events took from its energy."""
    return {c.component: -c.jumps for c in result.ledger.summary().components if c.jumps}


def assert_same(net: Network, whole: Any, apart: Any, tol: float = 1e-12) -> None:
    """Times, states and energies of events, within a few rounding units."""
    np.testing.assert_allclose(apart.time, whole.time, rtol=1e-12)
    for name in (f"{m}.{n}" for m, d in net.declared.items() for v in d.states for n in v.names()):
        scale = max(np.abs(whole.column(name)).max(), 1e-3)
        np.testing.assert_allclose(apart.column(name), whole.column(name), atol=tol * scale, err_msg=name)
    assert lost(apart) == pytest.approx(lost(whole), rel=tol)
    told, other = apart.ledger.summary(), whole.ledger.summary()
    assert told.closed and other.closed and told.events == other.events


@pytest.mark.parametrize("k", CASES)
def test_a_body_throws_back_what_is_linked_to_it(k: int) -> None:
    """Two bodies of 2 and 1 kg: (1 - e^2)/2 3 kg v^2 is lost, each goes on with -e v."""
    net = linked(ball(2.0, 0.5, 0.33), mass(1.0, k=3.0, d=0.4, v=-1.0))
    whole, apart = both(net, k, Options(stop=1.0, step=0.1))
    assert_same(net, whole, apart)
    at = int(np.flatnonzero(np.diff(apart.time) == 0)[0])
    v = apart.column("b0.v")[at]
    assert apart.column("b0.v")[at + 1] == apart.column("b1.v")[at + 1] == pytest.approx(-0.5 * v, rel=1e-14)
    assert lost(apart) == pytest.approx({"b0": 0.75 * v**2, "b1": 0.375 * v**2}, rel=1e-13)


@pytest.mark.parametrize("k", CASES)
def test_feet_of_several_members_meet_walls_at_once(k: int) -> None:
    """A beam whose two feet, of other members and restitutions, come down at one instant: contacts push only."""
    v, w = state("v", unit="m/s", start=-1.0), state("w", unit="rad/s")
    ports = [Port(n, TRANSLATIONAL, "effort", {v: 1.0, w: r}) for n, r in (("left", -0.4), ("right", 0.4))]
    beam = PHDAE(
        "beam",
        states=(v, w),
        energies=(energy(v**2 / 2), energy(0.1 * w**2 / 2)),
        E={w: 0.1},
        dissipation=(damping(v, 0.2), damping(w, 0.1)),
        ports=tuple(ports),
    )
    net = Network("beam")
    net.add("beam", beam)
    for side, e in (("left", 0.2), ("right", 0.9)):
        net.add(side, ball(0.3, e, 0.33))
        net.junction(f"at_{side}", [f"{side}.flange", f"beam.{side}"], kind="1")
    whole, apart = both(net, k, Options(stop=0.7, step=0.1))
    assert_same(net, whole, apart)
    assert len(apart.notes) == 1 and "left.hits, right.hits" in apart.notes[0]
    at = int(np.flatnonzero(np.diff(apart.time) == 0)[0])
    before, after = ([apart.column(f"{side}.v")[i] for side in ("left", "right")] for i in (at, at + 1))
    assert after == pytest.approx([-0.2 * before[0], -0.9 * before[1]], rel=1e-13)


@pytest.mark.parametrize("k", CASES)
def test_a_pole_that_is_forced_open_stops_branches_of_other_members(k: int) -> None:
    """At a node of inductors the current of the line is that of two branches, of 20 and 30 mH: what goes round in them stays."""
    start, L = (3.0, 1.0, 2.0), (0.01, 0.02, 0.03)
    net = Network("inductors")
    net.add("line", breaker(0.5, L[0], phases=1, start=[start[0]], i=1.0))
    for n, i in ((1, 1), (2, 2)):
        net.add(f"coil{n}", rl_branch(0.3, L[n], size=1, i0=start[i]))
    net.junction("node", ["line.b", "coil1.terminal", "coil2.terminal"])
    event = (Event(0.013, "line.command", 2.0),)
    whole, apart = both(net, k, Options(stop=0.02, step=2e-3, events=event))
    assert_same(net, whole, apart)


@pytest.mark.parametrize("k", CASES)
def test_a_bumper_comes_to_rest_with_what_is_linked_to_it_and_leaves(k: int) -> None:
    """Its guard reads the force of the link: a push of 5 N that turns at 2 s; then 3 kg v' = 2.5 N/s (t - 2 s)."""
    q, v = state("q", unit="m"), state("v", unit="m/s", start=-1.0)
    flange, wind = (
        Port(n, TRANSLATIONAL, "effort", {v: 1.0}, source=f) for n, f in (("flange", None), ("wind", 2.5 * time - 5.0))
    )
    body = PHDAE(
        "body", states=(q, v), energies=(energy(v**2 / 2),), structure=(skew(q, v, 1.0),), ports=(flange, wind)
    )
    net = Network("linked")
    net.add("hit", bumper(2.0, e=0.3, gap=0.2, v=-1.0))
    net.add("body", body)
    net.junction("link", ["hit.flange", "body.flange"], kind="1")
    whole, apart = both(net, k, Options(stop=2.6, step=0.1))
    assert_same(net, whole, apart)
    assert "comes to rest" in " ".join(apart.notes) and "leaves" in apart.notes[-1]
    assert f"t = {float(apart.notes[-1].split()[2]):.6g}" == "t = 2"
    assert apart.column("body.v")[-1] == pytest.approx(2.5 * 0.6**2 / 2 / 3.0, rel=1e-9 if k > 1 else 1e-3)


def test_a_jump_that_is_refused_leaves_all_members_where_the_step_ended() -> None:
    """It names the network, the event and what it allows; no member has moved."""
    net = linked(ball(2.0, 0.5, 0.33, most=0.1), mass(1.0, d=0.4, v=-1.0))
    models = {n: build_model(d) for n, d in net.declared.items()}
    members: list[Any] = [EngineMember(n, m, NativeInstance(m)) for n, m in models.items()]
    with pytest.raises(EventRefused, match=r"linked at t = 0.33.*'hits' would jump with .* more than its most = 0.1"):
        run(Coupled(net, members), Options(stop=0.7, step=0.1))
    x = [m.instance.x for m in members]
    assert abs(x[0][0]) < 1e-12 and x[0][1] == pytest.approx(x[1][1], rel=1e-14) and x[0][1] < -0.9


def test_a_jump_of_its_own_is_not_asked_of_others() -> None:
    """A body whose wall acts on a spring between it and its flange: nothing of the other member is in its system."""
    hit, other = ball(2.0, 0.5, 0.33), mass(1.0, d=0.4, v=-1.0)
    models = {"b0": build_model(hit), "b1": build_model(other)}
    for kind, shared in (("1", {"b0": {0}}), ("", {})):
        net = linked(hit, other) if kind else Network("loose")
        if not kind:
            net.add("b0", hit)
            net.add("b1", other)
        joined = Coupled(net, [EngineMember(n, m, NativeInstance(m)) for n, m in models.items()]).joined
        assert SharedJumps(joined).of == shared


@pytest.mark.slow
@pytest.mark.parametrize("k", [1, 2])
@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_a_unit_is_thrown_back_with_the_member_that_it_is_linked_to(k: int, version: str, tmp_path: Path) -> None:
    """Units with impulses take part in the jumps of others."""
    net = linked(ball(2.0, 0.5, 0.33), mass(1.0, k=3.0, d=0.4, v=-1.0))
    options = Options(stop=1.0, step=0.1)
    composed = build_model(net.compose(), Collocated(k))
    whole = run(Monolithic(composed, NativeInstance(composed)), options)
    models = {n: build_model(d, Collocated(k)) for n, d in net.declared.items()}
    (path,) = export(models["b1"], tmp_path, (version,), step=0.1, node_inputs=True, impulses=True)
    members: list[Any] = [
        EngineMember("b0", models["b0"], NativeInstance(models["b0"])),
        FMUMember("b1", FMUInstance(path)),
    ]
    assert_same(net, whole, run(Coupled(net, members), options))
