"""A unit that asks to end the simulation ends a run as its stop does, with a row up to where it asks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from phfmu import FMUInstance
from phfmu.audit.analysis import summarise
from phfmu.fmu.importer.refusal import UnitFailure
from phfmu.fmu.importer.slave import Slave
from phfmu.outcome.status import EndRequested
from tests.fmu import foreign
from tests.network.unit_members import pump_folder, table
from tests.wide import wide

VERSIONS = ["2.0", "3.0"]
SCENE = """
from phfmu import Network, Scene
from phfmu.components.mechanical.translational import spring


def joined():
    net = Network("joined")
    net.add("pump", "pump.fmu")
    net.add("spring", spring(40.0, elongation=0.3))
    net.junction("a", ["pump.flange", "spring.a"])
    return Scene("joined", net, stop=1.0, step=0.02)
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return pump_folder(tmp_path, "joined.py", SCENE)


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("isolate", wide([False, True], False))
def test_alone(folder: Path, version: str, isolate: bool, capsys: pytest.CaptureFixture[str]) -> None:
    """Before a step (2.0), at its end (3.0), or within it: q = 0.3 cos(w t) in all rows."""
    foreign.mass(folder / "pump.fmu", version)
    for mode, end in ((foreign.TERMINATE, 0.3 if version == "2.0" else 0.4), (foreign.END_WITHIN, 0.33)):
        options = [*(f"--set={n}" for n in ("k=40", "q=0.3", f"mode={mode}")), *["--isolate"] * isolate]
        rows = table(folder, "pump.fmu", "--step", "0.1", "--audit", str(folder / "a.parquet"), *options)
        said = capsys.readouterr()
        assert f"asks to end the simulation at t = {end:g} s" in said.out and f"the run ends at {end:g} s" in said.out
        assert rows["time"] == pytest.approx([*np.arange(0.0, end - 1e-9, 0.1), end])
        assert np.abs(rows["q"] - 0.3 * np.cos(np.sqrt(40.0) * rows["time"])).max() < 1e-12
        assert not summarise(folder / "a.parquet").events


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("coupling", wide(["newton", "anderson", "gauss-seidel", "jacobi"], "newton", "gauss-seidel"))
def test_coupled(folder: Path, version: str, coupling: str) -> None:
    """All members end there, as in a run with that stop."""
    foreign.mass(folder / "pump.fmu", version)
    at = 0.26 if version == "2.0" else 0.28
    for mode, end in ((foreign.TERMINATE, at), (foreign.END_WITHIN, 0.33)):
        rows = table(folder, "joined.py", "--coupling", coupling, "--set", f"pump.mode={mode}")
        usual = table(folder, "joined.py", "--coupling", coupling, "--stop", f"{end}")
        assert rows["time"][-1] == pytest.approx(end) and len(rows) == len(usual)
        for name in ("pump.v", "pump.q", "spring.e"):
            assert np.abs(rows[name] - usual[name]).max() < 1e-12, name


@pytest.mark.parametrize("version", VERSIONS)
def test_where_members_cannot_take_a_step_back(folder: Path, version: str) -> None:
    """The run ends with the last step that all have taken."""
    foreign.mass(folder / "pump.fmu", version, saves=False)
    rows = table(folder, "joined.py", "--coupling", "gauss-seidel", "--set", f"pump.mode={foreign.END_WITHIN}")
    assert rows["time"][-1] == pytest.approx(0.32)


@pytest.mark.parametrize("version", VERSIONS)
def test_at_the_start(folder: Path, version: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The trial of a unit, and that of the first step, are none of the run."""
    foreign.mass(folder / "pump.fmu", version)
    monkeypatch.setattr(Slave, "do_step", lambda self, t, h, no_set_prior: (t, True))
    assert len(np.atleast_1d(table(folder, "joined.py", "--coupling", "newton"))) == 1
    assert len(np.atleast_1d(table(folder, "pump.fmu"))) == 1


@pytest.mark.parametrize("version", VERSIONS)
def test_an_instance_tells_it(folder: Path, version: str) -> None:
    path = foreign.mass(folder / "pump.fmu", version)
    with FMUInstance(path, starts={"mode": foreign.END_WITHIN, "v": 1.0}) as unit:
        unit.do_step(0.0, 0.3)
        assert not unit.steps.ended
        with pytest.raises(EndRequested, match="asks to end the simulation at t = 0.33 s") as end:
            unit.do_step(0.3, 0.1)
        assert (end.value.time, end.value.reached, unit.time, unit.steps.ended) == (0.3, 0.33, 0.33, True)
        assert unit.get(["q"])[0] == pytest.approx(0.33)
    if version == "3.0":
        with FMUInstance(path, starts={"mode": foreign.TERMINATE}) as unit:
            unit.do_step(0.0, 0.3)
            assert unit.do_step(0.3, 0.1) == 0.4 and unit.steps.ended


def test_a_step_that_ends_where_it_began_twice_is_a_failure(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A unit may return early, and be asked again under other inputs; not again and again at one time."""
    path = foreign.mass(folder / "pump.fmu", "3.0")
    with FMUInstance(path, early_return=True) as unit:
        unit.do_step(0.0, 0.1)
        monkeypatch.setattr(Slave, "do_step", lambda self, t, h, no_set_prior: (t, False))
        assert unit.do_step(0.1, 0.1) == 0.1
        with pytest.raises(UnitFailure, match="foreign at t = 0.1 s, h = 0.05 s: .*twice at one time") as failure:
            unit.do_step(0.1, 0.05)
        assert failure.value.answer == "no progress"
