"""Packages in other masters: ecos (FMI 2.0, 3.0) and libcosim (FMI 2.0) step them explicitly and get an explicit run's numbers.

They come with `pip install phfmu[hosts]`; they run in a process of their own, because they are C++ libraries.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from phfmu.cli import main
from phfmu.ssp.loading import load
from tests.fmu.other_hosts import READ, run_elsewhere
from tests.ssp.packages import pack, unpacked

pytestmark = pytest.mark.slow
H, N = 1e-3, 200
NAMES = ("mass1.q", "mass2.q", "spring12.e", "mass1.flange.velocity", "spring12.a.force", "mass2.energy.residual")

ECOS = """
path, h, n, names, _ = task
simulation = EcosSimulation(ssp_path=path, step_size=h)
simulation.init(parameter_set="parameters")
simulation.step(n)
print("RESULT", json.dumps([simulation.get_real(name.replace(".", "::", 1)) for name in names]))
"""

#: takes an unpacked package
COSIM = """
import os, tempfile, zipfile
path, h, n, names, refs = task
with tempfile.TemporaryDirectory() as folder:
    zipfile.ZipFile(path).extractall(folder)
    execution = CosimExecution.from_ssp_file(ssp_path=folder, step_size=round(h * 1e9))
    observer = CosimObserver.create_last_value()
    execution.add_observer(observer=observer)
    execution.step(step_count=n)
    found = []
    for name in names:
        slave = execution.slave_index_from_instance_name(name.partition(".")[0])
        found += observer.last_real_values(slave_index=slave, variable_references=[refs[name]])
    print("RESULT", json.dumps(found), flush=True)
    os._exit(0)  # its units hold files of the folder
"""

SCRIPTS = {"ecos": ECOS, "libcosim": COSIM}


@pytest.mark.parametrize(("host", "fmi"), READ)
def test_other_masters_get_the_numbers_of_an_explicit_run(tmp_path: Path, host: str, fmi: str) -> None:
    """Parameters of the package count: the spring has another stiffness inside its unit."""
    assert main(["export", "oscillator", "--ssp", "--fmi", fmi[0], "--step", str(H), "-o", str(tmp_path)]) == 0
    files = unpacked(tmp_path / "oscillator.ssp")
    stiffer = re.sub(rb'value="157[.0-9]*"', b'value="170.0"', files["resources/spring12.ssv"])
    assert stiffer != files["resources/spring12.ssv"]
    path, table = pack(tmp_path / "stiffer.ssp", files | {"resources/spring12.ssv": stiffer}), tmp_path / "rows.csv"
    units = load(path).system.units
    refs = {n: units[n.partition(".")[0]].interface.variables[n.partition(".")[2]].reference for n in NAMES}
    found = run_elsewhere(host, SCRIPTS[host], str(path), H, N, NAMES, refs)
    line = [
        "run",
        str(path),
        "--coupling",
        "jacobi",
        "--step",
        str(H),
        "--stop",
        str(N * H),
        "-o",
        str(table),
        "--quiet",
    ]
    assert main(line) == 0
    rows = np.genfromtxt(table, delimiter=",", names=True, deletechars="")
    expected = [rows[name][-1] for name in NAMES]
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)
    assert abs(found[0]) < 0.9 and abs(found[1]) > 1e-3
