"""What is read of an audit: windows, single tables, units, percent, alarms, CSV; how much of it a run keeps."""

from __future__ import annotations

import csv
import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phfmu import (
    Coupled,
    EngineMember,
    Event,
    Monolithic,
    NativeInstance,
    Network,
    Options,
    PythonInstance,
    Scene,
    build_model,
    run,
)
from phfmu.audit import AuditWriter, audit_table, summarise
from phfmu.audit.alarms import Alarms, alarms
from phfmu.audit.log.window import Window
from phfmu.audit.summing import sums
from phfmu.audit.tables.sheets import Scale, fitting, flowed, shares, sheets
from phfmu.cli import main
from phfmu.components.mechanical.translational import mass, spring


def carts() -> Scene:
    """Two carts on a spring that becomes softer at 0.5 s; one is pushed from 0.25 s on."""
    net = Network("carts")
    net.add("a", mass(1.0, k=40.0, d=0.5, q=0.1))
    net.add("b", spring(30.0))
    net.add("c", mass(2.0, k=10.0))
    net.connect("a.flange", "b.a", name="left")
    net.connect("b.b", "c.flange", name="right")
    return Scene("carts", net, 1.0, 1e-2, (Event(0.5, "b.k", 10.0), Event(0.75, "a.k", 20.0)))


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any]:
    """An audit file, and the run of it."""
    scene, path = carts(), tmp_path_factory.mktemp("audit") / "carts.audit.parquet"
    model = build_model(scene.declaration())
    with AuditWriter(path) as sink:
        result = run(
            Monolithic(model, PythonInstance(model)), Options(stop=1.0, step=1e-2, events=scene.events, sink=sink)
        )
    return path, result


def test_a_window_has_the_sums_of_its_steps(log: tuple[Path, Any]) -> None:
    path, result = log
    part = summarise(path, window=Window(0.25, 0.6))
    assert part.closed and part.steps == 35 and part.events == {"parameter": 1}
    rows = [int(np.argmin(np.abs(result.time - t))) for t in (0.25, 0.6)]

    def change(name: str) -> float:
        column = result.column(name)
        return float(column[rows[1]] - column[rows[0]])

    for c in part.components:
        assert c.dissipated == pytest.approx(change(f"{c.component}.energy.dissipated"), abs=1e-15)
        assert c.supplied == pytest.approx(change(f"{c.component}.energy.supplied"), abs=1e-13)
        assert c.H_start == pytest.approx(result.column(f"{c.component}.energy.stored")[rows[0]], rel=1e-12)
        assert c.stored + (c.jumps or 0.0) == pytest.approx(c.H_end - c.H_start, abs=1e-13)
    ports = {f"{p.component}.{p.port}": p.supplied for p in part.ports}
    assert ports["a.flange"] == pytest.approx(change("a.flange.energy"), abs=1e-13)
    halves = [summarise(path, window=w) for w in (Window(end=0.5), Window(0.5))]
    assert [h.steps for h in halves] == [50, 50]
    with pytest.raises(ValueError, match="the start must be before the end"):
        Window(2.0, 1.0)


def test_the_verdict_of_a_window_is_that_of_the_log(log: tuple[Path, Any]) -> None:
    """A step that violates the ledger is told, also where it lies outside the window."""
    path, _ = log
    bad = summarise(path, 0.0)
    assert summarise(path, 0.0, Window(0.9)).violations == bad.violations


def test_the_command_line_shows_and_exports_one_table(
    log: tuple[Path, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    path, result = log
    assert main(["audit", str(path), "--by", "port", "--export", "csv", "--unit", "mJ"]) == 0
    rows = list(csv.DictReader(io.StringIO(capsys.readouterr().out)))
    assert list(rows[0]) == ["port", "supplied [mJ]", "junction"]
    told = {p.component + "." + p.port: p.supplied for p in result.ledger.summary().ports}
    assert {r["port"]: float(r["supplied [mJ]"]) / 1e3 for r in rows} == pytest.approx(told, rel=1e-15)
    assert main(["audit", str(path), "--by", "event", "--window", ":0.6"]) == 0
    text = capsys.readouterr().out
    assert "b.k = 10" in text and "a.k" not in text and "H start" not in text
    assert main(["audit", str(path), "--by", "junction", "--percent"]) == 0
    text = capsys.readouterr().out
    total = flowed(result.ledger.summary())
    assert f"Energy in percent of {total:.4g} J" in text and "left" in text
    assert main(["audit", str(path), "--export", "csv"]) == 2
    assert "say which with --by" in capsys.readouterr().err
    assert main(["audit", str(path), "--window", "0.5"]) == 2
    assert "expected A:B in s" in capsys.readouterr().err


def test_only_what_a_run_has_is_shown(log: tuple[Path, Any]) -> None:
    summary = log[1].ledger.summary()
    headers = {s.title: [c.header for c in s.columns] for s in sheets(summary)}
    assert "jumps" in headers["component"] and "numerical" not in headers["component"]
    network = next(s for s in sheets(summary) if s.title == "network")
    brought = dict((r[0], r[1]) for r in network.rows)["brought by events"]
    assert brought == pytest.approx(sum(c.jumps or 0.0 for c in summary.components), rel=1e-15) and brought < 0.0
    assert "supplied through estimated ports" not in [r[0] for r in network.rows]
    model = build_model(mass(1.0, k=4.0, q=0.1))
    alone = run(Monolithic(model, PythonInstance(model)), Options(stop=0.1, step=1e-2)).ledger.summary()
    free = {s.title: [c.header for c in s.columns] for s in sheets(alone)}
    assert free["component"] == ["component", "H start", "H end", "stored", "of allowance", "verdict"]
    assert "junction" not in free and "brought by events" not in audit_table(alone)


def test_units_and_percent() -> None:
    model = build_model(mass(2e6, k=4e6, q=1.0))
    summary = run(Monolithic(model, PythonInstance(model)), Options(stop=0.1, step=1e-2)).ledger.summary()
    assert fitting(summary) == "MJ" and shares(summary).whole == pytest.approx(2e6)
    assert "Energy in MJ" in audit_table(summary, scale=Scale("MJ"))
    assert Scale("MWh").of(3.6e9) == 1.0 and Scale(whole=4.0).of(1.0) == 25.0


@pytest.mark.parametrize("unit", ["MJ", "J", "auto"])
def test_a_unit_and_percent_are_refused_together(
    unit: str, log: tuple[Path, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["audit", str(log[0]), "--unit", unit, "--percent"]) == 2
    said = capsys.readouterr()
    assert not said.out and f"--unit {unit}" in said.err and "leave one of them out" in said.err


def test_alarms_come_before_violations(log: tuple[Path, Any]) -> None:
    summary = log[1].ledger.summary()
    assert list(alarms(summary, Alarms())) == []
    worst = max(summary.components, key=lambda c: c.worst_ratio)
    lines = list(alarms(summary, Alarms(residual=0.9 * worst.worst_ratio, junction=1.0)))
    assert len(lines) >= 1 and any(
        line.startswith(f"warning: {worst.component}: step {worst.worst_step}") for line in lines
    )
    made = replace(summary, junctions=[replace(j, residual=1e-3 * (j.exchanged or 0.0)) for j in summary.junctions])
    assert sum("created" in line for line in alarms(made, Alarms(1.0, 1e-4))) == 2


def test_a_junction_through_which_nothing_passes_is_closed() -> None:
    """Twins move alike: the spring between them holds 1e-30 J, which is rounding of what the twins hold."""
    net = Network("twins")
    for name in "ab":
        net.add(name, mass(1.0, k=4.0, q=0.1))
    net.add("s", spring(16.0))
    net.connect("a.flange", "s.a", name="left")
    net.connect("s.b", "b.flange", name="right")
    model = build_model(net.compose())
    members: list[Any] = [
        EngineMember(n, m, NativeInstance(m))
        for n, m in ((n, build_model(replace(d, name=n))) for n, d in net.declared.items())
    ]
    for stepper in (Monolithic(model, NativeInstance(model)), Coupled(net, members)):
        summary = run(stepper, Options(stop=2.0, step=1e-2)).ledger.summary()
        held = next(c for c in summary.components if c.component == "s")
        assert held.H_end < 1e-28 and summary.closed, summary.worst


def test_a_junction_that_creates_energy_is_found_beside_quiet_ones() -> None:
    """The rounding that members explain is far below a coupling's error."""
    from phfmu.audit import Booking, Ledger, PortKey
    from phfmu.outcome.steps import Steps

    ports = (PortKey("a", "p", junction="j"), PortKey("b", "p", junction="j"))
    for error, closed in ((1e-16, True), (1e-9, False)):
        ledger, pairs = Ledger(), np.array([[1e-12 + error, -1e-12]])
        stored = pairs.copy()
        ledger.add(Booking(("a", "b"), ports), 0, 0.0, 0.1, Steps(H=np.ones((1, 2)) + stored, stored=stored,
                   dissipated=np.zeros((1, 2)), supplied=pairs, pairs=pairs, moved=np.ones((1, 2))), np.ones((1, 2)))  # fmt: skip
        assert ledger.summary().closed is closed


def test_how_much_a_run_keeps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("s.py").write_text("from tests.audit.test_audit_views import carts\n")
    assert main("run s.py:carts --engine python --stop 0.05 --audit none".split()) == 0
    none = capsys.readouterr().out
    assert "Energy in" not in none and "5 steps" in none
    assert main("run s.py:carts --engine python --stop 0.05 --audit summary".split()) == 0
    assert "Energy in joule" in capsys.readouterr().out and not list(Path().glob("*.parquet"))
    assert main("run s.py:carts --engine python --stop 0.05 --audit full".split()) == 0
    assert Path("carts.audit.parquet").is_file()
    assert summarise("carts.audit.parquet").steps == 5


def test_a_table_without_rows_says_so(log: tuple[Path, Any], capsys: pytest.CaptureFixture[str]) -> None:
    """A composed run has no parts of junctions: a line, and as CSV the header that programs read."""
    assert main(["audit", str(log[0]), "--by", "part"]) == 0
    assert "there is no part in it" in capsys.readouterr().out
    assert main(["audit", str(log[0]), "--by", "part", "--export", "csv"]) == 0
    assert list(csv.reader(io.StringIO(capsys.readouterr().out))) == [
        ["junction", "part", "residual [J]", "worst step [J]"]
    ]
    assert main(["audit", str(log[0]), "--window", "0.9:", "--by", "event", "--export", "csv"]) == 0
    assert capsys.readouterr().out.startswith("event,t [s]")


@pytest.mark.usefixtures("compiler")
def test_compiled_sums_have_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of any size and sign, with what is no number, in rows of any cut; a run changes over after some steps."""
    rng = np.random.default_rng(0)
    x = rng.normal(size=(3000, 7)) * 10.0 ** rng.integers(-12, 12, (3000, 7))
    x[77, 3], x[900, 4] = np.inf, np.nan
    monkeypatch.setattr(sums, "_library", None)

    def found() -> list[np.ndarray]:
        own = [sums.CompensatedSum() for _ in range(7)]
        running = sums.extend(own, x).copy()
        sums.add(own, x[:700])
        ends = np.array([(s.high, s.low) for s in own])
        most = sums.largest_so_far([0.0, 1e9, *[0.0] * 5], np.abs(np.where(np.isfinite(x), x, 0.0)))
        return [running, ends, sums.across(x), sums.across_each(x, [[5, 0, 3], [], [1]]), most]

    by_arrays = found()
    sums.use_compiled()
    assert sums._library is not None
    for one, two in zip(by_arrays, found(), strict=True):
        np.testing.assert_array_equal(one, two)


def test_a_residual_is_told_as_a_share_of_what_is_allowed(log: tuple[Path, Any]) -> None:
    """No number that reads as an error: percent, with the words for it."""
    summary = log[1].ledger.summary()
    text = audit_table(summary)
    assert "of allowance" in text and "worst  " not in text.replace("worst step", "")
    share = next(c.worst_ratio for c in summary.components)
    assert f"{100.0 * share:.2g} %" in text


def test_percent_is_of_what_flowed_whatever_was_stored() -> None:
    """A loss of 1 J from 1e9 J that stay: 100 % are what left them, not what was there."""
    model = build_model(mass(1.0, k=4.0, d=2.0, q=1.0))
    summary = run(Monolithic(model, PythonInstance(model)), Options(stop=2.0, step=1e-2)).ledger.summary()
    (c,) = summary.components
    assert flowed(summary) == pytest.approx(-c.stored, rel=1e-12)
    much = replace(summary, components=[replace(c, H_start=c.H_start + 1e9, H_end=c.H_end + 1e9)])
    assert shares(much).whole == pytest.approx(c.dissipated, rel=1e-9)
    assert "which flowed" in audit_table(much, scale=shares(much))
