"""Networks of many equal members on the command line: planned once, told in a summary."""

import csv
import io
import resource
import subprocess
import sys
from pathlib import Path

import pytest

import phfmu.discretise.model as discretise
from phfmu import Network
from phfmu.audit.tables.report import shortened
from phfmu.audit.tables.sheets import Sheet, SheetColumn
from phfmu.cli import main

STAR = """
from phfmu import Network
from phfmu.components.mechanical.translational import mass, spring

def star(n={n}):
    net = Network("star")
    net.add("middle", mass(1.0, v=1.0))
    for i in range(n):
        net.add(f"m{{i}}", mass(1.0 + i / n))
        net.add(f"s{{i}}", spring(100.0))
        net.junction(f"j{{i}}", [f"m{{i}}.flange", f"s{{i}}.b"])
    net.junction("hub", ["middle.flange", *(f"s{{i}}.a" for i in range(n))])
    return net
"""


@pytest.fixture
def star(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.chdir(tmp_path)
    Path("star.py").write_text(STAR.format(n=30))
    return "star.py"


def test_equal_members_are_planned_once(star: str, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    made, last = [], "m7.v"
    Path(star).write_text(STAR.format(n=8))
    plan = discretise.step_plan
    monkeypatch.setattr(discretise, "_PLANNED", {})  # of other tests in this process
    monkeypatch.setattr(discretise, "step_plan", lambda *a: made.append(a[0].model.name) or plan(*a))
    assert main(["run", star, "--coupling", "newton", "--stop", "0.003", "-o", "apart.csv"]) == 0
    assert len(made) == 2, made
    assert main(["run", star, "--engine", "python", "--stop", "0.003", "-o", "composed.csv"]) == 0
    capsys.readouterr()
    apart, composed = (dict(zip(*rows, strict=True)) for rows in map(first_and_last, ("apart.csv", "composed.csv")))
    for name in ("m0.v", last, "middle.v", "s5.e"):
        assert float(apart[name]) == pytest.approx(float(composed[name]), rel=1e-9)
    assert apart["m0.v"] != apart[last]  # each has a mass of its own


def first_and_last(path: str) -> tuple[list[str], list[str]]:
    rows = list(csv.reader(io.StringIO(Path(path).read_text())))
    return rows[0], rows[-1]


def test_what_a_run_prints_does_not_grow_with_the_members(star: str, capsys) -> None:
    assert main(["run", star, "--coupling", "newton", "--stop", "0.003", "--audit", "a.parquet"]) == 0
    out = capsys.readouterr().out
    assert len(out.splitlines()) < 110
    assert "38 others" in out
    assert main(["audit", "a.parquet"]) == 0
    assert "38 others" in capsys.readouterr().out
    assert main(["audit", "a.parquet", "--all"]) == 0
    out = capsys.readouterr().out
    assert "others" not in out and "m29 " in out


def test_of_many_hidden_constraints_the_largest_are_told(star: str, capsys) -> None:
    """A second mass on each spring: two velocities are one."""
    text = STAR.format(n=30).replace('.b"])', '.b", f"w{i}.flange"])')
    Path(star).write_text(text.replace('net.add(f"s', 'net.add(f"w{i}", mass(1.0))\n        net.add(f"s'))
    assert main(["run", star, "--coupling", "newton", "--stop", "0.003"]) == 0
    out = capsys.readouterr().out
    assert out.count("largest |constraint.velocity.") == 12 and "and 18 more of these" in out


def test_info_groups_members_by_kind(star: str, capsys) -> None:
    assert main(["info", star]) == 0
    out = capsys.readouterr().out
    assert len(out.splitlines()) < 20
    assert "61 of 2 kinds" in out and "31 x mass" in out and "30 x spring" in out and "m = 1 .. 1.96667 kg" in out
    assert "30 x mass.flange, spring.b" in out and "1 x mass.flange, 30 x spring.a" in out
    assert main(["info", star, "--all"]) == 0
    assert "junction j29:" in capsys.readouterr().out
    assert main(["info", "oscillator"]) == 0
    assert "junction" in capsys.readouterr().out


def test_the_last_row_of_a_shortened_table_is_the_sum_of_all_others() -> None:
    worst, verdict = SheetColumn("worst", float, adds=False), SheetColumn("verdict", str, "word")
    columns = (SheetColumn("name", str, "name"), SheetColumn("J", float), worst, verdict)
    rows = tuple((f"c{i}", float(i), -float(i), "closed" if i != 3 else "VIOLATED") for i in range(10))
    sheet = Sheet("component", columns, rows)
    assert shortened(sheet, 10) is sheet
    short = shortened(sheet, 4)
    assert [r[0] for r in short.rows] == ["c3", "c8", "c9", "7 others"]
    assert short.rows[-1] == ("7 others", 0.0 + 1 + 2 + 4 + 5 + 6 + 7, -7.0, "closed")


def test_many_junctions_are_made_in_linear_time_and_joined_ends_are_known() -> None:
    from phfmu.components.mechanical.translational import mass, spring
    from phfmu.network.junction import ConnectionError

    net = Network("n")
    net.add("a", mass(1.0))
    net.add("b", mass(1.0))
    net.add("s", spring(1.0))
    net.junction("one", ["a.flange", "s.a"])
    with pytest.raises(ConnectionError, match=r"a\.flange.*'one'"):
        net.junction("two", ["a.flange", "b.flange"])
    net.junctions.clear()
    net.junction("two", ["a.flange", "b.flange"])
    with pytest.raises(ConnectionError, match="'two' is taken"):
        net.junction("two", ["s.a", "s.b"])


@pytest.mark.slow
def test_five_hundred_wheels_on_springs_start_in_at_most_fifteen_times_the_processor_time_of_two(
    tmp_path: Path,
) -> None:
    """9.2 s against 1.4 s; planned one by one about 50 s, 35 times."""

    def spent(n: int) -> float:
        (tmp_path / "star.py").write_text(STAR.format(n=n))
        words = ["run", "star.py", "--coupling", "newton", "--stop", "0.001", "--quiet"]
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([sys.executable, "-m", "phfmu", *words], cwd=tmp_path, check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime

    spent(2)  # compiles, once on a machine
    assert spent(500) <= 15.0 * spent(2)
