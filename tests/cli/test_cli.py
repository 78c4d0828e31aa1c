"""Runs and audits at the command line on sound input: every option, every kind of target, and the tables they write."""

from __future__ import annotations

import os
import shutil
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from phfmu.audit import AuditWriter, metadata, read
from tests.cli.commands import Cli, balances, column, table

# -- result tables -------------------------------------------------------------------------------------------


def test_columns_of_a_component(cli: Cli) -> None:
    code, out, _ = cli("run", "four_particle", "--stop", "0.105", "-o", "f.csv")
    names, rows = table("f.csv")
    assert code == 0 and "11 steps" in out and "largest |constraint.velocity.lambda| over the run" in out
    assert names[0] == "time" and names.count("q[1]") == 1
    wanted = ["energy.stored", "energy.supplied", "energy.dissipated", "energy.residual"]
    wanted += [f"q[{i}]" for i in range(1, 13)] + [f"v[{i}]" for i in range(1, 13)]
    assert [n for n in names if n in wanted] == wanted
    assert {"lambda[1]", "lambda_end[2]", "constraint.position.lambda[1]"} <= set(names)
    # a row at the start with the start values, and the last partial step is taken
    assert np.allclose(rows[:, 0], [*np.arange(11) * 0.01, 0.105], rtol=0, atol=1e-15)
    assert rows[0, names.index("v[12]")] == 20 / 17 and rows[0, names.index("q[4]")] == 1.0


def test_columns_of_a_machine_in_csv_and_parquet(cli: Cli) -> None:
    assert cli("run", "smib", "--stop", "0.0022", "--quiet", "-o", "s.csv") == (0, "", "")
    assert cli("run", "smib", "--stop", "0.0022", "--quiet", "-o", "s.parquet") == (0, "", "")
    names, rows = table("s.csv")
    assert names[0] == "time" and len(rows) == 23
    assert {f"gen.I[{i}]" for i in range(1, 7)} | {"gen.p", "gen.theta", "energy.stored"} <= set(names)
    assert {"gen.shaft.speed", "gen.terminal.i[1]", "gen.terminal.i_step[1]", "bus1.v[3]"} <= set(names)
    again, same = table("s.parquet")
    assert again == names and np.array_equal(same, rows)  # 17 digits lose nothing


def test_events_land_on_the_grid_exactly(cli: Cli) -> None:
    assert cli("run", "models.py:pushed", "--stop", "0.95", "-o", "p.csv", "--quiet")[0] == 0
    time_, v = column("p.csv", "time"), column("p.csv", "v")
    assert 0.31 in time_ and 0.52 in time_ and time_[0] == 0.0 and time_[-1] == 0.95
    assert np.diff(time_).max() < 0.1 * (1 + 1e-12) and np.diff(time_).min() > 1e-3
    exact = np.clip(time_ - 0.31, 0.0, 0.21)  # 2 N on 2 kg
    assert np.allclose(v, exact, rtol=0, atol=1e-14)


def test_input_table_is_held(cli: Cli) -> None:
    Path("in.csv").write_text("time,flange.force,m\n0,1,1\n# the mass doubles\n\n0.25,1,2\n0.5,-2,2\n")
    code, out, _ = cli("run", "mass", "--step", "0.1", "--input", "in.csv", "-o", "p.csv")
    assert code == 0 and "events: 1 parameter, 1 input" in out
    time_, q, v = (column("p.csv", n) for n in ("time", "q", "v"))
    (middle,) = np.flatnonzero(time_ == 0.5)
    assert 0.25 in time_
    # velocity is the state: it stays when the mass changes
    assert [v[middle], v[-1]] == pytest.approx([0.375, -0.125], rel=1e-13)
    work = q[middle] - 2 * (q[-1] - q[middle])
    assert column("p.csv", "flange.energy")[-1] == pytest.approx(work, rel=1e-12)


def test_input_rows_before_the_start_hold_at_the_start(cli: Cli) -> None:
    """With a byte order mark, as spreadsheets write it."""
    Path("in.csv").write_text("\ufefftime,flange.force\n-3,5\n-1,2\n0.5,0\n", encoding="utf-8")
    assert cli("run", "mass", "--step", "0.1", "--input", "in.csv", "-o", "p.csv", "--quiet")[0] == 0
    assert column("p.csv", "v")[-1] == pytest.approx(1.0, rel=1e-13)


def test_set(cli: Cli) -> None:
    words = ["--set", "mass1.q=0.5", "--set", "mass2.m = 2", "--set", "spring12.e=-0.5", "--stop", "0.02"]
    assert cli("run", "oscillator", *words, "-o", "o.csv")[0] == 0
    assert column("o.csv", "mass1.q")[0] == 0.5
    assert column("o.csv", "energy.stored")[0] == pytest.approx(2.5 * np.pi**2, rel=1e-14)
    assert cli("run", "mass", "--set", "flange.force=3", "-o", "m.csv", "--quiet")[0] == 0
    assert column("m.csv", "v")[-1] == pytest.approx(3.0, rel=1e-12)
    words = ["--set", "G=2", "--set", "terminal.v[1]=3", "--stop", "0.01"]
    assert cli("run", "fault_resistor", *words, "-o", "g.csv", "--quiet")[0] == 0
    assert column("g.csv", "terminal.i[1]")[-1] == pytest.approx(6.0)


# -- schemes, engines, couplings -----------------------------------------------------------------------------


def test_order(cli: Cli) -> None:
    errors = []
    for order in ("2", "4"):
        code, out, _ = cli("run", "oscillator", "--order", order, "-o", "o.csv")
        assert code == 0 and f"order {order}" in out
        t = column("o.csv", "time")
        exact = (np.cos(2 * np.pi * t) + np.cos(6 * np.pi * t)) / 2
        errors.append(np.abs(column("o.csv", "mass1.q") - exact).max())
    assert 0.01 < errors[0] < 0.1 and errors[1] < 2e-4


@pytest.mark.slow
def test_engines_and_couplings_agree(cli: Cli) -> None:
    results = {}
    for engine, coupling in product(("python", "native", "fmu"), ("monolithic", "newton")):
        words = ["--engine", engine, "--coupling", coupling, "--stop", "0.2", "-o", "o.csv"]
        code, out, _ = cli("run", "oscillator", *words)
        assert code == 0 and f"{engine} engine, {coupling}" in out and "VIOLATED" not in out
        results[engine, coupling] = column("o.csv", "mass1.q"), column("o.csv", "spring12.b.force_step")
    q, f = results["python", "monolithic"]
    for way, (q_way, f_way) in results.items():
        assert np.allclose(q_way, q, rtol=0, atol=1e-11), way
        assert np.allclose(f_way, f, rtol=0, atol=1e-9), way


def test_targets_in_a_file(cli: Cli) -> None:
    assert cli("run", "models.py:ready", "--stop", "0.01")[0] == 0
    code, out, _ = cli("info", "models.py:joined")
    assert code == 0 and "junction joint: m.flange, s.b" in out and "mass and spring" in out
    assert cli("check", str(Path("models.py").resolve()) + ":joined")[0] == 0
    assert "step 0.001 s to 1 s: 1000 steps" in cli("run", "models.py:joined", "-o", "j.csv")[1]
    exact = 0.3 + 0.2 * np.cos(np.sqrt(3) * column("j.csv", "time"))
    assert np.allclose(column("j.csv", "m.q"), exact, rtol=0, atol=1e-6)


def test_a_run_without_a_compiler(cli: Cli, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from phfmu.engine.build import compile as found
    from phfmu.engine.native import library

    def missing() -> None:
        raise found.CompilerMissing("none here")

    monkeypatch.setattr(library, "require_compiler", missing)
    code, out, err = cli("run", "mass", "--stop", "0.01")
    assert code == 0 and "native engine" in out and not err  # by what a compiler left in the cache
    monkeypatch.setenv("PHFMU_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(library, "runtime", missing)
    code, out, err = cli("run", "mass", "--stop", "0.01")
    assert code == 0 and "python engine" in out and "using the Python engine" in err


def test_a_run_says_how_kernels_ran(cli: Cli, compiler: None, tmp_path: Path) -> None:
    from pyarrow import parquet as pq

    log = tmp_path / "log.parquet"
    for kernels in ("interpreted", "compiled"):
        code, out, _ = cli("run", "mass", "--stop", "0.01", "--kernels", kernels, "--audit", str(log))
        assert code == 0 and f"native engine, monolithic, kernels {kernels};" in out.splitlines()[0]
        told = pq.read_schema(log).metadata
        assert any(f"kernels {kernels}" in value.decode() for value in told.values())
        log.unlink()
    code, out, _ = cli("run", "mass", "--stop", "0.01", "--engine", "python")
    assert code == 0 and "kernels" not in out.splitlines()[0]
    code, _, err = cli("run", "mass", "--engine", "python", "--kernels", "compiled")
    assert code == 2 and "--kernels compiled is for the native engine, here it is python" in err


# -- units ---------------------------------------------------------------------------------------------------


def test_export_and_run_of_the_unit(cli: Cli) -> None:
    code, out, _ = cli("export", "oscillator", "-o", "out/units", "--fmi", "3", "--set", "mass1.q=0.5")
    (path,) = out.split()
    assert code == 0 and path == str(Path("out/units/oscillator_fmi3.fmu"))
    assert cli("check", path)[0] == 0 and "mass1.m" in cli("info", path)[1]
    assert cli("run", path, "--stop", "0.105", "-o", "u.csv", "--audit", "u.parquet")[0] == 0
    assert cli("run", "oscillator", "--set", "mass1.q=0.5", "--stop", "0.105", "-o", "o.csv")[0] == 0
    assert column("u.csv", "time")[-1] == 0.105
    assert np.allclose(column("u.csv", "mass1.q"), column("o.csv", "mass1.q"), rtol=0, atol=1e-13)
    assert cli("audit", "u.parquet")[0] == 0


def test_export_both_versions_and_inputs_of_a_unit(cli: Cli) -> None:
    out = cli("export", "mass", "--step", "0.01")[1]
    assert out.split() == ["mass_fmi2.fmu", "mass_fmi3.fmu"]
    Path("in.csv").write_text("time,flange.force\n0,2\n0.5,0\n")
    for path in out.split():
        words = ["--set", "m=4", "--set", "q=3", "--input", "in.csv", "-o", "u.csv"]
        code, out, _ = cli("run", path, *words)
        assert code == 0 and "step 0.01 s to 1 s: 100 steps" in out  # of its default experiment
        assert column("u.csv", "q")[0] == 3.0
        assert column("u.csv", "v")[-1] == pytest.approx(0.25, rel=1e-12)


# -- the audit and the pipe ----------------------------------------------------------------------------------


def test_audit_prints_the_totals_of_the_run(cli: Cli) -> None:
    code, out, _ = cli("run", "drive", "--stop", "0.02", "--audit", "d.parquet")
    assert code == 0 and "audit: d.parquet (print with: phfmu audit d.parquet)" in out
    assert not Path("d.arrows").exists()
    code, again, err = cli("audit", "d.parquet")
    assert (code, err) == (0, "") and balances(again) == balances(out)
    about = metadata(read("d.parquet"))
    assert about["target"] == "drive" and "order 2" in about["run"]


def test_audit_judges_by_rtol(cli: Cli) -> None:
    assert cli("run", "oscillator", "--audit", "o.parquet", "--quiet")[0] == 0
    assert cli("audit", "o.parquet", "--rtol", "1e-30")[0] == 0  # rounding closes
    line = "run four_particle --scheme midpoint --stop 0.1 --audit m.parquet --quiet"
    assert cli(*line.split())[0] == 4
    code, out, _ = cli("audit", "m.parquet", "--rtol", "1e-6")
    assert code == 4 and "VIOLATED" in out and "allowed: 1.0e-06" in out


def test_recover(cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    """A run that is killed leaves its stream: it can be read, and made the file of a sound end."""
    with monkeypatch.context() as killed:
        killed.setattr(AuditWriter, "close", lambda self: self.flush())
        cli("run", "oscillator", "--audit", "o.parquet")
    shutil.copy("o.arrows", "by_name.arrows")
    os.truncate("o.arrows", os.path.getsize("o.arrows") - 5)
    said = cli("audit", "recover", "o.arrows")[1]
    assert "recovered 0 rows into o.parquet (the torn end" in said and not Path("o.arrows").exists()
    code, out, _ = cli("audit", "by_name.arrows")
    assert code == 0 and "100 steps" in out and cli("audit", "recover", "by_name.parquet")[0] == 0
    assert cli("audit", "by_name.parquet")[:2] == (0, out)
