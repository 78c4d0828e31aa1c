"""Units of other tools inside the unit of a coupled network: the bits of `phfmu run`, saved states, refusals, other hosts."""

from __future__ import annotations

import shutil
import zipfile
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest

from phfmu.cli import main
from tests.fmu import foreign
from tests.fmu.other_hosts import READ, run_elsewhere
from tests.fmu.public_units import public
from tests.fmu.test_fmu_hosts import SCRIPTS
from tests.network.test_network_unit import Importer, importer
from tests.network.test_network_unit import driven as driven_over
from tests.network.test_quarter_truck import CHASSIS, FINE, WHEEL
from tests.network.test_quarter_truck import SCENE as TRUCK
from tests.network.unit_members import pump_folder
from tests.sanitized import output
from tests.wide import turning

SCENE = """
from phfmu import Event, Network, Scene
from phfmu.components.mechanical.translational import mass, spring

PORT = {"domain": "translational", "effort_unit": "N", "flow_unit": "m/s"}


def mixed():
    net = Network("mixed")
    net.add("pump", "pump.fmu")
    net.add("cart", mass(2.0, q=0.3))
    net.add("spring", spring(40.0, elongation=0.3))
    net.junction("a", ["pump.flange", "spring.a"])
    net.junction("b", ["cart.flange", "spring.b"])
    return Scene("mixed", net, stop=0.4, step=0.01)


def foreign():
    net = Network("foreign")
    net.add("pump", "pump.fmu")
    net.add("rod", "rod.fmu", ports={"end": {"effort": "s", "flow": "r", "sign": -1, **PORT}})
    net.connect("pump.flange", "rod.end", name="bond")
    return Scene("foreign", net, stop=0.4, step=0.01)


def driven():
    # the force on the mass is a free input; u is an input without power, y = 2 u + t
    net = Network("driven")
    net.add("pump", "pump.fmu")
    net.add("cart", mass(2.0, q=0.3))
    net.add("spring", spring(40.0, elongation=0.3))
    net.connect("cart.flange", "spring.a")
    events = [Event(0.1, "pump.F", -2.0), Event(0.2, "cart.m", 3.0), Event(0.2, "pump.u", 4.0)]
    return Scene("driven", net, stop=0.4, step=0.01, events=events)


def signals():
    # rod is a lag, x' = a x + b r, s = c x: between units, from and to own members, into a port and an input without power
    net = Network("signals")
    net.add("pump", "pump.fmu")
    net.add("rod", "rod.fmu")
    net.add("cart", mass(2.0, q=0.3))
    net.add("spring", spring(40.0, elongation=0.3))
    net.add("load", mass(0.5, k=20.0, d=0.5))
    net.junction("a", ["pump.flange", "spring.a"])
    net.junction("b", ["cart.flange", "spring.b"])
    net.signal("pump.q", "rod.r", factor=2.0, offset=0.1)
    net.signal("rod.s", "load.flange.force", factor=-1.0)
    net.signal("load.v", "pump.u")
    return Scene("signals", net, stop=0.4, step=0.01, events=[Event(0.2, "load.m", 0.8)])
"""
#: of the mass a spring to the ground; of the rod, s = 40 x, x' = r, with a damper
STARTS = {
    "mixed": ["--set=pump.k=5"],
    "foreign": ["--set=pump.q=0.1", "--set=pump.k=5", "--set=rod.b=1", "--set=rod.c=40"],
    "signals": ["--set=pump.k=5", "--set=rod.a=-3", "--set=rod.b=2", "--set=rod.c=10"],
}
N = 40


@pytest.fixture
def folder(tmp_path: Path, compiler: None) -> Path:
    return pump_folder(tmp_path, "scene.py", SCENE)


def units(folder: Path, version: str, **how: Any) -> None:
    foreign.mass(folder / "pump.fmu", version, **how)
    foreign.unit(folder / "rod.fmu", "2.0", foreign.FIRST_ORDER, saves=how.get("saves", True))


def exported(folder: Path, scene: str, *options: str, version: str = "2") -> Path:
    line = ["export", f"{folder}/scene.py:{scene}", "--as-unit", "--fmi", version, "-o", str(folder / "out"), *options]
    assert main(line) == 0
    return folder / "out" / f"{scene}_fmi{version}.fmu"


def table(target: str, h: float, n: int, *options: str) -> dict[str, np.ndarray]:
    path = Path(target).parent / "run.csv"
    line = ["run", target, "--step", repr(h), "--stop", repr(n * h), "-o", str(path), "--quiet", *options]
    assert main(line) == 0
    rows = np.genfromtxt(path, delimiter=",", names=True, deletechars="")
    assert rows.dtype.names
    return {name: rows[name] for name in rows.dtype.names}


def driven(path: Path, h: float, n: int, names: list[str]) -> np.ndarray:
    return driven_over(path, h, n, (), names)


def equal_to_the_bit(
    path: Path, rows: dict[str, np.ndarray], h: float, least: int, events: tuple[float, ...] = ()
) -> None:
    """From the first step on: before it, a coupling that iterates tells what its trial step found."""
    there = {v.name for v in fmpy.read_model_description(path, validate=True).modelVariables}
    names = [n for n in rows if n in there and n != "time" and not n.startswith("energy.")]
    assert len(names) >= least and all("_end" in n for n in rows if n not in there and n != "time")
    found = driven_over(path, h, len(rows["time"]) - 1, events, names)
    for i, name in enumerate(names):
        np.testing.assert_array_equal(found[1:, i], rows[name][1:], err_msg=name)


#: scene, version of the units inside, coupling
WAYS = [
    (s, i, c)
    for s in ("mixed", "foreign")
    for i in ("2.0", "3.0")
    for c in ("jacobi", "gauss-seidel", "newton", "anderson")
]
#: order, version of the unit
OUTER = {"mixed": [(k, o) for k in (2, 4, 6) for o in "23"], "foreign": [(2, "2"), (2, "3")]}
TELLING = [
    (("mixed", "2.0", "jacobi"), (2, "3")), (("mixed", "3.0", "newton"), (4, "2")),
    (("foreign", "3.0", "gauss-seidel"), (2, "3")),
]  # fmt: skip


@pytest.mark.parametrize(
    ("inside", "outside"),
    [case for s in OUTER for case in turning(
        [w for w in WAYS if w[0] == s], OUTER[s], *(pair for pair in TELLING if pair[0][0] == s)
    )], ids=str,
)  # fmt: skip
def test_unit_has_the_bits_of_the_run(folder: Path, inside: tuple[str, str, str], outside: tuple[int, str]) -> None:
    (scene, inner, coupling), (order, outer) = inside, outside
    units(folder, inner)
    how = ["--coupling", coupling, "--order", str(order), *STARTS[scene]]
    how += ["--sequence", "pump,cart,spring"] if (scene, coupling) == ("mixed", "gauss-seidel") else []
    path = exported(folder, scene, *how, version=outer)
    equal_to_the_bit(path, table(f"{folder}/scene.py:{scene}", 0.01, N, *how), 0.01, 6 if scene == "foreign" else 20)


def test_energies_are_those_of_the_audit(folder: Path) -> None:
    """What the junction makes, and through which ports it goes; the sum of all sizes is no less than the size of the sum."""
    from phfmu.audit.analysis import summarise

    units(folder, "2.0")
    how = ["--coupling", "jacobi", *STARTS["foreign"]]
    path, audit = exported(folder, "foreign", *how), folder / "audit.parquet"
    table(f"{folder}/scene.py:foreign", 0.01, N, *how, "--audit", str(audit))
    (bond,) = summarise(audit).junctions
    made, gross, *ports = driven(
        path, 0.01, N, ["bond.energy", "energy.junctions", "pump.flange.energy", "rod.end.energy"]
    )[-1]
    assert abs(made) > 1e-4 and made == pytest.approx(bond.residual, rel=1e-12)
    assert gross >= abs(made) and sum(ports) == pytest.approx(made, rel=1e-9)


@pytest.mark.parametrize("keeps", [1, 2])
def test_steps_are_repeated_as_the_unit_can(folder: Path, keeps: int) -> None:
    """Units that move on only from a point that was told to be final take the accepted step once more."""
    units(folder, "2.0")
    how = ["--coupling", "newton", f"--set=pump.keeps={keeps}", *STARTS["mixed"]]
    equal_to_the_bit(exported(folder, "mixed", *how), table(f"{folder}/scene.py:mixed", 0.01, N, *how), 0.01, 20)


#: coupling, order, version of the unit
SIGNALS = [(c, k, o) for c in ("gauss-seidel", "jacobi", "anderson") for k in (2, 4, 6) for o in "23"]


@pytest.mark.parametrize(
    ("inner", "case"), turning(["2.0", "3.0"], SIGNALS, ("2.0", ("gauss-seidel", 2, "3"))), ids=str
)
def test_signals_are_held_as_in_the_run(folder: Path, inner: str, case: tuple[str, int, str]) -> None:
    """Extrapolated over each step; a parameter of a member that changes starts them anew."""
    coupling, order, outer = case
    with_signals(folder, inner)
    how = ["--coupling", coupling, "--order", str(order), *STARTS["signals"]]
    path = exported(folder, "signals", *how, "--events", "inside", version=outer)
    rows = table(f"{folder}/scene.py:signals", 0.01, N, *how, "--restart", "0")
    equal_to_the_bit(path, rows, 0.01, 30, (0.2,))
    about = {v.name: v.causality for v in fmpy.read_model_description(path).modelVariables}
    assert [about[n] for n in ("rod.r", "pump.u", "load.flange.force", "pump.q")] == ["local"] * 3 + ["output"]
    assert np.ptp(rows["load.q"]) > 0.03 and np.ptp(rows["pump.y"]) > 0.3


def with_signals(folder: Path, version: str, abilities: str = "") -> None:
    own = abilities.replace("FMUState", "FMUstate")
    foreign.unit(folder / "rod.fmu", "2.0", foreign.FIRST_ORDER, saves=True, abilities=own)
    others = OTHERS if version == "2.0" else MORE
    variables = foreign.MASS[version].format(unit="N") + others
    foreign.unit(folder / "pump.fmu", version, variables, saves=True, abilities=abilities)


MORE = """
<Float64 name="u" valueReference="1" causality="input" start="0.5"/>
<Float64 name="y" valueReference="2" causality="output"/>
"""
OTHERS = """
<ScalarVariable name="u" valueReference="1" causality="input"><Real start="0.5"/></ScalarVariable>
<ScalarVariable name="y" valueReference="2" causality="output"><Real/></ScalarVariable>
<ScalarVariable name="flag" valueReference="4" causality="output"><Boolean/></ScalarVariable>
<ScalarVariable name="choice" valueReference="7" causality="local" initial="exact"><Integer start="1"/></ScalarVariable>
"""


def test_inputs_and_parameters_that_change_are_those_of_the_run(folder: Path) -> None:
    """A free port that counts outward, an input without power, and a parameter of a member of this package."""
    (folder / "pump.ports.toml").write_text((folder / "pump.ports.toml").read_text().replace("sign = 1", "sign = -1"))
    foreign.unit(folder / "pump.fmu", "2.0", foreign.MASS["2.0"].format(unit="N") + OTHERS, saves=True)
    how = ["--coupling", "gauss-seidel", "--set=pump.F=3", "--set=pump.choice=2"]
    path = exported(folder, "driven", *how)
    rows = table(f"{folder}/scene.py:driven", 0.01, N, *how, "--restart", "0")
    assert rows["pump.choice"][-1] == 2.0
    names = [
        n
        for n in (
            "pump.flag",
            "pump.choice",
            "pump.q",
            "pump.v",
            "pump.y",
            "pump.F",
            "pump.u",
            "cart.q",
            "cart.v",
            "cart.energy.stored",
        )
        if n in rows
    ]
    with importer(path) as unit:
        assert unit.get(["pump.F", "pump.u"]) == [3.0, 0.5]
        for k in range(N):
            unit.set({10: {"pump.F": -2.0}, 20: {"cart.m": 3.0, "pump.u": 4.0}}.get(k, {}))
            unit.step(k * 0.01, 0.01)
        found, other = unit.get(names), unit.get(["pump.y", "pump.F"])
    at_end = {n: rows[n][-1] for n in names}
    assert len(names) > 5 and dict(zip(names, found, strict=True)) == at_end and other == [2 * 4.0 + 0.4, -2.0]


def test_long_steps_are_internal_ones(folder: Path) -> None:
    """States and energies of the same internal steps, to the rounding of their times and of sums."""
    units(folder, "2.0")
    path = exported(folder, "mixed", "--coupling", "newton", *STARTS["mixed"])
    names = ["pump.q", "pump.v", "cart.q", "pump.flange.energy", "a.energy", "energy.supplied"]
    fine, coarse = driven(path, 0.01, 40, names)[::4], driven(path, 0.04, 10, names)
    np.testing.assert_allclose(coarse, fine, rtol=1e-11, atol=1e-14)


# -- saved states -----------------------------------------------------------------------------------------------------


def states(unit: Importer, version: str) -> Any:
    u, word = unit.unit, "FMUState" if version == "3" else "FMUstate"
    read = u.deserializeFMUState if version == "3" else u.deSerializeFMUstate
    get, free = (u.getFMUState, u.freeFMUState) if version == "3" else (u.getFMUstate, u.freeFMUstate)
    return get, getattr(u, f"set{word}"), free, getattr(u, f"serialize{word}"), read


@pytest.mark.parametrize(
    ("version", "inner", "coupling", "scene"),
    [("2", "3.0", "jacobi", "mixed"), ("3", "2.0", "newton", "mixed"), ("3", "3.0", "gauss-seidel", "signals")],
)
def test_saved_states_come_back_to_the_bit(folder: Path, version: str, inner: str, coupling: str, scene: str) -> None:
    """Also as bytes, in another instance; what is damaged, cut or of another unit is refused."""
    made = with_signals if scene == "signals" else units
    made(folder, inner, abilities=f'canSerializeFMU{"S" if inner == "3.0" else "s"}tate="true"')
    path = exported(folder, scene, "--coupling", coupling, *STARTS[scene], version=version)
    with importer(path) as unit, importer(path) as other:
        names = [n for n in unit.refs if n != "time"]
        get, set_, free, serialise, _ = states(unit, version)
        for k in range(10):
            unit.step(k * 0.01, 0.01)
        state, rows = get(), []
        data = serialise(state)
        for _ in range(2):
            for k in range(10, 20):
                unit.step(k * 0.01, 0.01)
            rows.append(unit.get(names))
            set_(state)
        np.testing.assert_array_equal(*rows)
        _, set_other, free_other, _, read = states(other, version)
        for bad in (data[:-1], data + b"x", data[: len(data) // 2], bytes([*data[:-9], data[-9] ^ 4, *data[-8:]])):
            with pytest.raises(Exception, match="(?i)fmi"):
                read(bad)
        there = read(data)
        set_other(there)
        for k in range(10, 20):
            other.step(k * 0.01, 0.01)
        np.testing.assert_array_equal(rows[0], other.get(names))
        free(state)
        free_other(there)


@pytest.mark.parametrize(("saves", "abilities", "told"), [(False, "", "00"), (True, "", "10")])
def test_the_whole_can_what_all_of_its_members_can(folder: Path, saves: bool, abilities: str, told: str) -> None:
    units(folder, "2.0", saves=saves, abilities=abilities)
    path = exported(folder, "mixed", "--coupling", "jacobi")
    about = fmpy.read_model_description(path).coSimulation
    assert about and [about.canGetAndSetFMUstate, about.canSerializeFMUstate] == [c == "1" for c in told]
    with importer(path) as unit:
        unit.step(0.0, 0.01)
        get, _, free, serialise, _ = states(unit, "2")
        if saves:
            state = get()
            with pytest.raises(Exception, match="fmi2SerializedFMUstateSize"):
                serialise(state)
            free(state)
        else:
            with pytest.raises(Exception, match="fmi2GetFMUstate"):
                get()


# -- steps that are refused -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("mode", "saves", "answer"), [(1, True, 2), (2, True, 2), (3, True, 2), (1, False, 3)])
def test_a_refused_step_is_told(folder: Path, mode: int, saves: bool, answer: int, capfd: Any) -> None:
    """Discarded, with all members where they were, if they can go back; else an error."""
    units(folder, "2.0", saves=saves)
    path = exported(folder, "mixed", "--coupling", "jacobi", f"--set=pump.mode={mode}")
    with importer(path) as unit:
        names = ["pump.q", "pump.v", "cart.q", "cart.v"]
        for k in range(25):
            unit.step(k * 0.01, 0.01)
        before = unit.get(names)
        with pytest.raises(Exception, match=f"status {answer}"):
            unit.step(0.25, 0.01)
        if saves and mode < 3:  # after a fatal error it is not called any more, not even to be freed
            assert unit.get(names) == before
    said = capfd.readouterr().out
    assert "pump: at t = 0.25 s fmi2DoStep was answered with" in said and "valve stuck at 7 %" in said


# -- files ------------------------------------------------------------------------------------------------------------

FOUND = {
    "2.0": '<ScalarVariable name="found" valueReference="28" causality="local"><Real/></ScalarVariable>',
    "3.0": '<Float64 name="found" valueReference="28" causality="local"/>',
}


@pytest.mark.parametrize(("inner", "outer"), [("2.0", "3"), ("3.0", "2")])
def test_files_are_found(folder: Path, inner: str, outer: str) -> None:
    """An URI in 2.0, a path in 3.0, whatever the unit around is given; licences stay, libraries of other platforms do not."""
    files = {"resources/table.txt": "1", "documentation/licenses/license.txt": "free", "binaries/other/foreign.so": "-"}
    about = foreign.MASS[inner].format(unit="N") + FOUND[inner]
    foreign.unit(folder / "pump.fmu", inner, about, saves=True, more=files)
    path = exported(folder, "mixed", "--coupling", "jacobi", version=outer)
    with zipfile.ZipFile(path) as archive:
        there = {n for n in archive.namelist() if n.startswith("resources/pump/")}
    assert {f"resources/pump/{n}" for n in ("modelDescription.xml", *files)} - there == {
        "resources/pump/binaries/other/foreign.so"
    }
    moved = folder / "with ü & a blank"
    moved.mkdir()
    shutil.move(path, moved)
    unzipped = fmpy.extract(moved / path.name, moved / "unzipped")
    rows = fmpy.simulate_fmu(unzipped, stop_time=0.1, step_size=0.01, output=["pump.found", "pump.q"])
    assert rows["pump.found"][-1] == 1.0 and rows["pump.q"][-1] != 0.0


@pytest.mark.parametrize(
    ("how", "options", "said"),
    [
        ({"abilities": 'needsExecutionTool="true"'}, (), "pump: needs a tool of its maker where it runs"),
        ({"abilities": 'canBeInstantiatedOnlyOncePerProcess="true"'}, (), "pump: can have one instance in a process"),
        ({}, ("--platform", "x86_64-windows"), "pump: has no library for x86_64-windows; it has some for"),
        ({"saves": False}, ("--coupling", "newton"), "pump cannot save its state"),
        ({}, ("--set=pump.forgets=1", "--coupling", "newton"), "pump does not restore its state"),
    ],
)  # fmt: skip
def test_refused(folder: Path, how: dict[str, Any], options: tuple[str, ...], said: str, capsys: Any) -> None:
    units(folder, "2.0", **how)
    assert main(["export", f"{folder}/scene.py:mixed", "--as-unit", "-o", str(folder / "out"), *options]) == 2
    assert said in capsys.readouterr().err and not (folder / "out").exists()


def test_iterated_signals_and_own_units_are_refused(folder: Path, capsys: Any) -> None:
    with_signals(folder, "2.0")
    assert main(["export", f"{folder}/scene.py:signals", "--as-unit", "--coupling", "newton", "-o", str(folder)]) == 2
    said = capsys.readouterr().err
    assert "signals of pump, rod would be iterated to agreement" in said and "take --coupling gauss-seidel" in said
    scene = (
        (folder / "scene.py").read_text().replace('"pump.q", "rod.r", factor=2.0, offset=0.1', '"pump.flag", "rod.r"')
    )
    (folder / "scene.py").write_text(scene)
    assert main(["export", f"{folder}/scene.py:signals", "--as-unit", "--coupling", "jacobi", "-o", str(folder)]) == 2
    assert "pump: the signal flag is no scalar of type Float64" in capsys.readouterr().err
    assert main(["export", "mass", "--fmi", "2", "-o", str(folder)]) == 0
    shutil.move(folder / "mass_fmi2.fmu", folder / "pump.fmu")
    (folder / "pump.ports.toml").unlink()
    assert main(["export", f"{folder}/scene.py:mixed", "--as-unit", "-o", str(folder)]) == 2
    assert "pump: is a unit of this package, whose declaration goes in as code" in capsys.readouterr().err


# -- memory, other hosts, units that others publish -------------------------------------------------------------------

SANITIZED = """
import json, sys
from pathlib import Path
from tests.network.test_embedded_units import SCENE, STARTS, driven, exported, importer, states, units, with_signals
from tests.network.unit_members import pump_folder
folder = pump_folder(Path(%r), "scene.py", SCENE)
for inner, coupling, outer, scene in (
    ("2.0", "newton", "3", "mixed"), ("3.0", "jacobi", "2", "mixed"), ("3.0", "gauss-seidel", "2", "signals")
):
    made = with_signals if scene == "signals" else units
    made(folder, inner, abilities=f'canSerializeFMU{"S" if inner == "3.0" else "s"}tate="true"')
    path = exported(folder, scene, "--coupling", coupling, *STARTS[scene], version=outer)
    with importer(path) as unit:
        get, set_, free, serialise, read = states(unit, outer)
        first = get()
        for k in range(5):
            unit.step(k * 0.05, 0.05)
        state = get()
        there = read(serialise(state))
        unit.step(0.25, 0.05)
        for s in (state, there, first):
            set_(s)
            free(s)
print("steps", 5)
"""


@pytest.mark.slow
def test_nothing_is_out_of_bounds(tmp_path: Path) -> None:
    """States of both kinds, steps of several parts, an instance in its first state again."""
    assert output(SANITIZED % str(tmp_path), tmp_path)[-2:] == ["steps", "5"]


@pytest.fixture
def truck(tmp_path: Path, compiler: None) -> Path:
    for path in (public(CHASSIS, WHEEL), public(WHEEL)):
        shutil.copy(path, tmp_path)
    (tmp_path / "scene.py").write_text(TRUCK)
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize(
    ("coupling", "step"),
    [
        *((c, h) for c in ("jacobi", "gauss-seidel") for h in (1e-3, 5e-3, 1e-2)),
        ("newton", 1e-4),
        ("anderson", 1e-4),
        ("newton", 5e-3),
        ("anderson", 1e-2),
    ],
)
def test_quarter_truck_has_the_bits_of_the_run(truck: Path, coupling: str, step: float) -> None:
    how = ["--coupling", coupling, *FINE]
    path = exported(truck, "truck", "--step", repr(step), *how, version="3")
    equal_to_the_bit(path, table(f"{truck}/scene.py:truck", step, 300, *how), step, 10)


@pytest.mark.slow
@pytest.mark.parametrize(("host", "version"), READ)
def test_other_importers_run_the_quarter_truck(truck: Path, host: str, version: str) -> None:
    """They add up the time, on which the steps of the units inside depend in the last digits."""
    path = exported(truck, "truck", "--step", "1e-3", "--coupling", "gauss-seidel", *FINE, version=version[0])
    names = ["chassis.velocity", "wheel.position", "wheel.out_spring_damper_f", "bond.energy", "energy.junctions"]
    refs = {v.name: v.valueReference for v in fmpy.read_model_description(path).modelVariables}
    found = run_elsewhere(host, SCRIPTS[host], str(path), 1e-3, 1000, {}, names, refs)
    rows = driven(path, 1e-3, 1000, names)
    np.testing.assert_allclose(found, rows[-1], rtol=1e-7)
