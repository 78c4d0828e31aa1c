"""Steps that are only the rounding of a master's clock, and clocks that are only rounding apart."""

from __future__ import annotations

import shutil
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest

from phfmu import Scene, build_model, export
from phfmu.components.electrical.machines.dc_motor import dc_motor
from phfmu.components.library import LIBRARY, RUNS, SWITCHED, build
from phfmu.components.mechanical.four_particle import four_particle
from phfmu.components.mechanical.heavy_top import heavy_top
from phfmu.fmu.export import sources
from phfmu.fmu.export.description import ExportedUnit
from phfmu.fmu.export.value_groups import telling_constant
from phfmu.fmu.importer.reader import FMUInstance
from tests.engines import ENGINES
from tests.wide import turning

HERE = Path(__file__).parent
SLIVERS = [10.0**-e for e in range(19, 11, -1)]
KEPT = ("x", "a", "y_step", "energy", "supplied", "dissipated", "residual")
OPEN = ("fault",)  # takes no current before an event closes it
needs_cc = pytest.mark.skipif(not shutil.which("cc"), reason="needs a C compiler for the host program")


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("declaration", [four_particle, heavy_top, dc_motor])
def test_a_sliver_moves_time_and_nothing_else(engine, declaration) -> None:
    instance = engine(build_model(declaration()))
    h = 1e-3
    instance.set_input(np.ones(instance.model.step.nu))
    instance.run(0.0, h, 20)
    before, ledger = instance.signals(), {n: 0.0 * v for n, v in instance.ledger().items()}
    sensitivity = instance.sensitivity()
    t = 20 * h
    for sliver in SLIVERS:
        instance.do_step(t, sliver)
        t += sliver
        now = instance.signals()
        assert instance.time == t
        for block in KEPT:
            assert now[block].tobytes() == before[block].tobytes(), block
        np.testing.assert_allclose(now["a_end"], before["a_end"], rtol=1e-12, atol=1e-12)
        for name, row in instance.ledger().items():
            assert (row == ledger[name]).all()
    assert instance.counts["steps"] == 20 + len(SLIVERS)
    np.testing.assert_allclose(instance.sensitivity(), sensitivity, rtol=1e-12)
    instance.do_step(t, h)
    assert (instance.x != before["x"]).any()


@pytest.mark.parametrize("engine", ENGINES)
def test_values_now_follow_the_inputs_over_a_sliver(engine) -> None:
    """As over a step of length zero; the means stay those of the last step, with its inputs."""
    model = build_model(build("resistor"))
    skipped, stayed = engine(model), engine(model)
    for instance in (skipped, stayed):
        instance.set_input(np.ones(model.step.nu))
        instance.do_step(0.0, 1e-3)
        instance.set_input(2.0 * np.ones(model.step.nu))
    mean = skipped.output()
    skipped.do_step(1e-3, 1e-15)
    stayed.do_step(1e-3, 0.0)
    assert skipped.signal("y_end").tolist() == stayed.signal("y_end").tolist() != mean.tolist()
    assert skipped.output().tolist() == mean.tolist()


@pytest.mark.parametrize("engine", ENGINES)
def test_a_step_of_two_roundings_of_a_late_clock_is_a_sliver(engine) -> None:
    """Also before any other step; three of them are a step."""
    model = build_model(four_particle())
    instance, t = engine(model), 2.0**20
    unit = np.finfo(float).eps * t
    instance.set_x(t, model.x0)
    instance.initialise()
    instance.do_step(t, 2 * unit)
    assert instance.x.tobytes() == model.x0.tobytes() and instance.time == t + 2 * unit
    instance.do_step(t + 2 * unit, 3 * unit)
    assert (instance.x != model.x0).any()


@pytest.fixture(scope="module")
def host(tmp_path_factory: pytest.TempPathFactory) -> Path:
    program = tmp_path_factory.mktemp("host") / "host"
    command = ["cc", "-std=c11", "-isystem", str(sources.HEADERS), str(HERE / "fmu_host.c"), "-o", str(program), "-ldl"]
    subprocess.run(command, check=True)
    return program


@needs_cc
@pytest.mark.parametrize(
    ("name", "version"),
    turning(
        (n for n in LIBRARY if n not in SWITCHED), ["2.0", "3.0"], ("four_particle", "2.0"), ("four_particle", "3.0")
    ),
)
def test_units_take_slivers(host: Path, tmp_path: Path, name: str, version: str) -> None:
    found = build(name)
    declaration = found.declaration() if isinstance(found, Scene) else found
    usual = min(0.01, RUNS.get(name, (1.0, 0.01))[1])
    h = found.step if isinstance(found, Scene) else usual if "mechanical" in LIBRARY[name][1] else 1e-4
    slivers = [s for s in SLIVERS if s <= 1e-9 * h]
    model = build_model(declaration)
    (path,) = export(model, tmp_path, (version,), step=h)
    with zipfile.ZipFile(path) as archive:
        library = next(n for n in archive.namelist() if n.startswith("binaries/"))
        (tmp_path / "unit.so").write_bytes(archive.read(library))
    with FMUInstance(path) as unit:
        about, names = unit.interface, unit.names
    references = [str(about.variables[n].reference) for n in names]
    more = ",".join(f"{s:.17g}" for s in slivers)
    drive = next((v.reference for v in about.variables.values() if v.causality == "input"), -1)
    command = [host, tmp_path / "unit.so", version, about.token, repr(h), "30", drive, "0.9", more, *references]
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    before, *after = np.array([float(v) for v in done.stdout.split()]).reshape(1 + len(slivers), len(names))
    block = {v.name: v.block for v in ExportedUnit(telling_constant(model), h).variables}
    rows = np.array([block[n].startswith("FMU_ROW") for n in names])
    kept = np.array([f"{block[n]}".removeprefix("PH_").lower() in KEPT for n in names])
    now = ~rows & ~kept & np.array([n != "time" for n in names])
    empty = name in OPEN or not (declaration.states or declaration.ports)
    assert kept.any() and (before[kept] != 0.0).any() != empty, "nothing to keep"
    for row in after:
        assert row[kept].tobytes() == before[kept].tobytes()
        assert (row[rows] == 0.0).all()
        np.testing.assert_allclose(row[now], before[now], rtol=1e-9, atol=1e-9 * np.abs(before[now]).max(initial=1e-3))


# -- clocks ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=["2.0", "3.0"])
def motor(request, tmp_path_factory: pytest.TempPathFactory) -> Path:
    declaration = dc_motor()
    (path,) = export(build_model(declaration), tmp_path_factory.mktemp("motor"), (request.param,), step=0.1)
    return path


def test_a_skipped_step_is_refused_however_late_it_is(motor: Path) -> None:
    h = 1e-4
    with FMUInstance(motor, start=1e6) as unit:
        for k in range(10):
            unit.do_step(1e6 + k * h, h)
        for skipped in (1, 9):
            with pytest.raises(RuntimeError, match="rounding explains"):
                unit.do_step(1e6 + (10 + skipped) * h, h)
        unit.do_step(1e6 + 10 * h, h)


@pytest.mark.parametrize("start", [0.0, 1e6, -1e6])
def test_clocks_of_honest_masters_are_accepted(motor: Path, start: float) -> None:
    """t += h; t_0 + k h; a base clock that ticks a hundred times a step; a change from the first to the second."""
    h, n = 0.1, 20_000
    with FMUInstance(motor, start=start) as unit:
        t = start
        for _ in range(n):
            unit.do_step(t, h)
            t += h
        assert t != start + n * h, "rounding has added up"
        unit.do_step(start + n * h, h)
    with FMUInstance(motor, start=start) as unit:
        for k in range(100):
            unit.do_step(start + k * h, h)
    with FMUInstance(motor, start=start) as unit:
        t = start
        for _ in range(50):
            unit.do_step(t, h)
            for _ in range(100):
                t += h / 100
