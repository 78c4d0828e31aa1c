"""The command `phfmu bench`, and peers that may be absent."""

from __future__ import annotations

import csv
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from phfmu import Scene
from phfmu.cli import FINE, USAGE, main
from phfmu.components.library import LIBRARY
from phfmu.components.mechanical.four_particle import four_particle
from phfmu.studies.bench.families import FAMILIES, member
from phfmu.studies.bench.precision.candidate import NotAvailable
from phfmu.studies.bench.precision.problem import InitialValueProblem, problem_of
from phfmu.studies.bench.precision.work_precision import measure
from tests.bench.rows import declaration, rows, solved

# -- the command --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_bench_of_the_oscillator(compiler: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Rows of own schemes fall with their order; the reference is exact: q1 = (cos 2 pi t + cos 6 pi t)/2."""
    words = ["bench", "oscillator", "--steps", "0.02,0.01", "--stop", "1", "--times", "0.3", "--repeat", "1"]
    words += ["--tolerances", "1e-5,1e-8", "--states", "mass1.q", "--errors", "1e-3"]
    assert main([*words, "-o", str(tmp_path)]) == FINE
    out = capsys.readouterr().out
    assert "ratio at error 0.001: collocated:" in out and "CasADi cvodes Adams" in out
    text = (tmp_path / "oscillator.csv").read_text()
    assert "cores" in text and "casadi" in text and (tmp_path / "oscillator.png").stat().st_size > 10_000
    table = list(csv.DictReader(line for line in text.splitlines() if not line.startswith("#")))
    error = {(r["method"], r["setting"]): float(r["error_0.3s"]) for r in table}
    for order in (2, 4, 6):
        two = [error[(f"collocated:{order}", f"h={h}")] for h in (0.02, 0.01)]
        assert np.log2(two[0] / two[1]) == pytest.approx(order, abs=0.3)
    for method in (
        "SciPy DOP853",
        "SciPy LSODA",
        "SciPy Radau",
        "CasADi cvodes Adams",
        "CasADi cvodes BDF, compiled",
        "CasADi idas",
    ):
        assert error[(method, "rtol=1e-08")] < min(1e-5, error[(method, "rtol=1e-05")])
    assert all(float(r["ledger_J"]) < 1e-12 for r in table if r["ledger_J"])


def test_bench_with_a_reference_of_the_user(compiler: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "exact.csv"
    names = ["time", *(n for v in declaration("oscillator").states for n in v.names())]
    file.write_text(",".join(names) + "\n1.0," + ",".join(["1.0"] * (len(names) - 1)) + "\n")
    words = ["bench", "oscillator", "--stop", "1", "--times", "1", "--peers", "none", "--repeat", "1", "--steps", "0.1"]
    words += ["--schemes", "collocated:2", "--engines", "python"]
    assert main([*words, "--reference", str(file), "-o", str(tmp_path)]) == FINE
    assert f"reference: {file}" in capsys.readouterr().out
    assert main([*words, "--times", "0.5,1", "--reference", str(file), "-o", str(tmp_path)]) == USAGE
    assert "no row at t = 0.5 s" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--peers", "matlab"], "choose from all, none, scipy, casadi, sundae, mujoco, exudyn"),
        (["--steps", "0.1,x"], "positive numbers with commas"),
        (["--schemes", "two-level:x"], "NAME:ORDER"),
        (["--engines", "fast"], "native, python"),
        (["--states", "mass1.p"], "no state variable 'mass1.p'"),
        (["--times", "99"], "after 0 and up to the stop time"),
        (["--repeat", "0"], "at least one"),
    ],
)
def test_bad_usage(words: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "oscillator", "--stop", "1", *words, "-o", str(tmp_path)]) == USAGE
    assert said in capsys.readouterr().err


def test_ida_on_the_stabilised_index_2_form(compiler: None) -> None:
    """Four particles against the independent solution: errors of the tolerance, both constraint levels held."""
    pytest.importorskip("sksundae")
    from phfmu.studies.bench.precision import sundae

    p = problem_of(Scene("four_particle", four_particle(), 0.1, 0.01), times=(0.05, 0.1), judged=("q",))
    p.reference = np.array([rows("four_particle")[0.1][:24]] * 2)  # only the second row is judged below
    solve = next(sundae.candidates(p, [1e-7])).prepare()
    for times in ([0.05, 0.1], [0.1]):
        x = solve(times).x
        assert x.shape == (len(times), 24)
        assert p.distance(x[-1], p.reference[-1]) <= 1e-6
        assert np.abs(np.array(p._probe(0.1, x[-1])[1])).max() <= 1e-9


def test_mujoco_converges_to_the_chain_of_the_declaration(compiler: None) -> None:
    """RK4 in hinge coordinates: the same motion in positions and velocities, order 4."""
    pytest.importorskip("mujoco")
    from phfmu.studies.bench.precision import mujoco_chain

    p = solved(problem_of(member("chain:2"), times=(0.4,), stop=0.4))  # type: ignore[arg-type]
    found = {c.value: c.prepare()([0.4]).x for c in mujoco_chain.candidates(p, 2) if c.method.endswith("RK4")}
    errors = [p.judge(found[h]).errors[0] for h in (0.02, 0.01)]
    assert errors[0] < 1e-6 and np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.4)


def exudyn_errors(p: InitialValueProblem, steps: tuple[float, ...]) -> dict[str, list[float]]:
    """Errors of q at the stop time by method, the largest step first; every run is repeated and must not change."""
    if find_spec("exudyn") is None:
        pytest.skip("exudyn is not installed: pip install exudyn")
    from phfmu.studies.bench.precision import exudyn_particles

    errors: dict[str, list[float]] = {}
    for c in exudyn_particles.candidates(p):
        if c.value in steps:
            solve = c.prepare()
            run = solve(list(p.grid), watch=True)
            assert run.steps == round(p.stop / c.value) <= (run.iterations or 0)
            assert np.array_equal(solve([p.stop]).x[0], run.x[-1])
            errors.setdefault(c.method, []).append(p.judge(run.x).errors[-1])
    return errors


def test_exudyn_converges_to_the_four_particles_of_the_declaration() -> None:
    """Bars, springs and the damper as it has them: order 2 against the independent solution, 1.6e-4 at h = 10 ms."""
    p = problem_of(Scene("four_particle", four_particle(), 1.0, 0.01), times=(1.0,), judged=("q",))
    p.reference = rows("four_particle")[1.0][None, :24]
    errors = exudyn_errors(p, (0.01, 0.005))
    assert list(errors) == ["exudyn generalized-alpha", "exudyn trapezoidal index 2"]
    for coarse, fine in errors.values():
        assert coarse == pytest.approx(1.58e-4, rel=0.05)
        assert np.log2(coarse / fine) == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("links", [2, 15])
def test_exudyn_converges_to_the_chain_of_the_declaration(links: int, compiler: None) -> None:
    """Order 2 at 0.4 s, with dense matrices (8 unknowns) and sparse ones (60 unknowns)."""
    p = solved(problem_of(member(f"chain:{links}"), times=(0.2, 0.4), stop=0.4, judged=("q",)))  # type: ignore[arg-type]
    errors = exudyn_errors(p, (0.01, 0.005))
    assert list(errors) == ["exudyn generalized-alpha", "exudyn trapezoidal index 2"]
    for coarse, fine in errors.values():
        assert coarse < 1e-3 and np.log2(coarse / fine) == pytest.approx(2.0, abs=0.2)


def test_a_peer_that_is_not_installed_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    from phfmu.studies.bench.precision import exudyn_particles, mujoco_chain, sundae

    for module in (exudyn_particles, mujoco_chain, sundae):
        monkeypatch.setattr(module, "find_spec", lambda name: None)
    p = problem_of(member("chain:2"), times=(0.1,), stop=0.1)  # type: ignore[arg-type]
    cs = [*sundae.candidates(p, [1e-3, 1e-6]), *mujoco_chain.candidates(p, 2), *exudyn_particles.candidates(p)]
    table = measure(p, cs, repeat=1)
    assert not table.rows and table.remarks == [
        "SUNDIALS IDA: not installed; pip install scikit-sundae",
        "MuJoCo: not installed; pip install mujoco",
        "exudyn: not installed; pip install exudyn",
    ]


def test_an_exudyn_with_other_names_of_settings_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    from phfmu.studies.bench.precision import exudyn_particles

    monkeypatch.setattr(exudyn_particles, "find_spec", lambda name: object())
    monkeypatch.setattr(exudyn_particles.metadata, "version", lambda name: "1.9.83")
    p = problem_of(Scene("four_particle", four_particle(), 1.0, 0.01))
    (only,) = exudyn_particles.candidates(p)
    with pytest.raises(NotAvailable, match=r"version 1\.9\.83 is older than 1\.13; pip install -U exudyn"):
        only.prepare()


def test_members_of_families() -> None:
    scene = member("chain:3")
    assert scene is not None and scene.name == "chain_3" and scene.declaration().states[0].n == 6
    assert member("four_particle") is None
    with pytest.raises(ValueError, match="number of links"):
        member("chain:x")


@pytest.mark.parametrize("name", sorted(set(FAMILIES) & set(LIBRARY)))
def test_a_family_is_the_component_or_scene_of_its_name(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    module, called = import_module(LIBRARY[name][1]), []
    original = getattr(module, name)
    monkeypatch.setattr(module, name, lambda *a, **k: called.append(a) or original(*a, **k))
    FAMILIES[name].build(3)
    assert called == [(3,)]


def test_the_plane_chain_of_the_bench_is_what_its_hinges_say() -> None:
    """MuJoCo's chain has unit links and unit masses, let go from the horizontal."""
    chain = FAMILIES["chain"].build(3)
    starts = {v.name: np.array(v.start) for v in (*chain.states, *chain.parameters)}
    assert starts["q"].reshape(3, 2).tolist() == [[1, 0], [2, 0], [3, 0]] and not starts["v"].any()
    assert starts["m"].tolist() == [1, 1, 1]
