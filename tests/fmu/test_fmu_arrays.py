"""Vector ports as arrays of FMI 3.0: the same numbers as with scalars, in FMPy and here."""

from __future__ import annotations

import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu
from lxml import etree

from phfmu import build_model, export
from phfmu.cli import main
from phfmu.components.electrical.rl_line import rl_line
from phfmu.fmu.export.variables import FMUError
from phfmu.fmu.importer.reader import FMUInstance

STEP = 1e-3
ARRAYS = {"a.v": 3, "a.i": 3, "a.i_step": 3, "b.v": 3, "b.i": 3, "b.i_step": 3}


@pytest.fixture(scope="module")
def lines(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """A line with arrays and with scalars in FMI 3.0, and in FMI 2.0 of the export with arrays."""
    declaration = rl_line(0.3, 0.2, i=(1.0, -0.5, -0.5))
    model = build_model(declaration)
    folder = tmp_path_factory.mktemp("line")
    two, arrays = export(model, folder / "arrays", step=STEP, arrays=True)
    (scalars,) = export(model, folder / "scalars", ("3.0",), step=STEP)
    return arrays, scalars, two


def test_the_description_lists_arrays(lines: tuple[Path, Path, Path]) -> None:
    arrays, scalars, two = lines
    for path in lines:
        assert validate_fmu(str(path)) == []
    root = etree.fromstring(zipfile.ZipFile(arrays).read("modelDescription.xml"))
    found = {v.get("name"): int(v.find("Dimension").get("start")) for v in root.iter("Float64") if len(v)}
    assert found == ARRAYS
    names = [v.get("name") for v in root.iter("Float64")]
    assert not [n for n in names if n.startswith(("a.", "b.")) and "[" in n]
    listed = {v.get("valueReference") for v in root.iter("Float64")}
    used = [e.get("valueReference") for tag in ("Output", "InitialUnknown") for e in root.iter(tag)]
    assert set(used) <= listed and len(used) == 2 * len(set(used))
    assert b"<Dimension" not in zipfile.ZipFile(scalars).read("modelDescription.xml")
    assert b'name="a.v[1]"' in zipfile.ZipFile(two).read("modelDescription.xml"), "FMI 2.0 has no arrays"


def test_terminals_name_variables_there_are(lines: tuple[Path, Path, Path]) -> None:
    for path, expected in ((lines[0], {"a.v", "a.i", "b.v", "b.i"}), (lines[2], {"a.v[1]", "b.i[3]"})):
        archive = zipfile.ZipFile(path)
        root = etree.fromstring(archive.read("terminalsAndIcons/terminalsAndIcons.xml"))
        members = {m.get("variableName") for m in root.iter("TerminalMemberVariable")}
        model = etree.fromstring(archive.read("modelDescription.xml"))
        assert members <= {v.get("name") for v in model.find("ModelVariables")}
        assert expected <= members


def test_steps_ledger_states_and_sensitivities_are_those_of_scalars(lines: tuple[Path, Path, Path]) -> None:
    with FMUInstance(lines[0], starts={"a.v[2]": 1.0}) as one, FMUInstance(lines[1], starts={"a.v[2]": 1.0}) as two:
        assert one.inputs == two.inputs and one.names == two.names
        for k in range(30):
            u = np.sin(0.1 * k + np.arange(6))
            for unit in (one, two):
                unit.set_input(u)
                unit.do_step(k * STEP, STEP)
            np.testing.assert_array_equal(one.output(), two.output())
            np.testing.assert_array_equal(list(one.values().values()), list(two.values().values()))
            for name, value in one.ledger().items():
                np.testing.assert_array_equal(value, two.ledger()[name])
        np.testing.assert_array_equal(one.sensitivity(), two.sensitivity())
        assert np.abs(one.sensitivity()).max() > 0
        end, state = one.output(), one.get_state()
        one.set({"b.v[3]": 9.0})
        assert one.get(["b.v[1]", "b.v[3]"]).tolist() == [u[3], 9.0], "the other entries stay"
        one.do_step(30 * STEP, STEP)
        one.set_state(state)
        np.testing.assert_array_equal(one.output(), end)


def test_fmpy_sets_and_reads_them(lines: tuple[Path, Path, Path]) -> None:
    rows = fmpy.simulate_fmu(
        str(lines[0]), stop_time=20 * STEP, output_interval=STEP, start_values={"a.v": [5.0, -2.0, 1.0]},
        output=["a.i", "b.i_step", "energy.residual"],
    )  # fmt: skip
    starts = {"a.v[1]": 5.0, "a.v[2]": -2.0, "a.v[3]": 1.0}
    scalars = fmpy.simulate_fmu(
        str(lines[1]), stop_time=20 * STEP, output_interval=STEP, start_values=starts,
        output=[f"{n}[{i}]" for n in ("a.i", "b.i_step") for i in (1, 2, 3)],
    )  # fmt: skip
    for name in ("a.i", "b.i_step"):
        np.testing.assert_array_equal(rows[name], np.stack([scalars[f"{name}[{i}]"] for i in (1, 2, 3)], axis=1))
    assert np.abs(rows["a.i"]).max() > 0.1 and np.abs(rows["energy.residual"]).max() < 1e-14


def test_wrong_numbers_of_values_are_refused(lines: tuple[Path, Path, Path]) -> None:
    with FMUInstance(lines[0]) as unit:
        slave = unit._slave
        group = slave.references([unit.variable(f"a.v[{i}]") for i in (1, 2, 3)])
        (block,) = group.by_type
        assert (block.n, block.total) == (1, 3), "one reference, three values"
        right = block.arguments
        block.arguments = (*right[:-1], 2)
        with pytest.raises(FMUError, match="fmi3SetFloat64: 2 values for 3 scalar variables"):
            slave.set(group)
        block.arguments = right
        group.values[:] = [1.0, np.nan, 2.0]
        with pytest.raises(FMUError, match=r"'a.v\[2\]' = -?nan is not finite"):
            slave.set(group)
        assert unit.get(["a.v[1]"]) == 0.0, "a refused call changes nothing"


def test_the_command_line_writes_arrays(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", "rl_line", "--fmi", "3", "--arrays", "-o", str(tmp_path)]) == 0
    path = Path(capsys.readouterr().out.strip())
    assert b"<Dimension" in zipfile.ZipFile(path).read("modelDescription.xml")
    assert main(["run", str(path), "--set", "a.v[1]=1", "--stop", "0.01"]) == 0
