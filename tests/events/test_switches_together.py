"""Members with ideal switches that land together with all others: the composed run, with the steps of members apart."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from event_reference import LA, LD
from event_reference import bridge as bridge_by_hand

from phfmu import (
    Collocated,
    Coupled,
    EngineMember,
    Event,
    Monolithic,
    NativeInstance,
    Network,
    Options,
    build_model,
    run,
    time,
)
from phfmu.cli import main
from phfmu.components.electrical.branches import rl_branch
from phfmu.components.electrical.sources import voltage_source
from phfmu.components.electrical.switches import ideal_switch
from phfmu.components.library import build
from phfmu.engine.switched import stepped
from phfmu.network.couplings.choice.partitioned_network import PartitionedNetwork
from phfmu.network.couplings.gauss_seidel import GaussSeidel
from phfmu.network.couplings.newton import newton
from phfmu.network.members.interpolant import Interpolant
from tests.events.test_switched_members import network as charger
from tests.wide import wide

#: what of a column two runs that are the same may differ by
ROUNDING = 1e-12


def members(net: Network, orders: dict[str, int] | int) -> list[Any]:
    k = orders if isinstance(orders, dict) else dict.fromkeys(net.declared, orders)
    models = {n: build_model(d, Collocated(k[n])) for n, d in net.declared.items()}
    return [EngineMember(n, m, stepped(m, NativeInstance)) for n, m in models.items()]


def both(net: Network, k: int, options: Options) -> tuple[Any, Any]:
    """The run apart and the composed one."""
    model = build_model(net.compose(), Collocated(k))
    apart = run(Coupled(net, members(net, k)), options)
    return apart, run(Monolithic(model, stepped(model, NativeInstance)), options)


def require_same(apart: Any, composed: Any, events: int) -> None:
    """Rows at the same times, before and after each event; modes, states, outputs and energies to rounding; closed."""
    assert np.abs(apart.time - composed.time).max() <= 1e-16 and (np.diff(apart.time) == 0).sum() >= events - 1
    names = [n for n in composed.names if n in apart.names and "residual" not in n]
    assert len(names) >= 20
    for name in names:
        off, size = np.abs(apart.column(name) - composed.column(name)), np.abs(composed.column(name))
        assert off.max() <= ROUNDING * max(1.0, size.max()), name
    summary = apart.ledger.summary()
    assert summary.closed and summary.events["state"] == composed.ledger.summary().events["state"] == events
    assert [n.partition(", lost")[0] for n in apart.notes] == [n.partition(", lost")[0] for n in composed.notes]


@pytest.mark.parametrize("k", wide((1, 2, 3), 2))
def test_a_bridge_between_two_members_is_the_composed_one(k: int) -> None:
    """Both sides of its switches are given by others: they have no steps of their own, but rows of the interface."""
    require_same(*both(build("rectifier").system, k, Options(stop=0.006, step=5e-4)), events=3)


@pytest.mark.parametrize("k", wide((2, 3), 2))
def test_three_phases_commutate_with_overlap_from_rest(k: int) -> None:
    """In the first mode all diodes block and nothing determines the rails; the start closes two."""
    require_same(*both(build("six_pulse").system, k, Options(stop=0.004, step=2.5e-4)), events=3)


def test_a_chopper_and_a_diode_change_together() -> None:
    """Two members of the network change modes at one instant, by the clock of one of them."""
    apart, composed = both(build("buck").system, 2, Options(stop=1e-4, step=5e-6))
    require_same(apart, composed, events=5)
    assert any("chopper.switch off, diode.diode on" in n for n in apart.notes)


def test_events_of_the_scene_reach_the_instants_too() -> None:
    """A resistance of a member beside the bridge is set on the way: what guards read follows it."""
    events = (Event(2.2e-3, "load.R", 15.0), Event(3.1e-3, "grid.R", 0.5))
    options = Options(stop=0.006, step=5e-4, events=events)
    apart, composed = both(build("rectifier").system, 2, options)
    require_same(apart, composed, events=3)
    assert composed.ledger.summary().events["parameter"] == 2


@pytest.mark.parametrize("k", wide((2, 3), 2))
def test_a_member_with_states_and_a_switch_steps_in_the_mode_of_all(k: int) -> None:
    require_same(*both(charger(), k, Options(stop=0.02, step=5e-4)), events=3)


@pytest.mark.parametrize("k", wide([1, 2, 3], 2))
def test_orders_apart_against_the_closed_form(k: int) -> None:
    """Eleven commutations of the rectifier: slopes 2k of event times and of currents at the stop."""
    times, ia, idc = bridge_by_hand()
    late, off = [], []
    for n in (50, 100):
        net = build("rectifier").system
        result = run(Coupled(net, members(net, k)), Options(stop=0.05, step=0.05 / n))
        found = result.time[np.flatnonzero(np.diff(result.time) == 0)]
        late.append(np.abs(found - times).max())
        flux = np.array([result.column(f"{m}.flux")[-1] for m in ("grid", "load")])
        off.append(np.linalg.norm(flux / [LA * ia, LD * idc] - 1))
    assert min(np.log2([late[0] / late[1], off[0] / off[1]])) >= 2 * k - 0.4
    assert late[1] <= (2e-6, 1e-9, 1e-12)[k - 1]


def test_where_switches_can_not_land_with_all_others_they_are_refused_by_name() -> None:
    net = build("rectifier").system
    with pytest.raises(
        ValueError, match="member 'bridge' has ideal switches .* between inputs.*, or take --coupling newton"
    ):
        Coupled(net, members(net, 1), GaussSeidel(("grid", "bridge", "load")))
    with pytest.raises(
        ValueError, match=r"between inputs.* \(members have different orders \(grid: 4, bridge: 4, load: 2\)"
    ):
        Coupled(net, members(net, {"grid": 2, "bridge": 2, "load": 1}))
    many: list[Any] = [EngineMember(m.name, m.model, m.instance, 2) for m in members(net, 2)]
    with pytest.raises(ValueError, match=r"between inputs.* \(grid takes no inputs at the nodes of its steps"):
        Coupled(net, many)


def test_inputs_that_follow_data_are_refused_beside_switches_that_land() -> None:
    net = charger()
    coupled = Coupled(net, members(net, 2), newton)
    with pytest.raises(ValueError, match="charger: inputs .* do not follow data.*; leave out --coupling"):
        coupled.followed = Interpolant(["x"], np.array([0.0, 1.0]), np.zeros((2, 1)), "linear")


def test_what_such_members_exchange_is_told() -> None:
    apart = PartitionedNetwork(build("rectifier").system)
    assert apart.order() == "--order, composed and with --coupling newton (k = order / 2 values per step)"
    assert set(apart.exchanged().values()) == {"k values, order 2k"}


def test_the_command_line_steps_the_rectifier_apart(capsys: Any) -> None:
    args = ["--coupling", "newton", "--order", "4", "--stop", "0.002"]
    assert main(["run", "rectifier", *args]) == 0
    assert "closed" in capsys.readouterr().out


def test_a_node_that_nothing_conducts_to_floats_through_steps() -> None:
    """Between two open switches no row determines the voltage: it is least in norm, until one of them closes."""
    net = Network("floating")
    net.add("source", voltage_source(24.0 * ca.cos(100.0 * time), v=24.0))
    net.add("first", ideal_switch(conducts=False, v=24.0))
    net.add("second", ideal_switch(conducts=False, v=24.0))
    net.add("load", rl_branch(2.0, 0.01, v=24.0))
    net.junction("supply", ["source.terminal", "first.a"])
    net.junction("between", ["first.b", "second.a"])
    net.junction("end", ["second.b", "load.terminal"])
    events = (Event(2e-3, "first.conducts", 1.0), Event(3e-3, "second.conducts", 1.0))
    apart, composed = both(net, 2, Options(stop=5e-3, step=5e-4, events=events))
    require_same(apart, composed, events=2)
    voltage, current = apart.column("between.v"), apart.column("load.current")
    assert not voltage[apart.time < 2e-3].any() and voltage[-1] == pytest.approx(24.0 * np.cos(0.475), rel=1e-3)

    def forced(t: float) -> float:
        return float((24.0 * np.exp(100j * t) / (2.0 + 1j)).real)

    assert current[-1] == pytest.approx(forced(5e-3) - forced(3e-3) * np.exp(-2e-3 / 5e-3), rel=1e-5)
