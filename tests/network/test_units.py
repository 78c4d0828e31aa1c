"""Units of other tools as members: a scene file from the command line, against the same scene declared."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from phfmu import Coupled, EngineMember, Network, Options, PythonInstance, build_model, export
from phfmu import run as run_
from phfmu.cli import main
from phfmu.components.mechanical.translational import mass
from phfmu.fmu.export.variables import FMUError
from phfmu.fmu.importer.reader import FMUInstance
from phfmu.fmu.importer.unit_file import unit_file
from phfmu.network.junction import ConnectionError
from phfmu.network.members.unit_member import tried, unit_member
from tests.fmu import foreign
from tests.wide import slow, wide

VERSIONS = ["2.0", "3.0"]
SIDECAR = '[flange]\neffort = "F"\nflow = "v"\nsign = 1\n'
SCENE = """
from phfmu import Network, Scene
from phfmu.components.mechanical.translational import mass, spring


def {name}():
    net = Network("{name}")
    net.add("pump", {pump})
    net.add("cart", mass(2.0, q=0.3))
    net.add("spring", spring(40.0, elongation=0.3))
    net.junction("a", ["pump.flange", "spring.a"])
    net.junction("b", ["cart.flange", "spring.b"])
    return Scene("{name}", net, stop=1.0, step=0.01)
"""
Cli = Callable[..., np.ndarray]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "declared.py").write_text(SCENE.format(name="declared", pump="mass(1.0)"))
    (tmp_path / "pump.ports.toml").write_text(SIDECAR)
    return tmp_path


@pytest.fixture
def run(folder: Path) -> Cli:
    """Rows of `phfmu run` of a scene of the folder."""

    def call(name: str, *options: str) -> np.ndarray:
        table = folder / f"{name}.csv"
        assert main(["run", str(folder / f"{name}.py"), "-o", str(table), *options]) == 0
        return np.genfromtxt(table, delimiter=",", names=True, deletechars="")

    return call


def scene(folder: Path, pump: str = '"pump.fmu"') -> Path:
    """A file whose only function joins the unit beside it to declared members."""
    path = folder / "mixed.py"
    path.write_text(SCENE.format(name="mixed", pump=pump))
    return path


@pytest.mark.parametrize("version", VERSIONS)
def test_a_foreign_unit_in_a_scene_moves_as_the_declared_member(
    folder: Path, run: Cli, version: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """A mass under a held force is stepped exactly by the unit, and so by a midpoint rule."""
    foreign.mass(folder / "pump.fmu", version)
    scene(folder)
    mixed, declared = run("mixed"), run("declared")
    said = capsys.readouterr()
    assert np.abs(declared["pump.v"]).max() > 1.0
    for name in ("pump.v", "pump.q", "cart.v", "spring.e"):
        assert np.abs(mixed[name] - declared[name]).max() <= 1e-11, name
    assert "pump: left out, cannot be read or set here: String: 1 (label)" in said.out
    assert "pump: restores" not in said.out and "stepped last" not in said.out
    assert "estimated" in said.out and "closed" not in next(
        l for l in said.out.splitlines() if l.strip().startswith("pump")
    )


PORT = {"effort": "F", "flow": "v", "sign": 1}


@pytest.mark.parametrize(
    "table, said",
    [
        ({"sign": None}, "no sign; say sign = 1 if the force counts into the unit"),
        ({"sign": 2}, "sign = 2; say sign = 1"),
        ({"effort": "f"}, "foreign has no variable 'f'"),
        ({"effort": None}, 'say which variable is its effort: effort = "name"'),
        ({"effort": "H"}, "effort H is local; flow v is output; of a pair one has to be an input"),
        ({"flow": "m"}, "m is in kg, its port has m/s there"),
        ({"flow": "m", "domain": None}, r"its units \(effort F in N, flow m in kg\) do not tell its domain"),
        ({"domain": "thermal"}, "unknown domain 'thermal'; there are electrical, translational"),
        ({"domain": {"name": "mine"}}, "a domain of its own has name, effort, effort_unit, flow, flow_unit, common"),
        ({"velocity": "v"}, "unknown key 'velocity'"),
        ({"displacement": ["q", "q"]}, "2 displacements for 1 outputs"),
        ({"flow": ["v", "q"]}, "1 inputs but 2 outputs"),
    ],
)
def test_ports_that_do_not_fit_are_told_with_what_there_is(folder: Path, table: dict[str, object], said: str) -> None:
    path = foreign.mass(folder / "pump.fmu", "3.0")
    told = {k: v for k, v in {**PORT, "domain": "translational", **table}.items() if v is not None}
    with pytest.raises(FMUError, match=said):
        unit_file(path, {"flange": told})


def test_ports_are_found_in_the_scene_or_beside_the_unit(folder: Path) -> None:
    path = foreign.mass(folder / "pump.fmu", "2.0")
    (port,) = unit_file(path).ports
    assert (port.name, port.domain.name, port.given, port.n) == ("flange", "translational", "effort", 1)
    (other,) = unit_file(path, {"rod": {**PORT, "effort": ["F"], "flow": ["v"]}}).ports
    assert (other.name, other.input_names()) == ("rod", ["rod.force[1]"]), "a list makes a vector"
    (folder / "pump.ports.toml").write_text("[flange\n")
    with pytest.raises(FMUError, match=r"pump.ports.toml: no TOML: .*line 1"):
        unit_file(path)


def test_a_unit_in_a_network_cannot_be_composed(folder: Path) -> None:
    net = Network("one")
    net.add("pump", foreign.mass(folder / "pump.fmu", "2.0"))
    with pytest.raises(ConnectionError, match=r"one: pump is an FMU, which cannot be composed .*--coupling newton"):
        net.compose()
    with pytest.raises(ConnectionError, match="'cart' has ports of its own"):
        net.add("cart", mass(), ports={})


def test_values_before_the_start_are_set_by_name(folder: Path, run: Cli, capsys: pytest.CaptureFixture[str]) -> None:
    foreign.mass(folder / "pump.fmu", "3.0")
    path = scene(folder)
    rows = run("mixed", "--set", "pump.m=3", "--set", "pump.q=0.5", "--stop", "0.1")
    assert rows["pump.q"][0] == 0.5
    assert np.abs(rows["pump.v"] - run("declared", "--set", "pump.m=3", "--stop", "0.1")["pump.v"]).max() <= 1e-12
    assert main(["run", str(path), "--set", "pump.F=1"]) == 2
    assert "'pump.F' is fed by the junction 'a'" in capsys.readouterr().err
    assert main(["run", str(path), "--set", "pump.mm=1"]) == 2
    assert "no parameter, state or input 'pump.mm'; did you mean" in capsys.readouterr().err


@pytest.mark.parametrize("version", wide(VERSIONS, "3.0"))
@pytest.mark.parametrize(
    "forgets, said_of_it",
    [
        slow((None, "cannot save its state")),
        (1, "does not restore its state: a step repeated from a restored state ends with q = "),
        slow((2, "does not restore its state: a step repeated from a restored state ends with ")),
        (3, "does not restore its state: pump: fmi"),
    ],
)
def test_a_unit_that_cannot_take_steps_back_is_told_and_stepped_last(
    folder: Path, run: Cli, version: str, forgets: int | None, said_of_it: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The response of a free mass is linear, so that the prediction is exact and the run that of the declared member."""
    foreign.mass(folder / "pump.fmu", version, saves=forgets is not None)
    scene(folder)
    mixed = run("mixed", *(("--set", f"pump.forgets={forgets}") if forgets else ()))
    said = capsys.readouterr()
    line = next(line for line in said.out.splitlines() if "it is stepped last" in line)
    assert line.startswith(f"pump: {said_of_it}")
    assert "smaller step" not in said.out + said.err
    declared = run("declared")
    for name in ("pump.v", "pump.q", "cart.v", "spring.e"):
        assert np.abs(mixed[name] - declared[name]).max() <= 1e-10, name


def test_what_a_prediction_misses_is_booked_and_shrinks_with_the_step(folder: Path) -> None:
    """On a spring of its own the free motion of the unit is not uniform; what its junction makes of that is of second order."""
    path = foreign.mass(folder / "pump.fmu", "3.0", saves=False)
    model, missed, made = build_model(replace(mass(2.0, q=0.3, k=10.0), name="cart")), [], []
    for h in (0.02, 0.01, 0.005):
        net = Network("one")
        net.add("pump", path, ports={"flange": {**PORT, "displacement": "q"}})
        net.members["pump"] = net.units["pump"].with_starts({"k": 30.0, "q": 0.2})
        net.add("cart", mass(2.0, q=0.3, k=10.0))
        net.junction("a", ["pump.flange", "cart.flange"])
        unit, _ = unit_member("pump", net.units["pump"], h, tried(net.units, h)["pump"])
        coupled = Coupled(net, [unit, EngineMember("cart", model, PythonInstance(model))])
        result = run_(coupled, Options(stop=0.5, step=h))
        rows = dict(zip(result.names, result.values.T, strict=True))
        missed.append(np.abs(rows["pump.v"] - rows["cart.v"]).max())
        summary = result.ledger.summary()
        (junction,) = summary.junctions
        made.append(abs(junction.residual))
        assert summary.closed and junction.verdict == "loose"
        held, estimated = summary.parts
        assert (held.part, estimated.part) == ("held value", "estimated ports")
        assert estimated.residual == pytest.approx(junction.residual, abs=1e-13) and abs(held.residual) < 1e-13
        assert summary.network is not None and abs(summary.network.unexplained) < 1e-13
    for values in (missed, made):
        assert 3 < values[0] / values[1] < 5 and 3 < values[1] / values[2] < 5 and values[2] > 1e-9


#: a unit of the description that the text alone does not tell
KILO = '<UnitDefinitions><Unit name="kilonewton"><BaseUnit kg="1" m="1" s="-2" factor="1000"/></Unit></UnitDefinitions>'


@pytest.mark.parametrize("version", wide(VERSIONS, "3.0"))
@pytest.mark.parametrize("how", wide(["defined", "told", "terminal"], "told"))
def test_units_and_signs_of_the_variables_are_converted(folder: Path, run: Cli, version: str, how: str) -> None:
    """A force of 1 kN that the unit takes for 1 moves a mass of 1 as 1 N moves one of 1 g; so with force and sign turned."""
    told = {"defined": "sign = 1", "told": 'sign = -1\neffort_unit = "kN"'}
    if how == "terminal":
        (folder / "pump.ports.toml").unlink()
    else:
        (folder / "pump.ports.toml").write_text(SIDECAR.replace("sign = 1", told[how]))
    foreign.mass(
        folder / "pump.fmu", version, unit_of_force="kilonewton", before=KILO if how != "told" else "",
        terminals={"defined": "inflow", "told": "", "terminal": "inflow"}[how],
    )  # fmt: skip
    port = "flange" if how != "terminal" else "rod_flange"
    path = scene(folder)
    path.write_text(path.read_text().replace("pump.flange", f"pump.{port}"))
    turn = -1 if how == "told" else 1
    mixed = run("mixed", "--set", f"pump.m={1e-3 * turn}")
    assert np.abs(mixed["pump.v"] - run("declared")["pump.v"]).max() <= 1e-11


def test_terminals_that_are_no_ports_are_told(folder: Path) -> None:
    (folder / "pump.ports.toml").unlink()
    file = unit_file(foreign.mass(folder / "pump.fmu", "3.0", terminals="outflow"))
    assert [(m.name, m.domain.name, m.sign) for m in file.port_maps] == [("rod_flange", "translational", -1.0)]
    assert file.left_out[1:] == (
        "terminal 'bus': is no power port, which has as many signals as inflows or outflows: q (signal)",
    )


@pytest.mark.parametrize("version", VERSIONS)
def test_work_is_exact_by_a_displacement_and_of_second_order_by_the_trapezoid(folder: Path, version: str) -> None:
    """The energy that the unit itself tells, of a mass on a spring of its own, is what forces held over steps supply."""
    path = foreign.mass(folder / "pump.fmu", version)
    missed = {}
    for h in (0.1, 0.05):
        for name, more in (("trapezoid", {}), ("displacement", {"displacement": "q"})):
            file = unit_file(path, {"flange": {**PORT, **more}})
            with FMUInstance(path, file.port_maps, starts={"k": 30.0, "q": 0.2}) as unit:
                before = unit.get(["H"])[0]
                for k in range(round(1 / h)):
                    unit.set_input([np.cos(3 * k * h)])
                    unit.do_step(k * h, h)
                missed[name, h] = abs(unit.get(["H"])[0] - before - unit.energies()[0])
    assert missed["displacement", 0.1] < 1e-14 > missed["displacement", 0.05]
    assert 3 < missed["trapezoid", 0.1] / missed["trapezoid", 0.05] < 5 and missed["trapezoid", 0.05] > 1e-5


def test_two_units_that_cannot_take_steps_back_are_stepped_once_each(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    foreign.mass(folder / "pump.fmu", "2.0", saves=False)
    path = scene(folder)
    path.write_text(path.read_text().replace("mass(2.0, q=0.3)", f'"pump.fmu", ports={{"flange": {PORT}}}'))
    assert main(["run", str(path), "--stop", "0.02", "--step", "1e-3"]) == 0
    said = capsys.readouterr().out
    assert (
        "coupling gauss-seidel: pump cannot save its state; cart cannot save its state, so no step can be repeated"
        in said
    )
    assert main(["run", str(path), "--stop", "0.02", "--coupling", "newton"]) == 0
    assert capsys.readouterr().out.count("it is stepped last") == 2, "asked for"


@pytest.fixture(scope="module")
def isolated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a scene of two units, one of them to misbehave."""
    folder = tmp_path_factory.mktemp("isolated")
    for version in VERSIONS:
        foreign.mass(folder / f"pump{version[0]}.fmu", version)
        (folder / f"pump{version[0]}.ports.toml").write_text(SIDECAR)
        (folder / f"scene{version[0]}.py").write_text(SCENE.format(name="mixed", pump=f'"pump{version[0]}.fmu"'))
    return folder


@pytest.mark.parametrize(
    "version, mode, said",
    [
        slow(("2.0", foreign.CRASH, "pump at t = 0.25 s, h = 0.05 s: fmi2DoStep: its process ")),
        slow(
            (
                "3.0",
                foreign.HANG,
                "fmi3DoStep: no answer in 3 s: its process was ended. Next: allow it more time (--isolate-timeout)",
            )
        ),
        (
            "3.0",
            foreign.LAST_WORDS,
            "its process ended with exit code 7: it is not there any more; it says: pump speaks at 0.25",
        ),
    ],
)
def test_a_unit_that_breaks_its_process_ends_the_run_and_no_more(
    isolated: Path, tmp_path: Path, version: str, mode: int, said: str, capfd: pytest.CaptureFixture[str]
) -> None:
    """Exit code 3 with the name of the member; rows and audit of the accepted steps stay readable."""
    table, audit = tmp_path / "o.csv", tmp_path / "a.parquet"
    run = ["run", str(isolated / f"scene{version[0]}.py"), "--step", "0.05", "--isolate-timeout", "3"]
    line = [*run, "--set", f"pump.mode={mode}"]
    assert main([*line, "-o", str(table), "--audit", str(audit)]) == 3
    found = " ".join(capfd.readouterr().err.split())
    assert said in found and ("was ended by SIGSEGV" in found or mode != foreign.CRASH or sys.platform == "win32")
    rows = np.genfromtxt(table, delimiter=",", names=True, deletechars="")
    assert rows["time"].tolist() == pytest.approx([0.05 * k for k in range(6)])
    assert np.isfinite(rows["pump.v"]).all() and np.abs(rows["pump.v"]).max() > 0.1
    assert main(["audit", str(audit)]) == 0
    assert "pump" in capfd.readouterr().out


@pytest.mark.parametrize("version", wide(VERSIONS, "2.0"))
def test_an_isolated_unit_gives_the_same_bits_and_its_output_goes_to_stderr(
    isolated: Path, tmp_path: Path, version: str, capfd: pytest.CaptureFixture[str]
) -> None:
    line = [
        "run",
        str(isolated / f"scene{version[0]}.py"),
        "--stop",
        "0.4",
        "--step",
        "0.05",
        "--set",
        f"pump.mode={foreign.PRINT}",
    ]
    tables = [tmp_path / "here.csv", tmp_path / "there.csv"]
    assert main([*line, "-o", str(tables[0])]) == 0
    assert "pump speaks at 0.25\n" in capfd.readouterr().out, "in the process of the run it is in the way"
    assert main([*line, "-o", str(tables[1]), "--isolate"]) == 0
    said = capfd.readouterr()
    assert "pump speaks" not in said.out and "pump: pump speaks at 0.25\n" in said.err
    assert tables[0].read_bytes() == tables[1].read_bytes()


def test_what_cannot_be_isolated_is_told(isolated: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "mass", "--isolate"]) == 2
    assert "mass: --isolate is for FMUs, and there is none in it" in capfd.readouterr().err
    assert main(["run", str(isolated / "pump2.fmu"), "--isolate-timeout", "0"]) == 2
    assert "--isolate-timeout 0 s must be positive" in capfd.readouterr().err
    assert main(["run", str(isolated / "pump2.fmu"), "--isolate", "--set", f"mode={foreign.CRASH}", "--quiet"]) == 3
    assert "foreign at t = 0.3 s" in capfd.readouterr().err
    with pytest.raises(FMUError, match="'mode' is of the type Int32, which cannot hold 0.5"):
        FMUInstance(isolated / "pump3.fmu", starts={"mode": 0.5}, isolate=10.0)


def test_states_and_derivatives_of_isolated_units_are_those_of_others(isolated: Path, tmp_path: Path) -> None:
    (own,) = export(build_model(mass(2.0)), tmp_path, versions=("3.0",), step=0.01)
    with FMUInstance(own, isolate=30.0) as there, FMUInstance(own) as here:
        kept = there.get_state()
        for unit in (there, here):
            unit.set_input([3.0])
            unit.do_step(0.0, 0.1)
        assert there.output() == here.output() and (there.sensitivity() == here.sensitivity()).all()
        assert there.ledger()["supplied"] == here.ledger()["supplied"] > 0
        data = there.serialize(there.get_state())
        there.set_state(kept)
        assert there.get(["v"])[0] == 0.0
        there.set_state(there.deserialize(data, kept))
        assert there.get(["v"]) == here.get(["v"])
        for _ in range(5):
            there.get_state()


def test_a_network_of_units_only_that_cannot_take_steps_back(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One mass pushes another: what predictions miss is told, not judged; explicit couplings do not fit a rigid joint."""
    foreign.mass(folder / "pump.fmu", "3.0", saves=False)
    path = folder / "units.py"
    path.write_text(
        "from phfmu import Network, Scene\n\ndef units():\n    net = Network('units')\n    net.add('a', 'pump.fmu')\n"
        "    net.add('b', 'pump.fmu')\n    net.junction('j', ['a.flange', 'b.flange'])\n"
        "    return Scene('units', net, stop=1.0, step=0.01)\n"
    )
    assert main(["run", str(path), "--set", "a.k=30", "--set", "a.q=0.1", "-o", str(folder / "o.csv")]) == 0
    said = capsys.readouterr().out
    assert "coupling newton: units cannot be composed; a, b are stepped last" in said
    assert "loose" in next(line for line in said.splitlines() if line.startswith("j "))
    rows = np.genfromtxt(folder / "o.csv", delimiter=",", names=True, deletechars="")
    exact = -0.1 * np.sqrt(15.0) * np.sin(np.sqrt(15.0) * rows["time"])  # both masses of 1 on the spring of 30
    assert np.abs(rows["a.v"] - exact).max() < 5e-3 and np.abs(rows["b.v"] - exact).max() < 5e-3
    assert main(["run", str(path), "--set", "a.k=30", "--set", "a.q=0.1", "--coupling", "gauss-seidel"]) == 2
    assert "no output gives a.flange.force" in capsys.readouterr().err


def test_info_and_check_know_scenes_with_units(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    foreign.mass(folder / "pump.fmu", "3.0")
    path = scene(folder)
    (folder / "pump.ports.toml").write_text(SIDECAR + 'displacement = "q"\n')
    assert main(["info", str(path)]) == 0
    said = capsys.readouterr().out
    assert "members: pump, cart, spring" in said and "junction a: pump.flange, spring.a; common flow" in said
    assert (
        "translational  input F; output v; work by q" in said and "String: 1 (label)" in said and "cart: mass" in said
    )
    assert "order 2; pump is a unit of another tool, which takes held inputs" in said
    assert main(["info", str(folder / "pump.fmu")]) == 0
    assert "translational  input F; output v; work by q" in capsys.readouterr().out
    assert main(["check", str(path)]) == 0
    path.write_text(path.read_text().replace("mass(2.0", "mass(-2.0"))
    assert main(["check", str(path)]) == 1
    assert "cart: " in (said := capsys.readouterr().out) and "-2" in said
    assert main(["export", str(path)]) == 2
    assert "one model holds no FMU, as pump would be; --as-unit keeps" in capsys.readouterr().err


@pytest.mark.parametrize("stiffness", ["1e4", "1e6"])
def test_predictions_that_run_away_end_the_run_with_advice(
    folder: Path, stiffness: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The unit turns by 1 and by 10 rad in a step."""
    foreign.mass(folder / "pump.fmu", "2.0", saves=False)
    line = [
        "run",
        str(scene(folder)),
        "--set",
        f"pump.k={stiffness}",
        "--set",
        "pump.q=0.1",
        "--stop",
        "5",
        "--set",
        "spring.k=1e5",
    ]
    assert main(line) == 3
    said = capsys.readouterr().err
    assert "the energy of the members grows without bound" in said
    assert (
        "what pump will do in a step is predicted, since it cannot take one back" in said and "smaller step" not in said
    )


def test_members_that_hold_a_value_are_told_with_the_reason(tmp_path: Path) -> None:
    """A unit of this package without inputs at nodes, and ideal switches beside it."""
    from phfmu.components.scenes.electrical.rectifier import rectifier
    from phfmu.network.couplings.choice.partitioned_network import PartitionedNetwork

    (plain,) = export(build_model(replace(mass(1.0), name="plain")), tmp_path, ("3.0",), step=0.01)
    net = rectifier().system
    assert isinstance(net, Network)
    assert PartitionedNetwork(net).exchanged()["dc"] == "k values, order 2k"
    net.add("plain", plain)
    net.add("cart", mass(2.0))
    net.junction("b", ["plain.flange", "cart.flange"])
    told = PartitionedNetwork(net).exchanged()
    assert told["b"].startswith("one held value")
    assert told["b"].endswith("; plain was exported without inputs at nodes (--node-inputs, --order 4)")
    assert "; bridge has ideal switches, whose modes change within its step" in told["dc"]


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize(
    ("mode", "options", "why"),
    [
        (3, (), "valve stuck at 7 %"),
        (3, ("--isolate",), "valve stuck at 7 %"),
        (foreign.CRASH, ("--isolate",), "ended by SIGSEGV"),
    ],
)
def test_a_unit_that_dies_under_node_values_is_not_asked_again(
    folder: Path, version: str, mode: int, options: tuple[str, ...], why: str, capfd: pytest.CaptureFixture[str]
) -> None:
    """A step whose forecast fails is tried from the plain continuation, but not where a unit has died of it."""
    foreign.mass(folder / "pump.fmu", version)
    scene(folder)
    run = ["run", str(folder / "mixed.py"), "--order", "4", "--set", f"pump.mode={mode}", *options]
    assert main(run) == 3
    said = capfd.readouterr().err
    assert "pump at t = 0.25 s, h = 0.01 s" in said and why in said and "before" not in said
