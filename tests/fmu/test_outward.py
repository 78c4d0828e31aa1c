"""Flows that count out of a unit: what an importer sees that connects variables plainly, and that networks see no difference."""

from __future__ import annotations

import zipfile
from dataclasses import replace
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu
from lxml import etree

from phfmu import Collocated, Coupled, EngineMember, Event, Network, Options, PythonInstance, build_model, export, run
from phfmu.cli import main
from phfmu.components.electrical.machines.dc_motor import dc_motor
from phfmu.components.electrical.rl_line import rl_line
from phfmu.components.electrical.rlc_load import rlc_load
from phfmu.components.mechanical.translational import mass, spring
from phfmu.fmu import FMUError, FMUInstance
from phfmu.fmu.export.manifest import PATH
from phfmu.network.members.fmu_member import FMUMember
from tests.wide import slow, wide

pytestmark = pytest.mark.usefixtures("compiler")
VERSIONS = ("2.0", "3.0")
H = 1e-3


@pytest.fixture(scope="module")
def motors(tmp_path_factory: pytest.TempPathFactory) -> dict[bool, dict[str, Path]]:
    """{outward: {version: path}} of a motor of order 4 with inputs at nodes and impulses: current and torque out of it."""
    model, made = build_model(dc_motor(), Collocated(2)), {}
    for outward in ((), ("terminal", "shaft")):
        folder = tmp_path_factory.mktemp("motor")
        paths = export(model, folder, VERSIONS, step=H, node_inputs=True, impulses=True, outward=outward)
        made[bool(outward)] = dict(zip(VERSIONS, paths, strict=True))
    return made


#: voltage and speed are the same, current and torque (an input) have the other sign
TURNED = ("terminal.i", "shaft.torque")


def sign_of(name: str) -> float:
    return -1.0 if name.startswith(TURNED) else 1.0


@pytest.mark.parametrize("version", VERSIONS)
def test_flows_change_their_sign_and_nothing_else_does(motors, version: str) -> None:
    """All variables, at the start, after held inputs, inputs at nodes and a rollback; the ledger keeps its bits."""
    with FMUInstance(motors[False][version]) as inward, FMUInstance(motors[True][version]) as outward:
        names = [n for n in inward.names if n in outward.interface.variables]
        assert names == inward.names == outward.names
        signs = np.array([sign_of(n) for n in names])
        assert (signs < 0).sum() >= 3  # i, i_step, torque

        def same() -> None:
            np.testing.assert_array_equal(outward.get(names), signs * inward.get(names))

        same()
        for k in range(6):
            for unit, sign in ((inward, 1.0), (outward, -1.0)):
                unit.set({"terminal.v": 12.0 + k, "shaft.torque": sign * 0.1})
                if k % 2:
                    unit.set({f"shaft.torque_node[{i}]": sign * 0.1 * i for i in (1, 2)})
                unit.do_step(k * H, H)
            same()


@pytest.mark.parametrize("version", VERSIONS)
def test_a_master_of_this_package_sees_no_difference(motors, version: str) -> None:
    with FMUInstance(motors[False][version]) as inward, FMUInstance(motors[True][version]) as outward:
        assert [p.sign for p in outward.ports] == [-1.0, -1.0] and [p.sign for p in inward.ports] == [1.0, 1.0]
        saved = None
        for k in range(4):
            for unit in (inward, outward):
                if k == 3:
                    unit.set_node_inputs([[12.0, 0.1], [13.0, -0.2]])
                else:
                    unit.set_input([12.0 + k, 0.3])
                if k >= 2:
                    unit.at_nodes.set_impulses([1e-3, 2e-3], [-2e-3, 1e-3])
                unit.do_step(k * H, H)
            for what in ("output", "end_output", "node_output", "energies"):
                np.testing.assert_array_equal(getattr(outward, what)(), getattr(inward, what)())
            for key, value in inward.ledger().items():
                np.testing.assert_array_equal(outward.ledger()[key], value)
            assert abs(outward.ledger()["pairs"].sum() - outward.ledger()["supplied"][0]) < 1e-15
            if k < 2:
                np.testing.assert_array_equal(outward.sensitivity(), inward.sensitivity())
            np.testing.assert_array_equal(outward.at_nodes.jump(), inward.at_nodes.jump())
            mine, theirs = (u.at_nodes.node_sensitivity(impulses=True, end=True) for u in (outward, inward))
            for what in ("nodes", "end"):
                np.testing.assert_array_equal(getattr(mine, what), getattr(theirs, what))
            saved = outward.get_state()
        assert saved is not None
        outward.set_state(saved)
        np.testing.assert_array_equal(outward.output(), inward.output())


def test_adjoint_derivatives_know_the_signs(motors) -> None:
    """S^T seed = (seed^T S)^T in the variables of the unit."""
    path = motors[True]["3.0"]
    about = fmpy.read_model_description(str(path))
    ref = {v.name: v.valueReference for v in about.modelVariables}
    unit = FMU3Slave(guid=about.guid, unzipDirectory=fmpy.extract(str(path)), instanceName="m",
                     modelIdentifier=about.coSimulation.modelIdentifier)  # fmt: skip
    unit.instantiate()
    unit.enterInitializationMode()
    unit.exitInitializationMode()
    unit.doStep(0.0, H)
    known, unknown = [ref["terminal.v"], ref["shaft.torque"]], [ref["terminal.i_step"], ref["shaft.speed_step"]]
    forward = [unit.getDirectionalDerivative(unknown, known, seed) for seed in ([1.0, 0.0], [0.0, 1.0])]
    adjoint = [unit.getAdjointDerivative(unknown, known, seed) for seed in ([1.0, 0.0], [0.0, 1.0])]
    np.testing.assert_array_equal(np.array(forward).T, adjoint)
    with FMUInstance(motors[False]["3.0"]) as inward:
        inward.do_step(0.0, H)
        np.testing.assert_array_equal(np.array(adjoint), inward.sensitivity() * [[-1, 1], [1, -1]])
    unit.freeInstance()


@pytest.mark.parametrize("version", VERSIONS)
def test_terminals_page_and_manifest_tell_the_signs(motors, version: str) -> None:
    for outward in (False, True):
        path = motors[outward][version]
        assert validate_fmu(str(path)) == []
        with zipfile.ZipFile(path) as archive:
            terminals = etree.fromstring(archive.read("terminalsAndIcons/terminalsAndIcons.xml"))
            page = archive.read("documentation/index.html").decode()
            manifest = etree.fromstring(archive.read(PATH))
        kinds = {m.get("variableName"): m.get("variableKind") for m in terminals.iter("TerminalMemberVariable")}
        flow = "outflow" if outward else "inflow"
        assert {n: k for n, k in kinds.items() if "_" not in n} == {
            "terminal.v": "signal", "terminal.i": flow, "shaft.torque": flow, "shaft.speed": "signal",
        }  # fmt: skip
        assert [p.get("sign") for p in manifest.iter("Port")] == ["-1.0" if outward else None] * 2
        assert ("factor -1 on it" in page) != ("connect it plainly" in page)
        assert ("factor -1 on it" in page) is not outward
        assert "shaft.torque" in page and "shaft.speed is equal on both sides" in page


def two_masses() -> Network:
    net = Network("pair")
    net.add("one", mass(1.0, v=2.0))
    net.add("spring", spring(400.0))
    net.add("two", mass(2.0))
    net.connect("one.flange", "spring.a", name="left")
    net.connect("spring.b", "two.flange", name="right")
    return net


def circuit() -> Network:
    net = Network("line_and_load")
    net.add("line", rl_line(0.5, 1e-2))
    net.add("load", rlc_load(10.0, C=1e-3))
    net.connect("line.b", "load.terminal", name="bus")
    return net


def coupled(net: Network, folder: Path, outward: dict[str, list[str]], version: str = "3.0") -> Coupled:
    members = []
    for name, declaration in net.members.items():
        if name not in outward:
            model = build_model(replace(declaration, name=name))
            members.append(EngineMember(name, model, PythonInstance(model)))
            continue
        (path,) = export(build_model(declaration), folder / name, (version,), step=H, outward=outward[name])
        members.append(FMUMember(name, FMUInstance(path)))
    return Coupled(net, members)


@pytest.mark.parametrize("version", wide(VERSIONS, "3.0"))
@pytest.mark.parametrize(
    ("net", "units", "outward", "event"),
    [
        slow((two_masses, ("one", "spring"), {"one": ["flange"], "spring": ["a", "b"]}, None)),
        (circuit, ("line", "load"), {"line": ["a", "b"], "load": ["terminal"]}, Event(0.01, "line.a.v", 20.0)),
    ],
)
def test_a_network_of_outward_units_is_that_of_inward_ones(
    tmp_path: Path, net, units, outward, event: Event | None, version: str
) -> None:
    options = Options(stop=0.05, step=H, events=() if event is None else (event,))
    found = run(coupled(net(), tmp_path / "out", outward, version), options)
    expected = run(coupled(net(), tmp_path / "in", dict.fromkeys(units, []), version), options)
    assert found.names == expected.names
    for name in found.names:
        sign = -1.0 if name.split("[")[0].removesuffix("_step") in {
            "spring.a.force", "spring.b.force", "line.a.i", "line.b.i"} else 1.0  # fmt: skip
        np.testing.assert_array_equal(found.column(name), sign * expected.column(name), err_msg=name)
    assert found.ledger.summary().closed
    assert max(abs(found.column(found.names[0]))) > 0


def test_an_input_called_by_its_name_counts_as_the_unit_says(motors, tmp_path: Path) -> None:
    """--set and rows of --input name variables of the unit: a torque of -0.2 out of it accelerates."""
    speeds = {}
    for outward, sign in ((False, 1.0), (True, -1.0)):
        rows, table = tmp_path / "rows.csv", tmp_path / f"{outward}.csv"
        rows.write_text(f"time,shaft.torque\n0,{sign * 0.2}\n0.01,{sign * 0.1}\n")
        path = str(motors[outward]["3.0"])
        line = ["run", path, "--stop", "0.02", "--step", "1e-3", "--input", str(rows), "-o", str(table), "--quiet"]
        assert main(line) == 0
        speeds[outward] = np.genfromtxt(table, delimiter=",", names=True)["w"]
    np.testing.assert_array_equal(speeds[True], speeds[False])
    assert speeds[True][-1] > 0


def test_the_command_line_and_what_it_refuses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = ["export", "mass", "--fmi", "3", "-o", str(tmp_path), "--outward"]
    assert main([*line, "flange"]) == 0
    path = capsys.readouterr().out.strip()
    assert main(["info", path]) == 0
    assert "force positive out of the component" in capsys.readouterr().out
    assert main([*line, "flang"]) == 2
    assert "mass has no free port 'flang' that could count outward; did you mean flange?" in capsys.readouterr().err
    with pytest.raises(FMUError, match="no free port 'b'"):
        export(build_model(mass()), tmp_path, step=H, outward=["b"])


def test_two_units_joined_plainly_elsewhere(tmp_path: Path) -> None:
    """A master that only passes values on: with one outward port the pair swings, with both inward it runs away."""
    energies = {}
    for outward in ((), ("flange",)):
        folder = tmp_path / str(bool(outward))
        (a,) = export(build_model(mass(1.0, v=2.0)), folder, ("2.0",), step=H, outward=outward)
        (b,) = export(build_model(spring(400.0)), folder, ("2.0",), step=H)
        with FMUInstance(a, []) as one, FMUInstance(b, []) as two:
            two.set({"b.velocity": 0.0})
            for k in range(2000):  # Gauss-Seidel: the velocity first
                two.set({"a.velocity": one.get(["flange.velocity"])[0]})
                two.do_step(k * H, H)
                one.set({"flange.force": two.get(["a.force"])[0]})
                one.do_step(k * H, H)
            energies[bool(outward)] = one.get(["energy.stored"])[0] + two.get(["energy.stored"])[0]
    assert energies[True] < 10.0 and energies[False] > 1e6
