"""Members stepped apart tell the columns of the composed model: its names in its order, its units, its values in each row."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phfmu import Coupled, EngineMember, Monolithic, NativeInstance, Network, Options, build_model, run
from phfmu.cli import main
from phfmu.components.library import LIBRARY, build
from phfmu.components.mechanical.translational import mass
from phfmu.network.couplings.choice.coupling_choice import named_coupling
from phfmu.pick import matching
from phfmu.results.file import open_result
from phfmu.schemes.collocated import Collocated
from phfmu.signals import LEDGER, STEP_LEDGER, end_name, total
from tests.wide import turning

STEPS = 8
#: relative to the largest value of a column
CLOSE = 1e-8
#: one component; ideal switches, which need instances of their own; a mechanism, which has no order 4 (`test_engine.py` has it)
WHOLE = {
    *(
        "bouncing_ball",
        "bead",
        "rectifier",
        "buck",
        "hard_stop",
        "clutch_engagement",
        "six_pulse",
        "panda",
        "robot_arm",
        "engine",
    ),
}
SCENES = [n for n, (kind, *_) in LIBRARY.items() if kind == "scene" and n not in WHOLE]
#: scenes with state events, which units of order 2k do not take
NO_UNITS = {"two_point_control", "buffer", "breaker_opening", "smib_breaker", "island", "smib_exciter"}
#: differences of energies that cancel: rounding beside the energies in play
LEDGERS = {what for what, *_ in LEDGER}


def entries(*names: str) -> set[str]:
    return {f"{n}[{i}]" for n in names for i in (1, 2, 3)}


GRID = entries("grid.source.i", "grid.i_end")
#: told under the polynomial of the step at its end: what follows an input of another member at once, and voltages of bare nodes
ON_POLYNOMIALS = {
    "oscillator": set[str](),
    "drive": {"shaft.damper.torque_end", "shaft.damper.speed_end", "shaft.a.torque", "shaft.b.torque"},
    "speed_control": {"actuator.w_end", "actuator.source.power"},
    "two_point_control": {"actuator.w_end", "actuator.source.power"},
    "smib": GRID | entries("bus1.v_end"),
    "smib_hydro": GRID | entries("bus1.v_end"),
    "smib_folded": GRID,
}


def apart(net: Network, k: int, engine: Any, coupling: str = "newton") -> Coupled:
    held = [n for n, d in net.declared.items() if d.state_events]
    members = []
    for name, declared in net.separate(held).items():
        model = build_model(declared, Collocated(k))
        members.append(EngineMember(name, model, engine(model)))
    return Coupled(net, members, named_coupling(coupling, net).make)


def both(net: Network, k: int, step: float, engine: Any = NativeInstance, **how: Any) -> tuple[Any, Any]:
    model = build_model(net.compose(), Collocated(k))
    options = Options(stop=STEPS * step, step=step, **how)
    return run(Monolithic(model, engine(model)), options), run(apart(net, k, engine), options)


def same_names(one: Any, two: Any) -> None:
    n = len(one.names)
    assert two.names[:n] == one.names and two.units[:n] == one.units and two.kinds[:n] == one.kinds


def differing(one: Any, two: Any) -> set[str]:
    """Columns whose values are not equal, the ledger being measured by what is stored."""
    stored = float(np.abs(one.column(total("stored"))).max())
    out = set()
    for n in one.names:
        a, b = one.column(n), two.column(n)
        size = stored if n.rpartition(".")[2] in LEDGERS else float(np.abs(a).max())
        if n.startswith("constraint."):
            size = 1.0
        if float(np.abs(a - b).max()) > CLOSE * size + 1e-10:
            out.add(n)
    return out


@pytest.mark.parametrize("k", [1, 2])
@pytest.mark.parametrize("name", ["oscillator", "drive", "two_point_control"])
def test_columns_are_those_of_the_composed_run(name: str, k: int) -> None:
    scene = build(name)
    one, two = both(scene.system, k, scene.step, events=scene.events)
    same_names(one, two)
    assert len(two.names) == len(one.names)
    assert differing(one, two) == ON_POLYNOMIALS[name]


@pytest.mark.parametrize(("name", "k"), turning(SCENES, [1, 2, 3]))
def test_columns_of_all_scenes(name: str, k: int) -> None:
    scene = build(name)
    one, two = both(scene.system, k, scene.step, NativeInstance, events=scene.events)
    same_names(one, two)
    assert len(two.names) == len(one.names)
    assert all(matching(pattern, one.names) for pattern in scene.shown), "signals of its picture"
    if name in ON_POLYNOMIALS:
        assert differing(one, two) <= ON_POLYNOMIALS[name]


@pytest.mark.parametrize(("name", "order"), turning([n for n in SCENES if n not in NO_UNITS], [2, 4, 6]))
def test_columns_of_units(name: str, order: int, tmp_path: Path) -> None:
    """Units add what only they tell, before the free inputs."""
    scene, tables = build(name), []
    for kind in ("", "--coupling newton --engine fmu"):
        path = tmp_path / f"{len(tables)}.parquet"
        command = f"run {name} --order {order} --stop {STEPS * scene.step} --quiet -o {path} {kind}"
        assert main(command.split()) == 0
        tables.append(open_result(path))
    one, two = tables
    of_units = tuple({total("gap"), total("events"), *(total(what) for what, *_ in STEP_LEDGER)})
    shared = [i for i, n in enumerate(two.names) if not n.endswith(of_units)]
    assert [two.names[i] for i in shared] == one.names and [two.units[i] for i in shared] == one.units
    added = sorted(set(range(len(two.names))) - set(shared))
    assert added == list(range(added[0], added[-1] + 1))
    if name in ON_POLYNOMIALS and not (order == 2 and name == "speed_control"):  # signals of units of order 2 are held
        assert differing(one, two) <= ON_POLYNOMIALS[name]


def test_a_rigid_joint_has_the_spread_of_what_must_be_equal() -> None:
    """The checks of composed models, with the sign that they have there."""
    net = Network("joint")
    for name, m in (("one", 1.0), ("two", 2.0), ("three", 3.0)):
        net.add(name, mass(m, k=4.0, q=0.1))
    net.junction("joint", ["one.flange", "two.flange", "three.flange"])
    one, two = both(net, 1, 0.01)
    same_names(one, two)
    checks = [n for n in one.names if n.startswith("constraint.")]
    assert len(checks) == 2
    assert differing(one, two) <= {
        end_name(n) for n in one.names if n.startswith("joint") or n.endswith("flange.force")
    }
