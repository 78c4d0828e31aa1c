"""Blame: net and gross energies of junctions and members, their causes, and sentences with a remedy."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from phfmu.audit import AuditWriter, Booking, Ledger, PortKey, summarise
from phfmu.audit.blame import EXTRAPOLATED, UNCONVERGED, blame, findings, why
from phfmu.audit.kinds import Quality
from phfmu.cli import main
from phfmu.outcome.steps import Steps
from tests.fmu.public_units import public
from tests.network.test_quarter_truck import CHASSIS, FINE, SCENE, WHEEL, made

N, H = 400, 0.01


def logged(path: Path, into: np.ndarray, tests: list[str] | None = None) -> Path:
    """A log of two members without books that meet at a junction; `into`: energies into them (N x 2) [J]."""
    ports = tuple(PortKey(m, "p", None, "bond", Quality.ESTIMATED) for m in ("motor", "spring"))
    booking = Booking(("motor", "spring"), ports, loose=True)
    supplied = into.copy()
    steps = Steps(
        H=np.cumsum(supplied, axis=0), stored=supplied, dissipated=np.zeros((N, 2)), supplied=supplied, pairs=into,
        accepted_by=None if tests is None else np.array(tests, object),
    )  # fmt: skip
    with AuditWriter(path) as sink:
        Ledger(sink).add(booking, np.arange(N), H * np.arange(N), np.full(N, H), steps)
    return path


def swinging(amplitude: float) -> np.ndarray:
    """Energies whose sum is -amplitude sin^2 of two swings: a store that gives and takes back."""
    W = -amplitude * np.sin(2.0 * np.pi * np.arange(N + 1) / N) ** 2
    return np.diff(W)


def test_signs_cancel_in_the_net_and_not_in_the_gross(tmp_path: Path) -> None:
    """Alternating +-2 J: 0 J net, 800 J gross; the ledger, its file and the tables say so."""
    made = 2.0 * (-1.0) ** np.arange(N)
    path = logged(tmp_path / "a.parquet", np.stack([made + 5.0, np.full(N, -5.0)], axis=1))
    (junction,) = summarise(path).junctions
    assert (junction.residual, junction.gross, junction.exchanged) == (0.0, 2.0 * N, 5.0 * N)
    assert [c.gross for c in summarise(path).components] == [5.0 * N, 5.0 * N]
    (found,) = blame(path).junctions
    assert (found.net, found.gross, found.members) == (0.0, 2.0 * N, ["motor", "spring"])
    assert found.causes == {EXTRAPOLATED: 2.0 * N}


def test_a_member_that_gives_without_an_end_is_named_with_the_time(tmp_path: Path) -> None:
    path = logged(tmp_path / "a.parquet", np.stack([np.full(N, -0.5), swinging(3.0)], axis=1))
    motor, spring = blame(path).members
    assert motor.component == "motor" and motor.makes and not spring.makes
    assert motor.least == pytest.approx(-0.5 * N) and motor.least_t == pytest.approx(N * H)
    assert spring.least == pytest.approx(-3.0) and spring.net == pytest.approx(0.0, abs=1e-12)
    told = why(blame(path))
    assert any("Member motor has given out 200 J" in s and "makes energy" in s for s in told)
    assert "Member spring" in told[-1] and "store of at least that" in told[-1]


@pytest.mark.parametrize(("begin", "rate"), [(0.0, 2.5), (0.0, 16.0), (0.6, 50.0)])
def test_a_store_that_empties_is_not_blamed(tmp_path: Path, begin: float, rate: float) -> None:
    """It gives ever less, over the whole run, or is empty before the last quarter: W = -(1 - exp(-rate (t - begin)))."""
    t = np.linspace(0.0, 1.0, N + 1)
    W = -(1.0 - np.exp(-np.maximum(t - begin, 0.0) * rate))
    path = logged(tmp_path / "a.parquet", np.stack([np.diff(W), swinging(3.0)], axis=1))
    members = {m.component: m for m in blame(path).members}
    assert members["motor"].least == pytest.approx(W[-1]) and not members["motor"].makes
    assert not any(f.accuses for f in findings(blame(path)))


def test_what_grows_is_blamed_and_what_swings_with_it_is_not(tmp_path: Path) -> None:
    """One makes exp(8 t) of energy, with which both stores swing: W = -exp(8 t) + swing, and a swing."""
    t = np.linspace(0.0, 1.0, N + 1)
    swing = np.exp(8.0 * t) * np.sin(40.0 * t) ** 2
    W = np.stack([-np.exp(8.0 * t) - swing, swing], axis=1)
    motor, spring = blame(logged(tmp_path / "a.parquet", np.diff(W, axis=0))).members
    assert motor.component == "motor" and motor.makes and not spring.makes


def told_otherwise(path: Path, factor: float) -> Path:
    """A log of two members with books, whose junction closes by what was exchanged, but one books `factor` times that."""
    ports = tuple(PortKey(m, "p", None, "bond") for m in ("motor", "spring"))
    booking = Booking(("motor", "spring"), ports, loose=True)
    made = np.stack([np.full(N, 1.0), np.full(N, -1.0)], axis=1)
    supplied = made * [1.0, factor]
    steps = Steps(
        H=np.cumsum(supplied, axis=0), stored=supplied, dissipated=np.zeros((N, 2)), supplied=supplied, pairs=supplied,
        exchanged=made,
    )  # fmt: skip
    with AuditWriter(path) as sink:
        ledger = Ledger(sink)
        ledger.add(booking, np.arange(N), H * np.arange(N), np.full(N, H), steps)
        assert ledger.summary().closed == (factor == 1.0)
    return path


@pytest.mark.parametrize("factor", [1.0, 1.001, -1.0])
def test_a_port_that_books_other_than_what_was_exchanged_comes_first(tmp_path: Path, factor: float) -> None:
    path = told_otherwise(tmp_path / "a.parquet", factor)
    found = summarise(path).violations
    assert [(v.name, v.steps) for v in found] == ([] if factor == 1.0 else [("spring.p", N)])
    told = findings(blame(path))
    if factor == 1.0:
        assert told == []
        return
    assert (told[0].subject, told[0].name, told[0].accuses) == ("member", "spring", True)
    assert told[0].text.startswith("Port spring.p: step 0 at t = 0 s passes") and f"({N} steps)" in told[0].text
    assert told[1].subject == "junction" and not told[1].accuses


def test_a_member_whose_balance_does_not_close_comes_before_what_the_coupling_made(tmp_path: Path) -> None:
    ports = tuple(PortKey(m, "p", None, "bond") for m in ("motor", "spring"))
    booking, into = (
        Booking(("motor", "spring"), ports, loose=True),
        np.stack([np.full(N, 6.0), np.full(N, -5.0)], axis=1),
    )
    stored = into * [1.0, 0.99]
    steps = Steps(H=np.cumsum(stored, axis=0), stored=stored, dissipated=np.zeros((N, 2)), supplied=into, pairs=into)
    with AuditWriter(tmp_path / "a.parquet") as sink:
        Ledger(sink).add(booking, np.arange(N), H * np.arange(N), np.full(N, H), steps)
    told = findings(blame(tmp_path / "a.parquet"))
    assert [(f.subject, f.name, f.accuses) for f in told] == [("member", "spring", True), ("junction", "bond", False)]
    assert "Member spring: step" in told[0].text and "misses" in told[0].text


def test_steps_that_were_given_up_are_told_apart(tmp_path: Path) -> None:
    """Of 400 steps that make 1 J each, 100 did not converge; the first cause is what the iteration left elsewhere."""
    tests = ["unconverged" if k % 4 == 0 else "energy" for k in range(N)]
    path = logged(tmp_path / "a.parquet", np.stack([np.full(N, 6.0), np.full(N, -5.0)], axis=1), tests)
    causes = blame(path).junctions[0].causes
    assert causes[UNCONVERGED] == N / 4 and sum(causes.values()) == N and EXTRAPOLATED not in causes


def test_why_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(logged(tmp_path / "a.parquet", np.stack([np.full(N, 6.0), np.full(N, -5.0)], axis=1)))
    assert main(["audit", path, "--why"]) == 0
    told = capsys.readouterr().out.splitlines()
    assert told[0].startswith("1. Member spring has given out 2e+03 J more than it was given by t = 4 s, and goes on")
    assert told[1].startswith("2. Junction bond of motor, spring made 400 J gross, 400 J net, of 2.2e+03 J exchanged")
    assert "Next: a smaller step" in told[1]
    assert main(["audit", path, "--why", "--by", "port", "--percent"]) == 2
    assert "leave out --by and --percent" in capsys.readouterr().err


def test_a_run_that_makes_nothing_has_one_sentence(
    compiler: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    audit = str(tmp_path / "a.parquet")
    assert main(["run", "oscillator", "--stop", "0.1", "--coupling", "newton", "--audit", audit, "--quiet"]) == 0
    capsys.readouterr()
    assert main(["audit", audit, "--why"]) == 0
    assert capsys.readouterr().out.startswith("1. No junction made more than")


@pytest.mark.slow
@pytest.mark.parametrize("step", [1e-3, 5e-3, 1e-2])
@pytest.mark.parametrize("coupling", [["jacobi"], ["gauss-seidel", "--sequence", "chassis,wheel"]], ids=str)
def test_the_quarter_truck(tmp_path: Path, coupling: list[str], step: float) -> None:
    """As much as exact solutions under held inputs make."""
    net, gross = made(coupling[0], step, 10.0)
    for path in (public(CHASSIS, WHEEL), public(WHEEL)):
        shutil.copy(path, tmp_path)
    (tmp_path / "truck.py").write_text(SCENE)
    audit = tmp_path / "a.parquet"
    options = ["--coupling", *coupling, "--step", f"{step:g}", "--audit", str(audit), "--quiet", *FINE]
    assert main(["run", str(tmp_path / "truck.py"), *options]) == 0
    (found,) = blame(audit).junctions
    assert found.gross == pytest.approx(gross, rel=0.02) and found.net == pytest.approx(net, abs=2e-3 * gross)
    assert set(found.causes) == {EXTRAPOLATED}
    (told,) = summarise(audit).junctions
    assert (told.gross, told.residual) == pytest.approx((found.gross, found.net), rel=1e-9, abs=1e-9)
