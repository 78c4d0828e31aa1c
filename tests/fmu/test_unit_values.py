"""What is set and told of a unit's variables from the command line: units, types, arrays, and what takes no value."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from phfmu.cli import main
from tests.fmu import foreign

#: a force told in kN, pushing a mass of 2 kg
UNITS = '<UnitDefinitions><Unit name="kN"><BaseUnit kg="1" m="1" s="-2" factor="1000"/></Unit></UnitDefinitions>'
SIDECAR = '[flange]\neffort = "F"\nflow = "v"\nsign = 1\n'
SCENE = """
from phfmu import Network, Scene


def alone():
    net = Network("alone")
    net.add("pump", "pump.fmu")
    return Scene("alone", net, stop=0.2, step=0.1)
"""
SHAPES = """
<Float32 name="single" valueReference="5" causality="input" start="0.5" unit="bar"/>
<Float64 name="x" valueReference="8" causality="input" start="3 4"><Dimension valueReference="10"/></Float64>
<UInt64 name="n" valueReference="10" causality="structuralParameter" variability="fixed" start="2"/>
<Float64 name="y" valueReference="2" causality="output"/>
<Float64 name="fixed" valueReference="2" causality="local" variability="constant" start="7"/>
<Float64 name="t" valueReference="40" causality="independent"/>
"""


@pytest.mark.parametrize("target", ["pump.fmu", "alone.py"])
@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_inputs_in_units_of_the_unit_are_told_in_them(tmp_path: Path, version: str, target: str) -> None:
    """0.004 kN move 2 kg by 2 m/s2; data in kN hold before they begin and are followed after it."""
    foreign.mass(tmp_path / "pump.fmu", version, unit_of_force="kN", before=UNITS)
    (tmp_path / "pump.ports.toml").write_text(SIDECAR)
    (tmp_path / "alone.py").write_text(SCENE)
    (tmp_path / "force.csv").write_text(f"time,{'' if target == 'pump.fmu' else 'pump.'}F\n0.1,0.004\n0.2,0.008\n")
    own, table = "" if target == "pump.fmu" else "pump.", tmp_path / "o.csv"
    line = ["run", str(tmp_path / target), "--stop", "0.2", "--step", "0.1", "-o", str(table), "--quiet"]
    line += ["--set", f"{own}F=0.004", "--set", f"{own}m=2"]
    for more in ([], ["--input", str(tmp_path / "force.csv")]):
        assert main([*line, *more]) == 0
        rows = np.genfromtxt(table, delimiter=",", names=True, deletechars="")
        assert rows[f"{own}F"][:2] == pytest.approx([0.004, 0.004])
        # the library moves m v' = F by the number it is given
        assert rows[f"{own}v"][-1] == pytest.approx(0.2 * 0.004 / 2)


@pytest.fixture
def shapes(tmp_path: Path) -> Path:
    return foreign.unit(tmp_path / "shapes.fmu", "3.0", SHAPES)


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("n=3", "'n' is a structural parameter, which stays as it is here: it cannot be set"),
        ("y=3", "'y' is an output that the unit computes: it cannot be set"),
        ("fixed=3", "'fixed' is constant: it cannot be set"),
        ("t=3", "'t' is the time of the unit: it cannot be set"),
        ("single=1e39", "'single' is of the type Float32, which cannot hold 1e+39"),
        ("x[3]=1", "has no parameter, state or input 'x[3]'; did you mean x[2], x[1]"),
    ],
)
def test_what_takes_no_value_is_told(shapes: Path, setting: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(shapes), "--set", setting]) == 2
    assert said in capsys.readouterr().err


def test_the_name_of_an_array_sets_its_entries(shapes: Path, tmp_path: Path) -> None:
    table = tmp_path / "o.csv"
    assert main(["run", str(shapes), "--set", "x=5", "-o", str(table), "--quiet"]) == 0
    rows = np.genfromtxt(table, delimiter=",", names=True, deletechars="")
    assert rows["x[1]"][-1] == rows["x[2]"][-1] == 5.0


def test_units_of_single_precision_and_sizes_of_arrays_are_told(
    shapes: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["info", str(shapes)]) == 0
    told = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["single", "bar,", "Float32", "0.5"] in told
    assert ["n", "UInt64", "2"] in told


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("export alone.py", "one model holds no FMU, as pump would be; --as-unit keeps"),
        ("run alone.py --dense 2", "or put declarations in the place of pump: an FMU cannot be composed"),
    ],
)
def test_what_scenes_with_units_cannot_do_has_a_remedy_that_works(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    foreign.mass(tmp_path / "pump.fmu", "2.0")
    (tmp_path / "pump.ports.toml").write_text(SIDECAR)
    (tmp_path / "alone.py").write_text(SCENE)
    monkeypatch.chdir(tmp_path)
    assert main(line.split()) == 2
    assert said in capsys.readouterr().err
    if line.startswith("export"):
        assert main([*line.split(), "--ssp"]) == 0 and Path("alone.ssp").is_file()
