"""Units with ideal switches: all modes in one library, changed within a communication step, in the saved state."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu

from phfmu import (
    ELECTRICAL,
    PHDAE,
    Collocated,
    FMUInstance,
    NativeInstance,
    Network,
    Port,
    SwitchedInstance,
    build_model,
    damping,
    energy,
    export,
    state,
)
from phfmu.components.electrical.rectifiers import rectifier_bridge
from phfmu.components.electrical.switches import diode, ideal_switch
from phfmu.components.mechanical.translational import mass
from phfmu.components.scenes.electrical.rectifier import rectifier
from phfmu.fmu.export import sources
from phfmu.fmu.export.description import ExportedUnit
from phfmu.fmu.export.schedule import UnitEvent
from phfmu.fmu.export.variables import FMUError
from phfmu.fmu.importer.refusal import UnitFailure

VERSIONS = ("2.0", "3.0")
H, N = 1e-3, 50


@pytest.fixture(scope="module")
def bridge() -> Any:
    return build_model(rectifier().declaration(), Collocated(2))


@pytest.fixture(scope="module")
def units(bridge: Any, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    paths = export(bridge, tmp_path_factory.mktemp("units"), VERSIONS, step=H, stop=N * H)
    return dict(zip(VERSIONS, paths, strict=True))


@pytest.mark.parametrize("version", VERSIONS)
def test_a_rectifier_is_what_the_native_engine_steps(bridge: Any, units: dict[str, Path], version: str) -> None:
    """11 changes of modes; nothing lost, books closed, modes as variables."""
    native = SwitchedInstance(bridge, NativeInstance)
    native.prepare(H)
    states, told = [n for v in bridge.declaration.states for n in v.names()], 0
    assert validate_fmu(str(units[version])) == []
    with FMUInstance(units[version]) as unit:
        for k in range(N):
            native.do_step(k * H, H)
            unit.do_step(k * H, H)
            told += len(native.happened)
            assert unit.get(states) == pytest.approx(native.x, rel=1e-12, abs=1e-14)
            modes = unit.get(["mode.bridge.blocks[1]", "mode.bridge.blocks[2]", "events.count"])
            assert modes.tolist() == [*native.mode, told]
        events, gap, residual, stored = unit.get(["energy.events", "energy.gap", "energy.residual", "energy.stored"])
    assert told == 11 and abs(events) <= 1e-14 and abs(gap) <= 1e-14 and abs(residual) <= 1e-14
    assert stored == pytest.approx(native.signal("H").sum(), rel=1e-13)


@pytest.mark.parametrize("version", VERSIONS)
def test_fmpy_runs_it_without_knowing(units: dict[str, Path], version: str) -> None:
    columns = ["grid.flux", "load.flux", "mode.bridge.blocks[1]", "events.count"]
    rows = fmpy.simulate_fmu(str(units[version]), stop_time=N * H, output_interval=H, output=columns)
    with FMUInstance(units[version]) as unit:
        for k in range(N):
            unit.do_step(k * H, H)
        assert [rows[-1][c] for c in columns] == pytest.approx(unit.get(columns), rel=1e-12)
    assert np.abs(np.diff(rows["mode.bridge.blocks[1]"])).sum() == 5


@pytest.mark.parametrize("version", VERSIONS)
def test_a_step_back_across_changes_of_modes_gives_the_same_bits(units: dict[str, Path], version: str) -> None:
    """Also as bytes in another instance, and after a reset."""
    with FMUInstance(units[version]) as unit, FMUInstance(units[version]) as other:
        for k in range(10):
            unit.do_step(k * H, H)
        before, mode = unit.get_state(), unit.get(["mode.bridge.blocks[1]"])
        assert mode == 1.0
        for k in range(10, 20):
            unit.do_step(k * H, H)
        later = unit.values()
        assert later["events.count"] > 4 and later["mode.bridge.blocks[1]"] == 0.0
        unit.set_state(before)
        assert unit.get(["mode.bridge.blocks[1]"]) == mode
        other.set_state(other.deserialize(unit.serialize(before), like=other.get_state()))
        for u in (unit, other):
            for k in range(10, 20):
                u.do_step(k * H, H)
            assert u.values() == later


def capacitor(c: float, v: float) -> PHDAE:
    q = state("q", unit="C", start=c * v, nominal=c * 10)
    port = Port("terminal", ELECTRICAL, "flow", {q: 1.0}, nominal=1.0)
    return PHDAE(
        "capacitor", states=(q,), energies=(energy(q**2 / (2 * c)),), dissipation=(damping(q, 1e-3),), ports=(port,)
    )


def joined() -> PHDAE:
    net = Network("joined")
    net.add("one", capacitor(2e-6, 100.0))
    net.add("two", capacitor(5e-6, 20.0))
    net.add("switch", ideal_switch(conducts=False, i=1.0, v=100.0))
    net.junction("left", ["one.terminal", "switch.a"])
    net.junction("right", ["switch.b", "two.terminal"])
    return net.compose()


@pytest.mark.slow
def test_a_switch_that_joins_capacitors_loses_what_the_formula_says(tmp_path: Path) -> None:
    """Closed by an event within a communication step, and by a tunable parameter between two."""
    model, lost = build_model(joined(), Collocated(2)), 2e-6 * 5e-6 / (2 * 7e-6)
    (path,) = export(
        model, tmp_path / "inside", ("3.0",), step=1e-5, events=[UnitEvent(1.5e-5, "switch.conducts", 1.0)]
    )
    with FMUInstance(path) as unit:
        unit.do_step(0.0, 1e-5)
        unit.do_step(1e-5, 1e-5)
        events, count, conducts, gap = unit.get(["energy.events", "events.count", "switch.conducts", "energy.gap"])
        v = unit.get(["one.q", "two.q"]) / [2e-6, 5e-6]
    assert count == 1 and conducts == 1 and v[0] == pytest.approx(v[1], rel=1e-12) and abs(gap) < 1e-16
    dv = 100.0 * np.exp(-1.5e-5 / 2e-3) - 20.0 * np.exp(-1.5e-5 / 5e-3)  # the charges leak until the event
    assert events == pytest.approx(-lost * dv**2, rel=1e-12)
    (path,) = export(model, tmp_path / "between", ("2.0",), step=1e-5, tunable=["switch.conducts"])
    with FMUInstance(path) as unit:
        unit.set({"switch.conducts": 1.0})
        unit.do_step(0.0, 1e-5)
        assert unit.get(["energy.events", "switch.conducts"]) == pytest.approx([-lost * 80.0**2, 1.0], rel=1e-12)


@pytest.mark.slow
def test_a_change_that_cannot_be_discards_the_step(tmp_path: Path) -> None:
    """A switch that cuts an inductor's current with nowhere to go; the unit is where it was, and says why."""
    flux = state("flux", unit="Wb", start=0.3, nominal=0.1)
    ports = (Port("terminal", ELECTRICAL, "effort", {flux: 1.0}, nominal=1.0),)
    coil = PHDAE(
        "coil", states=(flux,), energies=(energy(flux**2 / 0.2),), dissipation=(damping(flux, 0.2),), ports=ports
    )
    net = Network("cut")
    net.add("coil", coil)
    net.add("load", capacitor(1e-3, 0.0))
    net.add("switch", ideal_switch(i=1.0, v=10.0))
    net.junction("up", ["load.terminal", "switch.a"])
    net.junction("node", ["switch.b", "coil.terminal"])
    event = [UnitEvent(1e-3, "switch.conducts", 0.0)]
    (path,) = export(build_model(net.compose(), Collocated(1)), tmp_path, ("3.0",), step=1e-4, events=event)
    with FMUInstance(path) as unit:
        for k in range(10):
            unit.do_step(k * 1e-4, 1e-4)
        before = unit.get(["coil.flux", "switch.conducts"]).tolist()
        with pytest.raises(UnitFailure, match="'switch.switch': it would cut"):
            unit.do_step(1e-3, 1e-4)
        assert unit.get(["coil.flux", "switch.conducts"]).tolist() == before


def test_switches_that_no_unit_can_have_are_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(FMUError, match=r"ideal switches \(pair1, pair2\) between inputs"):
        export(build_model(rectifier_bridge()), tmp_path, step=H)
    net = Network("many")
    for i in range(7):
        for end, v in (("a", 1.0), ("b", 0.0)):
            net.add(f"{end}{i}", capacitor(1e-6, v))
        net.add(f"d{i}", diode())
        net.connect(f"d{i}.a", f"a{i}.terminal")
        net.connect(f"d{i}.b", f"b{i}.terminal")
    with pytest.raises(FMUError, match="7 ideal switches, 128 modes; a unit has at most 64"):
        export(build_model(net.compose()), tmp_path, step=H)


def test_units_without_switches_have_nothing_of_them() -> None:
    plain, switched = ExportedUnit(build_model(mass(1.0, k=2.0)), 0.1), ExportedUnit(build_model(joined()), 0.1)
    own = {*sources.fixed(switched)} - {*sources.fixed(plain)}
    assert {"fmu_modes.c", "modes.c", "mode_land.c", "mode_choice.c"} <= own
    assert "switches.c" in sources.generated(switched) and "mode1.c" in sources.generated(switched)
    assert "switches" not in sources.interface_text(plain, "token")
