"""The order that head lines and `phfmu info` tell of members stepped apart is the one that their runs have."""

from __future__ import annotations

import numpy as np
import pytest

from phfmu import (
    Collocated,
    Coupled,
    EngineMember,
    Monolithic,
    NativeInstance,
    Network,
    Options,
    build_model,
    run,
)
from phfmu.cli import _parser, main
from phfmu.cli.job import job_of
from phfmu.cli.parser import parsed
from phfmu.components.electrical.branches import rc_node
from phfmu.components.electrical.breaker import ideal_diode
from phfmu.components.library import build
from phfmu.components.mechanical.contacts import impact_pair
from phfmu.components.mechanical.translational import spring
from phfmu.engine.switched import stepped
from phfmu.network.couplings.choice.partitioned_network import PartitionedNetwork
from phfmu.network.members.node_values import HeldNodes
from phfmu.schemes.named import named_scheme
from tests.wide import wide

#: scene -> end and step of its runs: with events in them where it has some
RUNS = {
    "buffer": (0.5, 0.01), "breaker_opening": (0.03, 2.5e-4), "rectifier": (0.012, 5e-4), "six_pulse": (0.01, 2.5e-4),
    "clutch_engagement": (0.4, 0.005), "smib": (0.02, 4e-4),
    "ladder": (0.02, 2e-4), "two_machine": (0.05, 4e-4), "oscillator": (1.0, 0.02), "drive": (0.1, 1e-3),
    "speed_control": (0.5, 0.01), "two_point_control": (1.0, 0.02),
}  # fmt: skip
CASES = [(name, 4) for name in RUNS]
CASES += [(name, order) for name in ("buffer", "oscillator") for order in (2, 6)]
#: below this part of a state errors are rounding
ROUNDING = 2e-12


def job(name: str, order: int):
    return job_of(parsed(_parser(), ["run", name, "--coupling", "newton", "--order", str(order)]))


@pytest.mark.parametrize(("name", "order"), wide(CASES, ("buffer", 4), ("oscillator", 6), ("two_point_control", 4)))
def test_the_head_line_and_info_tell_the_order_that_is_measured(name, order):
    """Against the composed run of order 6 in finer steps: slopes of the errors of all states at the end."""
    (stop, h), scene = RUNS[name], build(name)
    declaration = scene.declaration()
    model = build_model(declaration, named_scheme(declaration, "auto", 6))
    options = {"stop": stop, "events": scene.events}
    exact = run(Monolithic(model, stepped(model, NativeInstance)), Options(step=h / 8, **options))
    states = [n for v in declaration.states for n in v.names()]
    size = np.array([np.abs(exact.column(n)).max() for n in states])
    moving = size > 1e-9 * np.array([abs(x) or 1.0 for v in declaration.states for x in v.nominal])
    errors, told = [], job(name, order)
    by_signals = name == "two_point_control"
    parts = (4, 16, 64) if by_signals else (1, 2, 4)  # switching times of order 1 are irregular in few steps
    for n in parts:
        result = run(told.build(), Options(step=h / n, **options))
        off = np.array([abs(result.column(s)[-1] - exact.column(s)[-1]) for s in states])
        errors.append(float((off[moving] / size[moving]).max()))
    said = 1 if by_signals else order
    assert told.order == said and f", order {said}" in told.label
    text = PartitionedNetwork(scene.system).order()
    assert ("1 apart" if by_signals else "--order, composed and with --coupling newton") in text
    slopes = [np.log(a / b) / np.log(q / p) for a, b, p, q in zip(errors, errors[1:], parts, parts[1:], strict=False)
              if b > ROUNDING]  # fmt: skip
    assert all(s > said - (0.45 if by_signals else 0.6) for s in slopes) and errors[-1] < errors[0] + ROUNDING
    if by_signals:
        assert 0.6 < np.log(errors[0] / errors[-1]) / np.log(16) < 1.5
    elif slopes and order == 2:
        assert slopes[-1] < 2.7


def cradle() -> Network:
    """Two bodies that throw each other back, each on a spring."""
    net = Network("cradle")
    net.add("pair", impact_pair(1.0, 1.3, e=0.8, gap=0.2, v_a=1.5, v_b=-0.3))
    net.add("left", spring(40.0))
    net.add("right", spring(25.0))
    net.connect("pair.a", "left.a", name="l")
    net.connect("pair.b", "right.a", name="r")
    return net


def charger() -> Network:
    """A capacitor that discharges into another one over a diode, until the current is zero."""
    net = Network("charger")
    net.add("a", rc_node(50.0, 1e-4, v0=80.0, v=100.0, i=10.0))
    net.add("b", rc_node(20.0, 2e-4, v0=0.0, v=100.0, i=10.0))
    net.add("d", ideal_diode(0.5, 0.01, conducts=True, i=10.0, v=100.0))
    net.connect("a.terminal", "d.a", name="na")
    net.connect("b.terminal", "d.b", name="nb")
    return net


def apart(net: Network, k: int) -> Coupled:
    models = {n: build_model(d, Collocated(k)) for n, d in net.declared.items()}
    return Coupled(net, [EngineMember(n, m, NativeInstance(m)) for n, m in models.items()])


@pytest.mark.parametrize("k", wide([2, 3], 2))
@pytest.mark.parametrize("net", [cradle, charger, lambda: build("buffer").system], ids=["cradle", "charger", "buffer"])
def test_guards_that_read_what_others_give_keep_the_composed_run(net, k):
    """Members land together, by the guards of the composed declaration: 2e-12 instead of 7e-4 of the cradle's motion."""
    net = net()
    stop, h = {"cradle": (2.0, 0.04), "charger": (0.01, 4e-4)}.get(net.name, (2.0, 0.02))
    model = build_model(net.compose(), Collocated(k))
    whole = run(Monolithic(model, NativeInstance(model)), Options(stop=stop, step=h))
    found = run(apart(net, k), Options(stop=stop, step=h))
    assert len(found.time) == len(whole.time)
    for v in net.compose().states:
        for n in v.names():
            scale = np.abs(whole.column(n)).max()
            assert np.abs(found.column(n) - whole.column(n)).max() <= 2e-9 * scale, n
    summary = found.ledger.summary()
    assert summary.closed and summary.events == whole.ledger.summary().events
    assert not PartitionedNetwork(net).held


def held_by(stepper: Coupled) -> list[str]:
    return [s.values.member.name for s in stepper._exchange.shares if isinstance(s.values, HeldNodes)]


def test_what_is_held_at_bare_nodes_and_beside_units_is_told_as_it_is():
    """`PartitionedNetwork` tells of declarations what `InterfaceUnknowns` finds of members."""
    for name in ("buffer", "breaker_opening", "smib_breaker", "two_point_control", "smib", "rectifier"):
        net = build(name).system
        whole = PartitionedNetwork(net)
        declared = net.separate(whole.holding(lambda _: True)) if net.wires else net.declared
        models = {n: build_model(d, Collocated(2)) for n, d in declared.items()}
        stepper = Coupled(net, [EngineMember(n, m, stepped(m, NativeInstance)) for n, m in models.items()])
        assert sorted(held_by(stepper)) == sorted(whole.held), name


def test_a_member_in_a_unit_or_in_parts_lands_alone_and_the_run_says_order_2(capsys):
    for more, name in (("--member", "body=fmu"), ("--parts", "body=2")):
        words = ["buffer", "--coupling", "newton", "--order", "4", "--stop", "0.3"]
        assert main(["run", *words, more, name]) == 0
        out = capsys.readouterr().out
        assert "order 2 (members of order 4, inputs held)" in out
        assert "body has state events whose" in out and "takes the mean of its inputs" in out
    assert PartitionedNetwork(build("buffer").system, ["spring"]).held == ["body"]
    assert "guards read what others give, and spring has steps of its own" in PartitionedNetwork(
        build("buffer").system, ["spring"]
    ).why_held("body")
