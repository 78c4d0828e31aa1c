"""The command line on bad input: exit code, named object, numbers and remedy, never a traceback."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from phfmu.audit import read, summarise
from phfmu.cli import main
from tests.cli.wrong_models import MODELS

Cli = Callable[..., str]


@pytest.fixture
def refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Cli:
    """Runs a command line that must end with the code and say the words; gives all that it says."""
    monkeypatch.chdir(tmp_path)
    Path("models.py").write_text(MODELS, encoding="utf-8")

    def call(code: int, line: str, *words: str) -> str:
        try:
            found = main(line.split())
        except SystemExit as leave:
            found = leave.code
        out, err = capsys.readouterr()
        assert "Traceback" not in out + err and "internal error" not in err
        assert found == code, err
        assert all(w in out + err for w in words), (err or out, words)
        return out + err

    return call


def test_a_table_and_an_audit_are_not_compared(refused: Cli) -> None:
    assert main("run mass --engine python --stop 0.2 --step 0.1 -o o.csv --audit a.parquet --quiet".split()) == 0
    refused(2, "compare o.csv a.parquet", "o.csv and a.parquet: one is the table of a run, the other an audit")


# -- the command line itself ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "line, said",
    [
        ("", "required: VERB list info check phfmu list"),
        ("simulate mass", "invalid choice: 'simulate' 'list' 'info' 'check' 'run' 'export' 'audit'"),
        ("run", "required: target"),
        ("run mass --stpo 1", "unrecognized arguments: --stpo"),
        ("run mass --step fast", "--step 'fast'"),
        ("run mass --engine quick", "'quick' 'python' 'native' 'fmu'"),
        ("run mass --order 3", "order 3 is one of --scheme radau"),
        ("run osillator", "no component or scene 'osillator' did you mean oscillator?"),
        ("info zzz", "no component or scene 'zzz' there are: synchronous_machine two_machine"),
        ("check smib_hidro", "did you mean smib_hydro"),
        ("export osilator", "did you mean oscillator"),
        ("export mass -o models.py", "models.py is a file; name a folder"),
        ("export mass --step 0", "--step 0.0 s must be positive"),
        ("export mass --platform pdp11", "pdp11 x86_64-linux aarch64-darwin"),
        ("run models.py", "say which function of models.py models.py:units or models.py:sign"),
        ("run models", "no component or scene 'models' in the library; models.py:units"),
        ("run models.py:unit", "no function 'unit' units, sign, efforts"),
        ("run none.py:f", "no file 'none.py'"),
        ("run bad.py:f", "bad.py: SyntaxError line 1"),
        ("run empty.py:f", "empty.py has no function 'f'; it has: none"),
        ("run models.py:number", "gives an int; expected a PHDAE, a Network or a Scene"),
        ("run models.py:divides", "models.py, line 39, divides: ZeroDivisionError: division by zero"),
        ("info models.py:misses", "line 40, misses: KeyError: key"),
        ("run models.py:leaves", "line 41, leaves: SystemExit: 0"),
        ("run models.py:needs", "needs: TypeError 1 required positional argument: 'a'"),
        ("run models.py:units", "unit mismatch a.flange N, b.terminal V; transformer"),
        ("check models.py:sign", "a.flange - b.a: u_a = +1 y_b and u_b = +1 y_a create power 2 opposite"),
        ("run models.py:efforts", "a.flange b.flange both take the effort junction('name', kind='0'"),
        ("run models.py:sizes", "a.a has 3 scalar pairs, b.terminal has 1"),
        ("run models.py:no_port", "member 'a' has no free port 'flang'; did you mean flange?"),
        ("run models.py:again", "a.flange is joined at 'a_flange_b_a' already"),
        ("run models.py:umlaut", "member name 'größe' letters a-z"),
        ("run models.py:nothing", "network 'net' has no members network.add"),
        ("run models.py:bad_event", "no parameter, state or input 'flange.forc'; did you mean flange.force?"),
        ("run models.py:bad_event --stop 1", "no parameter, state or input 'flange.forc'; did you mean flange.force?"),
        ("run models.py:nan_event --stop 1", "event m = nan at t = 900000000.0 s must be finite"),
        ("run models.py:state_event", "'q' follows from the equations; set a parameter"),
        ("run models.py:nan_event", "event m = nan at t = 900000000.0 s must be finite"),
        ("run models.py:currents", "net: joint.v[3]: sum to -0.1 tolerance sum of currents"),
        ("run models.py:currents --coupling newton", "net: joint.v[3]: sum 0.1 change the start values"),
        ("run models.py:rigid", "net: flange.force: velocity differ by 0.3 m/s change the start values"),
        ("run models.py:rigid --coupling newton", "velocity of a.flange and b.flange differ by 0.3 m/s"),
        ("run models.py:charged", "v of a.terminal and b.terminal differ by 5 V"),
        ("run models.py:charged --coupling newton", "v of a.terminal and b.terminal differ by 5 V"),
        ("run models.py:itself", "s.a is joined to itself; name the port of another element"),
        ("run four_particle --set v[4]=1", "lambda[1]: velocity residual 1 change the start values"),
        ("run four_particle --set q[4]=1.1", "lambda[1]: position residual 0.105 change the start values"),
        ("run four_particle --order 4", "odd stages use --order 2 or 6"),
        ("run four_particle --order 4 --scheme collocated", "four_particle: order 4 use --order 2 or 6"),
        ("run four_particle --coupling newton", "four_particle is a single component"),
        ("run empty.txt", "empty.txt is no target; file.py:function, X.fmu, X.ssp"),
        ("run .", ". is no target; name of the library"),
        ("export mass -o /proc/x", "-o /proc/x: cannot write in the folder '/proc'"),
        ("export oscillator -o o.ssp", "-o o.ssp is a folder --ssp -o ."),
        ("audit none", "no audit file 'none' phfmu run TARGET --audit none.audit.parquet"),
        ("audit o.csv", "o.csv is the table of a run; --audit X.parquet"),
        ("plot mass -o x.png", "mass is no file of a run; run it first, phfmu run mass -o RUN.csv"),
        ("report models.py:itself -o x.html", "models.py:itself is no file of a run; phfmu run models.py:itself -o"),
        ("audit none.parquet", "no audit file 'none.parquet' phfmu run TARGET --audit none.parquet"),
        ("audit recover none.arrows", "no stream none.arrows to recover"),
        ("audit bad.py", "bad.py is not an audit log"),
        ("audit a.parquet b.parquet", "audit takes one file"),
        ("audit x --rtol nan", "--rtol nan"),
    ],
)
def test_refused(refused: Cli, line: str, said: str) -> None:
    Path("bad.py").write_text("def f(:\n")
    Path("empty.py").touch()
    Path("empty.txt").touch()
    refused(2, line, *said.split())


def test_a_unit_that_is_none_is_refused_before_a_run(refused: Cli) -> None:
    assert main(["new", "component", "tank"]) == 0
    path = Path("tank.py")
    path.write_text(path.read_text(encoding="utf-8").replace("N.s/m", "Wbb"), encoding="utf-8")
    refused(2, "run tank.py --engine python --stop 0.01", "variable 'd': unknown unit symbol 'Wbb'", "--no-check")
    refused(2, "export tank.py", "unknown unit symbol 'Wbb'")
    assert main("run tank.py --engine python --stop 0.01 --no-check".split()) == 0


def test_a_file_without_a_function_names_those_that_need_no_argument(refused: Cli) -> None:
    said = refused(2, "run models.py", "models.py:units or ", "models.py:broken")
    assert "models.py:line" not in said and "models.py:two" not in said  # they have arguments


@pytest.mark.parametrize(
    "words, said",
    [
        ("--set mass1.qq=1", "no parameter, state or input 'mass1.qq'; did you mean mass1.q"),
        ("--set mass1.q=1 --set mass1.q=2", "--set mass1.q and --set mass1.q are for the same number"),
        ("--fmi 2.0", "--fmi 2.0 says what --engine fmu exports add --engine fmu"),
        ("--set mas1.q=1", "no parameter, state or input 'mas1.q'; did you mean mass1.q"),
        ("--set =1", "'' members: mass1, mass2, spring12"),
        ("--set mass1.q=nan", "--set mass1.q=nan: finite number"),
        ("--set mass1.q=-inf", "--set mass1.q=-inf: finite number"),
        ("--set mass1.q", "--set mass1.q: NAME=VALUE"),
        ("--set mass1.flange.force=1", "'mass1.flange.force' is fed by the junction 'left'"),
        ("--step 0", "--step 0.0 s must be positive"),
        ("--step -0.1", "--step -0.1 s must be positive"),
        ("--step nan", "--step nan s must be positive and finite"),
        ("--step inf", "--step inf s must be positive and finite"),
        ("--step 1e-17", "--step 1e-17 s is lost in the rounding --stop 1.0 s"),
        ("--stop 0", "--stop 0.0 s after the start 0.0 s"),
        ("--stop -1", "--stop -1.0 s"),
        ("--stop nan", "--stop nan s must be finite"),
        ("--stop 1e300", "--step 0.01 s is lost in the rounding --stop 1e+300 s"),
        ("--rtol -1", "--rtol -1.0"),
        ("--audit-rtol -1", "--audit-rtol -1.0"),
        ("--atol 1e-6", "--atol adaptive steps give --rtol"),
        ("--rtol 1e-6 --min-step 1 --max-step 0.1", "--min-step 1.0 s --max-step 0.1 s 0 <= min <= max"),
        ("--rtol 1e-4 --coupling newton", "--rtol needs one composed model leave out --coupling"),
        (
            "--restart 1 --coupling anderson",
            "--restart members stepped apart take damping steps with --coupling newton",
        ),
        ("--restart -1", "--restart -1: a number of steps from 0"),
        ("-o none/o.csv", "-o none/o.csv: there is no folder 'none'"),
        ("-o o.xlsx", "-o o.xlsx: the ending must be .csv or .parquet"),
        ("--audit none/a.parquet", "--audit none/a.parquet: there is no folder 'none'"),
        ("--audit a.csv", "a.csv must end in .parquet, e.g. a.audit.parquet"),
        ("--audit a.parquet -o a.parquet", "both name a.parquet"),
        ("--input none.csv", "--input none.csv: no such file"),
        ("--scheme two-level", "oscillator has no holonomic constraints; use --scheme collocated"),
        ("--gradient joint-gonzalez --order 4", "joint-gonzalez has order 2 per-term"),
        ("--scheme midpoint --order 4", "midpoint has order 2"),
    ],
)
def test_options_of_a_run(refused: Cli, words: str, said: str) -> None:
    """Refused before the first step: nothing is written."""
    refused(2, f"run oscillator --engine python {words}", *said.split())
    assert {p.name for p in Path().iterdir()} <= {"models.py", "__pycache__"}


@pytest.mark.parametrize(
    "text, said",
    [
        (b"", "first column must be 'time'"),
        (b"m,time\n1,0\n", "first column must be 'time'"),
        (b"time;m\n0;1\n", "first column must be 'time' commas"),
        (b"time,m\n", "no rows below its header"),
        (b"time,flange.forc\n0,1\n", "unknown input 'flange.forc'; did you mean flange.force?"),
        ("time,größe\n0,1\n".encode(), "unknown input 'größe'; there are: m, flange.force"),
        (b"time,m,m\n0,1,2\n", "2 columns are called 'm'"),
        (b"time,m\n# comment\n\n0,1\n0.5,nan\n", "in.csv, line 5, column m: nan at time 0.5 is not finite"),
        (b"time,m\n0,-1e400\n", "in.csv, line 2, column m: -1e400 at time 0"),
        (b"time,m\n0,1\ninf,1\n", "in.csv, line 3, column time: inf"),
        (b"time,m\n0,one\n", "in.csv, line 2, column m: 'one' is not a number"),
        (b"time,m\n0,1\n0.5\n", "in.csv, line 3: 1 values, expected 2 (time, m)"),
        (b"time,m\n0,1\n1,1\n0.5,2\n", "in.csv, line 4: time 0.5 after 1; times must not decrease"),
        (b"\xff\xfet\x00i\x00", "in.csv is not a CSV file in UTF-8"),
    ],
)
def test_input_tables(refused: Cli, text: bytes, said: str) -> None:
    Path("in.csv").write_bytes(text)
    refused(2, "run mass --engine python --input in.csv", "in.csv", *said.split())


# -- runs that fail ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("engine", ["python", "native"])
def test_no_convergence(refused: Cli, engine: str) -> None:
    """Audit and table hold all accepted steps, and the table is said to be kept."""
    line = f"run models.py:unsolvable --stop 2 --step 0.02 --engine {engine} --audit u.parquet -o u.csv"
    said = "unsolvable at t = 0.9|, h = 0.000|Newton's method did not converge|worst: |Next: substeps down to 0.000"
    text = refused(3, line, *said.split("|"))
    failed = float(text.split("t = ")[1].split(" s")[0])
    summary = summarise(read("u.parquet"))
    rows = Path("u.csv").read_text().splitlines()[1:]
    assert summary.events == {"nonconverged": 1} and len(rows) == summary.steps + 1
    assert float(rows[-1].split(",")[0]) == pytest.approx(summary.t_end) and f"kept: u.csv, {len(rows)} rows" in text
    assert 0 <= failed - summary.t_end < 0.02 and summary.steps == round(summary.t_end / 0.02) > 40
    refused(0, "audit u.parquet", "closed", "1 nonconverged")


def test_a_scheme_that_does_not_keep_energy(refused: Cli) -> None:
    line = "run four_particle --scheme midpoint --stop 1 --audit m.parquet"
    text = refused(4, line, "VIOLATED", "ledger violated: four_particle", "allowed: 1.0e-11")
    assert "four_particle: step" in text
    refused(4, "audit m.parquet", "VIOLATED", "misses")
    refused(4, "audit m.parquet --rtol 1e-2", "misses")  # the first step moves 86 uJ and misses 2.3 uJ
    refused(0, "audit m.parquet --rtol 1e-1", "closed")


def test_check_gives_all_problems(refused: Cli) -> None:
    refused(1, "check models.py:broken", "'banana'", "[unit]", "eigenvalue -1", "[passivity]", "2 problems")


def test_audit_files(refused: Cli) -> None:
    refused(0, "run mass --stop 0.01 --audit a.parquet -o t.parquet")
    sound = Path("a.parquet").read_bytes()
    for name, data in (("half", sound[:2000]), ("none", b""), ("junk", b"junk")):
        Path(f"{name}.parquet").write_bytes(data)
        refused(2, f"audit {name}.parquet", f"{name}.parquet is not an audit log")
    refused(2, "audit t.parquet", "t.parquet is not an audit log: it lacks the key")
    table = pq.read_table("a.parquet")
    leak = pa.array([None if x is None else x + 1.0 for x in table["dH"].to_pylist()])
    pq.write_table(table.set_column(table.column_names.index("dH"), "dH", leak), "b.parquet")
    refused(4, "audit b.parquet", "VIOLATED", "misses 1.000e+00 J")
    Path("c.arrows").write_bytes(b"left by a crash")
    refused(2, "run mass --audit c.parquet", "c.arrows is left from a run", "phfmu audit recover c.arrows")
    refused(2, "audit recover c.arrows", "c.arrows was cut off in its header")
    assert Path("c.arrows").exists()


# -- units ---------------------------------------------------------------------------------------------------


def test_units(refused: Cli) -> None:
    refused(0, "export mass --fmi 3")
    sound, description = Path("mass_fmi3.fmu").read_bytes(), "modelDescription.xml"

    def changed(change: Callable[[str, bytes], tuple[str, bytes]], **more: bytes) -> None:
        with zipfile.ZipFile("mass_fmi3.fmu") as old, zipfile.ZipFile("x.fmu", "w") as new:
            for name in old.namelist():
                new.writestr(*change(name, old.read(name)))
            for name, data in more.items():
                new.writestr(name, data)

    def refuse(*words: str) -> None:
        for code, verb in ((2, "run"), (2, "info"), (1, "check")):
            refused(code, f"{verb} x.fmu", "x.fmu", *words)

    for data in (sound[: len(sound) // 2], b"no archive", b""):
        Path("x.fmu").write_bytes(data)
        refuse("not a readable archive", "export or download it again")
    changed(lambda n, b: (n.replace("binaries/", "binaries/pdp11-").replace("sources/", "sources/"), b))
    refused(2, "run x.fmu", "x.fmu", "no library for this platform", "the archive has pdp11-")
    refused(1, "check x.fmu", "x.fmu", "no library for this platform", "the archive has pdp11-")
    refused(0, "info x.fmu", "libraries for: pdp11-", "it can be read, not run")
    for name in ("../out.txt", "/out.txt", "a/../../out.txt"):
        changed(lambda n, b: (n, b), **{name: b"out"})
        refuse(f"the path '{name}', which leaves its folder")
    entity = b'<!DOCTYPE a [<!ENTITY e SYSTEM "file:///etc/passwd">]>\n<fmiModelDescription'
    changed(lambda n, b: (n, b.replace(b"<fmiModelDescription", entity) if n == description else b))
    refuse("document type definition", "refused")
    changed(lambda n, b: (n, b[:300] if n == description else b))
    refuse("x.fmu/modelDescription.xml", "not well formed")
    changed(lambda n, b: (n.replace(description, "other.xml"), b))
    refuse("no modelDescription.xml")
    refused(2, "run none.fmu", "none.fmu: there is no such file")
    refused(2, "export mass_fmi3.fmu", "is an FMU; this verb needs a declaration")
    refused(2, "run mass_fmi3.fmu --set mm=1", "no parameter, state or input 'mm'; did you mean m?")
    refused(2, "run mass_fmi3.fmu --order 4", "--order 4 has no effect", "compiled in")
    refused(2, "run mass_fmi3.fmu --coupling newton", "--coupling newton has no effect")
    Path("in.csv").write_text("time,m\n0,1\n")
    refused(2, "run mass_fmi3.fmu --input in.csv", "unknown input 'm'; there are: flange.force")
