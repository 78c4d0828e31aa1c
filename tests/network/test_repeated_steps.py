"""What units of other tools make of noSetFMUStatePriorToCurrentPoint, and the tolerance of the experiment."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phfmu import FMUInstance
from phfmu.cli import main
from phfmu.fmu.importer.access import Access
from phfmu.fmu.importer.unit_file import unit_file
from phfmu.network.couplings.compiled.called_share import CalledShare
from phfmu.network.members.rollback import REPEAT_MODES
from phfmu.network.members.unit_member import tried
from tests.fmu import foreign
from tests.network.unit_members import pump_folder, table, unit_members
from tests.wide import wide

VERSIONS = ["2.0", "3.0"]
#: of `keeps`: a step told False begins at the last point told True;  leaves the unit where it was;  after one told True nothing
#: is restored;  the last two at once
LAST_POINT, STAYS, FINAL, STAYS_AND_FINAL = KEEPS = range(1, 5)
SCENE = """
from phfmu import Network, Scene
from phfmu.components.mechanical.translational import mass, spring


def mixed():
    net = Network("mixed")
    net.add("pump", "pump.fmu")
    net.add("cart", mass(2.0, q=0.3))
    net.add("spring", spring(40.0, elongation=0.3))
    net.junction("a", ["pump.flange", "spring.a"])
    net.junction("b", ["cart.flange", "spring.b"])
    return Scene("mixed", net, stop=0.4, step=0.01)


def outputs():
    net = Network("outputs")
    net.add("pump", "pump.fmu")
    net.add("spring", spring(40.0, elongation=0.3))
    net.junction("a", ["pump.flange", "spring.a"])
    return Scene("outputs", net, stop=0.4, step=0.01)
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return pump_folder(tmp_path, "scene.py", SCENE)


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("keeps", KEEPS)
@pytest.mark.parametrize("isolate", wide([False, True], False))
def test_a_unit_alone_is_told_that_nothing_is_restored(folder: Path, version: str, keeps: int, isolate: bool) -> None:
    """A mass on a spring, free: q = 0.3 cos(w t), which a unit that begins at an old point misses."""
    foreign.mass(folder / "pump.fmu", version)
    options = [*(f"--set={n}" for n in ("k=40", "q=0.3", f"keeps={keeps}")), "--step", "0.05", *["--isolate"] * isolate]
    rows = table(folder, "pump.fmu", *options)
    assert len(rows) == 21 and np.abs(rows["q"] - 0.3 * np.cos(np.sqrt(40.0) * rows["time"])).max() < 1e-12


@pytest.mark.parametrize("version", wide(VERSIONS, "3.0"))
@pytest.mark.parametrize("coupling", ["newton", "anderson"])
@pytest.mark.parametrize("keeps", KEEPS)
def test_couplings_that_repeat_steps_find_the_way_to_do_so(
    folder: Path, version: str, coupling: str, keeps: int, capsys: pytest.CaptureFixture[str]
) -> None:
    foreign.mass(folder / "pump.fmu", version)
    rows = table(folder, "scene.py:mixed", "--coupling", coupling, "--set", f"pump.keeps={keeps}")
    said = capsys.readouterr().out
    assert "restore" not in said and "stepped last" not in said
    usual = table(folder, "scene.py:mixed", "--coupling", coupling)
    for name in usual.dtype.names or ():
        assert np.array_equal(rows[name], usual[name]), name


@pytest.mark.parametrize("version", wide(VERSIONS, "2.0"))
@pytest.mark.parametrize("coupling", ["gauss-seidel", "jacobi"])
@pytest.mark.parametrize("keeps", KEEPS)
def test_couplings_that_step_once_tell_that_nothing_is_restored(
    folder: Path, version: str, coupling: str, keeps: int
) -> None:
    foreign.mass(folder / "pump.fmu", version)
    rows = table(folder, "scene.py:outputs", "--coupling", coupling, "--set", f"pump.keeps={keeps}")
    usual = table(folder, "scene.py:outputs", "--coupling", coupling)
    assert np.abs(usual["pump.v"]).max() > 0.5
    for name in usual.dtype.names or ():
        assert np.array_equal(rows[name], usual[name]), name


@pytest.mark.parametrize("keeps", KEEPS)
def test_a_step_that_is_taken_in_halves(folder: Path, keeps: int) -> None:
    """Where the iteration of a whole step is given up, its halves begin at their own points."""
    foreign.mass(folder / "pump.fmu", "3.0")
    options = "--unconverged", "halve", "--stop", "0.4", "--step", "0.1", "--coupling", "anderson"
    rows = table(folder, "scene.py:mixed", *options, "--set", f"pump.keeps={keeps}")
    usual = table(folder, "scene.py:mixed", *options)
    assert np.array_equal(rows["pump.q"], usual["pump.q"]) and np.abs(usual["pump.v"]).max() > 0.5


def test_the_trial_tells_the_way(folder: Path) -> None:
    path, found = foreign.mass(folder / "pump.fmu", "2.0"), {}
    for keeps in (0, *KEEPS):
        units = {"pump": unit_file(path).with_starts({"keeps": keeps})}
        found[keeps] = tried(units, 0.01)["pump"]
    always, never, once_more = REPEAT_MODES
    assert {k: f.way for k, f in found.items()} == {
        0: always, LAST_POINT: always, STAYS: always, FINAL: never, STAYS_AND_FINAL: once_more,
    }  # fmt: skip
    assert all(f.works and not f.words for f in found.values())


@pytest.mark.parametrize("version", VERSIONS)
def test_an_instance_tells_what_is_held(folder: Path, version: str) -> None:
    """While a state of an older time is held a step is told False, by which this unit stays where it was."""
    path = foreign.mass(folder / "pump.fmu", version)
    with FMUInstance(path, starts={"keeps": STAYS, "v": 1.0}) as unit:
        unit.do_step(0.0, 0.1)
        here = unit.get_state()
        unit.do_step(0.1, 0.1)
        assert unit.get(["q"])[0] == pytest.approx(0.2), "a state of this very time is not prior to it"
        unit.set_state(here)
        unit.do_step(0.1, 0.1)
        assert unit.get(["q"])[0] == pytest.approx(0.2)
        unit.do_step(0.2, 0.1)
        unit.do_step(0.3, 0.1)
        assert unit.get(["q"])[0] == pytest.approx(0.3), "the state of 0.1 s may still be restored"
        del here
        unit.do_step(0.2, 0.1)
        unit.do_step(0.3, 0.1)
        assert unit.get(["q"])[0] == pytest.approx(0.4)


@pytest.mark.parametrize("coupling", wide(["newton", "anderson", "gauss-seidel", "jacobi"], "newton", "gauss-seidel"))
@pytest.mark.parametrize("version", VERSIONS)
def test_units_of_this_package_are_told_so_too(version: str, coupling: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where they are called back; those that the master steps itself are looked at below."""
    from phfmu.fmu.importer.slave import Slave

    monkeypatch.setattr("phfmu.network.couplings.compiled.master.own_share", lambda _: CalledShare)
    told, do_step = [], Slave.do_step

    def watched(self: Slave, t: float, h: float, no_set_prior: bool) -> float:
        told.append(no_set_prior)
        return do_step(self, t, h, no_set_prior)

    monkeypatch.setattr(Slave, "do_step", watched)
    run = [
        "run",
        "drive",
        "--engine",
        "fmu",
        "--fmi",
        version,
        "--coupling",
        coupling,
        "--stop",
        "1e-3",
        "--step",
        "1e-4",
    ]
    assert main([*run, "--order", "2"]) == 0
    assert told and all(told)


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("kind", ["fmi2", "fmi3"])
def test_the_compiled_master_tells_so(tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    import ctypes

    from phfmu.components.scenes.mechanical.oscillator import oscillator

    more = [ctypes.c_int] if kind == "fmi2" else [ctypes.c_bool, *[ctypes.c_void_p] * 4]
    plain = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, *more)
    functions, kept, told = Access.functions, [], list[bool]()

    def of(self: Access, names: Any) -> list[Any]:
        found = functions(self, names)
        at = list(names).index("DoStep")
        real: Any = ctypes.cast(found[at], plain)

        def do_step(instance: Any, t: float, h: float, *rest: Any) -> int:
            told.append(bool(rest[0]))
            return real(instance, t, h, *rest)

        kept.append(plain(do_step))
        found[at] = kept[-1]
        return found

    monkeypatch.setattr(Access, "functions", of)
    with unit_members(tmp_path) as made:
        stepper = made(oscillator().system, kind, 1, 1e-2)
        stepper.check_start()
        stepper.advance(0.0, 1e-2, 5)
        assert stepper.master.taken == 5
    assert len(told) >= 10 and all(told)


TOLERANCE = {
    "2.0": '<ScalarVariable name="tolerance" valueReference="30" causality="local"><Real/></ScalarVariable>',
    "3.0": '<Float64 name="tolerance" valueReference="30" causality="local"/>',
}


@pytest.mark.parametrize("version", VERSIONS)
def test_the_tolerance_of_the_experiment(
    folder: Path, version: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """-1 stands for one that is not defined; it is told in networks and to processes of their own, too."""
    monkeypatch.setitem(foreign.MASS, version, foreign.MASS[version] + TOLERANCE[version])
    foreign.mass(folder / "pump.fmu", version)
    for options, expected in (([], -1.0), (["--unit-tolerance", "1e-5"], 1e-5)):
        assert np.all(table(folder, "pump.fmu", *options)["tolerance"] == expected)
        assert np.all(table(folder, "pump.fmu", "--isolate", *options)["tolerance"] == expected)
        assert np.all(table(folder, "scene.py:mixed", *options)["pump.tolerance"] == expected)
    assert main(["run", f"{folder}/pump.fmu", "--unit-tolerance", "0"]) == 2
    assert "--unit-tolerance 0: expected a positive number" in capsys.readouterr().err
    assert main(["run", "drive", "--unit-tolerance", "1e-5"]) == 2
    assert "--unit-tolerance is for FMUs, and there is none in it" in capsys.readouterr().err


LANDED = """
from phfmu import Network, Scene, PHDAE, Port, TRANSLATIONAL, energy, skew, state
from phfmu.components.mechanical.translational import spring
from phfmu.declare.event import Guard, Jump, StateEvent


def landed():
    q, p = state("q", unit="m", start=0.1), state("p", unit="kg.m/s")
    hopper = PHDAE(
        "hopper", states=(q, p), energies=(energy(p**2 / 2),), structure=(skew(q, p, 1.0),),
        ports=(Port("rod", TRANSLATIONAL, "effort", {p: 1.0}),),
        state_events=(StateEvent(Guard("wall", q, -1, unit="m"), jump=Jump({p: 1.0}, 0.8)),),
    )
    net = Network("landed")
    net.add("pump", "pump.fmu")
    net.add("hopper", hopper)
    net.add("spring", spring(40.0, elongation=0.3))
    net.junction("a", ["pump.flange", "spring.a"])
    net.junction("b", ["hopper.rod", "spring.b"])
    return Scene("landed", net, stop=0.2, step=0.01)
"""


@pytest.mark.parametrize(("how", "tol"), [(f"pump.keeps={STAYS_AND_FINAL}", 0.0), ("stepped last", 1e-10)])
def test_steps_that_all_members_end_at_an_event(folder: Path, how: str, tol: float) -> None:
    """Members of order 4 land together; the unit, a free mass whose prediction is exact, takes the steps that were landed on."""
    (folder / "landed.py").write_text(LANDED)
    foreign.mass(folder / "pump.fmu", "3.0")
    usual = table(folder, "landed.py", "--order", "4")
    assert (np.diff(usual["hopper.p"]) > 0.5).sum() == 1 and np.abs(usual["pump.v"]).max() > 1.0
    if how == "stepped last":
        foreign.mass(folder / "pump.fmu", "3.0", saves=False)
    rows = table(folder, "landed.py", "--order", "4", *(["--set", how] if "=" in how else []))
    for name in ("pump.v", "pump.q", "hopper.q", "hopper.p", "spring.e"):
        assert np.abs(rows[name] - usual[name]).max() <= tol, name


def test_a_unit_that_refuses_to_save_is_stepped_once_all_the_same(folder: Path) -> None:
    """Its description claims that it saves, which couplings that step once do not need."""
    foreign.mass(folder / "pump.fmu", "2.0")
    usual = table(folder, "scene.py:outputs", "--coupling", "gauss-seidel")
    rows = table(folder, "scene.py:outputs", "--coupling", "gauss-seidel", "--set", "pump.forgets=3")
    assert np.array_equal(rows["pump.v"], usual["pump.v"])
