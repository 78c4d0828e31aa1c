"""Connections without power, and units of other tools in packages: signals, and ports that a connection tells."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from phfmu.cli import main
from phfmu.ssp.loading import load
from phfmu.ssp.structure import SSPError
from tests.fmu import foreign
from tests.ssp.documents import SPRING, component, connection, linear, system
from tests.ssp.packages import document, pack, unpacked

PUMP = ("F", "input", ""), ("v", "output", ""), ("q", "output", "")


def ran(target: Path | str, into: Path, *options: str) -> np.ndarray:
    assert main(["run", str(target), "-o", str(into), "--quiet", *options]) == 0
    return np.genfromtxt(into, delimiter=",", names=True, deletechars="")


@pytest.fixture
def loads(tmp_path: Path) -> str:
    """Rows of inputs in place of the event of the scene."""
    path = tmp_path / "loads.csv"
    path.write_text("time,rotor.b.torque\n0,0\n0.1,-5\n")
    return str(path)


def test_signals_of_a_scene_are_written_and_run(
    compiler: None, tmp_path: Path, loads: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """A speed control: the command is a plain connection, the measured state, no output of its unit, stands in the annotation."""
    assert main(["export", "speed_control", "--ssp", "-o", str(tmp_path)]) == 0
    said = capsys.readouterr().err
    assert "signal rotor.w -> controller.measured: only in the annotation" in said and "SSP has no events" in said
    path = tmp_path / "speed_control.ssp"
    text = unpacked(path)["SystemStructure.ssd"].decode()
    wire = 'startElement="controller" startConnector="command" endElement="actuator" endConnector="torque"/>'
    assert wire in text
    apart = ["--coupling", "newton", "--engine", "fmu", "--fmi", "2.0", "--stop", "0.2"]
    expected = ran("speed_control", tmp_path / "a.csv", *apart)
    found = ran(path, tmp_path / "b.csv", "--stop", "0.2", "--input", loads)
    names = found.dtype.names or ()
    # without the declaration nothing says that it is a source that the signal feeds: its output has the name of the unit's
    assert set(names) - set(expected.dtype.names or ()) == {"actuator.source.speed", "actuator.source.speed_step"}
    for name in set(names) & set(expected.dtype.names or ()):
        np.testing.assert_array_equal(found[name], expected[name], err_msg=name)
    assert abs(found["rotor.w"] - 100.0).max() > 0.5
    # half the gains, twice the command
    turned = text.replace(wire, wire[:-2] + f">{linear(2.0)}</ssd:Connection>")
    twice = pack(tmp_path / "twice.ssp", unpacked(path) | {"SystemStructure.ssd": turned})
    assert main(["export", str(twice), "--ssp", "-o", str(tmp_path / "again")]) == 0
    again = unpacked(tmp_path / "again" / "speed_control.ssp")["SystemStructure.ssd"]
    assert b'<ssc:LinearTransformation factor="2.0"/>' in again
    halved = ["--stop", "0.2", "--input", loads, "--set", "controller.kp=0.4", "--set", "controller.ki=4"]
    scaled = ran(twice, tmp_path / "c.csv", *halved)
    np.testing.assert_allclose(scaled["rotor.w"], found["rotor.w"], rtol=1e-11)


def pumps(folder: Path, content: str, **more: bytes) -> Path:
    """A package around the mass of another tool, which has no ports of its own."""
    folder.mkdir(exist_ok=True)
    foreign.mass(folder / "pump.fmu", "2.0")
    files: dict[str, bytes | str] = {"resources/pump.fmu": (folder / "pump.fmu").read_bytes()}
    files |= {f"resources/{n}": d for n, d in more.items()}
    return pack(folder / "pumps.ssp", files | {"SystemStructure.ssd": document(content)})


def test_plain_connections_of_other_tools_are_signals(compiler: None, tmp_path: Path) -> None:
    """Two masses of 1 kg that pull each other by what they tell: q1'' = -40 q2, q2'' = -40 q1; of order 2."""
    cross = (
        connection("a:q", "b:F", linear(-40.0), ' suppressUnitConversion="true"'),
        connection("b:q", "a:F", linear(-40.0), ' suppressUnitConversion="true"'),
    )
    path = pumps(tmp_path, system(component("a", "pump", PUMP), component("b", "pump", PUMP), connections=cross))
    scene = load(path)
    assert [str(w) for w in scene.system.wires] == ["a.q -> b.F (times -40)", "b.q -> a.F (times -40)"]
    errors = []
    for h in ("0.01", "0.005"):
        rows = ran(path, tmp_path / "p.csv", "--step", h, "--stop", "0.5", "--set", "a.q=1", "--set", "b.q=1")
        errors.append(np.abs(rows["a.q"] - np.cos(np.sqrt(40.0) * rows["time"])).max())
    assert errors[0] < 0.05 and errors[1] < errors[0] / 2.5


@pytest.mark.parametrize("sign", [1, -1])
def test_a_port_follows_from_what_it_is_connected_with(
    compiler: None, units: dict[str, bytes], tmp_path: Path, sign: int, capsys: pytest.CaptureFixture[str]
) -> None:
    """The factor says which way the force of the unknown unit counts; with -1 into it, as that of the spring does."""
    joined = connection("pump:v", "coil:a.velocity"), connection("coil:a.force", "pump:F", linear(-sign))
    content = system(component("pump", "pump", PUMP), component("coil", "spring", SPRING), connections=joined)
    path = pumps(tmp_path, content, **{"spring.fmu": units["resources/spring.fmu"]})
    (port,) = load(path).system.members["pump"].port_maps
    assert (port.given, port.inputs, port.outputs, port.sign) == ("effort", ("F",), ("v",), float(sign))
    if sign < 0:
        return  # the mass does count it inward: the numbers would be those of a mass that is pushed on
    told = f'[a]\neffort = "F"\nflow = "v"\nsign = {sign}\n'
    beside = pumps(
        tmp_path / "told", content, **{"spring.fmu": units["resources/spring.fmu"], "pump.ports.toml": told.encode()}
    )
    found, expected = (ran(p, tmp_path / "p.csv", "--set", "pump.k=9", "--set", "pump.q=0.5") for p in (path, beside))
    np.testing.assert_array_equal(found["pump.v"], expected["pump.v"])
    assert main(["run", str(path)]) == 0
    assert "F, v of pump: taken for a port like coil.a, whose flow counts into pump" in capsys.readouterr().out


def test_what_is_neither_port_nor_signal_is_refused(compiler: None, units: dict[str, bytes], tmp_path: Path) -> None:
    both = component("pump", "pump", PUMP), component("coil", "spring", SPRING)
    for wires, words in (
        ((connection("pump:v", "coil:a.velocity"),), "a.velocity belongs to the power port coil.a"),
        (
            (connection("coil:a.force", "pump:F", linear(2.0)), connection("pump:v", "coil:a.velocity")),
            "belongs to",
        ),
    ):
        path = pumps(tmp_path, system(*both, connections=wires), **{"spring.fmu": units["resources/spring.fmu"]})
        with pytest.raises(SSPError, match=words):
            load(path)
