"""Units of other tools as members: a scene file from the command line, against the same scene declared."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from phfmu import Network
from phfmu.cli import main
from phfmu.components.mechanical.translational import mass
from phfmu.fmu.unit_file import unit_file
from phfmu.fmu.variables import FMUError
from phfmu.network.junctions.junction import ConnectionError
from tests.fmu import foreign

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
    assert "pump.fmu: left out, cannot be read or set here: String: 1 (label)" in said.err
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
        ({"flow": "m"}, "m is in kg, ports of the domain translational have m/s there"),
        ({"flow": "m", "domain": None}, r"its units \(effort in N, flow in kg\) do not tell its domain"),
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
