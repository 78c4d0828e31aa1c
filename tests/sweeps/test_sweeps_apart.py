"""Sweeps of members apart and of units: the numbers of `phfmu run` with these values, to the bit."""

from __future__ import annotations

from pathlib import Path

import pyarrow.parquet as pq
import pytest

from phfmu.cli import _parser, main
from phfmu.cli.parser import parsed
from phfmu.cli.verbs.sweep import _apart
from phfmu.components.library import build
from phfmu.sweeps.design import axes
from phfmu.sweeps.recipe import Steppers
from phfmu.sweeps.runs import sweep

pytestmark = pytest.mark.usefixtures("compiler")
SMIB = ("smib", "gen.J=25000,30000,40000", ["line.flux[1]", "gen.p", "energy.stored"])
DRIVE = ("drive", "load.J=0.0005,0.001,0.002", ["load.w", "shaft.twist", "energy.stored"])
SHORT = ["--stop", "0.01", "--step", "0.0002"]


def swept(folder: Path, target: str, vary: str, signals: list[str], *options: str) -> dict[str, list]:
    words = [w for s in signals for w in ("--measure", f"last({s})")]
    file = folder / "swept.parquet"
    assert main(["sweep", target, "--vary", vary, *words, *options, "-o", str(file), "--quiet"]) == 0
    return pq.read_table(file).to_pydict()


def ran(folder: Path, target: str, given: str, signals: list[str], *options: str) -> list[float]:
    file = folder / "one.parquet"
    assert main(["run", target, "--set", given, *options, "-o", str(file), "--quiet"]) == 0
    table = pq.read_table(file)
    return [table[s][-1].as_py() for s in signals]


@pytest.mark.parametrize(
    ("case", "options"),
    [
        (SMIB, ("--coupling", "newton", "--order", "4")),
        (SMIB, ("--coupling", "anderson")),
        (SMIB, ("--parts", "line=2")),
        (DRIVE, ("--coupling", "gauss-seidel")),
        (DRIVE, ("--coupling", "jacobi")),
        (DRIVE, ("--coupling", "jacobi", "--ecco", "1e-3")),
    ],
    ids=lambda o: " ".join(o) if isinstance(o, tuple) and o[0].startswith("--") else "",
)
def test_members_apart(case: tuple, options: tuple[str, ...], tmp_path: Path) -> None:
    target, vary, measured = case
    name = vary.partition("=")[0]
    found = swept(tmp_path, target, vary, measured, *options, *SHORT, "--jobs", "2")
    assert len(found[name]) == 3 and set(found["error"]) == {""}
    assert max(found["ledger"]) <= 1.0
    for i, value in enumerate(found[name]):
        told = [found[f"last({s})"][i] for s in measured]
        assert told == ran(tmp_path, target, f"{name}={value}", measured, *options, *SHORT)
    assert len({row for row in found["last(energy.stored)"]}) == 3


def test_a_unit(tmp_path: Path) -> None:
    assert main(["export", "four_particle", "--fmi", "2", "-o", str(tmp_path)]) == 0
    unit, signals = str(tmp_path / "four_particle_fmi2.fmu"), ["v[1]", "energy.stored"]
    found = swept(tmp_path, unit, "k13=40,50,60", signals, "--stop", "0.5", "--step", "0.01")
    for i, value in enumerate(found["k13"]):
        told = [found[f"last({s})"][i] for s in signals]
        assert told == ran(tmp_path, unit, f"k13={value}", signals, "--stop", "0.5", "--step", "0.01")
    assert len(set(found["last(v[1])"])) == 3


def test_going_on_takes_what_is_left_of_the_same_unit_only(tmp_path: Path) -> None:
    """The digest of the file is part of what the sweep is known by."""
    units = [tmp_path / folder for folder in ("one", "other")]
    for folder, order in zip(units, ("2", "6"), strict=True):
        assert main(["export", "four_particle", "--fmi", "2", "--order", order, "-o", str(folder)]) == 0
    design, told = axes(["k13=40,50,60"]), ["last(v[1])"]

    def steppers(folder: Path) -> Steppers:
        words = ["sweep", str(folder / "four_particle_fmi2.fmu"), "--vary", "k13=40,50", "--measure", "last(v[1])"]
        return _apart(parsed(_parser(), words), design, anywhere=False)["target"]

    whole, file = sweep(steppers(units[0]), design, told), tmp_path / "t.parquet"

    def stop(done: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sweep(steppers(units[0]), design, told, file=file, jobs=1, progress=stop)
    with pytest.raises(ValueError, match="holds another sweep"):
        sweep(steppers(units[1]), design, told, file=file, resume=True)
    assert sweep(steppers(units[0]), design, told, file=file, resume=True).equals(whole)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["smib", "--coupling", "newton", "--vary", "line.L=-1,0.1"], "line.L: is -1 H; it must be above 0"),
        (["smib", "--coupling", "newton", "--vary", "line.M=0.1,0.2"], "has no parameter, state or input 'line.M'"),
        (["four_particle", "--coupling", "newton", "--vary", "k13=1,2"], "four_particle is a single component"),
        (["smib", "--signals-held", "--coupling", "newton", "--vary", "line.R=1,2"], "there are none"),
    ],
)  # fmt: skip
def test_refused_before_any_run(words: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sweep", *words, "--measure", "last(energy.stored)", "--stop", "0.01"]) == 2
    assert said in capsys.readouterr().err.replace("'line.L'", "line.L")


def test_a_run_that_fails_is_a_row(tmp_path: Path) -> None:
    """A line whose current begins elsewhere than that of the machine is off its junction; with that of the scene it is not."""
    start = build("smib").system.members["line"].states[0].start[0]
    found = swept(tmp_path, "smib", f"line.flux[1]={start},0.0", ["gen.p"], "--coupling", "newton", *SHORT)
    assert found["error"][0] == "" and "inconsistent start" in found["error"][1]
    assert found["last(gen.p)"][1] is None
