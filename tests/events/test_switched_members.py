"""Models with ideal switches in adaptive steps, and as members stepped apart: modes change within a step that is told as one."""

from __future__ import annotations

from math import pi
from typing import Any

import casadi as ca
import numpy as np
import pytest
from event_reference import bridge as bridge_by_hand

from phfmu import (
    ELECTRICAL,
    PHDAE,
    Collocated,
    Coupled,
    EngineMember,
    Monolithic,
    NativeInstance,
    Network,
    Options,
    Port,
    Switch,
    SwitchedInstance,
    algebraic,
    build_model,
    damping,
    energy,
    parameter,
    run,
    state,
    time,
)
from phfmu.cli import main
from phfmu.components.control.relay import relay
from phfmu.network.couplings.choice.partitioned_network import PartitionedNetwork
from phfmu.outcome.status import Status, StepFailure
from tests.events.scenes import BRIDGE_STOP, LA, LD, bridge
from tests.wide import wide


@pytest.mark.parametrize("k", wide((2, 3), 3))
def test_adaptive_steps_commutate_within_their_tolerance(k):
    """Eleven events at their times; the error of currents at the stop follows the tolerance; every joule is booked."""
    times, ia, idc = bridge_by_hand()
    model, errors = build_model(bridge(), Collocated(k)), []
    for rtol in (1e-4, 1e-6):
        result = run(
            Monolithic(model, SwitchedInstance(model, NativeInstance)), Options(stop=BRIDGE_STOP, step=5e-4, rtol=rtol)
        )
        summary = result.ledger.summary()
        assert summary.closed and summary.events == {"state": 11}
        found = result.time[np.flatnonzero(np.diff(result.time) == 0)]
        errors.append(np.hypot(result.column("fa")[-1] / LA - ia, result.column("fd")[-1] / LD - idc))
        assert np.abs(found - times).max() <= rtol * 0.01
    assert errors[0] <= 2e-4 and errors[1] <= 2e-6 and errors[1] <= 0.05 * errors[0]


R, L, C, LOAD, E, W, H = 0.5, 5e-3, 1e-3, 10.0, 10.0, 2 * pi * 50, 5e-4


def branch() -> PHDAE:
    """An inductor with a source and an ideal diode in series; while it blocks, a voltage u holds its current at zero."""
    flux, u = state("flux", unit="Wb", start=0.5 * L, nominal=L), algebraic("u", unit="V", nominal=E)
    blocks = parameter("blocks", 0.0)
    ports = (
        Port("terminal", ELECTRICAL, "effort", {flux: 1.0}, nominal=E),
        Port("source", ELECTRICAL, "effort", {flux: 1.0}, source=E * ca.cos(W * time + 2.0), nominal=E),
    )
    return PHDAE(
        "branch", states=(flux,), algebraics=(u,), parameters=(blocks,), energies=(energy(flux**2 / (2 * L)),),
        dissipation=(damping(flux, R),), ports=ports, switches=(Switch("diode", u, {flux: 1.0}, blocks, nominal=1.0, unit="A"),),
    )  # fmt: skip


def rc() -> PHDAE:
    q = state("q", unit="C", start=-2.0 * C, nominal=C * E)
    port = Port("terminal", ELECTRICAL, "flow", {q: 1.0}, nominal=1.0)
    return PHDAE(
        "rc", states=(q,), energies=(energy(q**2 / (2 * C)),), dissipation=(damping(q, 1 / LOAD),), ports=(port,)
    )


def network() -> Network:
    net = Network("charger")
    net.add("supply", branch())
    net.add("load", rc())
    net.connect("supply.terminal", "load.terminal", name="node")
    return net


def instance_of(model: Any) -> Any:
    return NativeInstance(model) if model.modes is None else SwitchedInstance(model, NativeInstance)


def apart(k: int = 1) -> Coupled:
    net = network()
    models = {n: build_model(d, Collocated(k)) for n, d in net.declared.items()}
    return Coupled(net, [EngineMember(n, m, instance_of(m)) for n, m in models.items()])


@pytest.fixture(scope="module")
def reference() -> Any:
    model = build_model(network().compose(), Collocated(3))
    return run(Monolithic(model, SwitchedInstance(model, NativeInstance)), Options(stop=0.02, step=H))


@pytest.mark.parametrize("k", wide((1, 2), 1))
def test_members_with_switches_keep_order_two(reference, k):
    """Slope 2 in the states, ledgers and junctions closed; a guard that reads a held input is zero a little early or late."""
    errors = []
    times = [float(note.split()[2]) for note in reference.notes if note.startswith("t =")]
    assert len(times) == 3
    for h in (H, H / 4):
        result = run(apart(k), Options(stop=0.02, step=h))
        summary = result.ledger.summary()
        assert summary.closed and summary.events == {"state": len(times)}
        notes = [note for note in result.notes if note.startswith("t =")]
        assert all("supply.diode" in note for note in notes)
        late = np.abs(np.array([float(note.split()[2]) for note in notes]) - times)
        assert late.max() <= 0.05 * h
        errors.append(abs(result.column("load.q")[-1] - reference.column("load.q")[-1]))
    assert np.log2(errors[0] / errors[1]) / 2 >= 1.8


def test_a_step_with_a_change_of_mode_is_told_as_one_and_taken_back_bitwise():
    """Its books are those of its parts, h u^T y is what the port supplied, and after a rollback it gives the same bits."""
    model = build_model(branch(), Collocated(2))
    instance = SwitchedInstance(model, NativeInstance)
    h, step, seen = 1e-3, 0, 0
    while seen < 3:
        t, before = step * h, instance.signal("H").sum()
        instance.set_input([-0.4 * E * np.sin(70.0 * t)])
        state, mode = instance.get_state(), instance.mode
        instance.do_step(t, h)
        row, out, x = instance.ledger(), instance.output(), instance.x
        lost = sum(e.lost.sum() for e in instance.happened)
        supplied = row["supplied"].sum()
        change = instance.signal("H").sum() - before
        assert change + row["dissipated"].sum() + lost - supplied == pytest.approx(0.0, abs=1e-15 * E * E)
        assert h * out @ instance.held_input == pytest.approx(row["pairs"][0], abs=1e-16 * E)
        if any(e.switched for e in instance.happened):
            seen += 1
            with pytest.raises(StepFailure) as refused:
                instance.sensitivity()
            assert refused.value.status is Status.NO_SENSITIVITY
        again = [instance.get_state()]
        for _ in range(2):
            instance.set_state(state)
            assert instance.mode == mode
            instance.do_step(t, h)
            assert instance.x.tobytes() == x.tobytes() and instance.output().tobytes() == out.tobytes()
            assert all(instance.ledger()[name].tobytes() == row[name].tobytes() for name in row)
        instance.set_state(again[0])
        step += 1
    assert step < 60


def test_what_members_with_switches_exchange_is_told() -> None:
    """Where all land together they exchange what others do; beside signals, which are held, they land inside their steps."""
    assert (
        "with --coupling newton (k = order / 2 values" in PartitionedNetwork(network()).order()
        and not PartitionedNetwork(network()).held
    )
    net = network()
    net.add("relay", relay(0.0, 1.0))
    net.add("other", relay(0.0, 1.0))
    net.signal("relay.command", "other.measured")
    apart = PartitionedNetwork(net)
    assert apart.order().startswith("--order composed; 1 apart: ") and "; supply takes held inputs" in apart.order()
    assert "supply has ideal switches, whose modes change within its step" in apart.exchanged()["node"]
    assert apart.held == ["supply", "relay", "other"]


def test_a_bridge_between_currents_that_are_given_is_refused_as_a_member_by_name(capsys):
    """Where members step in turn, both sides of its switches are inputs; composed and with newton it runs."""
    assert main(["run", "rectifier", "--coupling", "gauss-seidel"]) == 2
    err = capsys.readouterr().err
    assert "bridge" in err and "leave out --coupling, so that the network is composed" in err
    assert "or take --coupling newton" in err


def test_a_sliver_moves_time_and_nothing_else_after_a_change_of_mode():
    """Nor does it look for modes; inputs at the nodes of a step are not held, which a step with guards takes only."""
    instance = SwitchedInstance(build_model(branch(), Collocated(2)), NativeInstance)
    h, step = 1e-3, 0
    while not any(e.switched for e in instance.happened) or step < 2:
        instance.set_input([-0.4 * E * np.sin(70.0 * step * h)])
        instance.do_step(step * h, h)
        step += 1
    t, x, out, mode, end = step * h, instance.x, instance.output(), instance.mode, instance.signal("energy")
    for sliver in (1e-19, 1e-15, 5e-13):
        instance.do_step(t, sliver)
        assert instance.time == t + sliver and instance.mode == mode and not instance.happened
        assert instance.x.tobytes() == x.tobytes() and instance.output().tobytes() == out.tobytes()
        assert instance.signal("energy").tobytes() == end.tobytes()
        assert not any(row.any() for row in instance.ledger().values())
    instance.set_node_inputs([[1.0], [2.0]])
    with pytest.raises(StepFailure) as refused:
        instance.do_step(t, h)
    assert refused.value.status is Status.ARGUMENT
    instance.step_exactly(t, h)
    assert h / 2 * instance.node_output()[:, 0] @ [1.0, 2.0] == pytest.approx(instance.ledger()["pairs"][0], rel=1e-13)
    instance.set_input([1.5])
    instance.do_step(t + h, h)
