"""Events and units: parameters that may be set between steps, and events that are built in."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy.validation import validate_fmu

from phfmu import (
    Coupled,
    Event,
    FMUInstance,
    FMUMember,
    Monolithic,
    NativeInstance,
    Network,
    Options,
    Scene,
    StepFailure,
    build_model,
    export,
    run,
)
from phfmu.cli import main
from phfmu.components.mechanical.translational import mass, spring
from phfmu.fmu.export.schedule import UnitEvent, fed_inside
from phfmu.fmu.export.variables import FMUError
from phfmu.outcome.status import Status

EVENTS = (Event(0.2, "flange.force", 3.0), Event(0.4, "k", 90.0), Event(0.7, "flange.force", -1.0))


def oscillator() -> Any:
    return mass(2.0, k=100.0, d=0.5, q=0.1)


def pushed() -> Scene:
    """A scene with events of both kinds, one at the start."""
    return Scene("pushed", oscillator(), 1.0, 1e-2, (Event(0.0, "d", 0.4), *EVENTS))


def reference(events: Any = EVENTS, step: float = 1e-2) -> Any:
    model = build_model(oscillator())
    return run(Monolithic(model, NativeInstance(model)), Options(stop=0.9, step=step, events=events))


@pytest.fixture(scope="module", params=["2.0", "3.0"])
def tunable(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    (path,) = export(
        build_model(oscillator()), tmp_path_factory.mktemp("t"), (request.param,), step=1e-2, tunable=["k"]
    )
    return path


def test_a_tunable_parameter_is_set_between_steps_and_its_energy_booked(tunable: Path) -> None:
    assert validate_fmu(str(tunable)) == []
    with FMUInstance(tunable) as unit:
        assert unit.tunable == ["k"]
        for i in range(20):
            unit.do_step(i * 1e-2, 1e-2)
        before = unit.get(["q", "energy.stored", "energy.residual"])
        kept = unit.get_state()
        for _ in range(2):  # a restored state knows its books
            unit.set({"k": 90.0})
            q, H, residual, jump, gap = unit.get(
                ["q", "energy.stored", "energy.residual", "energy.events", "energy.gap"]
            )
            assert q == before[0] and residual == before[2]
            assert jump == pytest.approx(0.5 * (90.0 - 100.0) * q**2, rel=1e-12)
            assert H - before[1] == pytest.approx(jump, rel=1e-12)
            assert abs(gap) < 1e-15
            unit.do_step(0.2, 1e-2)
            after = unit.values()
            unit.set_state(kept)
            assert unit.get(["energy.events"])[0] == 0.0
        with pytest.raises(FMUError, match="k = -1 must be at least 0"):
            unit.set({"k": -1.0})
        with pytest.raises(FMUError, match="'m' is fixed after initialization"):
            unit.set({"m": 3.0})
        unit.set({"k": 90.0})
        unit.do_step(0.2, 1e-2)
        assert unit.values() == after


def test_events_drive_members_that_are_units_wherever_they_fall(tmp_path: Path) -> None:
    """An event off the grid of steps, on a parameter that H depends on: the composed model's columns and jump."""
    net = Network("pair")
    net.add("a", mass(1.0, k=40.0, q=0.1))
    net.add("b", spring(30.0, d=0.1))
    net.add("c", mass(2.0, k=10.0))
    net.connect("a.flange", "b.a")
    net.connect("b.b", "c.flange")
    options = Options(stop=0.2, step=1e-2, events=(Event(0.1234, "b.k", 10.0), Event(0.15, "a.k", 60.0)))
    model = build_model(net.compose())
    whole = run(Monolithic(model, NativeInstance(model)), options)
    members = []
    for name, part in net.declared.items():
        (path,) = export(build_model(replace(part, name=name)), tmp_path, ("3.0",), step=1e-2, tunable=["k"])
        members.append(FMUMember(name, FMUInstance(path)))
    apart = run(Coupled(net, members), options)
    np.testing.assert_allclose(apart.time, whole.time, rtol=1e-15)
    for name in ("a.q", "c.q"):
        np.testing.assert_allclose(apart.column(name), whole.column(name), atol=1e-12)
    told, found = whole.ledger.summary(), apart.ledger.summary()
    assert told.closed and found.closed and found.events == {"parameter": 2} == told.events
    jumps = [{c.component: c.jumps for c in s.components if c.jumps} for s in (told, found)]
    assert jumps[0].keys() == jumps[1].keys() == {"a", "b"}
    assert all(jumps[1][c] == pytest.approx(jumps[0][c], rel=1e-9) for c in jumps[0])


@pytest.fixture(scope="module", params=["2.0", "3.0"])
def scheduled(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    events = [UnitEvent(e.t, e.name, e.value) for e in EVENTS]
    model = build_model(fed_inside(oscillator(), [e.name for e in events]))
    (path,) = export(model, tmp_path_factory.mktemp("s"), (request.param,), step=1e-2, events=events)
    return path


def test_a_unit_lands_on_its_events_within_a_communication_step(scheduled: Path) -> None:
    """Steps of 0.3 s with events at 0.2, 0.4 and 0.7 s give what a run that lands on them gives, in every book."""
    whole, names = reference(), ["q", "v", "energy.stored", "energy.supplied", "energy.dissipated", "flange.energy"]
    assert validate_fmu(str(scheduled)) == []
    with FMUInstance(scheduled) as unit:
        assert unit.inputs == [] and unit.variable("flange.force").causality == "parameter"
        energy, kept = 0.0, unit.get_state()
        for i in range(3):
            kept = unit.get_state()
            unit.do_step(0.3 * i, 0.3)
            row = int(np.argmin(np.abs(whole.time - 0.3 * (i + 1))))
            wanted = [whole.column(n)[row] for n in names]
            np.testing.assert_allclose(unit.get(names), wanted, rtol=1e-11, atol=1e-13)
            step = unit.get([f"energy.{n}_step" for n in ("stored", "supplied", "dissipated")])
            assert step[0] + step[2] == pytest.approx(step[1], abs=1e-13)
            energy += step[1]
        assert energy == pytest.approx(unit.get(["energy.supplied"])[0], rel=1e-12)
        jump = whole.ledger.summary().components[0].jumps
        assert unit.get(["energy.events"])[0] == pytest.approx(jump, rel=1e-10)
        assert abs(unit.get(["energy.gap"])[0]) < 1e-13
        last = unit.values()
        unit.set_state(kept)
        unit.do_step(0.6, 0.3)
        assert unit.values() == last
        unit.reset()
        for i in range(9):  # events on the grid of steps, too
            unit.do_step(0.1 * i, 0.1)
        np.testing.assert_allclose(unit.get(names), [whole.column(n)[-1] for n in names], rtol=1e-11, atol=1e-13)


def test_derivatives_of_a_step_end_at_an_event_in_it(tmp_path: Path) -> None:
    (path,) = export(build_model(oscillator()), tmp_path, ("3.0",), step=1e-2, events=[UnitEvent(0.015, "k", 90.0)])
    with FMUInstance(path) as unit:
        unit.do_step(0.0, 1e-2)
        assert unit.sensitivity().shape == (1, 1)
        unit.do_step(1e-2, 1e-2)
        with pytest.raises(StepFailure) as failure:
            unit.sensitivity()
        assert failure.value.status is Status.NO_SENSITIVITY and "parameters changed" in str(failure.value)
        unit.do_step(2e-2, 1e-2)
        assert unit.sensitivity().shape == (1, 1)


def test_the_command_line_builds_events_in_or_names_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("s.py").write_text("from tests.fmu.test_unit_events import pushed\n")
    assert main("export s.py:pushed --fmi 3 --events inside --set d=0.7".split()) == 0
    said = capsys.readouterr()
    assert said.err == "phfmu: --set wins over the scene's event d = 0.4 at t = 0 s\n"
    page = Path("page.html")
    with FMUInstance(said.out.strip()) as unit:
        assert unit.variable("d").start == 0.7 and set(unit.tunable) == {"k", "flange.force"}
    import zipfile

    page.write_bytes(zipfile.ZipFile(said.out.strip()).read("documentation/index.html"))
    assert "<li>t = 0.4 s: k = 90</li>" in page.read_text()
    assert main("export s.py:pushed --fmi 3 -o out".split()) == 0
    said = capsys.readouterr()
    assert said.err.splitlines() == [
        "phfmu: not in the unit: event at t = 0.2 s, flange.force = 3: set this input at that time",
        "phfmu: not in the unit: event at t = 0.4 s, k = 90: set this tunable parameter at that time",
        "phfmu: not in the unit: event at t = 0.7 s, flange.force = -1: set this input at that time",
    ]
    with FMUInstance(said.out.strip()) as unit:
        assert unit.variable("d").start == 0.4 and unit.tunable == ["k"]  # the event at 0 s is the start
    assert main("export mass --fmi 3 -o out --tunable kk".split()) == 2
    assert "no parameter 'kk'" in capsys.readouterr().err
