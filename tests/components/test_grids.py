"""Grids from files: their operating points against published power flows, faults, trips, and what is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phfmu import Collocated, Monolithic, NativeInstance, Network, Options, Scene, build_model, run
from phfmu.cli import main
from phfmu.components.electrical.capacitors import capacitor_network
from phfmu.components.grids import Fault, GridModel, Trip, fault_of, grid_model, grid_scene, trip_of
from phfmu.components.grids.lattice import lattice
from phfmu.components.scenes.electrical.grids import new_england, public_grid, wecc240
from phfmu.importers.grid import Demand, Dynamics, Grid, GridError, Line, Shunt, Transformer, read_raw, with_dynamics
from tests.reference.phasor_reference import Swings, admittance
from tests.wide import wide

CASES = Path(__file__).parent.parent / "reference" / "data" / "grids"
ALPHA = np.array([0.0, 2.0 * pi / 3.0, -2.0 * pi / 3.0])


@cache
def model(name: str) -> GridModel:
    return grid_model(public_grid(name), plants="currents", controls=False)


@cache
def published(name: str) -> dict[str, Any]:
    return json.loads((CASES / f"{name}.json").read_text())


def nine() -> Grid:
    return with_dynamics(read_raw(CASES / "ieee9.raw"), CASES / "ieee9_gen.csv")


def mismatch(m: GridModel) -> float:
    """Largest difference in per unit between powers by the phasors of the point and those of the table; the units that hold a
    voltage are left out in Q, those of the slack bus in P too."""
    grid, V = m.grid, m.voltages()
    numbers, Y = admittance(grid)
    v = np.array([V[n] for n in numbers])
    S = v * np.conj(Y @ v)
    for d in grid.demands:
        S[numbers.index(d.bus)] += complex(d.p, d.q) / grid.base
    for g in grid.generators:
        if g.on:
            S[numbers.index(g.bus)] -= complex(g.p, g.q) / grid.base
    kind = np.array([b.kind for b in grid.buses])
    return max(np.abs(S.real[kind < 3]).max(), np.abs(S.imag[kind == 1]).max())


@pytest.mark.parametrize(("name", "near"), [("ieee39", 6e-6), ("wecc240", 2e-4)])
def test_voltages_are_those_of_the_published_power_flow(name: str, near: float) -> None:
    """To the digits of the file; in the 240-bus case a series capacitor at bus 3891 has a resistance that is left out, which
    changes the voltages beside it by 2e-4."""
    point, J = model(name).voltages(), published(name)
    v = np.array([point[n] for n in J["bus_num"]])
    off = np.abs(np.abs(v) - J["bus_Vm"])
    assert off.max() < near
    assert np.abs(np.angle(v * np.exp(-1j * np.array(J["bus_Va"])))).max() < (1e-6 if name == "ieee39" else 2.5e-5)
    assert sum(off > 1e-5) == (0 if name == "ieee39" else 7)
    assert model(name).point.residual < 1e-11


def test_powers_of_machines_are_the_published_ones() -> None:
    m, J = model("ieee39"), published("ieee39")
    for bus, P, Q in zip(J["gen_bus"], J["gen_MW"], J["gen_Mvar"], strict=True):
        s = -m.point.power(f"gen{bus}.terminal") / 1e6
        assert s.real == pytest.approx(P, abs=2e-3) and s.imag == pytest.approx(Q, abs=2e-3)


def test_new_england_is_solved_as_by_pandapower() -> None:
    """The file has the solution of pandapower to 1e-11; tests of the readers compare it with the case there."""
    m = model("new_england")
    V = m.voltages()
    assert max(abs(V[b.number] - b.vm * np.exp(1j * b.va)) for b in m.grid.buses) < 1e-9


@pytest.mark.slow
def test_machines_swing_as_by_phasors() -> None:
    """After a fault of 50 ms, to a twentieth of the swing: phasors leave out direct currents, which brake the machines."""
    scene = new_england(t_clear=0.15, stop=1.2)
    m = build_model(scene.declaration(), Collocated(1))
    own = run(
        Monolithic(m, NativeInstance(m)),
        Options(
            stop=scene.stop, step=1e-4, events=scene.events, restart=scene.restart, signals=("gen*.theta",), every=0.01
        ),
    )
    swings = Swings(public_grid("new_england"))
    at = own.time > 0.151
    turned = np.array([own.column(f"gen{b}.theta") - own.column(f"gen{b}.theta")[0] for b in swings.buses])
    turned -= turned.mean(axis=0)
    theirs = swings.after(16, 0.1, 0.15, own.time[at])
    assert np.abs(theirs).max() > 0.35
    assert np.abs(turned[:, at] - theirs).max() < 0.06 * np.abs(theirs).max()


@pytest.mark.parametrize("n", (9, 60, 250))
def test_generated_grids_meet_a_power_flow_of_phasors(n: int) -> None:
    assert mismatch(grid_model(lattice(n))) < 1e-9


def test_shunts_reactors_ends_and_negative_loads_are_in_the_balance() -> None:
    """Every kind of data that nine buses lack, against the phasors."""
    grid = lattice(20)
    lines = (replace(grid.lines[0], ends=(0.01, 0.02, 0.03, -0.3)), *grid.lines[1:], Line(1, 7, "2", 0.01, 0.2, 0.0))
    demands = (*grid.demands[:4], Demand(5, "1", 40.0, -30.0), Demand(6, "1", 0.0, 12.0), Demand(7, "1", 0.0, -15.0),
               Demand(8, "1", -20.0, 5.0), *grid.demands[8:])  # fmt: skip
    shunts = (Shunt(2, "1", 3.0, 25.0), Shunt(3, "1", 0.0, -20.0), Shunt(4, "off", 0.0, 500.0, False))
    transformers = (replace(grid.transformers[0], tap=1.05, g=0.01, b=-0.02), *grid.transformers[1:])
    m = grid_model(
        replace(grid, lines=lines, demands=demands, shunts=shunts, transformers=transformers), plants="currents"
    )
    assert mismatch(m) < 1e-9
    assert "C" in {v.name for v in m.network.declared["load5"].parameters} and "feed8_1" in m.network.members
    assert "reactor3" in m.network.members and "conductance2" in m.network.members


@pytest.mark.parametrize(
    ("degrees", "assumed"),
    [
        (30, "vector group YNd1"),
        (-30, ""),
        (180, "vector group YNyn6"),
        (150, "vector group YNd5"),
        (0, "vector group YNyn0"),
    ],
)
def test_angles_of_transformers_are_vector_groups(degrees: float, assumed: str) -> None:
    """The machine behind one turns with it; the group of the file, Dyn11, counts where its hour is the angle."""
    grid = lattice(9)
    first = grid.transformers[0]
    t = replace(first, i=first.j, j=first.i, shift=degrees * pi / 180, group="Dyn11")
    m = grid_model(replace(grid, transformers=(t,)))
    assert mismatch(m) < 1e-9
    row = m.report.of(f"transformer{t.i}_{t.j}")
    assert row.assumed == assumed and ("Dyn11" in row.unused) == bool(assumed)


def test_series_capacitors_are_exact() -> None:
    """Series capacitors beside lines with charging: capacitors in a loop, whose charges are those of one part."""
    grid = lattice(30)
    bus = replace(grid.buses[0], number=1001, name="behind the capacitor")
    first = grid.lines[0]
    lines = (replace(first, i=1001), Line(1, 1001, "1", 0.0, -0.01, 0.0), *grid.lines[1:])
    m = grid_model(replace(grid, buses=(*grid.buses, bus), lines=lines))
    assert "capacitors1" in m.network.members
    assert mismatch(m) < 1e-9
    assert steady(m.point.started(), m) < 3e-5


def test_a_matrix_of_capacitors_without_ground_is_refused() -> None:
    with pytest.raises(ValueError, match="at least one bus needs a capacitor to ground"):
        capacitor_network([[1e-6, -1e-6], [-1e-6, 1e-6]])


def steady(net: Network, m: GridModel, steps: int = 100, step: float = 5e-5) -> float:
    """Largest change of a state in a run of order 4 from the point, turned back, relative to the largest of its variable."""
    declaration = net.compose()
    unit = NativeInstance(build_model(declaration, Collocated(2)))
    r = run(Monolithic(unit.model, unit), Options(stop=steps * step, step=step))
    last = {n: float(r.column(n)[-1]) for v in declaration.states for n in v.names()}
    back, begun = m.point.turned_back(last, steps * step), m.point.states
    sizes = [(v.names(), max(abs(begun[n]) for n in v.names()) or 1.0) for v in declaration.states]
    return max(abs(back[n] - begun[n]) / size for names, size in sizes for n in names)


@cache
def faulted(order: int) -> tuple[Scene, Any]:
    scene = grid_scene(public_grid("ieee39"), faults=[Fault(16, 0.1, 0.2)], controls=False, stop=0.3)
    declaration = scene.declaration()
    unit = NativeInstance(build_model(declaration, Collocated(order // 2)))
    options = Options(stop=scene.stop, step=scene.step, events=scene.events, restart=scene.restart)
    return scene, run(Monolithic(unit.model, unit), options)


def voltage(r: Any, grid: Grid, bus: int) -> np.ndarray:
    """|v| in per unit."""
    source = next(n for n in (f"bus{bus}.v", f"load{bus}.v", f"shunt{bus}.v") if f"{n}[1]" in r.names)
    phasor = 2.0 / 3.0 * sum(r.column(f"{source}[{k + 1}]") * np.exp(1j * ALPHA[k]) for k in range(3))
    return np.abs(phasor) / (np.sqrt(2.0 / 3.0) * grid.bus[bus].kv * 1e3)


def test_a_fault_on_39_buses() -> None:
    """Voltage before, in and after a fault of 0.001 pu at bus 16, and speeds, as a prototype of its own found them; both
    orders agree, and the ledger is closed."""
    speeds = {}
    for order in (2, 4):
        scene, r = faulted(order)
        V = voltage(r, public_grid("ieee39"), 16)
        n = len(V)
        assert V[int(0.3 * n)] == pytest.approx(0.9583, abs=1e-4)
        assert V[int(0.65 * n)] == pytest.approx(0.087, abs=1e-3)
        assert r.ledger.summary().closed
        speeds[order] = r.column("gen33.p")[-1] / r.column("gen33.p")[0] - 1.0
    assert 1e-3 < speeds[4] < 6e-3
    assert speeds[2] == pytest.approx(speeds[4], rel=2e-3)


@cache
def controlled(name: str) -> GridModel:
    return grid_model(public_grid(name), plants="currents", faults=[public_grid(name).slack.number])


@pytest.mark.parametrize("name", wide(["ieee39", "wecc240"], "ieee39"))
def test_controllers_of_the_tables_begin_at_what_the_power_flow_asks(name: str) -> None:
    """The network is the one without them; each exciter gives the field voltage K (Vref - V), each turbine its torque."""
    m, bare = controlled(name), model(name)
    assert m.point.residual < 1e-10
    for member, field in bare.point.inputs.items():
        if member.startswith("gen") and member.endswith((".field.v", ".shaft.torque")):
            assert m.point.parameters[member] == pytest.approx(field, rel=1e-9, abs=1e-9)  # V; plants at rest have none
    values = m.point.states | m.point.parameters
    exciters = [n for n in m.network.members if n.startswith("avr")]
    assert len(exciters) == sum(d.model == "SEXS" for d in m.grid.dynamics)
    for n in exciters:
        efd = values[f"{n}.K"] * (values[f"{n}.Vref"] + values[f"{n}.Vs"] - values[f"{n}.V"])
        assert efd == pytest.approx(values[f"{n}.Efd"], rel=1e-9)
        assert values[f"{n}.EMIN"] <= efd <= values[f"{n}.EMAX"]


def test_exciters_meet_and_leave_their_limits_in_a_fault_and_the_nodes_of_machines_hold() -> None:
    """39 buses: the field voltage of machine 31 as a prototype found it, those at their limit stay at that to rounding,
    and Kirchhoff's law holds at the bare nodes where the meters stand."""
    s = grid_scene(public_grid("ieee39"), faults=[Fault(16, 0.1, 0.2)], stop=0.3)
    unit = NativeInstance(build_model(s.declaration(), Collocated(1)))
    r = run(Monolithic(unit.model, unit), Options(stop=s.stop, step=s.step, events=s.events, restart=s.restart))
    assert r.ledger.summary().closed
    assert r.column("avr31.Efd")[0] == pytest.approx(2.0731, abs=1e-4)
    assert r.column("avr31.Efd").max() == pytest.approx(2.826, abs=1e-3)
    limited = [n for n in (33, 35, 36) if abs(r.column(f"avr{n}.Efd").max() - 3.0) <= 4 * np.spacing(3.0)]
    assert limited == [33, 35, 36]
    kirchhoff = np.abs(unit.signal("observables")[-len(unit.model.checks) :])
    assert (kirchhoff <= 1e-12 * np.array(unit.model.check_scale)).all()


def with_controllers() -> Grid:
    """Nine buses with the exciters, turbines and stabilisers of the public tables (ParaEMT_public)."""
    grid = nine()
    models = {
        "SEXS": {"TA_TB": 0.0, "TB": 10.0, "K": 10.0, "TE": 0.1, "Emin": 0.0, "Emax": 3.0},
        "GAST": {"R": 0.08, "T1": 0.5, "T2": 0.5, "T3": 3.0, "AT": 1.0, "KT": 2.0, "Vmax": 1.0, "Vmin": 0.0, "Dturb": 0.0},
        "IEEEST": {"A1": 1.013, "A2": 0.013, "A3": 0.0, "A4": 0.0, "A5": 1.013, "A6": 0.113, "T1": 3.0, "T2": 0.02, "T3": 0.0,
                   "T4": 0.0, "T5": 1.65, "T6": 1.65, "KS": 3.0, "LSmax": 0.1, "LSmin": -0.1, "VCU": 0.0, "VCL": 0.0},
    }  # fmt: skip
    more = [Dynamics(d.bus, d.id, m, values) for d in grid.dynamics for m, values in models.items()]
    return replace(grid, dynamics=(*grid.dynamics, *more))


@pytest.mark.parametrize("order", wide((2, 4, 6), 2))
def test_stabilisers_of_a_high_gain_meet_and_leave_their_limits(order: int) -> None:
    """Their signal of 4000 per unit of speed turns slowly at its limits, where rounding would go to and fro."""
    s = grid_scene(with_controllers(), faults=[Fault(7, 0.01, 0.05)], stop=0.08)
    unit = NativeInstance(build_model(s.declaration(), Collocated(order // 2)))
    r = run(Monolithic(unit.model, unit), Options(stop=s.stop, step=s.step, events=s.events, restart=s.restart))
    assert r.ledger.summary().closed
    for n in (1, 2, 3):
        mode, signal = r.column(f"pss{n}.Vs_at"), r.column(f"pss{n}.Vs")
        assert {-1.0, 0.0, 1.0} <= set(mode) and np.abs(signal).max() <= 0.1 * (1 + 1e-8)
        changes = r.time[np.flatnonzero(np.diff(mode))]
        assert len(changes) >= 4 and np.diff(changes).min() > 1e-7  # a step is 5e-5 s


@pytest.mark.long
def test_turbines_that_rest_at_their_lower_limit_stay_there() -> None:
    """240 buses with their controllers: synchronous condensers whose turbines have no power, through a fault.

    Before it the valves stay within the billionth by which limits are left: speeds move by the rounding of the power flow.
    """
    s = wecc240(t_fault=0.005, t_clear=0.01, stop=0.02, controls=True)
    unit = NativeInstance(build_model(s.declaration(), Collocated(1)))
    options = Options(
        stop=s.stop, step=s.step, events=s.events, restart=s.restart, signals=("gov7031_SC.*", "gov2438_ND.*")
    )
    r = run(Monolithic(unit.model, unit), options)
    assert r.ledger.summary().closed
    early = int(np.flatnonzero(r.time < 0.005)[-1])
    for n in ("gov7031_SC", "gov2438_ND"):
        assert np.abs(r.column(f"{n}.valve")[:early]).max() < 1e-9
        assert np.count_nonzero(np.diff(r.column(f"{n}.valve_at")[:early])) <= 2


def test_two_exciters_of_one_machine_are_refused_and_limits_below_the_power_told() -> None:
    grid = public_grid("ieee39")
    more = tuple(replace(d, model="HYGOV") for d in grid.dynamics if d.model == "GAST" and d.bus == 30)
    with pytest.raises(GridError, match=r"bus 30, machine 'G': HYGOV and GAST are both a governor"):
        grid_model(replace(grid, dynamics=(*grid.dynamics, *more)))
    low = tuple(replace(d, values={**d.values, "Vmax": 0.1}) if d.model == "GAST" else d for d in grid.dynamics)
    assert "GAST: Vmax raised" in grid_model(replace(grid, dynamics=low)).report.of("gen30").assumed


def test_a_line_trips_at_its_current_zeros() -> None:
    scene = grid_scene(nine(), faults=[Fault(7, 0.02, 0.05)], trips=[Trip("line7-5")], stop=0.1)
    unit = NativeInstance(build_model(scene.declaration(), Collocated(1)))
    options = Options(stop=scene.stop, step=scene.step, events=scene.events, restart=scene.restart)
    r = run(Monolithic(unit.model, unit), options)
    i = r.column("line5_7.i[1]")
    t = np.linspace(0.0, scene.stop, len(i))
    late = i[np.searchsorted(t, 0.065) :]
    assert np.abs(i).max() > 100.0 and np.abs(late).max() < 1e-6 * np.abs(i).max()
    assert r.ledger.summary().closed


def test_lines_trip_beside_plants_that_are_currents(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Currents given over time at a node of inductances hold in the mean of steps, which is no inconsistent state at an event."""
    case, table = str(CASES / "ieee9.raw"), tmp_path / "r.csv"
    line = [case, "--plants", "currents", "--trip", "line7-8:0.005"]
    assert main(["run", *line, "--stop", "0.02", "-o", str(table)]) == 0
    assert "VIOLATED" not in capsys.readouterr().out
    names, *rows = table.read_text().splitlines()
    i = np.array([[float(x) for x in row.split(",")] for row in rows])[:, names.split(",").index("line7_8.a.i[1]")]
    assert np.abs(i).max() > 100.0 and np.abs(i[-20:]).max() < 1e-6 * np.abs(i).max()
    assert main(["check", *line]) == 0
    assert main(["export", *line, "-o", str(tmp_path), "--fmi", "3"]) == 0
    assert (tmp_path / "ieee9_fmi3.fmu").exists()


def test_units_without_data_are_named_or_become_currents() -> None:
    grid = nine()
    grid = replace(grid, dynamics=tuple(d for d in grid.dynamics if d.bus != 3))
    with pytest.raises(GridError, match=r"bus 3, machine '1': no dynamic data .*--plants currents"):
        grid_model(grid)
    m = grid_model(grid, plants="currents")
    assert "plant3" in m.network.members and "constant balanced current" in m.report.of("plant3").assumed
    whole = grid_model(nine())
    for n, v in m.voltages().items():
        assert v == pytest.approx(whole.voltages()[n], abs=1e-9)


def test_units_without_data_become_inverters_in_the_same_point() -> None:
    """Steady with them, at order 4; in a fault their currents are at the limit."""
    grid = nine()
    grid = replace(grid, dynamics=tuple(d for d in grid.dynamics if d.bus != 3))
    m, currents = grid_model(grid, plants="inverters"), grid_model(grid, plants="currents")
    assert m.voltages() == pytest.approx(currents.voltages(), abs=1e-12)
    assert "grid-following inverter" in m.report.of("plant3").assumed
    scene = grid_scene(grid, plants="inverters", faults=[Fault(9, 0.05, 0.1)], stop=0.1)
    unit = NativeInstance(build_model(scene.declaration(), Collocated(2)))
    options = Options(stop=scene.stop, step=scene.step, events=scene.events, restart=scene.restart)
    r = run(Monolithic(unit.model, unit), options)
    assert r.ledger.summary().closed
    before = r.time < 0.05
    for name in ("plant3.U", "plant3.Id"):
        assert np.ptp(r.column(name)[before]) < 1e-6 * abs(r.column(name)[0])
    rating = next(g for g in grid.generators if g.bus == 3)
    limit = 1.1 * rating.base * 1e3 / grid.bus[3].kv
    amount = np.hypot(r.column("plant3.Id"), r.column("plant3.Iq"))
    assert amount.max() == pytest.approx(limit, rel=1e-3)


def test_a_subtransient_reactance_below_the_leakage_is_named() -> None:
    grid = nine()
    first = grid.dynamics[0]
    wrong = (replace(first, values={**first.values, "xd2": 0.05}), *grid.dynamics[1:])
    with pytest.raises(
        GridError, match=r"bus 1, machine '1' \(ieee9_gen.csv\).*xd2 = 0.05 is not above the leakage xl = 0.1"
    ):
        grid_model(replace(grid, dynamics=wrong))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"lines": (Line(4, 5, "1", 0.01, 0.0, 0.1),)}, "line 4-5 '1': x = 0; give it an inductance"),
        ({"lines": (Line(4, 5, "1", -0.01, 0.1, 0.1),)}, "r = -0.01 pu is negative"),
        ({"transformers": (Transformer(4, 5, "1", 0.0, 0.1, shift=0.3),)}, "shifts the phase by 17.18"),
        ({"lines": (Line(4, 5, "9", 0.0, -0.1, 0.0),)}, ""),
    ],
)
def test_what_has_no_part_is_named(change: dict[str, Any], words: str) -> None:
    grid = nine()
    wrong = replace(grid, **{k: (*getattr(grid, k), *v) for k, v in change.items()})
    if not words:
        assert grid_model(wrong).network.members
        return
    with pytest.raises(GridError) as error:
        grid_model(wrong)
    assert words in str(error.value)


def test_a_bus_apart_is_named() -> None:
    grid = nine()
    with pytest.raises(GridError, match="bus 3: no branch in service joins it to the slack bus 1"):
        grid_model(replace(grid, transformers=tuple(t for t in grid.transformers if 3 not in (t.i, t.j))))


def test_words_of_faults_and_trips() -> None:
    assert fault_of("bus7:0.1:0.18") == Fault(7, 0.1, 0.18) and fault_of("7:0.1:0.2:0.01").R == 0.01
    assert trip_of("line5-7:0.2") == Trip("line5-7", 0.2)
    for text in ("bus7", "bus7:a:b", "bus7:0.2:0.1"):
        with pytest.raises(ValueError, match="fault"):
            fault_of(text)
    for text in ("line5-7:a", "line5-7:-0.1", "line5-7:nan", "line5-7:inf"):
        with pytest.raises(ValueError, match="trip"):
            trip_of(text)
    with pytest.raises(ValueError, match="say when"):
        grid_scene(nine(), trips=[Trip("line5-7")])
    with pytest.raises(GridError, match="no line or transformer 'line5-8' in service; did you mean"):
        grid_scene(nine(), trips=[Trip("line5-8", 0.1)])
    with pytest.raises(GridError, match="no bus 77 in service for a fault"):
        grid_scene(nine(), faults=[Fault(77, 0.1, 0.2)])


def test_the_account_names_what_is_used_and_assumed() -> None:
    text = str(model("wecc240").report)
    assert "plant: " in text and "r = 2e-05 pu" in text and "voltage held at bus" in text
    assert "not represented: 25 HYGOV" in text
    assert model("ieee39").report.of("line1_2").device == "line 1-2 '1'"
    with pytest.raises(KeyError, match="line1_99"):
        model("ieee39").report.of("line1_99")


def test_the_command_line_runs_a_case(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    case, data = str(CASES / "ieee9.raw"), str(CASES / "ieee9_gen.csv")
    line = ["run", case, "--dynamics", data, "--fault", "bus7:0.002:0.004", "--trip", "line5-7", "--stop", "0.01"]
    assert main([*line, "-o", str(tmp_path / "r.csv")]) == 0
    out = capsys.readouterr().out
    assert "operating point: " in out and "assumed, 5 x line" in out and "unexplained" in out
    assert main(["run", case, "--stop", "0.01"]) == 2
    assert "bus 1, machine '1': no dynamic data" in capsys.readouterr().err
    assert main(["run", "smib", "--fault", "bus7:0.1:0.2"]) == 2
    assert "--fault is for grids" in capsys.readouterr().err
