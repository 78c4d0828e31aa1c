"""Ideal switches in the unit of a coupled network: bits of the run in all modes, states saved between them, what is refused."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import fmpy
import numpy as np
import pytest

from phfmu.cli import main
from phfmu.runs.march.march import pieces
from tests.events.test_switched_members import network as charger
from tests.network.test_network_unit import Importer, exported, importer, table
from tests.network.test_unit_landing import saved, unit_of
from tests.wide import slow

#: scene -> step [s], steps, times of its events in these, and inputs that are set then
SCENES: dict[str, tuple[float, int, dict[float, dict[str, float]]]] = {
    "clutch_engagement": (5e-3, 70, {0.1: {"clutch.engaged": 1.0}, 0.3: {"clutch.engaged": 0.0}}),
    "rectifier": (5e-4, 60, {}),
    "six_pulse": (2.5e-4, 80, {}),
    "buck": (5e-6, 400, {1.5e-3: {"chopper.duty": 0.6}}),
    "buffer": (1e-2, 200, {1.0: {"spring.a.velocity": 0.1}}),
}

#: scene -> what is set before the start
STARTS = {"clutch_engagement": {"driver.a.torque": 30.0, "load.d": 0.25}}


def equal(folder: Path, scene: str, order: int, version: str, times: int = 1) -> tuple[float, float, float]:
    """All that a unit and a run tell at communication points behind the start is the same bits; means over steps with events in
    them apart.  `times`: as many steps.  How many events there were, what they lost, and brought.
    """
    h, n, events = SCENES[scene]
    n *= times
    path = exported(folder, scene, order, version, "--step", repr(h), "--coupling", "newton")
    starts = STARTS.get(scene, {})
    rows = table(folder, scene, order, h, n, *(o for name, v in starts.items() for o in ("--set", f"{name}={v!r}")))
    there = {v.name for v in fmpy.read_model_description(path, validate=True).modelVariables}
    names = [name for name in rows if name in there and name != "time"]
    ends = [0.0, *events, n * h]
    with importer(path, starts) as unit:
        for start, end in zip(ends[:-1], ends[1:], strict=True):
            unit.set(events.get(start, {}))
            for t, step, count in pieces(start, end, h):
                for k in range(count):
                    now, after = t + k * step, t + (k + 1) * step
                    unit.step(now, after - now)
                    found = unit.get(names)
                    before = np.flatnonzero(rows["time"] <= now + 1e-9 * h)[-1]
                    here = np.flatnonzero(np.abs(rows["time"] - after) <= 1e-9 * h)
                    if not any(
                        abs(after - e) <= 1e-9 * h for e in events
                    ):  # else what is set then comes behind one of them
                        here = here[-1:]
                    other = [_other(names, found, rows, i, parted=i - before > 1) for i in here.tolist()]
                    assert not all(other), (after, [o[:5] for o in other])
        count, lost, brought = unit.get(["events.count", "events.lost", "energy.events"])
    return count, lost, brought


def _other(names: list[str], found: list[float], rows: dict[str, np.ndarray], i: int, *, parted: bool) -> list[str]:
    """What differs from row i; of a step with events in it means do, which the run has of its parts."""
    differ = [name for name, value in zip(names, found, strict=True) if value != rows[name][i]]
    return [name for name in differ if not (parted and _mean(name))]


def _mean(name: str) -> bool:
    """Whether a column is a mean over the step, by its name: of ports and junctions, and unknowns of switches."""
    kinds = {"v", "i", "u", "rail", "tau", "velocity", "force", "torque", "speed"}
    last = name.rpartition(".")[2].partition("[")[0]
    return last in kinds or (last.endswith("_step") and "energy" not in name)


@pytest.mark.parametrize(
    ("scene", "order", "version"),
    [("clutch_engagement", 2, "3"), slow(("clutch_engagement", 6, "2")), slow(("rectifier", 2, "2")),
     slow(("rectifier", 4, "3")), slow(("rectifier", 6, "2")), slow(("buck", 2, "2")), slow(("buck", 4, "3")),
     slow(("six_pulse", 2, "3")), slow(("six_pulse", 4, "2")), slow(("buffer", 4, "3")), slow(("buffer", 6, "2"))],
)  # fmt: skip
def test_unit_has_the_bits_of_the_run(tmp_path: Path, scene: str, order: int, version: str, compiler: None) -> None:
    count, lost, brought = equal(tmp_path, scene, order, version)
    assert count >= 2 and brought == pytest.approx(-lost, rel=1e-12, abs=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(("scene", "order", "version"), [("rectifier", 4, "2"), ("buck", 2, "3")])
def test_so_it_has_ten_times_as_long(tmp_path: Path, scene: str, order: int, version: str, compiler: None) -> None:
    count, _, _ = equal(tmp_path, scene, order, version, times=10)
    assert count >= 50


def taken(unit: Importer, h: float, steps: Sequence[int], names: list[str]) -> list[list[float]]:
    rows = []
    for i in steps:
        unit.step(i * h, h)
        rows.append(unit.get(names))
    return rows


@pytest.mark.slow
@pytest.mark.parametrize(("scene", "order", "version"), [("rectifier", 4, "3"), ("six_pulse", 2, "2")])
def test_a_state_saved_between_modes_comes_back_to_the_bit(
    tmp_path: Path, scene: str, order: int, version: str, compiler: None
) -> None:
    """Before and after each change: into the instance that has gone on in other modes, and as bytes into a new one."""
    h, n, _ = SCENES[scene]
    path = exported(tmp_path, scene, order, version, "--step", repr(h), "--coupling", "newton")
    with importer(path) as unit:
        names = [name for name, v in zip(unit.refs, unit.get([*unit.refs]), strict=True) if np.isfinite(v)]
        states, modes = {0: saved(unit)}, [n for n in names if n.startswith("mode.")]
        rows = [unit.get(names)]
        for i in range(n):
            rows += taken(unit, h, [i], names)
            states[i + 1] = saved(unit)
        places = [names.index(m) for m in modes]
        changed = [i for i in range(1, n) if any(rows[i][p] != rows[i + 1][p] for p in places)]
        assert len(changed) >= 3
        for first in [i + d for i in changed[:3] for d in (0, 1)]:
            after = range(first, min(first + 12, n))
            state, data = states[first]
            unit.unit.setFMUState(state)
            assert taken(unit, h, after, names) == rows[first + 1 : after[-1] + 2]
            with importer(path) as other:
                other.unit.setFMUState(other.unit.deserializeFMUState(data))
                assert taken(other, h, after, names) == rows[first + 1 : after[-1] + 2]


@pytest.mark.slow
def test_long_steps_tell_their_parts_as_one(tmp_path: Path, compiler: None) -> None:
    """States are those of the internal steps, means are means and energies sums of them, through changes of modes."""
    h, n, _ = SCENES["rectifier"]
    path = exported(tmp_path, "rectifier", 4, "3", "--step", repr(h), "--coupling", "newton")
    with importer(path) as fine, importer(path) as coarse:
        means = [m for m in fine.refs if m.endswith("_step") and "energy" not in m]
        means += ["ac.v", "dc.v", "bridge.u[1]", "bridge.u[2]"]
        sums = [m for m in fine.refs if m.endswith("_step") and "energy" in m]
        now = ["grid.current", "load.current", "energy.stored", "energy.events", "events.count", "events.last"]
        mean, total = np.zeros(len(means)), np.zeros(len(sums))
        for k in range(n):
            fine.step(k * h, h)
            mean, total = mean + np.array(fine.get(means)) / 10, total + fine.get(sums)
            if k % 10 == 9:
                coarse.step((k - 9) * h, 10 * h)
                np.testing.assert_allclose(coarse.get(now), fine.get(now), rtol=1e-11, atol=1e-11)
                np.testing.assert_allclose(coarse.get(means), mean, rtol=1e-10, atol=1e-9)
                np.testing.assert_allclose(coarse.get(sums), total, rtol=1e-9, atol=1e-12)
                mean, total = 0 * mean, 0 * total
        assert fine.get(["events.count"])[0] >= 5


def test_refused_by_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Couplings that do not land on modes, and switches whose member has states beside them."""
    line = ["export", "rectifier", "--as-unit", "--coupling", "gauss-seidel", "-o", str(tmp_path)]
    assert main(line) == 2
    assert "bridge have ideal switches, which only --coupling newton lands on" in capsys.readouterr().err
    with pytest.raises(Exception, match="supply has ideal switches beside states, losses or free ports"):
        unit_of(charger(), tmp_path, 2, "3.0")
    with pytest.raises(Exception, match="supply have ideal switches, which land inside the steps of their members"):
        unit_of(charger(), tmp_path, 1, "3.0")
    assert not list(tmp_path.iterdir())
