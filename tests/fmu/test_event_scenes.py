"""Scenes with state events in all hosts of a unit: the numbers of the native engine, whatever clock the host has."""

from __future__ import annotations

import subprocess
import zipfile
from math import ceil
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException

from phfmu import Collocated, FMUInstance, NativeInstance, SwitchedInstance, build_model, export, open_result
from phfmu.cli import main
from phfmu.components.electrical.rectifiers import six_pulse_bridge
from phfmu.components.library import build
from phfmu.components.scenes.electrical.buck import buck
from phfmu.fmu.export import sources
from phfmu.fmu.importer.refusal import UnitFailure
from tests.events.exact_buck import exact
from tests.fmu.exported import needs_cc

HERE, VERSIONS = Path(__file__).parent, ("2.0", "3.0")
#: all of the library whose events set modes, and clutch_engagement, whose modes the scene sets
QUICK = ("bouncing_ball", "clutch_engagement", "buck")
SCENES = (
    *QUICK,
    "buffer",
    "hard_stop",
    "two_point_control",
    "breaker_opening",
    "rectifier",
    "six_pulse",
    "bead",
    "smib_breaker",
)
STEP, STOP = 5e-6, 4.5e-3


def by(scene: str, tmp_path: Path, *how: str) -> Any:
    """The table of a run by command."""
    out = tmp_path / "run.parquet"
    assert main(["run", scene, *how, "-o", str(out)]) == 0
    return open_result(out)


def require_equal(name: str, version: str, order: str, tmp_path: Path) -> None:
    """Every state at every step."""
    (tmp_path / "native").mkdir()
    native = by(name, tmp_path / "native", "--engine", "native", "--order", order)
    unit = by(name, tmp_path, "--engine", "fmu", "--fmi", version, "--order", order)
    ours, theirs = grid(native), grid(unit)
    common = sorted(ours.keys() & theirs.keys())
    assert len(common) > 0.7 * build(name).stop / build(name).step
    for v in build(name).declaration().states:
        for n in v.names():
            expected = native.column(n)[[ours[t] for t in common]]
            found = unit.column(n)[[theirs[t] for t in common]]
            assert found == pytest.approx(expected, rel=1e-9, abs=1e-11 * max(abs(expected).max(), v.nominal[0]))


def grid(table: Any) -> dict[int, int]:
    """Instants with one row, where nothing happens, in units of rounding: the row."""
    at = np.round(table.time / (1e-13 * table.time[-1])).astype(int).tolist()
    return {t: i for i, t in enumerate(at) if at.count(t) == 1}


@pytest.mark.parametrize("name", QUICK)
def test_a_run_in_a_unit_is_that_of_the_native_engine(name: str, tmp_path: Path) -> None:
    """Nobody has to name parameters: those that events set are modes, the others may change."""
    require_equal(name, "3.0" if name != "buck" else "2.0", "2", tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("name", SCENES)
def test_runs_in_units_are_those_of_the_native_engine(name: str, version: str, tmp_path: Path) -> None:
    require_equal(name, version, "4" if version == "2.0" and name != "bead" else "2", tmp_path)


@pytest.fixture(scope="module")
def converter(tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, dict[str, Path]]:
    model = build_model(buck(later=None).declaration(), Collocated(1))
    paths = export(model, tmp_path_factory.mktemp("units"), VERSIONS, step=STEP, stop=1.0)
    return model, dict(zip(VERSIONS, paths, strict=True))


def native(model: Any, h: float, n: int, summed: bool = True) -> tuple[list[float], int]:
    """States after n steps of a clock, and how many events there were."""
    made = SwitchedInstance(model, NativeInstance)
    made.prepare(STEP)
    t, events = 0.0, 0
    for k in range(n):
        made.do_step(t, h, ceil(h / STEP - 1e-9))
        t = t + h if summed else (k + 1) * h
        events += len(made.happened)
    return made.x.tolist(), events


NAMES = ["coil.flux", "load.charge", "events.count"]


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("h", [5e-6, 1e-4])
def test_summed_clocks_of_an_importer_lose_no_instant(converter: Any, version: str, h: float) -> None:
    """The clock of the loop in every importer's manual, t += h, in steps that begin 1e-18 s beside instants of switching."""
    model, paths = converter
    n = round(STOP / h)
    with FMUInstance(paths[version]) as unit:
        t = 0.0
        for _ in range(n):
            unit.do_step(t, h)
            t += h
        found = unit.get(NAMES).tolist()
    x, events = native(model, h, n)
    assert found == pytest.approx([*x, events], rel=1e-9) and events >= 2 * STOP * 20e3 - 1


@needs_cc
@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("clock", ["", "-sums"])
def test_a_host_in_c_gets_the_same(converter: Any, version: str, clock: str, tmp_path: Path) -> None:
    model, paths = converter
    with zipfile.ZipFile(paths[version]) as archive:
        library = next(name for name in archive.namelist() if name.startswith("binaries/"))
        (tmp_path / "unit.so").write_bytes(archive.read(library))
    with FMUInstance(paths[version]) as unit:
        about = unit.interface
    host = tmp_path / "host"
    command = ["cc", "-std=c11", "-isystem", str(sources.HEADERS), str(HERE / "fmu_host.c"), "-o", str(host), "-ldl"]
    subprocess.run(command, check=True)
    h, n = 1e-6, 2000
    command = [str(host), str(tmp_path / "unit.so"), version + clock, about.token, repr(h), str(n), "-1", "0", "-"]
    done = subprocess.run(
        [*command, *(str(about.variables[m].reference) for m in NAMES)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    x, events = native(model, h, n, clock == "-sums")
    assert [float(line) for line in done.stdout.split()] == pytest.approx([*x, events], rel=1e-6)


@pytest.mark.parametrize("version", VERSIONS)
def test_fmpy_runs_hundreds_of_periods(converter: Any, version: str) -> None:
    _, paths = converter
    rows = fmpy.simulate_fmu(str(paths[version]), stop_time=0.03, output_interval=1e-4, output=NAMES)
    count = np.diff(rows["events.count"])
    assert len(rows) == 301 and (count[100:] == 4).all()  # two of each kind in two periods
    assert [rows[-1][n] for n in NAMES[:2]] == pytest.approx(exact(0.03, lambda _: 0.4), rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("version", VERSIONS)
def test_a_step_that_no_mode_can_take_is_refused_by_name(version: str, tmp_path: Path) -> None:
    """12 V at every terminal: the unit says why; the same step once more, with which importers loop for ever, is an error."""
    (path,) = export(build_model(six_pulse_bridge(), Collocated(1)), tmp_path, (version,), step=1e-4)
    told: list[str] = []
    with FMUInstance(path) as unit:
        given = [n for n, v in unit.interface.variables.items() if v.causality == "input"]
        unit.set_input(np.full(len(given), 12.0))
        for again in (False, True):
            with pytest.raises(UnitFailure, match="no mode of the switches obeys their laws") as failure:
                unit.do_step(0.0, 1e-4)
            told.append(str(failure.value))
            assert ("was discarded before" in told[-1]) == again
        with pytest.raises(UnitFailure) as failure:
            unit.do_step(0.0, 1e-5)
        assert "was discarded before" not in str(failure.value), "a shorter one is another"
    if version == "2.0":
        with pytest.raises(FMICallException, match="status 3"):
            fmpy.simulate_fmu(
                str(path), stop_time=1e-2, output_interval=1e-4, start_values=dict.fromkeys(given, 12.0), timeout=60
            )
