"""Units of other tools: refusals told apart, values that are not finite, noise, exits, and variables of all types."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from phfmu import ELECTRICAL
from phfmu.cli import main
from phfmu.fmu.export.manifest import PortMap
from phfmu.fmu.export.variables import FMUError
from phfmu.fmu.importer.inspect import fmu_info
from phfmu.fmu.importer.reader import FMUInstance
from phfmu.fmu.importer.refusal import UnitFailure
from phfmu.network.members.fmu_member import FMUMember
from phfmu.outcome.status import Status, StepFailure
from tests.fmu import foreign
from tests.wide import wide

VERSIONS = ["2.0", "3.0"]
DISCARD, ERROR, FATAL, LEAVE, NOT_A_NUMBER, _, EARLY, CHATTER, OUTPUT_ERROR = range(1, 10)

TWO = """
<ScalarVariable name="u" valueReference="1" causality="input"><Real start="0"/></ScalarVariable>
<ScalarVariable name="y" valueReference="2" causality="output"><Real/></ScalarVariable>
<ScalarVariable name="mode" valueReference="3" causality="parameter" variability="fixed"><Integer start="0"/></ScalarVariable>
<ScalarVariable name="flag" valueReference="4" causality="input" variability="discrete"><Boolean start="false"/></ScalarVariable>
<ScalarVariable name="choice" valueReference="7" causality="local"><Enumeration declaredType="E" start="2"/></ScalarVariable>
<ScalarVariable name="label" valueReference="9" causality="local"><String start="a"/></ScalarVariable>
"""
THREE = """
<Float64 name="u" valueReference="1" causality="input" start="0"/>
<Float64 name="y" valueReference="2" causality="output"/>
<Int32 name="mode" valueReference="3" causality="parameter" variability="fixed" start="0"/>
<Boolean name="flag" valueReference="4" causality="input" variability="discrete" start="false"/>
<Float32 name="single" valueReference="5" causality="input" start="0.5"/>
<Float64 name="wide" valueReference="6" causality="output"><Dimension start="2"/></Float64>
<Enumeration name="choice" valueReference="7" causality="local" declaredType="E" start="2"/>
<Float64 name="x" valueReference="8" causality="input" start="3 4"><Dimension valueReference="10"/></Float64>
<UInt64 name="n" valueReference="10" causality="structuralParameter" variability="fixed" start="2"/>
<String name="label" valueReference="9" causality="local"><Start value="a"/></String>
<String name="other" valueReference="11" causality="local"/><Clock name="tick" valueReference="12" intervalVariability="fixed"/>
<Binary name="blob" valueReference="13" causality="local"/>
"""
VARIABLES = {"2.0": TWO, "3.0": THREE}
PORT = [PortMap("end", ELECTRICAL, "effort", ("u",), ("y",))]


@pytest.fixture(scope="module")
def units(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("foreign")
    return {v: foreign.unit(folder / f"foreign{v[0]}.fmu", v, VARIABLES[v]) for v in VERSIONS}


Cli = Callable[..., str]


@pytest.fixture
def refused(units: dict[str, Path], capfd: pytest.CaptureFixture[str]) -> Cli:
    """`phfmu run` of the unit in a mode: exit code 3 and what it says."""

    def call(version: str, mode: int) -> str:
        assert main(["run", str(units[version]), "--set", f"mode={mode}"]) == 3
        return capfd.readouterr().err

    return call


@pytest.mark.parametrize("version", VERSIONS)
def test_refusals_are_told_apart_with_the_units_words(refused: Cli, version: str) -> None:
    for mode, answer, remedy in (
        (DISCARD, "discard", "try a smaller step"),
        (ERROR, "error", "begin the run anew"),
        (FATAL, "fatal", "begin in a new process"),
    ):
        said = refused(version, mode)
        assert f"foreign at t = 0.3 s, h = 0.1 s: fmi{version[0]}DoStep answers '{answer}'" in said
        assert "valve stuck at 7 %" in said and remedy in said
        assert "Newton" not in said and "\033" not in said
        assert r"first line \x1b[31mred\x1b[0m | valve" in said


def test_an_early_return_that_was_not_allowed_is_a_failure(refused: Cli) -> None:
    assert "answers 'early return'" in refused("3.0", EARLY)


@pytest.mark.parametrize("version", VERSIONS)
def test_outputs_that_are_not_finite_end_the_run(units: dict[str, Path], refused: Cli, version: str) -> None:
    said = refused(version, NOT_A_NUMBER)
    assert "foreign at t = 0.3 s: 'y' = nan" in said
    assert "GetReal answers 'error'" in (said := refused(version, OUTPUT_ERROR)) or "GetFloat64 answers 'error'" in said
    with FMUInstance(units[version], PORT, starts={"mode": NOT_A_NUMBER}) as unit:
        for k in range(2):
            unit.do_step(0.1 * k, 0.1)
        with pytest.raises(UnitFailure, match="foreign at t = 0.3 s: 'y' = nan") as failure:
            unit.do_step(0.2, 0.1)
        assert failure.value.status is Status.NOT_FINITE and failure.value.answer == "not finite"


@pytest.mark.parametrize("version", VERSIONS)
def test_rows_before_an_output_that_is_not_finite_are_kept(
    units: dict[str, Path], tmp_path: Path, version: str
) -> None:
    """y is 2 u + t until the step from 0.2 s to 0.3 s, after which it is nan."""
    table = tmp_path / "o.csv"
    assert main(["run", str(units[version]), "--set", f"mode={NOT_A_NUMBER}", "-o", str(table)]) == 3
    kept = np.genfromtxt(table, delimiter=",", names=True)
    assert kept["time"] == pytest.approx([0.0, 0.1, 0.2]) and kept["y"] == pytest.approx(kept["time"])


@pytest.mark.parametrize("version", VERSIONS)
def test_words_are_cut_in_length_and_number(refused: Cli, version: str) -> None:
    said = refused(version, CHATTER)
    assert "x" * 400 in said and len(said) < 2500 and "more characters)" in said


def test_the_refusal_is_data(units: dict[str, Path]) -> None:
    with FMUInstance(units["2.0"], PORT, starts={"mode": FATAL}) as unit:
        for k in range(3):
            unit.do_step(0.1 * k, 0.1)
        with pytest.raises(StepFailure) as failure:
            unit.do_step(0.3, 0.1)
        found = failure.value
        assert isinstance(found, UnitFailure)
        assert (found.component, found.function, found.answer) == ("foreign", "fmi2DoStep", "fatal")
        assert found.status is Status.UNIT and found.words[-1] == "valve stuck at 7 %"
        assert unit.dead
        with pytest.raises(UnitFailure, match="it met a fatal error before"):
            unit.get(["y"])
        FMUMember("foreign", unit).set_state(None)  # a rollback of the network finds nothing to restore
    # closing it must not call the library again, which would abort


@pytest.mark.skipif(sys.platform == "win32", reason="the C library cannot take handlers back")
@pytest.mark.parametrize("version", wide(VERSIONS, "3.0"))
def test_a_library_that_calls_exit_is_noticed(units: dict[str, Path], version: str, tmp_path: Path) -> None:
    """What is said to be left is there: nothing without -o and --audit."""
    run = [sys.executable, "-m", "phfmu.cli", "run", str(units[version]), "--set"]
    run[1:3] = ["-c", "import sys; from phfmu.cli import main; sys.exit(main(sys.argv[1:]))"]
    done = subprocess.run([*run, f"mode={LEAVE}"], capture_output=True, text=True, timeout=60)
    assert done.returncode == 3
    assert "the unit 'foreign' ended the process in" in done.stderr and "doStep" in done.stderr
    assert "until then\n" in done.stderr and ".partial" not in done.stderr and "recover" not in done.stderr
    table = ["-o", str(tmp_path / "run.csv")]
    done = subprocess.run([*run, f"mode={LEAVE}", *table], capture_output=True, text=True, timeout=60)
    assert "of this run rows are in the .partial file of -o\n" in done.stderr and "recover" not in done.stderr
    done = subprocess.run([*run, "mode=0"], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and "ended the process" not in done.stderr, "an ordinary end is not one"


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
@pytest.mark.parametrize(
    ("mode", "before", "code"),
    wide(
        [
            (foreign.CRASH, "", 3),
            (foreign.ABORT, "", 3),
            (foreign.CRASH, "faulthandler.enable()", 3),
            (foreign.ABORT, "signal.signal(signal.SIGABRT, signal.SIG_IGN)", -signal.SIGABRT),
        ],
        (foreign.CRASH, "", 3),
    ),
)
def test_a_unit_that_crashes_is_named(units: dict[str, Path], mode: int, before: str, code: int) -> None:
    """Which unit, in which call, when and how; a handler that something else has set stays."""
    program = f"import faulthandler, signal, sys; {before}\nfrom phfmu.cli import main\nsys.exit(main(sys.argv[1:]))"
    run = [sys.executable, "-c", program, "run", str(units["3.0"]), "--set", f"mode={mode}"]
    done = subprocess.run(run, capture_output=True, text=True, timeout=60)
    assert done.returncode == code
    if code == 3:
        assert "the unit 'foreign' crashed in doStep at t = 0.3 s" in done.stderr and "--isolate" in done.stderr
        assert ("SIGABRT" if mode == foreign.ABORT else "SIGSEGV") in done.stderr
    else:
        assert "crashed" not in done.stderr
    assert ("Current thread" in done.stderr) is ("faulthandler.enable" in before)


@pytest.mark.skipif(sys.platform != "linux", reason="of the linker and the signals of Linux")
@pytest.mark.parametrize("version", wide(VERSIONS, "3.0"))
@pytest.mark.parametrize(
    ("mode", "said"),
    [
        (foreign.LEAVE_AT_ONCE, "ended the process in doStep at t = 0.3 s (its library called _exit)"),
        (
            foreign.DEEP,
            "crashed in doStep at t = 0.3 s (SIGSEGV: it used memory that is not its own, or all of its stack)",
        ),
        (foreign.TRAP, "crashed in doStep at t = 0.3 s (SIGFPE: a fault in arithmetic)"),
    ],
)
def test_ends_that_run_no_handler(units: dict[str, Path], version: str, mode: int, said: str, tmp_path: Path) -> None:
    """The rows before are kept, and a first instance that was freed leaves nothing behind that hides the end of a second."""
    program = (
        "import sys\nfrom phfmu import FMUInstance\nfrom phfmu.cli import main\n"
        "FMUInstance(sys.argv[2]).close()\nsys.exit(main(sys.argv[1:]))"
    )
    options = ["--set", f"mode={mode}", "-o", str(tmp_path / "o.csv")]
    run = [sys.executable, "-c", program, "run", str(units[version]), *options]
    done = subprocess.run(run, capture_output=True, text=True, timeout=60)
    assert done.returncode == 3 and f"the unit 'foreign' {said}" in done.stderr and "--isolate" in done.stderr
    done = subprocess.run([*run, "--isolate"], capture_output=True, text=True, timeout=60)
    assert done.returncode == 3


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_a_crash_between_calls_is_no_units(units: dict[str, Path]) -> None:
    program = (
        "import os, sys\nfrom phfmu.fmu.importer.reader import FMUInstance\n"
        "unit = FMUInstance(sys.argv[1]); unit.do_step(0.0, 0.1); os.abort()"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, str(units["3.0"])], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == -signal.SIGABRT and not done.stderr


@pytest.mark.parametrize("version", VERSIONS)
def test_numbers_of_all_types_are_read_and_set(units: dict[str, Path], version: str) -> None:
    starts = {"mode": 0, "flag": 1, "choice": 3, "u": 1.5}
    if version == "3.0":
        starts |= {"single": 0.25, "x[2]": 7.0}
    with FMUInstance(units[version], starts=starts) as unit:
        assert unit.get(list(starts)).tolist() == list(starts.values())
        if version == "3.0":
            assert unit.get(["wide[2]", "wide[1]", "x[1]"]).tolist() == [20.0, 10.0, 0.0], "set entries keep the others"
            unit.set({"x[1]": 5.0, "x[2]": 6.0, "single": 0.1})
            assert unit.get(["x[2]", "y", "x[1]", "single"]).tolist() == [6.0, 3.0, 5.0, float(np.float32(0.1))]
        unit.do_step(0.0, 0.1)
        assert unit.values()["y"] == pytest.approx(3.1) and unit.values()["flag"] == 1.0
    with pytest.raises(FMUError, match="'mode' is of the type Int32, which cannot hold 0.5"):
        FMUInstance(units[version], starts={"mode": 0.5})
    with pytest.raises(FMUError, match="'flag' is of the type Boolean, which cannot hold 2"):
        FMUInstance(units[version], starts={"flag": 2})


def test_info_says_how_to_name_ports_and_what_could_be_one(tmp_path: Path) -> None:
    said = fmu_info(foreign.mass(tmp_path / "pump.fmu", "3.0"))
    assert "pump.ports.toml" in said and "F and v (translational)" in said and "F and q" not in said
    (tmp_path / "pump.ports.toml").write_text('[flange]\neffort = "F"\nflow = "v"\nsign = 1\n')
    assert "none told" not in fmu_info(tmp_path / "pump.fmu")


def test_what_is_left_out_is_said(units: dict[str, Path], capsys: pytest.CaptureFixture[str]) -> None:
    assert "left out, cannot be read or set here: String: 1 (label)" in fmu_info(units["2.0"])
    assert main(["run", str(units["3.0"]), "--stop", "0.2"]) == 0
    assert "left out, cannot be read or set here: String: 2 (label, other); Clock: 1 (tick); Binary: 1 (blob)" in (
        capsys.readouterr().err
    )


@pytest.mark.parametrize("version", VERSIONS)
def test_inputs_outside_of_ports_are_driven_from_a_table(units: dict[str, Path], tmp_path: Path, version: str) -> None:
    (tmp_path / "in.csv").write_text("time,u,flag\n0,0,0\n0.5,2,1\n")
    out = tmp_path / "out.csv"
    assert main(["run", str(units[version]), "--input", str(tmp_path / "in.csv"), "-o", str(out)]) == 0
    rows = np.genfromtxt(out, delimiter=",", names=True)
    assert rows["y"][[5, -1]] == pytest.approx([0.5, 5.0])


TYPED = {
    "2.0": """
<ScalarVariable name="u" valueReference="1" causality="input"><Real declaredType="Force" start="0"/></ScalarVariable>
<ScalarVariable name="y" valueReference="2" causality="output"><Real declaredType="Force" unit="N"/></ScalarVariable>
<ScalarVariable name="y2" valueReference="2" causality="output"><Real/></ScalarVariable>""",
    "3.0": """
<Float64 name="u" valueReference="1" causality="input" declaredType="Force" start="0"/>
<Float64 name="y" valueReference="2" causality="output" declaredType="Force" unit="N">
<Annotations><Annotation type="x"/></Annotations><Alias name="y2"/></Float64>
<Float64 name="wide" valueReference="6" causality="output"><Dimension start="2"/>
<Alias name="broad" description="too"/></Float64>""",
}
UNIT = '<Unit name="daN"><BaseUnit kg="1" m="1" s="-2" factor="10"/></Unit>'
UNIT += '<Unit name="degC"><BaseUnit K="1" offset="273.15"/></Unit><Unit name="none"><BaseUnit factor="0"/></Unit>'
TYPES = {
    "2.0": '<SimpleType name="Force"><Real unit="daN" nominal="5"/></SimpleType>',
    "3.0": '<Float64Type name="Force" unit="daN" nominal="5"/>',
}


@pytest.mark.parametrize("version", VERSIONS)
def test_declared_types_units_and_aliases_are_read(tmp_path: Path, version: str) -> None:
    before = f"<UnitDefinitions>{UNIT}</UnitDefinitions><TypeDefinitions>{TYPES[version]}</TypeDefinitions>"
    path = foreign.unit(tmp_path / "typed.fmu", version, TYPED[version], before=before)
    with FMUInstance(path, starts={"u": 1.5}) as unit:
        assert [(unit.variable(n).unit, unit.variable(n).nominal) for n in ("u", "y")] == [("daN", 5.0), ("N", 5.0)]
        assert unit.interface.units["daN"].factor == 10.0 and len(unit.interface.units) == 1
        unit.do_step(0.0, 0.1)
        assert unit.values()["y2"] == unit.values()["y"] == pytest.approx(3.1)
        if version == "3.0":
            assert unit.get(["broad[2]", "broad[1]"]).tolist() == [20.0, 10.0]
            assert unit.variable("broad[1]").description == "too" and unit.variable("wide[1]").description == ""
    table = tmp_path / "o.csv"
    assert main(["run", str(path), "-o", str(table)]) == 0
    assert {"y", "y2"} <= set(table.read_text().splitlines()[0].split(","))


@pytest.mark.parametrize("version", VERSIONS)
def test_outputs_that_follow_inputs_at_once_are_averaged_under_the_inputs_of_the_step(
    units: dict[str, Path], version: str
) -> None:
    """y = 2 u + t with u held: the mean over a step is 2 u + t + h / 2, whatever u was before."""
    with FMUInstance(units[version], PORT) as unit:
        supplied = 0.0
        for k, u in enumerate((3.0, -1.0, 5.0)):
            unit.set_input([u])
            unit.do_step(0.1 * k, 0.1)
            mean = 2 * u + 0.1 * (k + 0.5)
            supplied += 0.1 * u * mean
            assert unit.output()[0] == pytest.approx(mean, rel=1e-14)
            assert unit.ledger()["supplied"][0] == pytest.approx(0.1 * u * mean, rel=1e-14)
        assert unit.energies()[0] == pytest.approx(supplied, rel=1e-14)
