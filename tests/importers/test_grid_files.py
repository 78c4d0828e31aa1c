"""Readers of grids: formats and revisions that say the same give the same table; broken files are named."""

from __future__ import annotations

from dataclasses import replace
from math import radians
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phfmu.components.grids import grid_model
from phfmu.components.scenes.electrical.grids import public_grid
from phfmu.importers.grid import Grid, GridError, from_pandapower, read_grid, read_matpower, read_raw, with_dynamics
from phfmu.operating import PV

CASES = Path(__file__).parent.parent / "reference" / "data" / "grids"
NINE = CASES / "ieee9.raw"
HEAD = "0, 100.0, {revision}, 0, 1, 60.0 / made\nTITLE\nTITLE\n"
END = "0 / END OF {} DATA, BEGIN {} DATA\n"


def case(
    revision: int, bus: str, load: str, shunt: str, unit: str, branch: str, transformer: str, switched: str
) -> str:
    """A case of one record in each section, with the sections' names in their ends."""
    names = ("BUS", "LOAD", "FIXED SHUNT", "GENERATOR", "BRANCH", "TRANSFORMER", "AREA")
    parts = [bus, load, shunt, unit, branch, transformer]
    text = HEAD.format(revision=revision)
    if revision >= 34:
        text += "GENERAL, THRSHZ=0.0001\n0 / END OF SYSTEM-WIDE DATA, BEGIN BUS DATA\n@! a comment\n"
    for name, after, part in zip(names, names[1:], parts, strict=False):
        text += part + END.format(name, after)
    return text + END.format("AREA", "SWITCHED SHUNT") + switched + END.format("SWITCHED SHUNT", "GNE") + "Q\n"


BUS = "1,'A / B',20.0,3,1,1,1,1.02,5.0\n2,'C',230.0,1,1,1,1,1.0,-3.0\n"
LOAD = "2,'1',1,1,1,50.0,20.0,1.0,2.0,3.0,-4.0\n"
SHUNT = "2,'1',1,0.5,10.0 / kept\n"
TRANSFORMER = (
    "1,2,0,'1',2,2,1,0.0,0.0,2,'T',1,1,1.0,0,1.0,0,1.0,0,1.0,'YNd1'\n0.01,0.1,50.0\n21.0,20.0,30.0\n230.0,230.0\n"
)
UNIT = {
    33: "1,'1',60,10,99,-99,1.02,0,200,0.01,0.2,0,0,1,1\n",
    35: "1,'1',60,10,99,-99,1.02,0,0,200,0.01,0.2,0,0,1,1\n",
}
LINE = {
    33: "2,1,'1',0.01,0.1,0.2,9,9,9,0.1,0.2,0.3,0.4,1\n",
    34: f"2,1,'1',0.01,0.1,0.2,''{',9' * 12},0.1,0.2,0.3,0.4,1\n",
}
SWITCHED = {33: "2,1,0,1,1.1,0.9,0,100,'',25.0\n", 35: "2,'1',1,0,1,1.1,0.9,0,0,100,'',25.0\n"}


def made(tmp_path: Path, revision: int) -> Grid:
    path = tmp_path / f"v{revision}.raw"
    path.write_text(
        case(revision, BUS, LOAD, SHUNT, UNIT[35 if revision == 35 else 33], LINE[34 if revision > 33 else 33], TRANSFORMER,
             SWITCHED[35 if revision == 35 else 33])
    )  # fmt: skip
    return read_raw(path)


@pytest.mark.parametrize("revision", (32, 33, 34, 35))
def test_each_revision_gives_the_same_table(tmp_path: Path, revision: int) -> None:
    grid = made(tmp_path, revision)
    assert (grid.base, grid.frequency, grid.slack.number) == (100.0, 60.0, 1)
    assert grid.buses[0].name == "A / B" and grid.buses[1].va == radians(-3.0)
    line, transformer, unit = grid.lines[0], grid.transformers[0], grid.generators[0]
    assert (line.r, line.x, line.b, line.ends) == (0.01, 0.1, 0.2, (0.1, 0.2, 0.3, 0.4))
    assert (unit.p, unit.base, unit.r, unit.x) == (60.0, 200.0, 0.01, 0.2)
    assert (transformer.r, transformer.x) == (0.02, 0.2)  # of 50 MVA
    assert transformer.tap == 21.0 / 20.0 and transformer.shift == radians(30.0) and transformer.group == "YNd1"
    assert grid.demands[0].p == 50.0 and grid.demands[0].yq == -4.0
    assert [s.b for s in grid.shunts] == [10.0, 25.0] and grid.shunts[0].g == 0.5


def test_ends_without_names_are_taken_in_order(tmp_path: Path) -> None:
    text = NINE.read_text()
    plain = "\n".join("0" if "/ END OF" in line else line for line in text.splitlines())
    (tmp_path / "ieee9.raw").write_text(plain)
    assert read_raw(tmp_path / "ieee9.raw") == read_raw(NINE)


def test_three_windings_are_a_star(tmp_path: Path) -> None:
    """Between each two of its windings the star has the impedance that the file gives."""
    bus = BUS + "3,'D',10.0,1,1,1,1,1.0,0.0\n"
    star = "1,2,3,'1',1,1,1,0,0,2,'T',1\n0.01,0.1,100,0.02,0.3,100,0.03,0.16,100,1.0,0.0\n1.0\n1.0\n1.0\n"
    (tmp_path / "a.raw").write_text(case(33, bus, LOAD, SHUNT, UNIT[33], LINE[33], star, SWITCHED[33]))
    z = [complex(t.r, t.x) for t in read_raw(tmp_path / "a.raw").transformers]
    np.testing.assert_allclose([z[0] + z[1], z[1] + z[2], z[2] + z[0]], [0.01 + 0.1j, 0.02 + 0.3j, 0.03 + 0.16j])


def test_dyr_says_what_the_tables_say(tmp_path: Path) -> None:
    tables = with_dynamics(read_raw(NINE), CASES / "ieee9_gen.csv")
    assert [d.model for d in tables.dynamics] == ["GENROU"] * 3 and tables.dynamics[0].id == "1"  # 1' in the table
    rows = []
    for d in tables.dynamics:
        numbers = " ".join(f"{v:g}" for k, v in d.values.items() if k != "ra")
        rows.append(f"{d.bus} 'GENROU' {d.id}\n   {numbers} /\n{d.bus} 'IEEEVC' 1 0 0.1 / of no part\n")
    (tmp_path / "a.dyr").write_text("".join(rows))
    found = with_dynamics(read_raw(NINE), tmp_path / "a.dyr")
    for a, b in zip(tables.dynamics, [d for d in found.dynamics if d.model == "GENROU"], strict=True):
        assert {k: v for k, v in a.values.items() if k != "ra"} == dict(b.values)
    assert sum(d.model == "IEEEVC" for d in found.dynamics) == 3


@pytest.mark.parametrize(
    ("find", "put", "words"),
    [
        ("1.00000E-2, 8.50000E-2", "1.00000E-2, eight", "line 23, branch data: field 5 is 'eight', not a number"),
        ("0 / END OF GENERATOR DATA, BEGIN BRANCH DATA\n", "", "line 28 ends the branch data where generator data stand"),
        ("     5,'1 ',1,", "    55,'1 ',1,", "load '1': no bus 55"),
        (" 16.5000,3,", " 16.5000,2,", "0 slack buses"),
        (" 16.5000,3,", " 0.0,3,", "bus 1: base voltage 0 kV must be positive"),
        (", 33, 0, 1, 60", ", 29, 0, 1, 60", "revision 29 of the format; 32 to 35"),
        ("     4,     1,     0,'1 ',1,1,1", "     4,    71,     0,'1 ',1,1,1", "no bus 71"),
        ("     2,'BUS 2", "     1,'BUS 2", "bus 1 is there twice"),
    ],
)  # fmt: skip
def test_a_broken_case_is_named(tmp_path: Path, find: str, put: str, words: str) -> None:
    text = NINE.read_text()
    assert find in text
    (tmp_path / "broken.raw").write_text(text.replace(find, put, 1))
    with pytest.raises(GridError) as error:
        read_raw(tmp_path / "broken.raw")
    assert words in str(error.value) and str(error.value).startswith("broken")


def test_all_problems_of_a_table_are_told_at_once() -> None:
    grid = read_raw(NINE)
    wrong = [replace(d, bus=90 + k) for k, d in enumerate(grid.demands)]
    with pytest.raises(GridError) as error:
        replace(grid, demands=tuple(wrong))
    assert len(error.value.problems) == 3


def test_two_tables_of_one_unit_are_refused(tmp_path: Path) -> None:
    for name in ("a_gen.csv", "b_gen.csv"):
        (tmp_path / name).write_text((CASES / "ieee9_gen.csv").read_text())
    with pytest.raises(GridError, match="b_gen.csv: GENROU of '1' at bus 1 stands in a_gen.csv too"):
        with_dynamics(read_raw(NINE), tmp_path)
    assert len(with_dynamics(read_raw(NINE), tmp_path / "a_*.csv").dynamics) == 3


def test_data_that_end_too_early_are_named(tmp_path: Path) -> None:
    (tmp_path / "a.dyr").write_text("1 'GENROU' 1  8.9 0.01 /\n")
    with pytest.raises(GridError, match="GENROU of '1' at bus 1 has 2 numbers; missing: Tq10"):
        with_dynamics(read_raw(NINE), tmp_path / "a.dyr")
    (tmp_path / "b.dyr").write_text("one 'GENROU' 1 /\n")
    with pytest.raises(GridError, match="record 1: 'one 'GENROU' 1' is not"):
        with_dynamics(read_raw(NINE), tmp_path / "b.dyr")


def test_matpower_and_raw_give_one_grid(tmp_path: Path) -> None:
    pytest.importorskip("matpowercaseframes", reason="the extra `grid` is not installed")
    grid = public_grid("new_england")
    rows = {"bus": [], "gen": [], "branch": []}
    load = {d.bus: d for d in grid.demands}
    for b in grid.buses:
        d = load.get(b.number)
        rows["bus"].append(
            [b.number, b.kind, d.p if d else 0.0, d.q if d else 0.0, 0, 0, 1, b.vm, np.degrees(b.va), b.kv, 1, 1.1, 0.9]
        )
    rows["gen"] += [[g.bus, g.p, g.q, 99, -99, g.v, g.base, 1, 999, 0] for g in grid.generators]
    rows["branch"] += [[x.i, x.j, x.r, x.x, x.b, 0, 0, 0, 0, 0, 1, -360, 360] for x in grid.lines]
    rows["branch"] += [[x.i, x.j, x.r, x.x, 0, 0, 0, 0, x.tap, 0, 1, -360, 360] for x in grid.transformers]
    text = "function mpc = made\nmpc.version = '2';\nmpc.baseMVA = 100;\n"
    for name, matrix in rows.items():
        body = "\n".join("\t" + "\t".join(repr(float(v)) for v in row) + ";" for row in matrix)
        text += f"mpc.{name} = [\n{body}\n];\n"
    (tmp_path / "made.m").write_text(text)
    found = read_matpower(tmp_path / "made.m")
    ends = [{(x.i, x.j): (x.r, x.x) for x in g.lines} for g in (grid, found)]
    assert ends[0] == ends[1]
    assert {(t.i, t.j): (t.x, t.tap) for t in grid.transformers if t.tap != 1} == {
        (t.i, t.j): (t.x, t.tap) for t in found.transformers
    }
    assert [b.vm for b in grid.buses] == pytest.approx([b.vm for b in found.buses], abs=1e-12)


def test_new_england_is_the_case_of_pandapower() -> None:
    """The table of the package is that of pandapower's case39, and so is the solution, which its power flow finds again."""
    pp = pytest.importorskip("pandapower", reason="the extra `grid` is not installed")
    from pandapower.networks import case39

    net, ours = case39(), public_grid("new_england")
    theirs = from_pandapower(net)
    assert [(b.i - 1, b.j - 1, b.r, b.x, b.b) for b in ours.lines] == [(b.i, b.j, b.r, b.x, b.b) for b in theirs.lines]
    assert [(t.i - 1, t.j - 1, t.x, t.tap) for t in ours.transformers] == [
        (t.i, t.j, t.x, t.tap) for t in theirs.transformers
    ]
    assert [(d.bus - 1, d.p, d.q) for d in ours.demands] == [(d.bus, d.p, d.q) for d in theirs.demands]
    pp.runpp(net, tolerance_mva=1e-9, calculate_voltage_angles=True, trafo_model="pi", init="dc", numba=False)
    assert [b.vm for b in ours.buses] == pytest.approx(list(net.res_bus.vm_pu), abs=1e-9)
    assert [b.va for b in ours.buses] == pytest.approx(list(np.radians(net.res_bus.va_degree)), abs=1e-9)


def limited_new_england(most: float, less: float) -> tuple[Any, Any]:
    """Pandapower's net with a part `most` of its upper limits of reactive power, the lower ones less by `less` Mvar, as table."""
    pytest.importorskip("pandapower", reason="the extra `grid` is not installed")
    from pandapower.networks import case39

    net = case39()
    net.gen.max_q_mvar *= most
    net.gen.min_q_mvar -= less
    return net, from_pandapower(net)


@pytest.mark.parametrize("most", [0.6, 0.8])
def test_limits_of_reactive_power_are_met_as_by_pandapower(most: float) -> None:
    pp = pytest.importorskip("pandapower", reason="the extra `grid` is not installed")

    net, grid = limited_new_england(most, 500.0)
    pp.runpp(net, tolerance_mva=1e-9, calculate_voltage_angles=True, trafo_model="pi", init="dc", numba=False,
             enforce_q_lims=True)  # fmt: skip
    m = grid_model(grid, plants="currents", controls=False, q_limits=True)
    V = m.voltages()
    for bus, q in zip(net.gen.bus, net.res_gen.q_mvar, strict=True):
        assert -m.point.power(f"plant{bus}.terminal").imag / 1e6 == pytest.approx(q, abs=1e-6)
        assert abs(V[bus]) == pytest.approx(net.res_bus.vm_pu[bus], abs=1e-9)
    at_limit = {f"plant{b}.terminal" for b, q, top in zip(net.gen.bus, net.res_gen.q_mvar, net.gen.max_q_mvar, strict=True)
                if q > top - 1e-6}  # fmt: skip
    assert at_limit == set(m.point.limited) and len(at_limit) >= (4 if most < 0.7 else 1)


def test_a_regulator_leaves_its_limit_where_its_voltage_lets_it() -> None:
    """At bus 36 Q would be negative before others are at their limits; then it holds 1.0275 pu with 8.65 Mvar."""
    _, grid = limited_new_england(0.6, 0.0)
    m = grid_model(grid, plants="currents", controls=False, q_limits=True)
    free = grid_model(grid, plants="currents", controls=False)
    assert any(line.startswith("plant33 delivers") and "beyond its limits" in line for line in free.beyond())
    assert (
        sum("does not hold the voltage" in line for line in m.beyond()) == len(m.beyond()) == len(m.point.limited) == 4
    )
    V = m.voltages()
    for g in grid.generators:
        port, b = f"plant{g.bus}.terminal", grid.bus[g.bus]
        if b.kind != 2:
            continue
        q, (low, high) = -m.point.power(port).imag / 1e6, g.q_limits
        assert low - 1e-6 <= q <= high + 1e-6
        if port not in m.point.limited:
            assert abs(V[g.bus]) == pytest.approx(g.v, abs=1e-9)
        else:
            assert (q > high - 1e-6 and abs(V[g.bus]) < g.v) or (q < low + 1e-6 and abs(V[g.bus]) > g.v)
    assert "plant36.terminal" not in m.point.limited


def test_limits_that_are_nowhere_are_refused() -> None:
    with pytest.raises(ValueError, match="PV at gen.terminal: Q is within 2 and 1 var, which is nowhere"):
        PV("gen.terminal", P=1.0, V=1.0, Q=(2.0, 1.0))


def test_a_name_that_is_no_grid() -> None:
    with pytest.raises(GridError, match=r"no grid: its name ends in none of \.raw, \.m"):
        read_grid("case.txt")
