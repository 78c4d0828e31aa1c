"""Shapes that units of other tools come in: each runs, or is refused by name with the next move."""

from __future__ import annotations

import tempfile
import zipfile
from pathlib import Path

import numpy as np
import pytest

from phfmu.cli import main
from tests.fmu import foreign
from tests.wide import wide

VERSIONS = ["2.0", "3.0"]
SCENE = """
from phfmu import Network, Scene
from phfmu.components.mechanical.translational import spring

PORT = {{"flange": {{"effort": "F", "flow": "v", "sign": 1}}}}


def pair():
    net = Network("pair")
    net.add("one", "{one}", ports=PORT)
    net.add("two", "{two}", ports=PORT)
    net.add("spring", spring(40.0, elongation=0.3))
    net.junction("a", ["one.flange", "spring.a"])
    net.junction("b", ["two.flange", "spring.b"])
    return Scene("pair", net, stop=0.1, step=0.01)
"""


def scene(folder: Path, one: str, two: str) -> str:
    path = folder / "pair.py"
    path.write_text(SCENE.format(one=one, two=two), encoding="utf-8")
    return str(path)


def rewritten(path: Path, old: str, new: str) -> Path:
    """The unit with another text in its description."""
    with zipfile.ZipFile(path) as archive:
        files = {n: archive.read(n) for n in archive.namelist()}
    text = files["modelDescription.xml"].decode()
    assert old in text
    files["modelDescription.xml"] = text.replace(old, new).encode()
    return foreign.archive(path, files)


@pytest.mark.parametrize("version", VERSIONS)
def test_steps_of_one_length(tmp_path: Path, version: str, capsys: pytest.CaptureFixture[str]) -> None:
    """A step that events, or the stop, cut short ends the run by the name of the unit; rows before are kept."""
    told = 'canHandleVariableCommunicationStepSize="{}"'
    unit = foreign.mass(tmp_path / "pump.fmu", version, abilities=told.format("false"))
    table = tmp_path / "o.csv"
    assert main(["run", str(unit), "--stop", "0.3", "--step", "0.1"]) == 0
    assert main(["run", str(unit), "--stop", "0.35", "--step", "0.1", "-o", str(table)]) == 3
    said = capsys.readouterr().err
    assert "foreign at t = 0.3 s" in said and "a step of 0.05 s after steps of 0.1 s" in said
    assert "canHandleVariableCommunicationStepSize" in said and "onto the grid of steps" in said
    assert np.genfromtxt(table, delimiter=",", names=True)["time"] == pytest.approx([0.0, 0.1, 0.2, 0.3])
    other = foreign.mass(tmp_path / "other.fmu", version, abilities=told.format("true"))
    path = scene(tmp_path, "pump.fmu", "other.fmu")
    assert main(["run", path]) == 0
    assert main(["run", path, "--stop", "0.104"]) == 3
    assert "one at t = 0.1 s" in capsys.readouterr().err
    assert main(["run", str(other), "--stop", "0.35", "--step", "0.1"]) == 0
    assert main(["info", str(unit)]) == 0
    assert "takes steps of one length only" in capsys.readouterr().out


@pytest.mark.parametrize("version", wide(VERSIONS, "3.0"))
def test_a_unit_that_a_process_can_have_once(tmp_path: Path, version: str, capsys: pytest.CaptureFixture[str]) -> None:
    foreign.mass(tmp_path / "pump.fmu", version, abilities='canBeInstantiatedOnlyOncePerProcess="true"')
    foreign.mass(tmp_path / "other.fmu", version)
    for _ in range(2):  # the first run gives its instances back
        assert main(["run", scene(tmp_path, "pump.fmu", "other.fmu")]) == 0
    twice = scene(tmp_path, "pump.fmu", "pump.fmu")
    assert main(["run", twice]) == 2
    said = capsys.readouterr().err
    assert "pump.fmu: 'two' would be its second instance in this process" in said and "--isolate" in said
    assert main(["run", twice, "--isolate"]) == 0


@pytest.mark.parametrize("version", VERSIONS)
def test_a_unit_that_needs_a_tool(tmp_path: Path, version: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Where the tool is, it runs; where it is not, that is told."""
    unit = foreign.mass(tmp_path / "pump.fmu", version, abilities='needsExecutionTool="true"')
    assert main(["run", str(unit), "--stop", "0.2"]) == 0
    assert main(["info", str(unit)]) == 0
    assert "needs a tool of its maker" in capsys.readouterr().out
    rewritten(unit, '="1"><Co', '="tool"><Co')
    assert main(["run", str(unit)]) == 2
    assert "it needs a tool of its maker on this machine (needsExecutionTool)" in capsys.readouterr().err


@pytest.mark.parametrize("version", VERSIONS)
def test_sources_without_a_library(tmp_path: Path, version: str, capsys: pytest.CaptureFixture[str]) -> None:
    files = {"modelDescription.xml": foreign.description(version, ""), "sources/foreign.c": foreign.CODE.read_text()}
    path = foreign.archive(tmp_path / "pump.fmu", files)
    assert main(["run", str(path)]) == 2
    said = capsys.readouterr().err
    assert "the archive has none, and sources. Build them with `fmpy compile pump.fmu`" in said


@pytest.mark.parametrize("version", VERSIONS)
def test_kinds_of_interfaces(tmp_path: Path, version: str, capsys: pytest.CaptureFixture[str]) -> None:
    """For Model Exchange only: refused; for both: run as Co-Simulation, whose library may have a name of its own."""
    unit = foreign.mass(tmp_path / "pump.fmu", version)
    rewritten(unit, "<CoSimulation ", '<ModelExchange modelIdentifier="other"/><CoSimulation ')
    assert main(["run", str(unit), "--stop", "0.2"]) == 0
    rewritten(unit, "<CoSimulation ", "<ScheduledExecution ")
    assert main(["run", str(unit)]) == 2
    assert "no Co-Simulation interface; export it for Co-Simulation" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("version", wide(VERSIONS, "3.0"))
def test_folders_with_spaces_and_other_letters(
    tmp_path: Path, version: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of the archive, and of the place its resources are unpacked to."""
    folder = tmp_path / "ein Ordner, größer #1 % 单位"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    found = {
        "2.0": '<ScalarVariable name="found" valueReference="28" causality="output"><Real/></ScalarVariable>',
        "3.0": '<Float64 name="found" valueReference="28" causality="output"/>',
    }[version]
    name = folder / "Pumpe für 水.fmu"
    foreign.unit(name, version, found, more={"resources/table.txt": "1"})
    table = folder / "ö.csv"
    assert main(["run", str(name), "--stop", "0.2", "--step", "0.1", "-o", str(table)]) == 0, capsys.readouterr().err
    assert np.genfromtxt(table, delimiter=",", names=True)["found"] == pytest.approx(1.0)
    foreign.mass(folder / "ä b.fmu", version)
    assert main(["run", scene(folder, "ä b.fmu", "ä b.fmu")]) == 0, capsys.readouterr().err
    assert main(["run", scene(folder, "ä b.fmu", "ä b.fmu"), "--isolate"]) == 0, capsys.readouterr().err


STATES = {"2.0": "fmi2{}FMUstate", "3.0": "fmi3{}FMUState"}


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("isolate", [(), ("--isolate",)])
def test_a_library_without_what_nobody_calls(
    tmp_path: Path, version: str, isolate: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    verb = {"2.0": "DeSerialize", "3.0": "Deserialize"}[version]
    missing = STATES[version].format(verb)
    usual = foreign.mass(tmp_path / "usual.fmu", version)
    unit = foreign.mass(tmp_path / "pump.fmu", version, lacks=[missing, f"fmi{version[0]}Terminate"])
    tables = []
    for path in (usual, unit):
        table = tmp_path / "o.csv"
        assert (
            main(["run", str(path), "--stop", "0.3", "--set", "q=1", "--set", "k=40", "-o", str(table), *isolate]) == 0
        )
        tables.append(table.read_text())
    assert tables[0] == tables[1]
    said = capsys.readouterr().err
    assert f"pump.fmu: its library lacks {missing}, fmi{version[0]}Terminate\n" in said


@pytest.mark.parametrize("version", VERSIONS)
def test_a_capability_whose_functions_are_not_there_is_off(
    tmp_path: Path, version: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """States that cannot be restored: the unit is stepped last.  Derivatives are found by differences."""
    missing = STATES[version].format("Set"), f"fmi{version[0]}GetDirectionalDerivative"
    plural = "s" if version == "3.0" else ""
    claims = f'providesDirectionalDerivative{plural}="true"'
    for lacks, off in ((missing[0], "saving its state"), (missing[1], "directional derivatives")):
        foreign.mass(tmp_path / "pump.fmu", version, abilities=claims, lacks=[lacks])
        foreign.mass(tmp_path / "other.fmu", version)
        assert main(["run", scene(tmp_path, "pump.fmu", "other.fmu")]) == 0
        said = capsys.readouterr().out
        assert f"one: its library lacks {lacks}; it claims {off}, which is off" in said
        assert ("one: cannot save its state; it is stepped last" in said) is (lacks == missing[0])


@pytest.mark.parametrize("version", VERSIONS)
def test_a_library_of_another_kind(tmp_path: Path, version: str, capsys: pytest.CaptureFixture[str]) -> None:
    name = f"fmi{version[0]}DoStep"
    unit = foreign.mass(tmp_path / "pump.fmu", version, lacks=[name])
    assert main(["run", str(unit)]) == 2
    assert f"pump.fmu: its library lacks {name}, so it is none of FMI {version}" in capsys.readouterr().err


@pytest.mark.parametrize("version", VERSIONS)
def test_a_library_of_another_name(tmp_path: Path, version: str, capsys: pytest.CaptureFixture[str]) -> None:
    unit = rewritten(
        foreign.mass(tmp_path / "pump.fmu", version), 'modelIdentifier="foreign"', 'modelIdentifier="pump"'
    )
    assert main(["run", str(unit)]) == 2
    said = capsys.readouterr().err
    assert "its modelIdentifier is 'pump'" in said and "there is binaries/" in said and "foreign." in said
    assert "no library for this platform" not in said


def test_info_says_what_an_importer_needs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    able = 'hasEventMode="true" mightReturnEarlyFromDoStep="true"'
    unit = foreign.mass(tmp_path / "pump.fmu", "3.0", abilities=able)
    rewritten(
        unit, "<ModelVariables>", '<ModelVariables><Clock name="tick" valueReference="12" intervalVariability="fixed"/>'
    )
    foreign.mass(tmp_path / "other.fmu", "3.0")
    for target in (str(unit), scene(tmp_path, "pump.fmu", "other.fmu")):
        assert main(["info", target]) == 0
        said = capsys.readouterr().out.splitlines()
        assert "has 1 clock, which ticks in Event Mode only: run here, what depends on them stays as it is" in said
        assert "has an Event Mode, which is not entered here: its events happen within its steps" in said
        assert "may return early from doStep, which it is not allowed here" in said
    assert main(["info", str(tmp_path / "other.fmu")]) == 0
    said = capsys.readouterr().out
    assert "Event Mode" not in said and "early" not in said
