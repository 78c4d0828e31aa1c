"""What a run leaves: columns with units and inputs, rows and columns chosen, files that are read again, other packages."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from phfmu import Event, Monolithic, Options, PythonInstance, Scene, build_model, open_result, run
from phfmu.cli import main
from phfmu.components.library import build
from phfmu.network.couplings.coupled import Coupled
from phfmu.network.members.engine_member import EngineMember
from phfmu.runs.result import Result


def stepper(name: str = "dc_motor") -> Monolithic:
    found = build(name)
    model = build_model(found.declaration() if isinstance(found, Scene) else found)
    return Monolithic(model, PythonInstance(model))


@pytest.fixture(scope="module")
def result() -> Result:
    """A motor whose voltage is switched on at the start and raised at 0.03 s."""
    changes = (Event(0.0, "terminal.v", 12.0), Event(0.03, "terminal.v", 24.0))
    return run(stepper(), Options(stop=0.1, step=0.01, events=changes))


def test_inputs_are_columns(result: Result) -> None:
    """A row has the input of the step that ends there; the books know it: supplied = h u y over the step."""
    v = result.column("terminal.v")
    assert v.tolist() == [12.0] * 4 + [24.0] * 7
    work = np.diff(result.column("terminal.energy"))
    assert work == pytest.approx(0.01 * v[1:] * result.column("terminal.i_step")[1:], rel=1e-12)
    assert result.unit("terminal.v") == "V" and result.unit("w") == "rad/s" and result.unit("energy.stored") == "J"


def test_inputs_of_every_step(compiler: None, tmp_path: Path) -> None:
    """Rows of --input that fall on the grid, thousands in one stretch: each stands in the row of its own step."""
    t = np.arange(3000) * 1e-3
    v = 12.0 + np.sin(50 * t)
    rows = "\n".join(f"{a!r},{b!r}" for a, b in zip(t.tolist(), v.tolist(), strict=True))
    (tmp_path / "in.csv").write_text(f"time,terminal.v\n{rows}\n")
    out = tmp_path / "out.parquet"
    call = ["run", "dc_motor", "--input", str(tmp_path / "in.csv"), "--stop", "3", "-o", str(out), "--quiet"]
    assert main(call) == 0
    table = open_result(out)
    assert table.column("terminal.v")[1:].tolist() == v.tolist()
    work = np.diff(table.column("terminal.energy"))
    assert work == pytest.approx(1e-3 * v * table.column("terminal.i_step")[1:], rel=1e-9, abs=1e-12)


def test_members_apart_have_the_same_columns_and_units() -> None:
    scene = build("drive")
    whole = stepper("drive")
    members = [EngineMember(n, m := build_model(d), PythonInstance(m)) for n, d in scene.system.declared.items()]
    apart = Coupled(scene.system, members)
    assert apart.inputs() == whole.inputs() == {"motor.terminal.v": 12.0, "load.b.torque": 0.0}
    both = apart.units.keys() & whole.units.keys()
    assert len(both) >= 50 and {n: apart.units[n] for n in both} == {n: whole.units[n] for n in both}
    assert set(apart.names) <= set(apart.units)


def test_chosen_columns_and_rows(result: Result) -> None:
    changes = (Event(0.0, "terminal.v", 12.0), Event(0.03, "terminal.v", 24.0))
    few = run(stepper(), Options(stop=0.1, step=0.01, events=changes, signals=("terminal.*", "w"), every=4))
    assert few.names == ["terminal.i", "terminal.i_step", "terminal.energy", "terminal.v", "w"]
    assert few.units == ["A", "A", "J", "V", "rad/s"]
    kept = [0, 4, 8, 10]  # every fourth, and the last
    assert few.time.tolist() == result.time[kept].tolist()
    for name in few.names:
        assert few.column(name).tolist() == result.column(name)[kept].tolist()
    by_time = run(stepper(), Options(stop=0.1, step=0.01, every=0.025))
    assert by_time.time == pytest.approx([0.0, 0.03, 0.05, 0.08, 0.1])  # the first row at or after each multiple
    with pytest.raises(ValueError, match=r"the run has no signal 'terminl\.i'; did you mean terminal\.i"):
        run(stepper(), Options(stop=0.1, step=0.01, signals=("terminl.i",)))
    with pytest.raises(ValueError, match=r"--every 0: expected a number of rows from 1, or a time in s above 0"):
        Options(stop=0.1, step=0.01, every=0)


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_saved_and_opened(result: Result, tmp_path: Path, ending: str) -> None:
    path = result.save(tmp_path / f"run.{ending}", units_row=True)
    again = open_result(path)
    assert again.names == result.names and again.units == result.units
    assert again.time.tolist() == result.time.tolist() and np.array_equal(again.values, result.values)
    part = open_result(path, ["energy.*"])
    assert part.names == [n for n in result.names if n.startswith("energy.")]
    with pytest.raises(KeyError, match=r"no signal 'terminal\.u'; did you mean terminal\.v"):
        again.column("terminal.u")


def test_other_packages(result: Result) -> None:
    pytest.importorskip("pandas", reason="pandas is not installed")
    pytest.importorskip("polars", reason="polars is not installed")
    frame = result.to_pandas()
    assert frame.index.name == "time" and frame["w"].to_numpy().tolist() == result.column("w").tolist()
    assert frame.attrs["units"]["w"] == "rad/s"
    polar = result.to_polars()
    assert polar["terminal.i"].to_list() == result.column("terminal.i").tolist() and polar.columns[0] == "time"


def test_notebook_shows_a_table(result: Result) -> None:
    shown = result._repr_html_()
    assert "0 to 0.1 s" in shown and ">terminal.v< >V< >12< >24< >24<" in re.sub(r"</td><td [^>]*>", "< >", shown)
    assert repr(result) == f"<Result: {len(result.names)} signals, 11 rows, 0 to 0.1 s>"


def test_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "drive.csv"
    call = ["run", "drive", "--engine", "python", "--stop", "0.01", "-o", str(out), "--quiet"]
    assert (
        main([*call, "--signals", "motor.shaft.*", "--signals", "load.b.torque", "--every", "0.005s", "--units-row"])
        == 0
    )
    lines = out.read_text().splitlines()
    assert lines[0].split(",")[:3] == ["time", "motor.shaft.speed", "motor.shaft.speed_step"]
    assert lines[0].endswith("load.b.torque") and lines[1].startswith("s,rad/s,rad/s") and len(lines) == 5
    assert main([*call, "--every", "often"]) == 2
    assert "--every often: expected a number of rows (10) or a time (0.01s)" in capsys.readouterr().err


def test_kinds_of_signals_go_with_them(result: Result, tmp_path: Path) -> None:
    """Told by the declaration, kept in Parquet and beside CSV; a name says them where nothing else does."""
    kinds = dict(zip(result.names, result.kinds, strict=True))
    told = {
        "w": "state",
        "terminal.v": "input",
        "terminal.i": "port",
        "terminal.i_step": "mean",
        "energy.stored": "energy",
    }
    assert told.items() <= kinds.items() and kinds["terminal.energy"] == "energy" and "" not in kinds.values()
    again = open_result(result.save(tmp_path / "kinds.parquet"))
    assert again.kinds == result.kinds
    file = result.save(tmp_path / "kinds.csv")
    beside = open_result(file)
    assert (beside.kinds, beside.units) == (result.kinds, result.units)
    file.with_suffix(".columns.json").unlink()
    by_name = open_result(file)
    assert dict(zip(by_name.names, by_name.kinds, strict=True)) == {
        n: k if k in ("port", "mean", "energy", "algebraic", "end") else "" for n, k in kinds.items()
    }


def test_a_file_without_kinds_is_read_by_names(result: Result, tmp_path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = result.to_arrow()
    old = [f.with_metadata({b"unit": (f.metadata or {}).get(b"unit", b"")}) for f in table.schema]
    pq.write_table(table.cast(pa.schema(old)), tmp_path / "old.parquet")
    found = open_result(tmp_path / "old.parquet")
    assert found.units == result.units
    assert found.kinds[found.names.index("terminal.i_step")] == "mean" and found.kinds[found.names.index("w")] == ""


def test_what_a_signal_is_does_not_hang_on_its_name(tmp_path: Path) -> None:
    """A state that is called like a mean is drawn; by its name alone it is not."""
    from phfmu.report.picture.choice import usual
    from phfmu.results.kinds import kinds_by_name

    names = ["stride_step", "terminal.i_step", "my.energy"]
    kinds = {"stride_step": "state", "terminal.i_step": "mean", "my.energy": "observable"}
    assert usual(names, kinds) == ["stride_step", "my.energy"]
    assert usual([*names, "x"], kinds_by_name([*names, "x"])) == ["x"]


def test_a_csv_has_a_file_of_its_columns_beside_it(result: Result, tmp_path: Path) -> None:
    """One that pandas reads as a table; one of units alone is read too; one that is none is told."""
    import json

    pandas = pytest.importorskip("pandas", reason="pandas is not installed")
    file = result.save(tmp_path / "run.csv")
    path = tmp_path / "run.columns.json"
    told = pandas.read_json(path, orient="index")
    assert list(told.index) == ["time", *result.names]
    assert told.loc["terminal.i", "unit"] == "A" and told.loc["w", "kind"] == "state"
    assert list(pandas.read_csv(file).columns) == ["time", *result.names]  # the table itself is what it was
    path.write_text(json.dumps({"time": "s", "w": "rpm"}))
    assert open_result(file, ["w"]).units == ["rpm"]
    path.write_text("[]")
    with pytest.raises(ValueError, match="run.columns.json does not tell of the columns of run.csv"):
        open_result(file)


def test_elements_have_names_for_readers_and_numbers_for_programs(tmp_path: Path) -> None:
    from phfmu.components.library import build

    scene = build("smib")
    model = build_model(scene.declaration())
    rows = run(Monolithic(model, PythonInstance(model)), Options(stop=2e-4, step=1e-4))
    labels = dict(zip(rows.names, rows.labels, strict=True))
    wanted = {
        "gen.I[1]": "gen.I[a]", "gen.I[4]": "gen.I[fd]", "gen.I[6]": "gen.I[kq]", "gen.psi[3]": "gen.psi[0]",
        "gen.terminal.i_step[2]": "gen.terminal.i_step[b]", "bus1.v[3]": "bus1.v[c]", "bus1.v_end[3]": "bus1.v_end[c]",
        "line.a.i[1]": "line.a.i[a]", "grid.v[2]": "grid.v[b]", "gen.Te": "", "gen.shaft.torque": "",
    }  # fmt: skip
    assert wanted.items() <= labels.items()
    for ending in ("csv", "parquet"):
        again = open_result(rows.save(tmp_path / f"run.{ending}"))
        assert again.names == rows.names and again.labels == rows.labels
