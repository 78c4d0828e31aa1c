"""Units with state events: landed on in a communication step, booked, in the saved state; nothing for an importer to do."""

from __future__ import annotations

import subprocess
import zipfile
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu

from phfmu import (
    PHDAE,
    Collocated,
    Event,
    FMUInstance,
    Guard,
    Jump,
    Monolithic,
    NativeInstance,
    Options,
    StateEvent,
    build_model,
    energy,
    export,
    parameter,
    run,
    skew,
    state,
)
from phfmu.cli import main
from phfmu.components.mechanical.translational import mass
from phfmu.components.scenes.electrical.breaker_opening import breaker_opening
from phfmu.components.scenes.mechanical.bouncing_ball import bouncing_ball
from phfmu.fmu.export import sources
from phfmu.fmu.export.description import ExportedUnit
from phfmu.fmu.export.schedule import UnitEvent, fed_inside
from phfmu.fmu.export.variables import FMUError
from phfmu.fmu.importer.refusal import UnitFailure
from tests.fmu.exported import needs_cc

VERSIONS = ("2.0", "3.0")
HERE = Path(__file__).parent
H, OPENED, LINE = 2.0**-7, 80 * 2.0**-12, 2.0**-12


@pytest.fixture(scope="module")
def ball() -> Any:
    return build_model(bouncing_ball().declaration(), Collocated(2))


@pytest.fixture(scope="module")
def breaker() -> Any:
    declaration = breaker_opening(OPENED, chop=0.5).declaration()
    return build_model(fed_inside(declaration, ["line.command"]), Collocated(2))


@pytest.fixture(scope="module")
def units(ball: Any, breaker: Any, tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, str], Path]:
    folder = tmp_path_factory.mktemp("units")
    balls = export(ball, folder, VERSIONS, step=H, stop=6.0)
    event = [UnitEvent(OPENED, "line.command", 0.0)]
    breakers = export(breaker, folder, VERSIONS, step=LINE, stop=160 * LINE, events=event)
    return {
        (n, v): p for n, paths in (("ball", balls), ("breaker", breakers)) for v, p in zip(VERSIONS, paths, strict=True)
    }


def composed(model: Any, h: float, n: int, events: Any = ()) -> Any:
    return run(Monolithic(model, NativeInstance(model)), Options(stop=n * h, step=h, events=events))


@pytest.mark.parametrize("version", VERSIONS)
def test_a_unit_is_the_composed_run_bit_for_bit_until_the_ball_rests(
    ball: Any, units: dict[tuple[str, str], Path], version: str
) -> None:
    n = int(6.0 / H)
    whole = composed(ball, H, n)
    end = {t: i for i, t in enumerate(whole.time)}  # the row after the events of an instant
    q, p = whole.column("q"), whole.column("p")
    with FMUInstance(units["ball", version]) as unit:
        assert validate_fmu(str(units["ball", version])) == []
        (H0,) = unit.get(["energy.stored"])
        assert unit.get(["events.count", "events.last", "mode.flight"]).tolist() == [0.0, 0.0, 1.0]
        for k in range(n):
            unit.do_step(k * H, H)
            i = end[(k + 1) * H]
            assert unit.get(["q", "p"]).tolist() == [q[i], p[i]]
        count, last, mode, jumped, gap, residual, stored = unit.get(
            [
                "events.count",
                "events.last",
                "mode.flight",
                "energy.events",
                "energy.gap",
                "energy.residual",
                "energy.stored",
            ]
        )
    notes = [note for note in whole.notes if "floor" in note]
    assert count == len(notes) and f"t = {last:.12g} s" in notes[-1] and mode == 0.0
    lost = sum(float(note.rpartition("lost ")[2].removesuffix(" J")) for note in notes)
    assert jumped == pytest.approx(-lost, rel=1e-8) and abs(jumped + 9.81) < 1e-12  # all of m g h
    assert abs(gap) < 1e-13 and abs(residual) < 1e-13
    assert stored - H0 == pytest.approx(jumped, rel=1e-13)


@pytest.mark.parametrize("version", VERSIONS)
def test_a_breaker_opens_in_a_unit_as_in_the_composed_run(
    breaker: Any, units: dict[tuple[str, str], Path], version: str
) -> None:
    """A command inside the unit, then each pole at its current zero: bits, poles, and the energy of the chopped currents."""
    whole = composed(breaker, LINE, 160, (Event(OPENED, "line.command", 0.0),))
    end = {t: i for i, t in enumerate(whole.time)}
    names = [n for v in breaker.declaration.states for n in v.names()]
    modes = [f"mode.line.closed[{i}]" for i in (1, 2, 3)]
    with FMUInstance(units["breaker", version]) as unit:
        for k in range(160):
            unit.do_step(k * LINE, LINE)
            i = end[(k + 1) * LINE]
            assert unit.get(names).tolist() == [whole.column(n)[i] for n in names]
            assert unit.get(modes).tolist() == [whole.column(n.removeprefix("mode."))[i] for n in modes]
        count, jumped, gap, residual, lost = unit.get(
            ["events.count", "energy.events", "energy.gap", "energy.residual", "events.lost"]
        )
    summary = whole.ledger.summary()
    assert count == summary.events["state"] == 3.0
    assert jumped == pytest.approx(sum(c.jumps or 0.0 for c in summary.components), rel=1e-12) and jumped < 0
    assert lost == pytest.approx(-jumped, rel=1e-12)
    assert abs(gap) < 1e-13 and abs(residual) < 1e-13  # of joules that were stored


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("name", ["ball", "breaker"])
def test_fmpy_runs_it_without_knowing(units: dict[tuple[str, str], Path], name: str, version: str) -> None:
    """A plain importer: the end of the run, and modes as columns that change at the events."""
    path = units[name, version]
    h, n, mode, state_ = (
        (H, 256, "mode.flight", "q") if name == "ball" else (LINE, 160, "mode.line.closed[1]", "line.flux[1]")
    )
    rows = fmpy.simulate_fmu(
        str(path), stop_time=n * h, output_interval=h, output=[mode, state_, "events.count", "energy.events"]
    )
    with FMUInstance(path) as unit:
        for k in range(n):
            unit.do_step(k * h, h)
        assert [rows[-1][c] for c in (mode, state_, "events.count", "energy.events")] == unit.get(
            [mode, state_, "events.count", "energy.events"]
        ).tolist()
    count = rows["events.count"]
    assert (np.diff(count) >= 0).all() and count[0] == 0 and count[-1] >= 2


@pytest.mark.parametrize("version", VERSIONS)
def test_a_step_back_across_an_event_gives_the_same_bits(units: dict[tuple[str, str], Path], version: str) -> None:
    """The state block has modes, books and counts, also as bytes in another instance."""
    with FMUInstance(units["breaker", version]) as unit, FMUInstance(units["breaker", version]) as other:
        k = 0
        while unit.get(["events.count"])[0] < 2:
            before = unit.get_state()
            unit.do_step(k * LINE, LINE)
            k += 1
        after = unit.values()
        for _ in range(5):
            unit.do_step(k * LINE, LINE)
            k += 1
        later = unit.values()
        unit.set_state(before)
        assert unit.get(["events.count", "mode.line.closed[1]"]).tolist() != [
            later["events.count"],
            later["mode.line.closed[1]"],
        ]
        other.set_state(other.deserialize(unit.serialize(before), like=other.get_state()))
        for u in (unit, other):
            u.do_step((k - 6) * LINE, LINE)
            assert u.values() == after
            for i in range(5):
                u.do_step((k - 5 + i) * LINE, LINE)
            assert u.values() == later


def falling(**changes: Any) -> PHDAE:
    """A ball that is caught: it stops at the floor where it is slow enough."""
    q, p = state("q", unit="m", start=1.0), state("p", unit="kg.m/s")
    most, flight = parameter("most", 1e9), parameter("flight", 1.0)
    return PHDAE(
        "falling",
        states=(q, p),
        parameters=(flight, most),
        energies=(energy(p**2 / 2), energy(9.81 * q)),
        structure=(skew(q, p, flight.sx),),
        state_events=(StateEvent(Guard("floor", q, -1, unit="m"), jump=Jump({p: 1.0}, 0.0, **changes)),),
    )


@pytest.mark.parametrize("version", VERSIONS)
def test_an_event_that_cannot_happen_discards_the_step(tmp_path: Path, version: str) -> None:
    """With its name and numbers; the unit is where the step began and can go on from there."""
    (path,) = export(build_model(falling(most=0.5)), tmp_path, (version,), step=0.1)
    with FMUInstance(path) as unit:
        for k in range(4):
            unit.do_step(k * 0.1, 0.1)
        before = unit.values()
        with pytest.raises(UnitFailure, match="'floor': it would jump with .c. = 4.42945, more than its most = 0.5"):
            unit.do_step(0.4, 0.1)
        assert unit.values() == before
        with pytest.raises(UnitFailure, match="was discarded before, with the same inputs"):
            unit.do_step(0.4, 0.1)  # as importers do that take a discard for a pause
        unit.do_step(0.4, 0.01)


def test_a_unit_of_fmi_3_may_return_early_at_an_event(ball: Any, units: dict[tuple[str, str], Path]) -> None:
    """Where the importer allows it; the rest of the step gives the bits of the whole one."""
    path = units["ball", "3.0"]
    with FMUInstance(path) as whole, FMUInstance(path, early_return=True) as early:
        returns = []
        for k in range(2 * 128):
            whole.do_step(k * H, H)
            t = k * H
            while t < (k + 1) * H:
                reached = early.do_step(t, (k + 1) * H - t)
                if reached < (k + 1) * H:
                    returns.append(reached)
                    assert early.get(["events.last", "time"]).tolist() == [reached, reached]
                t = reached
            assert early.get(["q", "p", "events.count"]).tolist() == whole.get(["q", "p", "events.count"]).tolist()
    assert len(returns) == whole_count(ball) and returns[0] == pytest.approx((2 / 9.81) ** 0.5, abs=1e-14)


@needs_cc
def test_a_host_without_interpreter_goes_on_from_each_event(units: dict[tuple[str, str], Path], tmp_path: Path) -> None:
    """Early returns in C: at the impacts by hand, with height and speed there, and the end of the whole run to the bit."""
    path, n = units["ball", "3.0"], 256
    with zipfile.ZipFile(path) as archive:
        library = next(name for name in archive.namelist() if name.startswith("binaries/"))
        (tmp_path / "unit.so").write_bytes(archive.read(library))
    host = tmp_path / "host"
    command = ["cc", "-std=c11", "-isystem", str(sources.HEADERS), str(HERE / "fmu_host.c"), "-o", str(host), "-ldl"]
    subprocess.run(command, check=True)
    names = ["time", "q", "p", "events.count", "events.last", "energy.events", "energy.gap", "energy.residual"]
    with FMUInstance(path) as unit:
        about = unit.interface
        for k in range(n):
            unit.do_step(k * H, H)
        whole = unit.get(names[:5]).tolist()
    references = [str(about.variables[name].reference) for name in names]
    command = [str(host), str(tmp_path / "unit.so"), "3.0-events", about.token, repr(H), str(n), "-1", "0", "-"]
    done = subprocess.run([*command, *references], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    printed = np.array([float(line) for line in done.stdout.split()])
    returns, end = printed[: -len(names)].reshape(3, 1 + len(names)), printed[-len(names) :]
    impacts, t, v = [], (2 / 9.81) ** 0.5, (2 * 9.81) ** 0.5
    for _ in range(3):
        v *= 0.8
        impacts.append([t, t, 0.0, v, len(impacts) + 1, t, v**2 / 2 - 9.81, 0.0, 0.0])
        t += 2 * v / 9.81
    assert returns == pytest.approx(np.array(impacts), abs=2e-12)
    assert (returns[:, 0] == returns[:, 1]).all() and (returns[:, 0] == returns[:, 5]).all()
    assert end[:5].tolist() == whole and abs(end[6:]).max() < 1e-13


def whole_count(model: Any) -> int:
    return len([n for n in composed(model, H, 2 * 128).notes if "floor" in n])


def test_modes_are_local_and_discrete_and_set_before_the_start_only(
    units: dict[tuple[str, str], Path], ball: Any
) -> None:
    path = units["ball", "3.0"]
    with FMUInstance(path, starts={"mode.flight": 0.0}) as resting:
        resting.do_step(0.0, 1.0)
        assert resting.get(["q", "mode.flight"]).tolist() == [1.0, 0.0]
        with pytest.raises(FMUError, match="'mode.flight' is fixed after initialization"):
            resting.set({"mode.flight": 1.0})
    with FMUInstance(path) as unit:
        about = unit.interface.variables
        assert "flight" not in about and about["mode.flight"].causality == "local"
        assert {about[n].variability for n in ("mode.flight", "events.count", "events.last")} == {"discrete"}
    with pytest.raises(FMUError, match="state events set flight, which cannot be tunable as well"):
        export(ball, path.parent, ("3.0",), step=H, tunable=["flight"])
    with pytest.raises(FMUError, match="do not go with inputs at the nodes"):
        export(ball, path.parent, ("3.0",), step=H, node_inputs=True)


def test_units_without_state_events_have_nothing_of_them() -> None:
    plain, guarded = (ExportedUnit(build_model(d), 0.1) for d in (mass(1.0, k=2.0), falling()))
    own = {*sources.fixed(guarded)} - {*sources.fixed(plain)}
    assert {"fmu_landing.c", "events.c", "event_step.c", "event_locate.c"} <= own
    assert "guards.c" in sources.generated(guarded) and "guards.c" not in sources.generated(plain)
    assert "landing" not in sources.interface_text(plain, "token")
    names = {v.name for v in plain.variables}
    assert not {"events.count", "events.last", "energy.events"} & names


@pytest.mark.slow
@needs_cc
def test_the_sources_compile_without_warnings_and_run_in_a_host_without_interpreter(
    ball: Any, units: dict[tuple[str, str], Path], tmp_path: Path
) -> None:
    path = units["ball", "3.0"]
    with zipfile.ZipFile(path) as archive:
        archive.extractall(tmp_path / "unit")
    files = sorted(p.name for p in (tmp_path / "unit/sources").glob("*.c"))
    options = [
        "-std=c11",
        "-Wall",
        "-Wextra",
        "-Werror",
        "-O1",
        "-fvisibility=hidden",
        "-ffp-contract=off",
        "-DPH_API=",
    ]
    options += ["-shared", "-fPIC", "-isystem", str(sources.HEADERS), "-o", str(tmp_path / "unit.so")]
    done = subprocess.run(
        ["cc", *options, *files, "-lm"], cwd=tmp_path / "unit/sources", capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    host = tmp_path / "host"
    command = ["cc", "-std=c11", "-isystem", str(sources.HEADERS), str(HERE / "fmu_host.c"), "-o", str(host), "-ldl"]
    subprocess.run(command, check=True)
    with FMUInstance(path) as unit:
        names = ["q", "p", "events.count", "events.last", "energy.events"]
        about = unit.interface
        for k in range(128):
            unit.do_step(k * H, H)
        expected = unit.get(names).tolist()
    command = [str(host), str(tmp_path / "unit.so"), "3.0", about.token, repr(H), "128", "-1", "0", "-"]
    done = subprocess.run(
        [*command, *(str(about.variables[n].reference) for n in names)], capture_output=True, text=True, check=True
    )
    assert [float(line) for line in done.stdout.split()] == expected


def test_export_and_run_of_the_unit_by_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", "bouncing_ball", "-o", str(tmp_path), "--fmi", "3", "--step", str(H)]) == 0
    path = tmp_path / "bouncing_ball_fmi3.fmu"
    assert main(["run", str(path), "--stop", "1", "-o", str(tmp_path / "a.csv")]) == 0
    assert "closed" in capsys.readouterr().out
