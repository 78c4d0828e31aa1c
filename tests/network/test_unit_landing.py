"""State events of members in the unit of a coupled network: bits of the run, exact references, states saved before them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import FMU2Slave
from scipy.integrate import solve_ivp

from phfmu import (
    PHDAE,
    TRANSLATIONAL,
    FMUInstance,
    Guard,
    Jump,
    Network,
    Port,
    StateEvent,
    energy,
    parameter,
    skew,
    state,
)
from phfmu.cli import main
from phfmu.components.mechanical.translational import spring
from phfmu.fmu.importer.refusal import UnitFailure
from phfmu.network.as_unit.export import export_network
from phfmu.runs.march.march import pieces
from phfmu.schemes.collocated import Collocated
from tests.fmu import foreign
from tests.network.test_network_unit import Importer, exported, importer, table
from tests.network.unit_members import pump_folder
from tests.wide import slow

#: scene -> step [s], steps, times of its events in these, and inputs that are set then
SCENES: dict[str, tuple[float, int, dict[float, dict[str, float]]]] = {
    "breaker_opening": (2.5e-4, 140, {0.02: {"line.command": 0.0}}),
    "buffer": (1e-2, 200, {1.0: {"spring.a.velocity": 0.1}}),
    "two_point_control": (2e-2, 100, {}),
}
#: masses [kg], restitutions, where they start [m], how fast [m/s], stiffness between them and to the ground [N/m]
MASSES, RESTITUTIONS, GAPS, SPEEDS, BETWEEN, GROUND = (1.0, 2.0), (0.8, 0.6), (0.1, 0.05), (-1.0, 0.5), 50.0, 80.0


def ball(i: int, most: float = np.inf) -> PHDAE:
    """A body before a wall, which a force acts on, with a mode that says on which side of a band it was last."""
    q, v = state("q", unit="m", start=GAPS[i]), state("v", unit="m/s", start=SPEEDS[i])
    jump = Jump({v: 1.0}, RESTITUTIONS[i], law="unilateral", most=most)
    return PHDAE(
        "ball",
        states=(q, v),
        parameters=(parameter("far", 0.0, min=0.0, max=1.0),),
        energies=(energy(MASSES[i] * v**2 / 2),),
        E={v: MASSES[i]},
        structure=(skew(q, v, 1.0),),
        ports=(Port("flange", TRANSLATIONAL, "effort", {v: 1.0}),),
        state_events=(
            StateEvent(Guard("hits", q, -1, unit="m"), jump=jump),
            StateEvent(Guard("leaves", q - 0.08, 1, unit="m"), when={"far": 0.0}, sets={"far": 1.0}),
            StateEvent(Guard("comes", q - 0.06, -1, unit="m"), when={"far": 1.0}, sets={"far": 0.0}),
        ),
    )


#: of the runs that are compared with another method, s
STOP = 2.0


def balls(most: float = np.inf) -> Network:
    """Two bodies before walls, joined by a spring, one also by a spring to the ground."""
    net = Network("balls")
    net.add("a", ball(0, most))
    net.add("between", spring(BETWEEN))
    net.add("b", ball(1))
    net.add("ground", spring(GROUND))
    net.connect("a.flange", "between.a", name="left")
    net.junction("right", ["between.b", "b.flange", "ground.a"])
    return net


def unit_of(net: Network, folder: Path, k: int, version: str, step: float = 1e-2) -> Path:
    (path,) = export_network(net, folder, dict.fromkeys(net.declared, Collocated(k)), [version], step=step)
    return path


@pytest.mark.parametrize(
    ("scene", "coupling", "order", "version"),
    [("breaker_opening", "newton", 4, "3"), slow(("breaker_opening", "newton", 6, "2")),
     slow(("buffer", "newton", 2, "2")), slow(("buffer", "anderson", 4, "3")),
     slow(("two_point_control", "gauss-seidel", 4, "2"))],
)  # fmt: skip
def test_unit_has_the_bits_of_the_run(
    tmp_path: Path, scene: str, coupling: str, order: int, version: str, compiler: None
) -> None:
    """At all communication points behind the start; means over a step with events, which a run tells of its parts, apart."""
    h, n, events = SCENES[scene]
    path = exported(tmp_path, scene, order, version, "--step", repr(h), "--coupling", coupling)
    rows = table(tmp_path, scene, order, h, n, coupling=coupling)
    there = {v.name for v in fmpy.read_model_description(path, validate=True).modelVariables}
    assert {"events.count", "events.last", "events.lost"} <= there
    names = [name for name in rows if name in there and name != "time"]
    ends, differ, parted = [0.0, *events, n * h], set[str](), 0
    together = coupling == "newton" and order > 2
    with importer(path) as unit:
        for start, end in zip(ends[:-1], ends[1:], strict=True):
            unit.set(events.get(start, {}))
            for t, step, count in pieces(start, end, h):
                for k in range(count):
                    now, after = t + k * step, t + (k + 1) * step
                    unit.step(now, after - now if together else step)
                    found = np.array(unit.get(names))
                    here = np.flatnonzero(rows["time"] == after)
                    wanted = np.array([rows[name][here[-1]] for name in names])
                    other = [name for name, same in zip(names, found == wanted, strict=True) if not same]
                    if np.sum((rows["time"] > now + 1e-9 * h) & (rows["time"] <= after)) > 1:
                        differ, parted = differ | {*other}, parted + 1
                    else:
                        assert not other, (after, other[:5])
        count, lost, brought = unit.get(["events.count", "events.lost", "energy.events"])
    means = {"v", "i", "velocity", "force", "torque", "speed"}
    assert all("_step" in n or n.rpartition(".")[2].partition("[")[0] in means for n in differ), differ
    assert count >= 3 and brought == -lost and parted == (3 if together else 0)


def exact(stop: float) -> tuple[list[float], np.ndarray, float]:
    """Times of the impacts, the end, and the energy lost, by a Runge-Kutta method of order 8 from impact to impact."""
    (m, n), lost = MASSES, 0.0
    at, t, times = np.array([GAPS[0], SPEEDS[0], GAPS[1], SPEEDS[1], 0.0, 0.0]), 0.0, list[float]()

    def rates(_: float, y: np.ndarray) -> list[float]:
        between, ground = BETWEEN * y[4], GROUND * y[5]
        return [y[1], -between / m, y[3], (between - ground) / n, y[1] - y[3], y[3]]

    def hits(i: int) -> Any:
        def guard(_: float, y: np.ndarray) -> float:
            return float(y[2 * i])

        guard.terminal, guard.direction = True, -1  # type: ignore[attr-defined]
        return guard

    while t < stop:
        found = solve_ivp(rates, (t, stop), at, "DOP853", rtol=1e-13, atol=1e-14, events=[hits(0), hits(1)])
        t, at = float(found.t[-1]), found.y[:, -1].copy()
        for i in (0, 1):
            if len(found.t_events[i]):
                lost += MASSES[i] * (1 - RESTITUTIONS[i] ** 2) * at[2 * i + 1] ** 2 / 2
                at[2 * i], at[2 * i + 1] = 0.0, -RESTITUTIONS[i] * at[2 * i + 1]
                times.append(t)
    return times, at, lost


@pytest.mark.slow
def test_impacts_are_those_of_another_method(tmp_path: Path, compiler: None) -> None:
    """Order 2k in states, times and losses: the error of half the step is 2^4 times less; the books close."""
    times, end, lost = exact(STOP)
    assert len(times) >= 3
    errors = []
    path = unit_of(balls(), tmp_path, 2, "3.0")
    for n in (200, 400):
        with importer(path) as unit:
            seen = list[float]()
            for k in range(n):
                unit.step(k * STOP / n, (k + 1) * STOP / n - k * STOP / n)
                seen.append(unit.get(["events.lost"])[0])
            found = unit.get(["a.q", "a.v", "b.q", "b.v"])
            errors.append(max(np.abs(np.array(found) - end[:4]).max(), abs(seen[-1] - lost)))
            stored, supplied, brought = unit.get(["energy.stored", "energy.supplied", "energy.events"])
            begun = sum(m * v**2 / 2 for m, v in zip(MASSES, SPEEDS, strict=True))
            assert stored - begun - supplied - brought == pytest.approx(0.0, abs=1e-14 * begun * n)
            assert unit.get(["mode.a.far", "mode.b.far"]) == [float(x) for x in (found[0] > 0.06, found[2] > 0.06)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4, abs=0.6), errors


def saved(unit: Importer) -> tuple[Any, bytes]:
    own = unit.unit
    if isinstance(own, FMU2Slave):
        state = own.getFMUState()
        return state, own.serializeFMUState(state)
    state = own.getFMUState()
    return state, own.serializeFMUState(state)


@pytest.mark.parametrize(("k", "version"), [(2, "3.0"), slow((1, "2.0"))])
def test_a_state_saved_before_an_event_comes_back_to_the_bit(
    tmp_path: Path, k: int, version: str, compiler: None
) -> None:
    """Into the same instance and, as bytes, into another one: members land together (k = 2), or each inside its steps (k = 1)."""
    path = unit_of(balls(), tmp_path, k, version)
    with importer(path) as unit, importer(path) as other:
        names = [n for n, v in zip(unit.refs, unit.get([*unit.refs]), strict=True) if np.isfinite(v)]
        for i in range(9):
            unit.step(i * 1e-2, 1e-2)
        state, data = saved(unit)
        rows = []
        for instance in (unit, unit, other):
            own = instance.unit
            own.setFMUState(state if instance is unit else own.deserializeFMUState(data))
            before = instance.get(["events.count"])[0]
            for i in range(9, 30):
                instance.step(i * 1e-2, 1e-2)
            assert instance.get(["events.count"])[0] >= before + 2
            rows.append(instance.get(names))
        np.testing.assert_array_equal(rows[0], rows[1])
        np.testing.assert_array_equal(rows[0], rows[2])


@pytest.mark.slow
def test_long_steps_tell_their_parts_as_one(tmp_path: Path, compiler: None) -> None:
    """States are those of the internal steps, means are means and energies sums of them, through events."""
    path = unit_of(balls(), tmp_path, 2, "3.0")
    with importer(path) as fine, importer(path) as coarse:
        means = [n for n in fine.refs if n.endswith("_step") and "energy" not in n] + [
            "left.velocity",
            "right.velocity",
        ]
        sums = [n for n in fine.refs if n.endswith("_step") and "energy" in n]
        now = ["a.q", "a.v", "b.q", "b.v", "energy.stored", "energy.events", "events.count", "events.last"]
        mean, total = np.zeros(len(means)), np.zeros(len(sums))
        for k in range(120):
            fine.step(k * 1e-2, 1e-2)
            mean, total = mean + np.array(fine.get(means)) / 8, total + fine.get(sums)
            if k % 8 == 7:
                coarse.step((k - 7) * 1e-2, 8e-2)
                np.testing.assert_allclose(coarse.get(now), fine.get(now), rtol=1e-12, atol=1e-13)
                np.testing.assert_allclose(coarse.get(means), mean, rtol=1e-11, atol=1e-12)
                np.testing.assert_allclose(coarse.get(sums), total, rtol=1e-10, atol=1e-13)
                mean, total = 0 * mean, 0 * total
        assert fine.get(["events.count"])[0] >= 5


def test_a_refused_event_leaves_the_unit_where_it_was(tmp_path: Path, compiler: None) -> None:
    """The step is discarded, with the name of the guard and its numbers; a shorter one is taken."""
    path = unit_of(balls(most=1e-3), tmp_path, 2, "3.0")
    with FMUInstance(path) as unit:
        for i in range(12):
            unit.do_step(i * 1e-2, 1e-2)
        before = unit.values()
        with pytest.raises(UnitFailure, match="'a.hits': it would jump with .c. = .*, more than its most = 0.001"):
            unit.do_step(0.12, 1e-2)
        assert unit.values() == before
        unit.do_step(0.12, 1e-4)


MIXED = """
from phfmu import Network, Scene
from phfmu.components.mechanical.contacts import bumper
from phfmu.components.mechanical.translational import spring


def mixed():
    net = Network("mixed")
    net.add("pump", "pump.fmu")
    net.add("body", bumper(2.0, e=0.5, gap=0.02, v=-0.5))
    net.add("spring", spring(40.0, elongation=0.3))
    net.junction("a", ["pump.flange", "spring.a"])
    net.junction("b", ["body.flange", "spring.b"])
    return Scene("mixed", net, stop=2.0, step=0.01)
"""


@pytest.mark.slow
@pytest.mark.parametrize(("coupling", "inner", "version"), [("newton", "2.0", "3")])
def test_so_it_is_beside_units_of_other_tools(
    tmp_path: Path, coupling: str, inner: str, version: str, compiler: None
) -> None:
    """A member lands inside its steps, which are taken back with those of the unit; one that cannot save its state is refused."""
    folder, target = pump_folder(tmp_path, "scene.py", MIXED), f"{tmp_path}/scene.py:mixed"
    foreign.mass(folder / "pump.fmu", inner, saves=True)
    line = [
        "export",
        target,
        "--as-unit",
        "--order",
        "2",
        "--fmi",
        version,
        "--coupling",
        coupling,
        "-o",
        str(tmp_path),
    ]
    assert main(line) == 0
    rows = table(tmp_path, target, 2, 0.01, 100, coupling=coupling)
    with importer(tmp_path / f"mixed_fmi{version}.fmu") as unit:
        names = [n for n in rows if n in unit.refs and n != "time"]
        for k in range(100):
            unit.step(k * 0.01, 0.01)
            np.testing.assert_array_equal(unit.get(names), [rows[n][k + 1] for n in names])
        assert unit.get(["events.count"])[0] == 2
    foreign.mass(folder / "pump.fmu", inner, saves=False)
    assert main([*line[:-3], "gauss-seidel", *line[-2:]]) == 2
