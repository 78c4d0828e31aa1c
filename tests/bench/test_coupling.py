"""The bench of members apart: what it steps is what it says, and its tables have their rows."""

from __future__ import annotations

from time import perf_counter

import numpy as np
import pytest

from phfmu.network.couplings.coupled import Coupled
from phfmu.studies.bench.apart import coupling, crews, own_time
from phfmu.studies.bench.apart import networks as apart
from tests.network.both_loops import called_back


@pytest.mark.slow
def test_tables(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(coupling, "ROUNDS", 1)
    monkeypatch.setattr(coupling, "SIZES", {"ring": (3,), "star": (3,)})
    monkeypatch.setattr(crews, "table", lambda progress: "threads")
    monkeypatch.setattr(coupling, "HELD", {"oscillator": 1e-3, "smib": 2e-5})
    lines = coupling.table(["oscillator"]).splitlines()
    rows = [
        [c.strip() for c in line.strip("|").split("|")] for line in lines if line.startswith("| ") and "---" not in line
    ]
    assert [r[:3] for r in rows[1:4]] == [["oscillator", order, "3"] for order in ("2", "4", "6")]
    assert all(float(r[3]) > 0 and float(r[4]) > 0 and float(r[6]) == 2.0 for r in rows[1:4])
    kinds = [["oscillator", order, kind] for order in ("2", "4", "6") for kind in ("native", "FMU")]
    assert [r[:3] for r in rows[5:11]] == kinds
    for r in rows[5:11]:
        *parts, own = map(float, r[3:])
        assert all(p > 0 for p in parts) and sum(parts[1:]) == pytest.approx(own, abs=0.03)
    whole, given = ("newton", "anderson", "gauss-seidel", "jacobi"), ("newton", "anderson")
    named = [["oscillator", "3", c] for c in whole] + [["smib", "3", c] for c in given]
    assert [r[:3] for r in rows[12:18]] == named, "no output gives the voltages of smib's node"
    assert all(0 < float(r[3]) and float(r[8]) > 0 for r in rows[12:18])
    assert [float(r[4]) >= 2.0 for r in rows[12:18]] == [r[2] in given for r in rows[12:18]]
    assert [r[:3] for r in rows[19:]] == [["ring", "6", "2"], ["star", "7", "2"]], "members of two kinds"
    assert all(float(t) >= 0 for r in rows[19:] for t in r[3:6]) and all(float(r[6]) > 0 for r in rows[19:])
    assert lines[-1].rpartition("load ")[2]


def test_the_clock_of_the_loop_tells_where_the_time_goes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its parts are less than the whole, in the order of their names; without being asked it stands still."""
    monkeypatch.setattr(own_time, "ROUNDS", 2)
    stepper = apart.coupled(coupling.star(3), 1)
    assert isinstance(stepper, Coupled)
    stepper.check_start()
    stepper.advance(0.0, 1e-2, 10)
    assert stepper.master._struct.clock is None
    begun = perf_counter()
    found = own_time.own_time(stepper, 1e-2)
    spent = 1e6 * (perf_counter() - begun) / (own_time.STEPS * 7)
    parts = [found.steps, found.exchange, found.join, found.solve, found.columns]
    assert all(p > 0 for p in parts) and sum(parts) == pytest.approx(found.steps + found.own) and sum(parts) <= spent


@pytest.mark.slow
@pytest.mark.parametrize("cores", [1, 2, 3])
def test_threads(monkeypatch: pytest.MonkeyPatch, cores: int) -> None:
    """As many as cores, with the bits of one; no table for one core."""
    monkeypatch.setattr(crews, "SIZES", ((3, 4),))
    monkeypatch.setattr(crews, "TURNS", 1)
    monkeypatch.setattr("phfmu.processors.processors", lambda: cores)
    lines = crews.table().splitlines()
    if cores == 1:
        assert len(lines) == 1 and "one core" in lines[0]
        return
    head, row = ([c.strip() for c in lines[i].strip("|").split("|")] for i in (0, 2))
    assert head[4] == f"{cores} threads us" and row[:2] == ["3", "4"] and row[6] == "yes" and len(lines) == 3
    assert all(float(row[i]) > 0 for i in (2, 3, 4, 5, 7))


@pytest.mark.parametrize("make", [coupling.ring, coupling.star])
def test_networks_move_and_keep_their_energy(make) -> None:
    """Stepped by the master and called back alike."""
    H = []
    for called in (False, True):
        stepper = called_back(apart.coupled(make(4), 1), called)  # pyright: ignore[reportArgumentType]
        stepper.check_start()
        H.append(stepper.advance(0.0, 0.05, 6).H)
    assert np.abs(H[0] - H[1]).max() <= 1e-14
    assert np.abs(H[0].sum(axis=1) - 0.5).max() <= 1e-14 and H[0][:, 0].min() < 0.49
