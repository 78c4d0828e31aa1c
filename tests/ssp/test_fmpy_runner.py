"""What the runner of FMPy makes of packages, as docs/use/use-ssp.md says: no transformations, values one step late."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fmpy.ssp.simulation import simulate_ssp

from phfmu.cli import main
from tests.fmu import foreign
from tests.ssp.documents import connection, linear, ran, system
from tests.ssp.packages import document, pack

#: y = 2 u + t
PASSING = (
    '<ScalarVariable name="u" valueReference="1" causality="input"><Real start="0"/></ScalarVariable>'
    '<ScalarVariable name="y" valueReference="2" causality="output"><Real/></ScalarVariable>'
)
STEP, STOP = 0.125, 0.5


@pytest.fixture
def chain(tmp_path: Path) -> Path:
    """b.u is the negative of a.y."""
    unit = foreign.unit(tmp_path / "unit.fmu", "2.0", PASSING).read_bytes()
    ends = "".join(
        f'<ssd:Connector name="{n}" kind="{k}"><ssc:Real/></ssd:Connector>'
        for n, k in (("u", "input"), ("y", "output"))
    )
    elements = [
        f'<ssd:Component name="{n}" source="resources/{n}.fmu"><ssd:Connectors>{ends}</ssd:Connectors></ssd:Component>'
        for n in "abc"
    ]
    joined = connection("a:y", "b:u", linear(-1.0)), connection("b:y", "c:u"), connection("c:y", "a:u", linear(0.0))
    text = document(system(*elements, connections=joined), after=f'<ssd:DefaultExperiment stopTime="{STOP}"/>')
    return pack(tmp_path / "chain.ssp", {f"resources/{n}.fmu": unit for n in "abc"} | {"SystemStructure.ssd": text})


def test_transformations_are_ignored_and_values_late(chain: Path) -> None:
    rows = simulate_ssp(str(chain), stop_time=STOP, step_size=STEP)
    a, b, t = (rows[n] for n in ("a.y", "b.y", "time"))
    np.testing.assert_allclose(
        b[1:], 2.0 * a[:-1] + t[1:] + STEP, rtol=1e-14
    )  # no -1; the step before; its start as time
    assert b[0] == STEP  # inputs are 0 in the first step
    ours = ran(chain, "--step", str(STEP))
    np.testing.assert_allclose(ours["b.y"], -2.0 * ours["a.y"] + ours["time"], rtol=1e-14)


def test_ports_gain_energy_and_free_inputs_end_the_runner(tmp_path: Path) -> None:
    """The -1 of forces is lost, so that what should pull pushes; an input that nothing feeds is no case of the runner."""
    assert main(["export", "oscillator", "--ssp", "-o", str(tmp_path)]) == 0
    rows = simulate_ssp(str(tmp_path / "oscillator.ssp"), stop_time=0.5, step_size=1e-3)
    stored = sum(rows[f"{m}.energy.stored"] for m in ("mass1", "mass2", "spring12"))
    ours = ran(tmp_path / "oscillator.ssp", "--coupling", "jacobi", "--stop", "0.5", "--step", "1e-3")
    kept = sum(ours[f"{m}.energy.stored"] for m in ("mass1", "mass2", "spring12"))
    assert stored[-1] > 1e6 * kept[0] and kept[-1] < 1.5 * kept[0]
    assert main(["export", "drive", "--ssp", "-o", str(tmp_path)]) == 0
    with pytest.raises(UnboundLocalError):
        simulate_ssp(str(tmp_path / "drive.ssp"), stop_time=1e-3, step_size=1e-4)
