"""Coupled members are the composed model to rounding, at every order: stepped by engines, as units of FMI 2.0 and 3.0, mixed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phfmu import (
    PHDAE,
    Collocated,
    Coupled,
    EngineMember,
    Event,
    Monolithic,
    NativeInstance,
    Network,
    Options,
    PythonInstance,
    Scene,
    build_model,
    export,
    run,
)
from phfmu.cli import main
from phfmu.components.electrical.rl_line import rl_line
from phfmu.components.mechanical.translational import mass
from phfmu.components.scenes.electrical.ladder import ladder
from phfmu.components.scenes.electrical.smib import smib
from phfmu.components.scenes.electrical.two_machine import two_machine
from phfmu.components.scenes.mechanical.oscillator import oscillator
from phfmu.fmu.importer.reader import FMUInstance
from phfmu.network.members.consistent import InconsistentState
from phfmu.network.members.fmu_member import FMUMember
from phfmu.signals import CONSTRAINT
from tests.engines import BY_NAME
from tests.network.test_node_exchange import damped, loaded, quartic_on_cosh
from tests.wide import slow, turning, wide

UNITS = {"fmi2": "2.0", "fmi3": "3.0"}
MIXED = "native fmi3 python fmi2"
KINDS = ("python", "native", "fmi2", "fmi3", MIXED)


def rigid() -> Network:
    """Two masses on one joint: index 2, its rows linear in the velocities."""
    net = Network("rigid")
    net.add("a", mass(1.3, k=4.0, d=0.2, q=0.4, v=-0.3))
    net.add("b", mass(2.0, k=10.0, d=0.1, q=0.1, v=-0.3))
    net.junction("link", ["a.flange", "b.flange"])
    return net


def row_of_nodes() -> Network:
    """Machine - bare node - line - bare node - line - grid."""
    whole: Any = smib().system
    gen, grid = whole.members["gen"], whole.members["grid"]
    i, v = [-x for x in _currents(gen)], 2e4
    net = Network("row")
    net.add("gen", gen)
    net.add("near", rl_line(0.01, 2e-4, i=i, v=v))
    net.add("far", rl_line(0.02, 5e-4, i=i, v=v))
    net.add("grid", grid)
    for name, a, b in (
        ("bus1", "gen.terminal", "near.a"),
        ("bus2", "near.b", "far.a"),
        ("bus3", "far.b", "grid.terminal"),
    ):
        net.junction(name, [a, b])
    return net


def _currents(gen: Any) -> list[float]:
    """Of the terminal of a machine at its start."""
    return NativeInstance(build_model(gen)).signal("y_end")[:3].tolist()


@dataclass(frozen=True)
class Case:
    """A scene with its step and end; which kinds and orders run by default; junctions whose sums are zero at the ends of steps.

    `floor`: rounding is more than 1e-12: of lines that carry 1/1000 of the current of the machines they join.
    """

    make: Callable[[], Scene]
    step: float
    stop: float
    quick: tuple[tuple[str, int], ...] = ()
    kirchhoff: tuple[str, ...] = ()
    impulses: bool = True
    floor: bool = False


def scene_of(make: Callable[[], Network]) -> Callable[[], Scene]:
    return lambda: Scene("case", make(), stop=1.0, step=0.1)


def torque_step() -> Scene:
    scene = smib()
    return replace(scene, events=(replace(scene.events[0], t=3e-3),))


CASES = {
    "oscillator": Case(oscillator, 0.02, 0.4, ((MIXED, 3),)),
    "nonlinear": Case(scene_of(quartic_on_cosh), 0.1, 1.5, (("fmi3", 2),)),
    "rigid": Case(scene_of(rigid), 0.05, 0.75, (("fmi3", 1),)),
    "loaded": Case(scene_of(loaded), 1e-3, 0.015),
    "damped": Case(scene_of(damped), 0.05, 0.75),
    "ladder": Case(lambda: ladder(2), 1e-3, 0.015, floor=True),
    "smib without": Case(torque_step, 1e-3, 0.008, (), (), False),
    "smib": Case(torque_step, 1e-3, 0.008, ((MIXED, 2),), ("bus1",)),
    "two_machine": Case(lambda: two_machine(t_fault=4e-4, t_clear=12e-4), 2e-4, 2e-3, (), ("bus1",)),
    "row": Case(scene_of(row_of_nodes), 1e-3, 0.008, (), ("bus1", "bus2")),
}
#: a scene with its kinds of members, and k
TABLE = turning(
    [
        (name, kinds)
        for name, case in CASES.items()
        for kinds in KINDS
        if case.impulses
        or not {*kinds.split()} & {*UNITS}  # a unit without impulses is exported like that: at k = 1 it is held
    ],
    (1, 2, 3),
    *(((name, kinds), k) for name, case in CASES.items() for kinds, k in case.quick),
)


@pytest.fixture(scope="module")
def units(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """(member, declaration, k, version, step) -> path of its unit, with inputs at nodes, and impulses where ports take some."""
    made: dict[Any, dict[str, Path]] = {}

    def get(name: str, declaration: Any, k: int, version: str, step: float, scheme: Any) -> Path:
        key = (id(declaration), k)
        if key not in made:
            model = build_model(replace(declaration, name=name), scheme)
            kicked = any(p.kind != "none" for p in PythonInstance(model).impulse_ports)
            folder = tmp_path_factory.mktemp("units")
            later = [v.name for v in declaration.parameters if not v.signal]
            paths = export(
                model, folder, tuple(UNITS.values()), step=step, node_inputs=k > 1, impulses=kicked, tunable=later
            )
            made[key] = {"declaration": declaration} | dict(zip(UNITS.values(), paths, strict=True))  # keeps the id
        return made[key][version]

    return get


@pytest.fixture
def coupled(units: Any) -> Iterator[Any]:
    """(network, kinds in turn, k, step) -> members stepped apart."""
    with ExitStack() as stack:

        def make(net: Any, kinds: str, k: int, step: float, impulses: bool = True) -> Coupled:
            members: list[Any] = []
            for (name, d), kind in zip(net.members.items(), cycle(kinds.split()), strict=False):
                scheme = Collocated(k, impulses=impulses)
                if kind in UNITS:
                    path = units(name, d, k, UNITS[kind], step, scheme)
                    members.append(FMUMember(name, stack.enter_context(FMUInstance(path, name=name))))
                else:
                    model = build_model(replace(d, name=name), scheme)
                    members.append(EngineMember(name, model, BY_NAME[kind](model)))
            return Coupled(net, members)

        yield make


def states_differ(declaration: Any, one: Any, two: Any) -> float:
    """Largest difference of a state over the run relative to its size or nominal value."""
    worst = 0.0
    for v in declaration.states:
        for name, nominal in zip(v.names(), v.nominal, strict=True):
            a, b = one.column(name), two.column(name)
            worst = max(worst, float(np.max(np.abs(a - b)) / max(np.max(np.abs(a)), nominal)))
    return worst


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize(("members", "k"), TABLE, ids=lambda v: "-".join(v) if isinstance(v, tuple) else str(v))
def test_members_are_the_composed_model(coupled: Any, members: tuple[str, str], k: int) -> None:
    """Through events; joined currents sum to zero at step ends, and the books close."""
    name, kinds = members
    case = CASES[name]
    scene = case.make()
    net: Any = scene.system
    options = Options(stop=case.stop, step=case.step, events=scene.events)
    whole = scene.declaration()
    model = build_model(whole, Collocated(k, impulses=case.impulses))
    one = run(Monolithic(model, NativeInstance(model)), options)
    apart = coupled(net, kinds, k, case.step, case.impulses)
    two = run(apart, options)
    floor = states_differ(whole, one, run(Monolithic(model, PythonInstance(model)), options)) if case.floor else 0.0
    assert states_differ(whole, one, two) <= max(1e-12, 10 * floor)
    for bus in case.kirchhoff:
        assert max(v for n, v in two.worst.items() if n.startswith(f"{CONSTRAINT}velocity.{bus}")) <= 1e-9
    books = two.ledger.summary()
    if case.floor:  # of energies of the machines, the lines hardly have any
        assert max(abs(j.residual) for j in books.junctions) <= 1e-15 * sum(c.H_start for c in books.components)
    else:
        assert books.closed
    assert two.iterations <= 6 * two.steps
    assert apart.coupling.order == 2 * k


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("fmi", wide(["2.0", "3.0"], "3.0"))
@pytest.mark.parametrize("scene", wide(["smib", "two_machine"], "smib"))
@pytest.mark.parametrize("order", wide([2, 4, 6], 4))
def test_a_run_over_units_is_the_composed_run(scene: str, order: int, fmi: str, tmp_path: Path, capsys: Any) -> None:
    """From the command line; the label says the order, and the table has the columns of a run over an engine."""
    common = ["run", scene, "--order", str(order), "--stop", "0.006", "--step", "1e-3" if scene == "smib" else "2e-4"]
    tables = {}
    for name, how in {
        "composed": [],
        "engine": ["--coupling", "newton", "--engine", "native"],
        "units": ["--coupling", "newton", "--engine", "fmu", "--fmi", fmi],
    }.items():
        assert main([*common, *how, "-o", str(tmp_path / f"{name}.csv")]) == 0
        said = capsys.readouterr().out
        assert f"order {order}" in said.splitlines()[0] and "inputs held" not in said
        tables[name] = np.genfromtxt(
            tmp_path / f"{name}.csv", delimiter=",", names=True, deletechars="", replace_space=""
        )
    assert set(tables["engine"].dtype.names) <= set(tables["units"].dtype.names)
    assert set(tables["composed"].dtype.names) == set(tables["engine"].dtype.names)
    for n in ("stored", "supplied", "dissipated"):
        a, b = (tables[w][f"energy.{n}"] for w in ("composed", "units"))
        assert np.abs(a - b).max() <= 1e-10 * np.abs(a).max()
    assert not [n for n in tables["units"].dtype.names if "node" in n or "impulse" in n]
    shared = [n for n in tables["composed"].dtype.names if "flux" in n or ".I[" in n or n.endswith(("theta", ".p"))]
    assert len(shared) >= 14
    size: dict[str, float] = {}  # of the largest entry: dampers carry next to nothing beside the stator
    for n in shared:
        group = n.partition("[")[0]
        size[group] = max(size.get(group, 0.0), float(np.max(np.abs(tables["composed"][n]))))
    for n in shared:
        differ = np.max(np.abs(tables["composed"][n] - tables["units"][n]))
        assert differ <= 1e-12 * size[n.partition("[")[0]], n


@pytest.mark.slow
@pytest.mark.usefixtures("compiler")
def test_a_scene_of_units_keeps_their_order(tmp_path: Path, capsys: Any) -> None:
    """Units from files beside declared members: the run says its order, `info` what each junction exchanges."""
    net: Any = smib().system
    whole = build_model(smib().declaration(), Collocated(2))
    for name, order in (("gen", 2), ("line", 3)):
        export(
            build_model(replace(net.members[name], name=name), Collocated(order)),
            tmp_path,
            ("3.0",),
            step=1e-3,
            node_inputs=True,
        )
    scene = tmp_path / "scene.py"
    scene.write_text(
        "from phfmu import Network, Scene\nfrom phfmu.components.scenes.electrical.smib import smib\n"
        "def mixed(line=False):\n    own, net = smib().system, Network('mixed')\n"
        "    net.add('gen', 'gen_fmi3.fmu')\n    net.add('line', 'line_fmi3.fmu' if line else own.members['line'])\n"
        "    net.add('grid', own.members['grid'])\n    for j in own.junctions:\n"
        "        net.junction(j.name, [str(e) for e in j.ends])\n    return Scene('mixed', net, stop=0.006, step=1e-3)\n"
        "def finer():\n    return mixed(True)\n"
    )
    assert main(["info", f"{scene}:mixed"]) == 0
    said = capsys.readouterr().out
    assert "order: at most 4 with --coupling newton" in said
    assert "common effort; newton: k values and a pair of impulses, order 2k" in said
    options = Options(stop=6e-3, step=1e-3)
    one = run(Monolithic(whole, NativeInstance(whole)), options)
    for target, order in (("mixed", 4), ("mixed", 6), ("finer", 4)):
        table = tmp_path / f"{target}{order}.csv"
        assert main(["run", f"{scene}:{target}", "--order", str(order), "-o", str(table)]) == 0
        said = capsys.readouterr().out.splitlines()
        assert f"order {min(order, 4)}" in said[0] and "inputs held" not in said[0]
        assert ("units of order 4" in said[0]) == (order == 6)
        two = np.genfromtxt(table, delimiter=",", names=True, deletechars="", replace_space="")
        gap = np.abs(two["gen.theta"] - one.column("gen.theta")).max() / np.abs(one.column("gen.theta")).max()
        assert gap <= (1e-12 if (target, order) == ("mixed", 4) else 1e-6)


# -- starts and events ---------------------------------------------------------------------------------------------


def pulled_apart() -> Network:
    """A rigid link of two masses with different velocities: an impact that loses m1 m2 dv^2 / (2 (m1 + m2))."""
    net = rigid()
    net.members["a"] = mass(1.3, k=4.0, d=0.2, q=0.4, v=0.5)
    return net


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize(("kinds", "k"), [slow(("fmi2", 2)), slow(("fmi3", 1)), (MIXED, 2)])
def test_units_are_moved_onto_the_sums_of_their_junctions(coupled: Any, kinds: str, k: int) -> None:
    """By an impulse at the present time: velocities and energy are those of an inelastic impact, the books of units close."""
    apart = coupled(pulled_apart(), kinds, k, 0.05)
    with pytest.raises(InconsistentState, match="differ by 0.8 m/s"):
        apart.check_start()
    found = apart.project_start(0.0)
    common = (1.3 * 0.5 - 2.0 * 0.3) / 3.3
    assert found.energy == pytest.approx(-1.3 * 2.0 / 3.3 * 0.8**2 / 2, rel=1e-12)
    assert {n: v for n, _, v in found.moved} == pytest.approx({"a.v": common, "b.v": common}, rel=1e-12)
    apart.check_start()
    for m in apart.joined.members:
        if isinstance(m, FMUMember):
            assert m.unit.time < 1e-290 and abs(m.unit.gap() or 0.0) <= 1e-15
            assert abs(m.unit.get(["energy.residual"])[0]) <= 1e-15
    twin = coupled(pulled_apart(), "native", k, 0.05)
    twin.project_start(0.0)
    one, two = (run(c, Options(stop=0.5, step=0.05)) for c in (apart, twin))
    assert np.abs(one.column("a.q") - two.column("a.q")).max() <= 1e-13 and one.ledger.summary().closed


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize(("kinds", "k"), [("fmi2", 2), slow(("fmi3", 1))])
def test_an_event_at_a_node_of_units_moves_them_as_the_composed_model(coupled: Any, kinds: str, k: int) -> None:
    scene = smib()
    net: Any = scene.system
    L = next(float(v.start[0]) for v in net.members["line"].parameters if v.name == "L")
    options = Options(stop=0.01, step=1e-3, events=[Event(0.005, "line.L", 0.9 * L)])
    model = build_model(scene.declaration(), Collocated(k))
    one = run(Monolithic(model, NativeInstance(model)), options)
    two = run(coupled(net, kinds, k, 1e-3), options)
    assert states_differ(scene.declaration(), one, two) <= 1e-12
    assert two.ledger.summary().closed and two.ledger.summary().events == {"parameter": 1, "reprojection": 1}
    jump = [float(r.notes[0].partition("changed by ")[2].partition(" J")[0]) for r in (one, two)]
    assert jump[0] == pytest.approx(jump[1], rel=1e-8) and abs(jump[0]) > 1.0
    assert max(v for n, v in two.worst.items() if n.startswith(CONSTRAINT + "velocity.bus1")) <= 1e-8


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_a_start_of_units_is_projected_from_the_command_line(fmi: str, tmp_path: Path, capsys: Any) -> None:
    """At order 2 too, where nodes with linear sums exchange no impulses in a step."""
    scene = tmp_path / "impact.py"
    scene.write_text(
        "from phfmu import Network, Scene\nfrom phfmu.components.mechanical.translational import mass\n"
        "def impact():\n    net = Network('impact')\n    net.add('a', mass(1.0, v=1.0))\n    net.add('b', mass(2.0))\n"
        "    net.junction('link', ['a.flange', 'b.flange'])\n    return Scene('impact', net, stop=0.2, step=0.1)\n"
    )
    apart = ["--coupling", "newton", "--engine", "fmu", "--fmi", fmi]
    table = tmp_path / "o.csv"
    assert main(["run", str(scene), *apart, "--project", "-o", str(table)]) == 0
    assert "-0.333333333" in capsys.readouterr().out
    rows = np.genfromtxt(table, delimiter=",", names=True, deletechars="", replace_space="")
    assert np.abs(rows["a.v"] - 1 / 3).max() <= 1e-15 and np.abs(rows["b.v"] - 1 / 3).max() <= 1e-15


@pytest.mark.usefixtures("compiler")
def test_units_without_impulses_say_how_to_get_them(tmp_path: Path) -> None:
    net = pulled_apart()
    members: list[Any] = []
    with ExitStack() as stack:
        for name, d in net.members.items():
            assert isinstance(d, PHDAE)
            (path,) = export(build_model(replace(d, name=name)), tmp_path, ("3.0",), step=0.05)
            members.append(FMUMember(name, stack.enter_context(FMUInstance(path, name=name))))
        with pytest.raises(ValueError, match=r"a, b take no impulses; export units with --node-inputs or --impulses"):
            Coupled(net, members).project_start(0.0)
