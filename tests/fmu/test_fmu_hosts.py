"""Exported units in importers of other projects: ecos (FMI 2.0 and 3.0) and libcosim (FMI 2.0), beside FMPy's numbers.

The importers come with `pip install phfmu[hosts]`; they run in a process of their own, because they are C++ libraries.
"""

from __future__ import annotations

from pathlib import Path

import fmpy
import numpy as np
import pytest

from phfmu import build_model, export
from phfmu.components.library import build
from phfmu.fmu.importer.reader import FMUInstance
from tests.fmu.other_hosts import READ, run_elsewhere

pytestmark = pytest.mark.slow

#: unit -> step and values before the start: parameters, inputs and states
UNITS = {
    "mass": (1e-2, {"flange.force": 2.0, "m": 3.0}),
    "dc_motor": (1e-3, {"terminal.v": 12.0, "shaft.torque": -0.01}),
    "rl_line": (1e-3, {"a.v[1]": 5.0, "b.v[2]": -3.0, "R": 0.4}),
    "four_particle": (1e-2, {}),
}
N = 50

ECOS = """
path, h, n, starts, names, _ = task
structure = EcosSimulationStructure()
structure.add_model("unit", path)
structure.add_parameter_set("start", {f"unit::{k}": v for k, v in starts.items()})
simulation = EcosSimulation(structure=structure, step_size=h)
simulation.init(parameter_set="start")
simulation.step(n)
print("RESULT", json.dumps([simulation.get_real(f"unit::{name}") for name in names]))
"""

COSIM = """
path, h, n, starts, names, refs = task
execution = CosimExecution.from_step_size(step_size=round(h * 1e9))
slave = execution.add_local_slave(local_slave=CosimLocalSlave(fmu_path=path, instance_name="unit"))
observer = CosimObserver.create_last_value()
execution.add_observer(observer=observer)
for name, value in starts.items():
    execution.real_initial_value(slave_index=slave, variable_reference=refs[name], value=value)
execution.step(step_count=n)
print("RESULT", json.dumps(observer.last_real_values(slave_index=slave, variable_references=[refs[name] for name in names])))
"""

SCRIPTS = {"ecos": ECOS, "libcosim": COSIM}


@pytest.fixture(scope="module")
def units(tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, str], Path]:
    made = {}
    for name, (step, _) in UNITS.items():
        declaration = build(name)
        paths = export(build_model(declaration), tmp_path_factory.mktemp(name), step=step)
        made |= {(name, v): p for v, p in zip(("2.0", "3.0"), paths, strict=True)}
    return made


@pytest.mark.parametrize("name", UNITS)
@pytest.mark.parametrize(("host", "version"), READ)
def test_other_importers_get_the_numbers_of_fmpy(
    units: dict[tuple[str, str], Path], name: str, host: str, version: str
) -> None:
    path, (h, starts) = units[name, version], UNITS[name]
    with FMUInstance(path) as unit:
        about = unit.interface.variables
        names = [n for n, v in about.items() if v.causality in ("output", "local")]
    refs = {n: about[n].reference for n in (*names, *starts)}
    found = run_elsewhere(host, SCRIPTS[host], str(path), h, N, starts, names, refs)
    rows = fmpy.simulate_fmu(
        str(path), stop_time=N * h, step_size=h, output_interval=h, start_values=starts, output=names
    )
    expected = np.array([rows[-1][n] for n in names])
    assert rows["time"][-1] == pytest.approx(N * h)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())
