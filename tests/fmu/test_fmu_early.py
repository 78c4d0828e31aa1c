"""A communication step of several internal ones of which one cannot be solved: what is kept and what is told."""

from __future__ import annotations

import subprocess
import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu

import phfmu as ph
from phfmu import (
    PHDAE,
    Collocated,
    Coupled,
    EngineMember,
    FMUInstance,
    FMUMember,
    NativeInstance,
    Network,
    Options,
    Port,
    StepFailure,
    block,
    build_model,
    energy,
    export,
    run,
)
from phfmu.cli import main
from phfmu.fmu.export import sources
from phfmu.fmu.importer.refusal import UnitFailure
from tests.fmu.test_fmu_ledger import gap, needs_cc

HERE = Path(__file__).parent
START, POWER, INNER, STEP = 0.507, 1.0, 0.02, 0.2
#: the last internal step that ends before the voltage collapses
LAST = 0.5
VERSIONS = ("2.0", "3.0")


def drained() -> PHDAE:
    """A capacitor that feeds a load of constant power: H(t) = START - POWER t, nothing solves it after START / POWER."""
    q = ph.state("q", unit="C", start=np.sqrt(2.0 * START))
    return PHDAE(
        "drained",
        states=(q,),
        energies=(energy(0.5 * q.sx**2),),
        dissipation=(block((q,), POWER / q.sx**2),),
        ports=(Port("terminal", ph.ELECTRICAL, "flow", {q: 1.0}),),
    )


def coil() -> PHDAE:
    flux = ph.state("flux", unit="Wb")
    return PHDAE(
        "coil", states=(flux,), energies=(energy(0.5 / 50.0 * flux.sx**2),),
        ports=(Port("terminal", ph.ELECTRICAL, "effort", {flux: 1.0}),),
    )  # fmt: skip


@pytest.fixture(scope="module")
def units(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    declaration = drained()
    folder = tmp_path_factory.mktemp("units")
    paths = export(build_model(declaration, Collocated(1)), folder, step=INNER, stop=1.0)
    return dict(zip(VERSIONS, paths, strict=True))


def before_the_collapse(unit: FMUInstance) -> None:
    for i in range(2):
        assert unit.do_step(i * STEP, STEP) == i * STEP + STEP


def stored(unit: FMUInstance) -> float:
    return float(unit.energies()[0])


def test_units_say_that_they_might_return_early_and_are_valid(units: dict[str, Path]) -> None:
    assert [validate_fmu(str(p)) for p in units.values()] == [[], []]
    text = zipfile.ZipFile(units["3.0"]).read("modelDescription.xml")
    assert b'mightReturnEarlyFromDoStep="true"' in text


def test_the_parts_that_were_solved_are_kept_as_a_step_of_their_own(units: dict[str, Path]) -> None:
    with FMUInstance(units["3.0"], early_return=True) as unit, FMUInstance(units["3.0"]) as plain:
        before_the_collapse(unit)
        assert unit.do_step(0.4, STEP) == pytest.approx(LAST, abs=1e-15) == unit.time
        before_the_collapse(plain)
        plain.do_step(0.4, STEP * 5 / 10)
        assert unit.serialize(unit.get_state()) == plain.serialize(plain.get_state()), "to the last bit"
        assert stored(unit) == pytest.approx(START - POWER * LAST, abs=1e-13)
        book = unit.ledger()
        assert book["dissipated"] == pytest.approx(POWER * (LAST - 0.4), abs=1e-13)
        assert book["pairs"] == pytest.approx(book["supplied"], abs=1e-16), "means are over the part"
        assert np.abs(unit.get(["energy.residual", "energy.gap"])).max() < 1e-15


def test_what_cannot_be_solved_from_there_is_discarded_until_the_input_changes(units: dict[str, Path]) -> None:
    with FMUInstance(units["3.0"], early_return=True) as unit:
        before_the_collapse(unit)
        reached = unit.do_step(0.4, STEP)
        before = unit.serialize(unit.get_state())
        with pytest.raises(StepFailure, match="fmi3DoStep answers 'discard'"):
            unit.do_step(reached, STEP)
        assert unit.serialize(unit.get_state()) == before, "a discarded step changes nothing"
        unit.set_input([50.0])
        assert unit.do_step(reached, 0.1) == pytest.approx(0.6)
        assert stored(unit) > START and abs(gap(unit)) <= 16 * np.spacing(stored(unit))


@pytest.mark.parametrize("version", VERSIONS)
def test_without_leave_the_whole_step_is_discarded_and_told(units: dict[str, Path], version: str) -> None:
    with FMUInstance(units[version], early_return=version == "2.0") as unit:  # in FMI 2.0 there is no early return
        before_the_collapse(unit)
        state, energies = unit.get_state(), stored(unit)
        with pytest.raises(StepFailure, match="answers 'discard'") as failure:
            unit.do_step(0.4, STEP)
        assert unit.time == pytest.approx(0.4) and stored(unit) == energies
        if version == "2.0":
            assert "last successful time 0.5 s" in str(failure.value)
        unit.set_state(state)
        unit.do_step(0.4, LAST - 0.4)  # what it could solve
        assert stored(unit) == pytest.approx(START - POWER * LAST, abs=1e-13)


def test_fmi2_tells_how_far_it_came_after_a_discarded_step_only(units: dict[str, Path]) -> None:
    with FMUInstance(units["2.0"]) as unit:
        last = lambda: unit._slave.fmu.getRealStatus(2)  # noqa: E731
        before_the_collapse(unit)
        state = unit.get_state()
        assert last() == pytest.approx(0.4)
        with pytest.raises(StepFailure):
            unit.do_step(0.4, STEP)
        assert last() == pytest.approx(LAST, abs=1e-15)
        unit.set_state(state)
        assert last() == pytest.approx(0.4)
        with pytest.raises(StepFailure):
            unit.do_step(0.4, 10.0)
        assert last() == pytest.approx(LAST, abs=1e-13)


def test_inputs_at_nodes_belong_to_the_whole_step(tmp_path: Path) -> None:
    declaration = drained()
    model = build_model(declaration, Collocated(2))
    (path,) = export(model, tmp_path, ("3.0",), step=INNER, node_inputs=True)
    with FMUInstance(path, early_return=True) as unit:
        before_the_collapse(unit)
        state = unit.get_state()
        unit.set_node_inputs([[0.0], [1e-9]])
        with pytest.raises(StepFailure, match="answers 'discard'"):
            unit.do_step(0.4, STEP)
        unit.set_state(state)
        assert unit.do_step(0.4, STEP) == pytest.approx(LAST), "held inputs do not"


def test_fmpy_goes_on_from_the_communication_point_with_new_inputs(units: dict[str, Path]) -> None:
    """The current comes at 0.45 s; without a communication point at 0.5 s it is seen too late."""
    rows = [(0.0, 0.0), (0.45, 0.0), (0.46, 50.0), (1.0, 50.0)]
    signals = np.array(rows, [("time", float), ("terminal.i", float)])

    def simulated(allowed: bool):
        return fmpy.simulate_fmu(
            str(units["3.0"]), stop_time=0.8, output_interval=STEP, input=signals, early_return_allowed=allowed,
            output=["energy.stored", "energy.gap", "energy.residual"],
        )  # fmt: skip

    with pytest.raises(FMICallException):
        simulated(False)
    result = simulated(True)
    assert result["time"] == pytest.approx([0.0, 0.2, 0.4, LAST, 0.6, 0.8])
    assert result["energy.stored"][:4] == pytest.approx(START - POWER * result["time"][:4], abs=1e-13)
    assert result["energy.stored"][-1] > START
    assert np.abs(result["energy.gap"]).max() < 1e-12 and np.abs(result["energy.residual"]).max() < 1e-12


@pytest.mark.parametrize("early", [False, True])
def test_a_network_takes_all_members_back_and_says_why(units: dict[str, Path], early: bool) -> None:
    model = build_model(coil())
    unit = FMUInstance(units["3.0"], early_return=early)
    net = Network("drained_with_coil")
    net.add("cap", PHDAE("cap", ports=unit.interface.declared_ports()))
    net.add("coil", coil())
    net.connect("cap.terminal", "coil.terminal")
    instance = NativeInstance(model)
    coupled = Coupled(net, [FMUMember("cap", unit), EngineMember("coil", model, instance)])
    with pytest.raises(StepFailure) as failure:
        run(coupled, Options(stop=1.0, step=STEP))
    assert "part of a step" in str(failure.value) if early else "discard" in str(failure.value)
    assert isinstance(failure.value, UnitFailure) == early
    assert unit.time == instance.time > 0.0
    moved = stored(unit) + instance.signal("H")[0] - START
    assert moved == pytest.approx(-POWER * unit.time, abs=1e-12), "nothing of the accepted steps is lost"
    unit.close()


@pytest.mark.parametrize("version", VERSIONS)
def test_a_run_ends_with_what_was_solved(units: dict[str, Path], version: str, capsys: pytest.CaptureFixture) -> None:
    assert main(["run", str(units[version]), "--stop", "1", "--step", str(STEP)]) == 3
    assert "discard" in capsys.readouterr().err


@needs_cc
@pytest.mark.parametrize("version", ["2.0", "3.0-early"])
def test_a_host_without_interpreter_sees_the_same(units: dict[str, Path], tmp_path: Path, version: str) -> None:
    path = units[version[:3]]
    with zipfile.ZipFile(path) as archive:
        library = next(n for n in archive.namelist() if n.startswith("binaries/"))
        (tmp_path / "unit.so").write_bytes(archive.read(library))
    host = tmp_path / "host"
    command = ["cc", "-std=c11", "-isystem", str(sources.HEADERS), str(HERE / "fmu_host.c"), "-o", str(host), "-ldl"]
    subprocess.run(command, check=True)
    with FMUInstance(path) as unit:
        about = unit.interface
        reference = str(about.variables["energy.stored"].reference)
    command = [str(host), str(tmp_path / "unit.so"), version, about.token, str(STEP), "5", "-1", "0", "-", reference]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    last, energies = [float(line) for line in done.stdout.split()]
    assert last == pytest.approx(LAST, abs=1e-15)
    assert energies == pytest.approx(START - POWER * (0.4 if version == "2.0" else LAST), abs=1e-13)
