"""Signals between units at the nodes of their steps."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phfmu import (
    Collocated,
    Coupled,
    EngineMember,
    FMUInstance,
    FMUMember,
    NativeInstance,
    Network,
    Options,
    PythonInstance,
    build_model,
    export,
    run,
)
from phfmu.cli import main
from phfmu.components.scenes.mechanical.speed_control import speed_control
from phfmu.network.couplings.choice.partitioned_network import PartitionedNetwork
from phfmu.network.junction import ConnectionError
from phfmu.network.members.member import Member
from tests.engines import BY_NAME
from tests.network.governed import (
    LOOP,
    apart_by,
    composed,
    governed,
    loop,
    ran,
    speed,
)
from tests.wide import wide

# -- units -----------------------------------------------------------------------------------------------------

FMI = {"fmi2": "2.0", "fmi3": "3.0"}


@pytest.fixture
def with_units(compiler: None, tmp_path: Path) -> Iterator[Any]:
    """(network, kinds in turn, k, step) -> members stepped apart."""
    with ExitStack() as stack:

        def make(net: Network, kinds: str, k: int, h: float) -> Coupled:
            members: list[Member] = []
            for (name, part), kind in zip(net.separate().items(), cycle(kinds.split()), strict=False):
                model = build_model(part, Collocated(k))
                if kind in FMI:
                    kicked = any(p.kind != "none" for p in PythonInstance(model).impulse_ports)
                    later = [v.name for v in part.parameters]
                    folder = tmp_path / f"{name}{k}"
                    (path,) = export(
                        model, folder, (FMI[kind],), step=h, node_inputs=True, impulses=kicked, tunable=later
                    )
                    members.append(FMUMember(name, stack.enter_context(FMUInstance(path, name=name))))
                else:
                    members.append(EngineMember(name, model, BY_NAME[kind](model)))
            return Coupled(net, members)

        yield make


@pytest.mark.parametrize(
    ("kinds", "k"),
    wide([(kinds, k) for kinds in ("fmi2", "fmi3", "fmi3 native fmi2") for k in (2, 3)], ("fmi3 native fmi2", 2)),
)
def test_units_exchange_signals_at_nodes(with_units: Any, kinds: str, k: int) -> None:
    options = Options(stop=0.2, step=1e-2, events=speed_control().events)
    whole = run(composed(loop(), k), options)
    system = with_units(loop(), kinds, k, 1e-2)
    parts = run(system, options)
    assert system.coupling.order == 2 * k and parts.ledger.summary().closed
    for name in LOOP:
        size = np.abs(whole.column(name)).max()
        np.testing.assert_allclose(parts.column(name), whole.column(name), rtol=0, atol=1e-12 * size)
    with pytest.raises(KeyError, match="fed by a signal"):
        system.set_value("actuator.torque", 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("kinds", ["fmi2", "fmi3", "fmi3 native fmi2 python"])
def test_a_governed_machine_of_units_is_the_composed_one(with_units: Any, kinds: str) -> None:
    net, stop = governed(), 0.005
    parts = ran(net, with_units(net, kinds, 2, 1e-3), 1e-3, stop)
    assert apart_by(parts, ran(net, composed(net, 2, NativeInstance), 1e-3, stop)) < 1e-12
    assert parts.ledger.summary().closed


def test_a_plain_importer_sees_plain_inputs_and_outputs(compiler: None, tmp_path: Path) -> None:
    """Held, by its own name, with the bits of the engine; values at nodes are more variables, which none has to set."""
    model = build_model(loop().separate()["controller"], Collocated(2))
    (path,) = export(model, tmp_path, ("3.0",), step=1e-2, node_inputs=True)
    engine = NativeInstance(model)
    with FMUInstance(path) as unit:
        about = unit.interface.variables
        given = {n for n, v in about.items() if v.causality == "input"}
        assert given == {"reference", "measured", "measured_node[1]", "measured_node[2]"}
        found = {n for n, v in about.items() if v.causality == "output"}
        assert {"command", "error", "command_node[1]", "command_node[2]"} <= found and unit.ports == ()
        assert about["measured"].unit == "rad/s" and about["command_node[1]"].unit == "N.m"
        unit.set({"measured": 95.0})
        engine.set_input([95.0, 0.0])
        for i in range(3):
            unit.do_step(i * 1e-2, 1e-2)
            engine.do_step(i * 1e-2, 1e-2)
            assert unit.get(["x"])[0] == engine.x[0]
        assert unit.get(["command"])[0] == pytest.approx(0.8 * 5.0 + 8.0 * engine.x[0], rel=1e-15)


def test_units_from_the_command_line_find_each_others_signals(compiler: None, tmp_path: Path) -> None:
    """A controller and an actuator exported alone, with `--node-inputs`, in a network with a rotor: order 4."""
    source = tmp_path / "parts.py"
    source.write_text(
        "from phfmu.components.scenes.mechanical.speed_control import speed_control as s\n"
        "def controller():\n    return s().system.declared['controller']\n"
        "def actuator():\n    return s().system.declared['actuator']\n"
    )
    for name in ("controller", "actuator"):
        words = ["export", f"{source}:{name}", "--order", "4", "--node-inputs", "--step", "1e-2", "--fmi", "3"]
        assert main([*words, "-o", str(tmp_path / name)]) == 0
    net = Network("mixed", members={"rotor": loop().declared["rotor"]})
    for name in ("controller", "actuator"):
        (path,) = (tmp_path / name).glob("*.fmu")
        net.add(name, str(path))
    net.connect("rotor.a", "actuator.shaft", name="shaft")
    net.signal("rotor.w", "controller.measured")
    net.signal("controller.command", "actuator.torque")
    assert "at most 4" in PartitionedNetwork(net).order()
    rotor = build_model(net.separate()["rotor"], Collocated(2))
    with ExitStack() as stack:
        members: list[Member] = [EngineMember("rotor", rotor, PythonInstance(rotor))]
        for name, unit in net.units.items():
            members.append(FMUMember(name, stack.enter_context(FMUInstance(unit.path, name=name))))
        found = run(Coupled(net, members), Options(stop=0.2, step=1e-2, events=speed_control().events))
    np.testing.assert_allclose(found.column("rotor.w"), speed(2)[0].column("rotor.w"), rtol=1e-13)
    with pytest.raises(ConnectionError, match="has no signal input"):
        net.signal("rotor.w", "controller.measured_node[1]")
