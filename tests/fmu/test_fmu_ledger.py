"""The ledger of units: what it cannot explain is told, and importers measure it like that of the engines."""

from __future__ import annotations

import shutil
import subprocess
import zipfile
from math import fsum
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

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
    block,
    build_model,
    energy,
    export,
    run,
)
from phfmu.cli import main
from phfmu.components.mechanical.rotational import flexible_shaft
from phfmu.fmu.export import sources
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.network.couplings.unit import FMUStepper

STEP = 0.01
needs_cc = pytest.mark.skipif(not shutil.which("cc"), reason="needs cc")


def flywheel(gain: float = 0.0, constant: float = 1e8) -> PHDAE:
    """phi' = w, w' = -k phi - d w + gain phi + torque, beside a reservoir of `constant` J that nothing touches."""
    phi, w = ph.state("phi", unit="rad", start=1.0), ph.state("w", unit="rad/s")
    store = ph.state("store", start=np.sqrt(2.0 * constant))
    k, g = ph.parameter("k", 4.0), ph.parameter("gain", gain)
    return PHDAE(
        "flywheel",
        states=(phi, w, store),
        parameters=(k, g),
        energies=(energy(0.5 * k.sx * phi.sx**2), energy(0.5 * w.sx**2), energy(0.5 * store.sx**2)),
        structure=(block((phi, w), ca.blockcat([[0.0, 1.0], [g.sx - 1.0, 0.0]])),),
        dissipation=(block((w,), 0.1),),
        ports=(Port("shaft", ph.ROTATIONAL, "effort", {w: 1.0}),),
    )


@pytest.fixture(scope="module")
def units(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    declaration = flywheel()
    folder = tmp_path_factory.mktemp("units")
    paths = export(build_model(declaration, Collocated(1)), folder, step=STEP, stop=2.0)
    return dict(zip(("2.0", "3.0"), paths, strict=True))


@pytest.fixture(scope="module")
def leaking(units: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The unit with an error in its library: H grows by 1 mW, which no step books."""
    folder, name = tmp_path_factory.mktemp("leaking"), "sources/outputs.c"
    zipfile.ZipFile(units["3.0"]).extractall(folder)
    text, line = (folder / name).read_text(), "    if (!ph_finite(a, in->offset[PH_NBLOCK] - in->offset[PH_A_END])) {"
    assert text.count(line) == 1
    leak = "    in->table[in->offset[PH_H]] += 1e-3 * in->table[p->nx];\n"
    (folder / name).write_text(text.replace(line, leak + line))
    (library,) = [p for p in folder.glob("binaries/*/*")]
    flags = [
        "-std=c11",
        "-O1",
        "-shared",
        "-fPIC",
        "-fvisibility=hidden",
        "-DPH_API=",
        "-isystem",
        str(sources.HEADERS),
    ]
    files = sorted(map(str, folder.glob("sources/*.c")))
    subprocess.run(["cc", *flags, *files, "-o", str(library), "-lm"], check=True, cwd=folder)
    path = folder / "leaking.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        for part in (p for p in folder.rglob("*") if p.is_file() and p != path):
            archive.write(part, part.relative_to(folder))
    return path


def stepped(unit: FMUInstance, first: int, n: int, stored: list[float] | None = None) -> None:
    for i in range(first, first + n):
        unit.set_input([np.sin(0.3 * i)])
        unit.do_step(i * STEP, STEP)
        if stored is not None:
            stored.append(float(unit.ledger()["stored"][0]))


def gap(unit: FMUInstance) -> float:
    found = unit.gap()
    assert found is not None
    return found


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_the_gap_of_a_sound_unit_is_rounding_whatever_is_saved_and_restored(units: dict, version: str) -> None:
    with FMUInstance(units[version]) as unit:
        start, stored = unit.energies()[0], []
        assert gap(unit) == 0.0, "at the start nothing is left to explain"
        stepped(unit, 0, 300, stored)
        told = unit.energies()[0] - start - fsum(stored)
        one = np.spacing(start)  # H is known to its rounding, two sums of it are differenced
        assert abs(gap(unit) - told) <= 4 * one and abs(gap(unit)) <= 16 * one
        state, here = unit.get_state(), gap(unit)
        stepped(unit, 300, 50)
        there = gap(unit)
        unit.set_state(state)
        assert gap(unit) == here
        stepped(unit, 300, 50)
        assert gap(unit) == there
        with FMUInstance(units[version]) as other:
            other.set_state(other.deserialize(unit.serialize(state), other.get_state()))
            assert gap(other) == here, "books are part of the serialised state"
        unit.reset()
        assert gap(unit) == 0.0


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_a_sliver_leaves_the_gap_as_it_is(units: dict, version: str) -> None:
    with FMUInstance(units[version]) as unit:
        stepped(unit, 0, 5)
        before = gap(unit)
        unit.do_step(5 * STEP, 1e-16)
        assert gap(unit) == before and unit.ledger()["moved"] == 0.0


def test_members_of_a_unit_tell_their_gaps_too(tmp_path: Path) -> None:
    net = Network("pair")
    net.add("wheel", flywheel(constant=0.5))
    net.add("shaft", flexible_shaft(20.0, d=1e-3))
    net.connect("wheel.shaft", "shaft.a")
    declaration = net.compose()
    (path,) = export(build_model(declaration), tmp_path, ("3.0",), step=STEP, ledger_outputs=False)
    with FMUInstance(path) as unit:
        for i in range(50):
            unit.do_step(i * STEP, STEP)
        names = ["energy.gap", "wheel.energy.gap", "shaft.energy.gap"]
        assert {unit.variable(n).causality for n in names} == {"local"}, "--outputs local is for them too"
        both, *each = unit.get(names)
        assert both == pytest.approx(sum(each), abs=1e-18) and 0.0 < np.abs(each).max() <= 1e-14


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_energies_in_play_are_those_of_the_engines(units: dict, version: str) -> None:
    """The same blocks for the judge, whether the model is stepped by an engine, as a unit or as a member."""
    model = build_model(flywheel(), Collocated(1))
    expected = Monolithic(model, NativeInstance(model)).advance(0.0, STEP, 20).moved
    assert expected is not None and 0.0 < expected.max() < 1.0
    with FMUInstance(units[version]) as unit:
        moved = FMUStepper(unit).advance(0.0, STEP, 20).moved
    assert moved is not None
    np.testing.assert_allclose(moved, expected, rtol=1e-12)


def coupled(path: Path) -> tuple[Network, list]:
    shaft = build_model(flexible_shaft(20.0, d=1e-3))
    unit = FMUInstance(path)
    net = Network("wheel_and_shaft")
    net.add("wheel", PHDAE("wheel", ports=unit.interface.declared_ports()))
    net.add("shaft", flexible_shaft(20.0, d=1e-3))
    net.connect("wheel.shaft", "shaft.a", name="coupling")
    return net, [FMUMember("wheel", unit), EngineMember("shaft", shaft, NativeInstance(shaft))]


@needs_cc
def test_a_unit_whose_gap_does_not_close_violates_the_ledger(
    units: dict, leaking: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """1e-5 J a step, which is small to what the reservoir holds and large to what moves."""
    with FMUInstance(leaking) as unit:
        stepped(unit, 0, 100)
        assert gap(unit) == pytest.approx(1e-3, rel=1e-3)
        assert abs(unit.get(["energy.residual"])[0]) < 1e-12, "its balance closes over it"
    assert main(["run", str(units["3.0"]), "--stop", "1"]) == 0
    assert main(["run", str(leaking), "--stop", "1"]) == 4
    assert "J more than it books as stored" in capsys.readouterr().err
    for path, closed in ((units["3.0"], True), (leaking, False)):
        net, members = coupled(path)
        summary = run(Coupled(net, members), Options(stop=0.5, step=STEP)).ledger.summary()
        members[0].unit.close()
        assert summary.closed == closed
        assert {(v.kind, v.name) for v in summary.violations} == (set() if closed else {("change", "wheel")})


def test_a_unit_whose_balance_does_not_close_violates_the_ledger(tmp_path: Path) -> None:
    declaration = flywheel(gain=0.5)
    (path,) = export(build_model(declaration, Collocated(1)), tmp_path, ("2.0",), step=STEP)
    assert main(["run", str(path), "--stop", "1", "--step", str(STEP)]) == 4
