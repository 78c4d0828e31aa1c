"""A coupled network as one unit: the bits of `phfmu run --coupling ..`, in FMI 2.0 and 3.0, saved, nested, refused."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave

from phfmu import Coupled, EngineMember, Event, FMUInstance, Network, Options, build_model, run
from phfmu.cli import main
from phfmu.cli.stepping import instance_of
from phfmu.components.library import build
from phfmu.network.members.fmu_member import FMUMember
from phfmu.runs.march.march import pieces
from phfmu.schemes.collocated import Collocated
from tests.fmu.other_hosts import READ, run_elsewhere
from tests.fmu.test_fmu_hosts import SCRIPTS
from tests.wide import slow

#: scene -> step [s], steps, times of its events in these
SCENES = {
    "oscillator": (1e-3, 200, ()), "smib": (1e-4, 200, ()), "drive": (1e-3, 200, ()), "speed_control": (1e-3, 200, (0.1,)),
    "motor_start": (1e-4, 200, ()), "two_machine": (1e-4, 2200, (0.1, 0.2)), "wscc9": (1e-4, 100, ()),
}  # fmt: skip

#: couplings with one held value a step
HELD = ("anderson", "gauss-seidel", "jacobi")


class Importer:
    """A unit by the functions of the standard."""

    def __init__(self, path: Path, starts: dict[str, float] | None = None):
        about = fmpy.read_model_description(path)
        self.refs = {v.name: v.valueReference for v in about.modelVariables}
        self._folder = fmpy.extract(path)
        kind: Any = FMU3Slave if about.fmiVersion.startswith("3") else FMU2Slave
        assert about.coSimulation
        self.unit = kind(
            guid=about.guid, unzipDirectory=self._folder, modelIdentifier=about.coSimulation.modelIdentifier,
            instanceName="unit",
        )  # fmt: skip
        self.unit.instantiate()
        self._get, self._set = (
            (self.unit.getFloat64, self.unit.setFloat64)
            if kind is FMU3Slave
            else (self.unit.getReal, self.unit.setReal)
        )
        if kind is FMU3Slave:
            self.unit.enterInitializationMode(startTime=0.0)
        else:
            self.unit.setupExperiment(startTime=0.0)
            self.unit.enterInitializationMode()
        self.set(starts or {})
        self.unit.exitInitializationMode()

    def set(self, values: dict[str, float]) -> None:
        if values:
            self._set([self.refs[n] for n in values], list(values.values()))

    def get(self, names: list[str]) -> list[float]:
        return list(self._get([self.refs[n] for n in names]))

    def step(self, t: float, h: float) -> None:
        self.unit.doStep(currentCommunicationPoint=t, communicationStepSize=h)

    def close(self) -> None:
        self.unit.freeInstance()
        shutil.rmtree(self._folder)


@contextmanager
def importer(path: Path, starts: dict[str, float] | None = None) -> Iterator[Importer]:
    found = Importer(path, starts)
    try:
        yield found
    finally:
        found.close()


def exported(folder: Path, scene: str, order: int, version: str, *options: str) -> Path:
    line = ["export", scene, "--as-unit", "--order", str(order), "--fmi", version, "-o", str(folder), *options]
    assert main(line) == 0
    return folder / f"{scene}_fmi{version}.fmu"


def table(
    folder: Path, scene: str, order: int, h: float, n: int, *options: str, coupling: str = "newton"
) -> dict[str, np.ndarray]:
    path = folder / "run.csv"
    line = ["run", scene, "--coupling", coupling, "--order", str(order), "--step", repr(h), "--stop", repr(n * h)]
    assert main([*line, "--restart", "0", "-o", str(path), "--quiet", *options]) == 0
    rows = np.genfromtxt(path, delimiter=",", names=True, deletechars="")
    assert rows.dtype.names
    return {name: rows[name] for name in rows.dtype.names}


def driven(path: Path, h: float, n: int, events: tuple[float, ...], names: list[str]) -> np.ndarray:
    """Rows of a unit on the grid of a run, which starts anew at each event."""
    with importer(path) as unit:
        rows, ends = [unit.get(names)], [0.0, *events, n * h]
        for start, end in zip(ends[:-1], ends[1:], strict=True):
            for t, step, count in pieces(start, end, h):
                for k in range(count):
                    unit.step(t + k * step, step)
                    rows.append(unit.get(names))
        return np.array(rows)


#: sums over members, which the run adds in another order where there are many
def same(name: str) -> bool:
    return not name.startswith("energy.")


@pytest.mark.parametrize(
    ("scene", "order", "version"),
    [("oscillator", 2, "2"), ("smib", 4, "3"), ("speed_control", 6, "2")]
    + [
        slow((s, k, v))
        for s in SCENES
        for k in (2, 4, 6)
        for v in "23"
        if (s, k, v) not in {("oscillator", 2, "2"), ("smib", 4, "3"), ("speed_control", 6, "2")}
    ],
)
def test_unit_has_the_bits_of_the_run(tmp_path: Path, scene: str, order: int, version: str, compiler: None) -> None:
    equal_to_the_bit(tmp_path, scene, order, version, "newton")


@pytest.mark.parametrize(
    ("scene", "coupling", "order", "version"),
    [("oscillator", "gauss-seidel", 2, "3"), ("drive", "anderson", 4, "2"), ("oscillator", "jacobi", 6, "2"),
     ("speed_control", "gauss-seidel", 2, "3")]
    + [slow((s, c, k, v)) for s, c in [*((s, c) for s in ("oscillator", "drive", "speed_control") for c in HELD
                                         if (s, c) != ("drive", "jacobi")),
                                       ("smib", "anderson"), ("motor_start", "anderson"), ("two_machine", "anderson")]
       for k, v in ((2, "2"), (4, "3"))],
)  # fmt: skip
def test_so_it_has_under_couplings_that_hold_values(
    tmp_path: Path, scene: str, coupling: str, order: int, version: str, compiler: None
) -> None:
    equal_to_the_bit(tmp_path, scene, order, version, coupling)


def equal_to_the_bit(folder: Path, scene: str, order: int, version: str, coupling: str) -> None:
    h, n, events = SCENES[scene]
    path = exported(folder, scene, order, version, "--events", "inside", "--step", repr(h), "--coupling", coupling)
    rows = table(folder, scene, order, h, n, coupling=coupling)
    there = {v.name for v in fmpy.read_model_description(path, validate=True).modelVariables}
    names = [name for name in rows if name in there and name != "time"]
    ends = [n for n in rows if n not in there and n != "time"]
    assert len(names) > 30 and all("_end" in n or n.startswith("constraint.") for n in ends)
    found = driven(path, h, n, events, names)
    for i, name in enumerate(names):
        if same(name):
            np.testing.assert_array_equal(found[:, i], rows[name], err_msg=name)
        else:
            np.testing.assert_allclose(
                found[:, i], rows[name], rtol=1e-14, atol=1e-9 * np.abs(rows["energy.stored"]).max()
            )


@pytest.mark.parametrize(
    ("scene", "coupling", "version"),
    [("smib", "newton", "2"), ("smib", "newton", "3"), ("smib", "anderson", "3"), ("drive", "gauss-seidel", "2"),
     ("oscillator", "jacobi", "3"), ("speed_control", "gauss-seidel", "3"), slow(("speed_control", "anderson", "2")),
     slow(("smib", "anderson", "2")), slow(("drive", "gauss-seidel", "3"))],
)  # fmt: skip
def test_saved_states_come_back_to_the_bit(
    tmp_path: Path, scene: str, coupling: str, version: str, compiler: None
) -> None:
    """Into the same instance, and by their bytes into another one; the continuation of the steps is part of them."""
    path = exported(tmp_path, scene, 4, version, "--coupling", coupling, "--step", "1e-4")
    get, free = (f"{word}FMUState" for word in ("get", "free")) if version == "2" else ("getFMUState", "freeFMUState")
    with importer(path) as unit, importer(path) as other:
        names = [n for n in unit.refs if n.startswith("energy.") or not n.startswith("constraint")]
        names = [n for n, v in zip(names, unit.get(names), strict=True) if np.isfinite(v)]
        for k in range(20):
            unit.step(k * 1e-4, 1e-4)
        state = getattr(unit.unit, get)()
        data = unit.unit.serializeFMUState(state) if version == "3" else unit.unit.serializeFMUstate(state)
        rows = []
        for _ in range(2):
            for k in range(20, 40):
                unit.step(k * 1e-4, 1e-4)
            rows.append(unit.get(names))
            (unit.unit.setFMUState if version == "3" else unit.unit.setFMUstate)(state)
        there = other.unit.deserializeFMUState(data) if version == "3" else other.unit.deSerializeFMUstate(data)
        (other.unit.setFMUState if version == "3" else other.unit.setFMUstate)(there)
        for k in range(20, 40):
            other.step(k * 1e-4, 1e-4)
        np.testing.assert_array_equal(rows[0], rows[1])
        np.testing.assert_array_equal(rows[0], other.get(names))
        getattr(unit.unit, free)(state)


@pytest.mark.parametrize("coupling", ["newton", *HELD])
def test_forged_bytes_are_refused(tmp_path: Path, coupling: str, compiler: None) -> None:
    path = exported(tmp_path, "oscillator", 4, "3", "--coupling", coupling)
    with importer(path) as unit:
        for k in range(5):
            unit.step(k * 1e-2, 1e-2)
        data = bytearray(unit.unit.serializeFMUState(unit.unit.getFMUState()))
        for at in range(60, len(data), 97):
            forged = bytearray(data)
            forged[at] ^= 0x40
            with pytest.raises(Exception, match="(?i)fmi3"):
                unit.unit.deserializeFMUState(bytes(forged))


def test_values_before_the_start_find_other_junctions(tmp_path: Path, compiler: None) -> None:
    """Parameters and inputs that are set are those of a run that has them from the beginning."""
    path = exported(tmp_path, "drive", 4, "3", "--step", "1e-3")
    given = {"load.J": 0.02, "motor.terminal.v": 20.0}
    rows = table(tmp_path, "drive", 4, 1e-3, 50, *(f"--set={n}={v}" for n, v in given.items()))
    with importer(path, given) as unit:
        names = [n for n in rows if n in unit.refs and n != "time" and same(n)]
        found = [unit.get(names)]
        for k in range(50):
            unit.step(k * 1e-3, 1e-3)
            found.append(unit.get(names))
    for i, name in enumerate(names):
        size = np.abs(rows[name]).max()
        np.testing.assert_allclose(np.array(found)[:, i], rows[name], rtol=0, atol=1e-13 * size, err_msg=name)


def test_long_steps_are_internal_ones(tmp_path: Path, compiler: None) -> None:
    """States of equal internal steps; means and energies are those of the whole step."""
    path = exported(tmp_path, "drive", 4, "3", "--step", "1e-3")
    x = ["shaft.twist", "load.p"]
    with importer(path) as fine, importer(path) as coarse:
        x = [n for n in fine.refs if n in ("motor.current", "load.p", "shaft.twist", "motor.flux", "load.momentum")]
        x += [n for n in fine.refs if n.endswith(".energy") or n == "energy.stored"]
        means = [n for n in fine.refs if n.endswith("_step") and "energy" not in n]
        sums = [n for n in fine.refs if n.endswith(".energy_step")]
        total, mean = np.zeros(len(sums)), np.zeros(len(means))
        for k in range(40):
            fine.step(k * 1e-3, 1e-3)
            total, mean = total + fine.get(sums), mean + np.array(fine.get(means)) / 8
            if k % 8 == 7:
                coarse.step((k - 7) * 1e-3, 8e-3)
                np.testing.assert_allclose(coarse.get(x), fine.get(x), rtol=1e-12, atol=1e-14)
                np.testing.assert_allclose(coarse.get(means), mean, rtol=1e-11, atol=1e-13)
                np.testing.assert_allclose(coarse.get(sums), total, rtol=1e-9, atol=1e-16)
                total, mean = np.zeros(len(sums)), np.zeros(len(means))


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_unit_is_a_member_of_another_network(tmp_path: Path, version: str, compiler: None) -> None:
    """Coupled by Newton's method, it tells no derivatives of its steps: they are taken again. Held inputs: order 2."""
    inner, whole = Network("inner"), Network("whole")
    for net in (inner, whole):
        net.add("motor", build("dc_motor"))
        net.add("shaft", build("flexible_shaft"))
        net.connect("motor.shaft", "shaft.a")
    whole.add("load", build("rotational_inertia"))
    whole.connect("shaft.b", "load.a")
    from phfmu.network.as_unit.export import export_network

    errors = []
    for h in (5e-4, 2.5e-4):
        (path,) = export_network(
            inner, tmp_path / f"{h}", dict.fromkeys(inner.declared, Collocated(2)), [version], step=h
        )
        outer = Network("outer")
        outer.add("unit", path)
        outer.add("load", build("rotational_inertia"))
        outer.connect("unit.shaft.b", "load.a")
        load = build_model(outer.declared["load"])
        members: list[Any] = [
            FMUMember("unit", FMUInstance(path, name="unit", start=0.0)),
            EngineMember("load", load, instance_of(load, "native")),
        ]
        stepper = Coupled(outer, members)
        events = [Event(0.0, "unit.motor.terminal.v", 24.0)]
        result = run(stepper, Options(stop=0.1, step=h, events=events))
        assert result.ledger.summary().closed
        model = build_model(whole.compose(), Collocated(3))
        from phfmu.network.couplings.monolithic import Monolithic

        exact = run(
            Monolithic(model, instance_of(model, "native")),
            Options(stop=0.1, step=1e-4, events=[replace(events[0], name="motor.terminal.v")]),
        )
        speed = result.column("load.a.speed")[-1]
        errors.append(abs(speed - exact.column("load.a.speed")[-1]))
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.15)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("smib --as-unit --coupling jacobi", "no output gives bus1.v[1], bus1.v[2], bus1.v[3] at an instant"),
        (
            "drive --as-unit --coupling gauss-seidel --sequence motor,load",
            "sequence motor, load: each member of drive comes once",
        ),
        ("drive --as-unit --sequence motor,load,shaft", "is for gauss-seidel, not for newton"),
        ("drive --sequence motor,load,shaft", "say --as-unit too"),
        ("smib --coupling newton", "say --as-unit too"),
        ("smib --as-unit --node-inputs", "--as-unit and --node-inputs do not go together"),
        ("smib --as-unit --tunable gen.Raa", "has no parameter 'gen.Raa' to be tunable; did you mean gen.Ra"),
        ("dc_motor --as-unit", "has no members to keep apart"),
    ],
)
def test_refused(
    line: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["export", *line.split()]) == 2
    assert said in capsys.readouterr().err and not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.parametrize(("host", "version"), READ)
def test_other_importers_run_it(tmp_path: Path, host: str, version: str, compiler: None) -> None:
    path = exported(tmp_path, "two_machine", 4, version[0], "--events", "inside")
    names = ["m1.shaft.speed", "m2.shaft.speed", "line.flux[1]", "energy.stored", "energy.junctions"]
    refs = {v.name: v.valueReference for v in fmpy.read_model_description(path).modelVariables}
    found = run_elsewhere(host, SCRIPTS[host], str(path), 1e-4, 1500, {}, names, refs)
    rows = driven(path, 1e-4, 1500, (0.1,), names)
    np.testing.assert_allclose(found[:4], rows[-1][:4], rtol=1e-8)
