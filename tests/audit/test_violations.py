"""What violates the ledger, and what does not: steps, junctions, signs, values that are not numbers."""

import math
from pathlib import Path

import numpy as np
import pytest

from phfmu.audit import (
    AuditWriter,
    Booking,
    Ledger,
    LedgerSummary,
    PortKey,
    audit_table,
    read,
    summarise,
    verdict,
)
from tests.audit.arrays import add_blocks, book, run_arrays

# the verdict


def judged(arrays: dict[str, np.ndarray], path: Path | None = None, rtol: float = 1e-11) -> LedgerSummary:
    """The summary of a run; with a path, also that of its file is asked for and must be the same."""
    if path is None:
        ledger = Ledger(rtol=rtol)
        add_blocks(ledger, arrays, 30)
        return ledger.summary()
    with AuditWriter(path) as sink:
        ledger = Ledger(sink, rtol)
        add_blocks(ledger, arrays, 30)
    live, stored = ledger.summary(), summarise(path, rtol)
    assert str(live) == str(stored)  # NaN has no equal
    return stored


def kinds(summary: LedgerSummary) -> set[tuple[str, str]]:
    return {(v.kind, v.name) for v in summary.violations}


def test_verdict_finds_the_step_that_does_not_close(tmp_path: Path):
    arrays = run_arrays(100, leak=0.0)
    arrays["dissipated"][41, 1] += 1e-6
    summary = judged(arrays, tmp_path / "x.parquet")
    assert kinds(summary) == {("balance", "b"), ("unexplained", "network")}
    violation = summary.violations[0]
    assert (violation.step, violation.t0, violation.steps) == (41, pytest.approx(1.41), 1)
    assert violation.size == pytest.approx(1e-6, rel=1e-6)
    assert 1e-11 * 5 < violation.allowed < 1e-11 * 30  # |H| is 10 J, ports pass some J
    table = read(tmp_path / "x.parquet")
    assert verdict(table) == verdict(tmp_path / "x.parquet") == summary.violations
    assert verdict(table, rtol=1e-5) == []
    text = audit_table(table)
    assert "b: step 41 at t = 1.41 s misses 1.000e-06 J" in text
    assert "VIOLATED" in text
    assert "VIOLATED" not in audit_table(table, rtol=1e-5)


def test_dissipation_is_not_negative(tmp_path: Path):
    """A resistance that creates 1 mJ closes the balance: the loss is what it is booked as."""
    arrays = run_arrays(100, leak=0.0)
    arrays["dH"][41, 1] += arrays["dissipated"][41, 1] + 1e-3
    arrays["dissipated"][41, 1] = -1e-3
    arrays["H"] = 10.0 + np.cumsum(arrays["dH"], axis=0)
    summary = judged(arrays, tmp_path / "x.parquet")
    assert kinds(summary) == {("dissipation", "b")}
    assert (summary.violations[0].step, summary.violations[0].size) == (41, -1e-3)
    assert [c.verdict for c in summary.components] == ["closed", "VIOLATED"]
    assert "b: step 41 at t = 1.41 s dissipates -1.000e-03 J" in audit_table(summary)
    arrays["dissipated"][41, 1] = -1e-14  # rounding
    arrays["dH"][41, 1] -= 1e-3
    arrays["H"] = 10.0 + np.cumsum(arrays["dH"], axis=0)
    assert judged(arrays).closed


def test_ports_and_books_must_agree(tmp_path: Path):
    """A unit whose ports say twice what its books say."""
    arrays = run_arrays(50, leak=0.0)
    arrays["port_energy"][7, 3] += 2.93  # b.field, at no junction
    summary = judged(arrays, tmp_path / "x.parquet")
    assert kinds(summary) == {("ports", "b"), ("unexplained", "network")}
    assert summary.violations[0].size == pytest.approx(-2.93, rel=1e-9)
    assert summary.network is not None
    assert (summary.components[1].verdict, summary.network.verdict) == ("VIOLATED", "VIOLATED")


def test_a_junction_that_creates_energy_violates(tmp_path: Path):
    summary = judged(run_arrays(50, leak=1e-3), tmp_path / "x.parquet")
    assert kinds(summary) == {("junction", "bus")}
    assert summary.junctions[0].verdict == "VIOLATED"
    assert "bus: step" in audit_table(summary)


@pytest.mark.parametrize("offset", [0.0, 1e10])
def test_a_constant_in_H_hides_nothing(tmp_path: Path, offset: float):
    """19 J made in 1000 steps beside an energy of 1e10 J that stays."""
    arrays = run_arrays(1000, leak=0.0)
    arrays["moved"] = np.abs(arrays["dH"])
    arrays["H"] = arrays["H"] + offset
    arrays["H0"] = np.vstack([[10.0 + offset, 10.0 + offset], arrays["H"][:-1]])
    assert judged(arrays, tmp_path / "x.parquet").closed
    arrays["dH"][:, 0] += 0.019
    arrays["H"][:, 0] += 0.019 * np.arange(1, 1001)
    arrays["H0"][1:] = arrays["H"][:-1]
    summary = judged(arrays, tmp_path / "y.parquet")
    assert kinds(summary) == {("balance", "a"), ("unexplained", "network")}
    assert summary.violations[0].steps == 1000


def test_coming_to_rest_is_not_a_violation(tmp_path: Path):
    """Energies fade to 1e-30 J while residuals stay at the rounding of those that were: eps times 10 J."""
    n = 2000
    energy = 10.0 * np.exp(-0.04 * np.arange(n + 1))
    lost = -np.diff(energy) + 1e-15 * np.random.default_rng(1).uniform(-1, 1, n)
    arrays = {"step": np.arange(n), "t0": 0.01 * np.arange(n), "h": np.full(n, 0.01), "H": energy[1:, None]}
    arrays |= {"dH": np.diff(energy)[:, None], "dissipated": lost[:, None], "moved": -np.diff(energy)[:, None]}
    with AuditWriter(tmp_path / "x.parquet") as sink:
        ledger = Ledger(sink)
        book(ledger, Booking(("pendulum",)), **arrays)
    assert ledger.summary().closed
    assert ledger.summary() == summarise(tmp_path / "x.parquet")
    arrays["dissipated"][1500] += 1e-11
    broken = Ledger()
    book(broken, Booking(("pendulum",)), **arrays)
    assert [v.step for v in broken.summary().violations if v.kind == "balance"] == [1500]


def test_H_that_changes_without_being_booked_is_found(tmp_path: Path):
    """Between two steps, within one, and slowly beside a constant that hides a single step."""
    jump = run_arrays(100, leak=0.0)
    jump["H"][60:, 0] += 0.5
    jump["H0"] = np.vstack([[10.0, 10.0], jump["H"][:-1]])
    jump["H0"][60, 0] += 0.5
    summary = judged(jump, tmp_path / "jump.parquet")
    assert kinds(summary) == {("gap", "a")}
    assert (summary.violations[0].step, summary.components[0].gap) == (60, pytest.approx(0.5))
    within = run_arrays(100, leak=0.0)
    within["H"][60:, 0] += 0.5
    within["H0"] = np.vstack([[10.0, 10.0], within["H"][:-1]])
    assert kinds(judged(within, tmp_path / "within.parquet")) == {("change", "a")}
    slow = run_arrays(5000, leak=0.0)
    slow["H"][:, 0] += 1e10 + 1e-5 * np.arange(5000)
    slow["H0"] = np.vstack([[1e10 + 10.0, 10.0], slow["H"][:-1]])
    slow["moved"] = np.abs(slow["dH"])
    summary = judged(slow, tmp_path / "slow.parquet")
    assert kinds(summary) == {("drift", "a")}
    assert summary.components[0].gap == pytest.approx(0.05, rel=1e-2)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize("column", ["dH", "H", "dissipated", "supplied", "port_energy"])
def test_what_is_not_a_number_is_a_violation(tmp_path: Path, column: str, bad: float):
    arrays = run_arrays(3, leak=0.0)
    arrays[column][1, 0] = bad
    summary = judged(arrays, tmp_path / "x.parquet")
    assert summary.components[0].verdict == "VIOLATED"
    assert summary.components[1].verdict == "closed"
    assert "VIOLATED" in audit_table(summary)


def test_energies_that_pass_within_a_component_count(tmp_path: Path):
    """Terms of +-1 J cancel in dH, H is 0: a residual of 1e-12 J is rounding, and only `moved` can say so."""
    small = {"h": 1.0, "H0": [[0.0, 0.0]], "H": [[1e-12, 1e-12]], "dH": [[1e-12, 1e-12]]}
    with AuditWriter(tmp_path / "x.parquet") as sink:
        ledger = Ledger(sink)
        book(ledger, Booking(("a", "b")), step=[0], t0=[0.0], **small, moved=[[0.0, 2.0]])
        book(ledger, Booking(("rest",)), step=[1], t0=[1.0], h=1.0, H=[[0.0]], dH=[[0.0]])
    assert {v.name for v in verdict(read(tmp_path / "x.parquet"))} == {"a"}


def test_estimated_ports_are_not_judged(tmp_path: Path):
    booking = Booking(("a",), (PortKey("a", "p", quality="estimated"),))
    half = {"supplied": [[0.5]], "port_energy": [[0.5]]}
    with AuditWriter(tmp_path / "x.parquet") as sink:
        book(Ledger(sink), booking, step=[0], t0=[0.0], h=1.0, H=[[1.0]], dH=[[0.0]], **half)
    table = read(tmp_path / "x.parquet")
    assert verdict(table) == []
    assert "estimated" in audit_table(table) and "closed" not in audit_table(table)


def test_a_unit_without_ports_and_books_has_no_verdict(tmp_path: Path):
    arrays = {"step": [0], "t0": [0.0], "h": 0.1, "H": [[0.0]], "dH": [[0.0]]}
    with AuditWriter(tmp_path / "x.parquet") as sink:
        ledger = Ledger(sink)
        book(ledger, Booking(("foreign",), silent=frozenset({"foreign"})), **arrays)
    summary = ledger.summary()
    assert summary.network is not None
    assert (summary.components[0].verdict, summary.network.verdict) == ("none", "none")
    assert "closed" not in audit_table(summary)
    assert summarise(tmp_path / "x.parquet") == summary


def test_names_in_a_log_are_text_on_a_terminal():
    """Control characters would move the cursor, and make up rows of the table."""
    ledger = Ledger()
    component = "a\x1b[31m\nb  closed"
    book(ledger, Booking((component,)), step=[0], t0=[0.0], h=0.1, H=[[0.0]], dH=[[1.0]])
    lines = audit_table(ledger.summary()).splitlines()
    assert all(line.isprintable() for line in lines)
    assert any(line.startswith(r"a\x1b[31m\nb  closed ") and line.endswith("VIOLATED") for line in lines)


def test_a_log_without_a_column_of_steps_is_no_log(tmp_path: Path):
    with AuditWriter(tmp_path / "x.parquet") as sink:
        ledger = Ledger(sink)
        book(ledger, Booking(("a",)), step=[0], t0=[0.0], h=0.1, H=[[0.0]], dH=[[0.0]])
    table = read(tmp_path / "x.parquet").drop_columns(["step"])
    with pytest.raises(ValueError, match="not an audit log: it has no column step"):
        summarise(table)


def test_energy_that_changes_between_steps_is_reported():
    """An event books what it added before the step that follows it."""
    for booked in (False, True):
        ledger = Ledger()
        book(ledger, Booking(("a",)), step=[0], t0=[0.0], h=1.0, H=[[1.0]], dH=[[0.0]])
        if booked:
            ledger.event(1.0, "impulse", "a", energy_jump=-0.5)
        book(ledger, Booking(("a",)), step=[1], t0=[1.0], h=1.0, H=[[0.5]], dH=[[0.0]])
        assert ("no event books it" in audit_table(ledger.summary())) is not booked
        assert ledger.summary().closed is booked


def test_one_event_that_changes_several_components_counts_once(tmp_path: Path):
    """Rows hold the energy per component; the table counts what happened."""
    with AuditWriter(tmp_path / "x.parquet") as sink:
        ledger = Ledger(sink)
        add_blocks(ledger, run_arrays(1, leak=0.0), 1)
        for t in (1.01, 1.02):
            ledger.event(t, "parameter", "a", 0.0, "k = 3")
            ledger.event(t, "parameter", "b", 0.0, "k = 3")
        ledger.event(1.02, "parameter", "b", 0.0, "k = 3")  # set again
        ledger.event(1.02, "input", message="u = 1")
        ledger.event(1.02, "input", message="u = 1")
    assert ledger.summary().events == {"parameter": 3, "input": 2}
    assert summarise(tmp_path / "x.parquet").events == ledger.summary().events
    assert "; 1 step from" in audit_table(ledger.summary())
