"""Packages written here: fit the schemas, are read here and by FMPy, and run as the scene they come from."""

from __future__ import annotations

from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.ssp.ssd import read_ssd
from lxml import etree

from phfmu.cli import main
from phfmu.fmu.importer.unit_file import unit_file
from phfmu.ssp.loading import load
from phfmu.ssp.names import PORTS, tag
from tests.fmu import foreign
from tests.ssp.packages import pack, unpacked

FMI = {"1.0": "2.0", "2.0": "3.0"}
SCHEMA = Path(str(fmpy.__file__)).parent / "ssp" / "schema"


@pytest.fixture(params=list(FMI))
def version(request: pytest.FixtureRequest) -> str:
    return request.param


def ran(target: Path | str, into: Path, *options: str) -> np.ndarray:
    assert main(["run", str(target), "-o", str(into), "--quiet", *options]) == 0
    return np.genfromtxt(into, delimiter=",", names=True, deletechars="")


def same(a: np.ndarray, b: np.ndarray, but: tuple[str, ...] = ()) -> None:
    """All columns of b but those are in a; units that are made for a run tell what events would do, too."""
    names = [n for n in b.dtype.names or () if not n.startswith(but)] if but else list(b.dtype.names or ())
    left = {n for n in set(a.dtype.names or ()) - set(names) if not n.endswith("energy.events")}
    assert len(names) > 10 and all(n.startswith(but) for n in left) and set(names) <= set(a.dtype.names or ())
    for name in names:
        np.testing.assert_array_equal(a[name], b[name], err_msg=name)


def test_a_package_runs_as_the_scene_it_comes_from(written: dict[str, Path], version: str, tmp_path: Path) -> None:
    """To the last bit, also the junctions; without the annotation, by its connections alone, too."""
    apart = ["--coupling", "newton", "--engine", "fmu", "--fmi", FMI[version]]
    expected = ran("oscillator", tmp_path / "scene.csv", *apart)
    same(expected, ran(written[version], tmp_path / "package.csv"))
    files = unpacked(written[version])
    root = etree.fromstring(files["SystemStructure.ssd"])
    system = root.find(tag("ssd", "System"))
    system.remove(system.find(tag("ssd", "Annotations")))
    assert PORTS.encode() not in etree.tostring(root)
    plain = pack(tmp_path / "plain.ssp", files | {"SystemStructure.ssd": etree.tostring(root)})
    same(
        expected,
        ran(plain, tmp_path / "plain.csv"),
        but=("left", "right", "constraint", "mass1_flange", "mass2_flange"),
    )


def test_documents_fit_the_schemas_and_other_readers(written: dict[str, Path]) -> None:
    for name, data in unpacked(written["1.0"]).items():
        schema = {"ssd": "SystemStructureDescription.xsd", "ssv": "SystemStructureParameterValues.xsd"}.get(name[-3:])
        if schema:
            etree.XMLSchema(file=str(SCHEMA / schema)).assertValid(etree.fromstring(data))
    found = read_ssd(str(written["1.0"]))
    assert [c.name for c in found.system.elements] == ["mass1", "mass2", "spring12"]
    assert len(found.system.connections) == 4
    root = etree.fromstring(unpacked(written["1.0"])["SystemStructure.ssd"])
    turned = {
        e.getparent().get("startConnector"): e.get("factor") for e in root.iter(tag("ssc", "LinearTransformation"))
    }
    assert turned == {"a.force": "-1.0", "b.force": "-1.0"}
    assert {u.name for u in found.units} >= {"N", "m/s", "kg", "N/m"}


def test_what_is_read_is_written_again_byte_for_byte(written: dict[str, Path], version: str, tmp_path: Path) -> None:
    assert main(["export", str(written[version]), "--ssp", version, "-o", str(tmp_path)]) == 0
    assert unpacked(tmp_path / "oscillator.ssp") == unpacked(written[version])


def test_settings_go_into_the_parameter_files(compiler: None, tmp_path: Path) -> None:
    """A stiffness in the package, then another one in its file."""
    assert main(["export", "oscillator", "--ssp", "--set", "spring12.k=50", "-o", str(tmp_path)]) == 0
    path = tmp_path / "oscillator.ssp"
    assert load(path).system.members["spring12"].starts["k"] == 50.0
    files = unpacked(path)
    assert b'<ssv:Real value="50.0" unit="N/m"/>' in files["resources/spring12.ssv"]
    changed = files["resources/spring12.ssv"].replace(b'"50.0"', b'"80.0"')
    other = pack(tmp_path / "other.ssp", files | {"resources/spring12.ssv": changed})
    apart = ["--coupling", "newton", "--engine", "fmu", "--set", "spring12.k=80"]
    expected, found = ran("oscillator", tmp_path / "a.csv", *apart), ran(other, tmp_path / "b.csv")
    np.testing.assert_allclose(found["mass1.q"], expected["mass1.q"], atol=1e-13)
    assert abs(found["mass1.q"] - ran(path, tmp_path / "c.csv")["mass1.q"]).max() > 0.1


def test_a_single_component_is_a_package_of_one_unit(compiler: None, tmp_path: Path) -> None:
    """Its free port is driven by its name."""
    assert main(["export", "mass", "--ssp", "--set", "m=4", "-o", str(tmp_path)]) == 0
    rows = ran(tmp_path / "mass.ssp", tmp_path / "a.csv", "--set", "mass.flange.force=2", "--stop", "0.5")
    np.testing.assert_allclose(rows["mass.v"], 0.5 * rows["time"], atol=1e-12)


@pytest.mark.slow
def test_outward_ports_need_no_factor(written: dict[str, Path], tmp_path: Path) -> None:
    line = [
        "export",
        "oscillator",
        "--ssp",
        "--outward",
        "spring12.a",
        "--outward",
        "mass2.flange",
        "-o",
        str(tmp_path),
    ]
    assert main(line) == 0
    path = tmp_path / "oscillator.ssp"
    assert b"LinearTransformation" not in unpacked(path)["SystemStructure.ssd"]
    expected, found = ran(written["1.0"], tmp_path / "a.csv"), ran(path, tmp_path / "b.csv")
    np.testing.assert_array_equal(found["mass1.q"], expected["mass1.q"])
    np.testing.assert_array_equal(found["spring12.a.force_step"], -expected["spring12.a.force_step"])


SCENE = """
from phfmu import Network, Scene
from phfmu.components.mechanical.translational import mass, spring


def {name}():
    net = Network("{name}")
    {members}
    return Scene("{name}", net, stop=0.1, step=0.01)
"""


def scene(folder: Path, name: str, *lines: str) -> str:
    (folder / f"{name}.py").write_text(SCENE.format(name=name, members="\n    ".join(lines)))
    return str(folder / f"{name}.py")


def test_junctions_that_connections_cannot_say_are_told(
    compiler: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two masses and two springs on one rigid joint: four ports, of which two take what the others give."""
    target = scene(
        tmp_path, "stuck", "net.add('a', mass(1.0, v=1.0))", "net.add('c', spring(30.0))", "net.add('d', spring(9.0))",
        "net.junction('joint', ['a.flange', 'c.a', 'd.a'])",
    )  # fmt: skip
    assert main(["export", target, "--ssp", "-o", str(tmp_path)]) == 0
    assert "junction joint (a.flange, c.a, d.a): only in the annotation" in capsys.readouterr().err
    path = tmp_path / "stuck.ssp"
    assert b"ssd:Connections" not in unpacked(path)["SystemStructure.ssd"]
    apart = ["--coupling", "newton", "--engine", "fmu", "--fmi", "2.0"]
    same(ran(target, tmp_path / "a.csv", *apart), ran(path, tmp_path / "b.csv"))


KILO = '<UnitDefinitions><Unit name="kilonewton"><BaseUnit kg="1" m="1" s="-2" factor="1000"/></Unit></UnitDefinitions>'


@pytest.mark.parametrize("force", ["newton", "told", "defined"])
def test_ports_of_a_foreign_unit_go_along(compiler: None, tmp_path: Path, force: str) -> None:
    """Told in the scene, they are written beside the unit; a force in kN is converted once, whoever defines its unit."""
    kilo = force == "defined"
    unit = {"unit_of_force": "kilonewton", "before": KILO} if kilo else {}
    foreign.mass(tmp_path / "pump.fmu", "2.0", **unit)
    told = {"flange": {"effort": "F", "flow": "v", "sign": 1} | ({"effort_unit": "kN"} if force == "told" else {})}
    target = scene(
        tmp_path, "mixed", f"net.add('pump', 'pump.fmu', ports={told})", "net.add('spring', spring(40.0, elongation=0.3))",
        "net.junction('a', ['pump.flange', 'spring.a'])",
    )  # fmt: skip
    assert main(["export", target, "--ssp", "-o", str(tmp_path)]) == 0
    path = tmp_path / "mixed.ssp"
    (port,) = load(path).system.members["pump"].port_maps
    assert (port,) == unit_file(tmp_path / "pump.fmu", told).port_maps
    assert port.input_factor == (1.0 if force == "newton" else 1000.0)
    light = [] if force == "newton" else ["--set", "pump.m=0.001"]
    found, expected = ran(path, tmp_path / "b.csv", *light), ran(target, tmp_path / "a.csv", "--engine", "fmu", *light)
    np.testing.assert_allclose(found["pump.v"], expected["pump.v"], atol=1e-12)
    assert np.abs(found["pump.v"]).max() > 0.1
    text = unpacked(path)["SystemStructure.ssd"]
    assert (b'<ssc:Unit name="kilonewton">' in text) is kilo and text.count(b"LinearTransformation") == 1
    assert (b'factor="-0.001"' in text) is (force == "told")  # the unit itself says N


def test_info_and_check_tell_what_is_in_a_package(written: dict[str, Path], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(written["1.0"])]) == 0
    said = capsys.readouterr().out
    for words in (
        "oscillator: two masses and three springs", "stop 1 s, step 0.01 s", "FMI 2.0, mass with optional spring",
        "translational  input flange.force; output", "junction left: mass1.flange, spring12.a; common flow",
        "set: k = 157.914", f"mass1: {written['1.0']}/resources/mass1.fmu",
    ):  # fmt: skip
        assert words in said
    assert main(["check", str(written["1.0"])]) == 0
    assert "no problems" in capsys.readouterr().out


def test_options_that_do_not_go_together(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = ["export", "oscillator", "--ssp", "-o", str(tmp_path)]
    for more, words in (
        (["--arrays"], "--ssp and --arrays do not go together"),
        (["--fmi", "2", "--fmi", "3"], "one FMI version"),
        (["--outward", "mass1.flang"], "no port 'mass1.flang' that could count outward; did you mean mass1.flange"),
    ):
        assert main([*line, *more]) == 2
        assert words in capsys.readouterr().err
