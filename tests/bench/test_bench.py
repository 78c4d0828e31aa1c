"""Work-precision bench: index reduction against independent solutions, judging, costs at equal errors, the command."""

from __future__ import annotations

import csv
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from phfmu import NativeInstance, Scene, algebraic, build_model, damping, energy, skew, state
from phfmu.bench import own
from phfmu.bench.candidate import Candidate, NotAvailable, Run
from phfmu.bench.families import FAMILIES, member
from phfmu.bench.peers import Functions, _Scipy
from phfmu.bench.problem import Judged, Problem, problem_of
from phfmu.bench.reduced import reduced
from phfmu.bench.work_precision import Row, Table, cost_at, costs_at, front, measure
from phfmu.cli import FINE, USAGE, main
from phfmu.components.library import LIBRARY, SWITCHED, build
from phfmu.components.mechanical.four_particle import four_particle
from phfmu.components.scenes.two_machine import two_machine
from phfmu.declare.block import block
from phfmu.declare.phdae import PHDAE
from phfmu.network.junctions.network import Network
from tests.wide import wide

REFERENCE = Path(__file__).parents[1] / "reference"


def declaration(name: str) -> PHDAE:
    item = build(name)
    if isinstance(item, Scene):
        return item.declaration()
    return item.compose() if isinstance(item, Network) else item


def rows(name: str) -> dict[float, np.ndarray]:
    """Independent states by time."""
    lines = [t for t in (REFERENCE / f"{name}.csv").read_text().splitlines() if not t.startswith("#")]
    return {float(t.split(",")[0]): np.array([float(x) for x in t.split(",")[1:]]) for t in lines[1:]}


# -- index reduction ----------------------------------------------------------------------------------------------------


#: what the reduction meets: springs, constraints, machines, networks of them, feedthrough, events
REDUCED = (
    "mass",
    "four_particle",
    "heavy_top",
    "oscillator",
    "rlc_load",
    "synchronous_machine",
    "smib",
    "resistor",
    "breaker",
)


@pytest.mark.parametrize("name", wide((n for n in LIBRARY if n not in SWITCHED), *REDUCED))
def test_rate_equals_that_of_a_small_step(compiler: None, name: str) -> None:
    """x' of the reduced system at the middle of a step of the engine = its mean slope + O(h)."""
    d = declaration(name)
    if not d.states:
        pytest.skip("no states")
    if name == "heavy_top":
        with pytest.raises(ValueError, match="zeros on its diagonal"):
            reduced(d)
        return
    system = reduced(d, gamma=0.0)
    instance = NativeInstance(build_model(d))
    x0, h = instance.x, 1e-6
    instance.do_step(0.0, h)
    slope = (instance.x - x0) / h
    exact = np.array(system.ode(h / 2, (instance.x + x0) / 2, system.live_start)).ravel()
    scale = np.abs(exact).max()
    assert np.abs(slope - exact).max() <= 1e-4 * scale + 1e-12


def test_four_particles_by_dop853_on_the_reduced_system() -> None:
    """The independent solution in tests/reference, which shares no code with the reduction."""
    from scipy.integrate import solve_ivp

    system = reduced(four_particle())
    f = lambda t, x: np.array(system.ode(t, x, [])).ravel()  # noqa: E731
    x = solve_ivp(f, (0.0, 0.1), system.x0, method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    assert np.abs(x - rows("four_particle")[0.1][:24]).max() <= 1e-9


def test_two_machines_through_a_fault() -> None:
    """Bare node (index 2), events and observables: rotor momenta and angles of the independent solution."""
    p = problem_of(two_machine(t_fault=0.02, t_clear=0.06, stop=0.1), times=(0.03, 0.04), stop=0.04)
    x = _Scipy(p, Functions(p), "DOP853", 1e-8)([0.03, 0.04]).x
    names = [n for v in p.declaration.states for n in v.names()]
    head = [t for t in (REFERENCE / "two_machine_early.csv").read_text().splitlines() if not t.startswith("#")][0]
    for i, t in enumerate((0.03, 0.04)):
        exact = dict(zip(head.split(",")[1:], rows("two_machine_early")[t], strict=True))
        for machine in "12":
            assert x[i, names.index(f"m{machine}.p")] == pytest.approx(exact[f"p{machine}"], rel=1e-7)
            assert x[i, names.index(f"m{machine}.theta")] == pytest.approx(exact[f"theta{machine}"], rel=1e-7)


def test_stabilisation_pulls_onto_the_constraints() -> None:
    """With gamma the position residual decays like (1 + gamma t) exp(-gamma t); without it stays."""
    from scipy.integrate import solve_ivp

    left = []
    for gamma in (0.0, 20.0):
        system = reduced(four_particle().with_starts({"q[4]": 1.001}), gamma=gamma)
        f = lambda t, x, s=system: np.array(s.ode(t, x, [])).ravel()  # noqa: E731
        x = solve_ivp(f, (0.0, 0.25), system.x0, method="DOP853", rtol=1e-9, atol=1e-11).y[:, -1]
        g = np.array(ca.Function("g", [system.x], [system.checks])(x)).ravel()[-2]
        left.append(abs(g) / (0.5 * (1.001**2 - 1)))
    assert left[0] == pytest.approx(1.0, abs=1e-3)
    assert left[1] == pytest.approx((1 + 5.0) * np.exp(-5.0), rel=0.02)


def test_rows_that_are_not_linear_in_their_variables() -> None:
    """q' = i over a resistor with v(i) = i + i^3 at a capacitor: q' = -i with i + i^3 = q."""
    q, i = state("q", start=2.0), algebraic("i")
    d = PHDAE(
        "diode", (q,), (i,), energies=(energy(0.5 * q.sx**2),), structure=(skew(i, q, 1.0),),
        dissipation=(block([i], 1.0 + i.sx**2),),
    )  # fmt: skip
    system = reduced(d)
    assert not system.linear
    assert system.w0[0] == pytest.approx(1.0)  # 1 + 1 = 2
    assert float(system.ode(0.0, 2.0, [])) == pytest.approx(-1.0)


# -- judging and costs --------------------------------------------------------------------------------------------------


def decay() -> Problem:
    x = state("x", start=1.0)
    d = PHDAE("decay", (x,), energies=(energy(0.5 * x.sx**2),), dissipation=(damping(x, 1.0),))
    p = problem_of(Scene("decay", d, stop=2.0, step=0.1), times=(1.0, 2.0))
    p.reference = np.exp(-p.grid)[:, None]
    return p


def test_judge_measures_states_and_energy() -> None:
    p = decay()
    judged = p.judge(np.exp(-p.grid)[:, None] * np.array([[1.01], [0.98]]))
    assert judged.errors == pytest.approx((0.01, 0.02))
    assert judged.energy == pytest.approx(0.5 * np.exp(-2) * (1.01**2 - 1), rel=1e-9)
    assert judged.drift == 0.0


def test_pieces_end_at_events() -> None:
    scene = build("smib")
    p = problem_of(scene, times=(0.2, 0.8), stop=1.0)
    found = [(x.start, x.end, list(x.times), list(x.stops)) for x in p.pieces([0.2, 0.8])]
    assert found == [(0.0, 0.5, [0.2], [0.2, 0.5]), (0.5, 0.8, [0.8], [0.8])]


def row(method: str, error: float, cpu: float, own: bool = False) -> Row:
    return Row(method, "", own, cpu, 0.0, Judged((error,), 0.0, 0.0), None, None, None)


def test_cost_lies_on_the_double_logarithmic_line_through_the_best_rows() -> None:
    """cpu = error^(-1/2), one row that is beaten by others."""
    line = [row("a", e, e**-0.5) for e in (1e-2, 1e-4, 1e-6)] + [row("a", 1e-3, 1e4)]
    assert front(line, 0) == [(1e-2, pytest.approx(10.0)), (1e-4, pytest.approx(100.0)), (1e-6, pytest.approx(1e3))]
    found = cost_at(1e-5, line, 0)
    assert found is not None and not found.bound and found.cpu == pytest.approx(10**2.5)
    coarse = cost_at(0.1, line, 0)
    assert coarse is not None and coarse.bound and coarse.cpu == pytest.approx(10.0)
    assert cost_at(1e-7, line, 0) is None
    table = Table([*line, row("b", 1e-8, 1.0, own=True)], [])
    assert [(c.method, c.own) for c in costs_at(table, 1e-5, 0)] == [("b", True), ("a", False)]


def test_what_fails_is_a_remark_and_no_row() -> None:
    p = decay()

    def exact(times, watch=False) -> Run:
        return Run(np.exp(-np.array(times))[:, None])

    def fails(times, watch=False) -> Run:
        raise RuntimeError("diverged at 0.3 s")

    def absent():
        raise NotAvailable("not installed")

    cs = [Candidate("good", "h=1", 1.0, lambda: exact), Candidate("bad", "h=2", 2.0, lambda: fails)]
    table = measure(p, [*cs, Candidate("far", "", 0.0, absent), Candidate("far", "x", 0.0, absent)], repeat=2)
    assert [r.method for r in table.rows] == ["good"] and table.rows[0].judged.errors == (0.0, 0.0)
    assert table.remarks == ["bad h=2: diverged at 0.3 s", "far: not installed"]


@pytest.mark.parametrize(("name", "rtol"), [("oscillator", "2.5e-14"), ("smib", "1e-12")])
def test_the_reference_stops_at_rounding(name: str, rtol: str, compiler: None) -> None:
    """smib: from a tolerance of 1e-13 on the error estimate is rounding of x', and steps would shrink without end."""
    item = build(name)
    scene = item if isinstance(item, Scene) else Scene(name, declaration(name), 1.0, 0.01)
    p = solved(problem_of(scene, times=(0.01,), stop=0.02))
    assert p.reference_name == f"DOP853 rtol {rtol} on the reduced system"
    assert p.reference.shape[0] == 2 and p.uncertainty < 1e-7


def test_sweeps_are_iterations(compiler: None) -> None:
    """Constrained particles are solved by the Schur stepper, without Newton's iterations: its sweeps are what a row shows."""
    p = problem_of(Scene("four_particle", four_particle(), 1.0, 0.02), times=(1.0,))
    solve = next(own.candidates(p, ["two-level:2"], ["native"], [0.02])).prepare()
    counts = []
    for _ in range(2):
        run = solve([1.0], watch=True)
        counts.append(solve._instance.counts)  # type: ignore[attr-defined]
        assert run.steps == 50 and (run.iterations or 0) >= 2 * 50
    assert counts[1]["schur"] - counts[0]["schur"] == 50
    assert run.iterations == counts[1]["sweeps"] - counts[0]["sweeps"]


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


# -- peers that may be absent -------------------------------------------------------------------------------------------


def solved(p: Problem) -> Problem:
    from phfmu.bench.peers import solve_reference

    solve_reference(p, Functions(p))
    return p


def test_ida_on_the_stabilised_index_2_form(compiler: None) -> None:
    """Four particles against the independent solution: errors of the tolerance, both constraint levels held."""
    pytest.importorskip("sksundae")
    from phfmu.bench import sundae

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
    from phfmu.bench import mujoco_chain

    p = solved(problem_of(member("chain:2"), times=(0.4,), stop=0.4))  # type: ignore[arg-type]
    found = {c.value: c.prepare()([0.4]).x for c in mujoco_chain.candidates(p, 2) if c.method.endswith("RK4")}
    errors = [p.judge(found[h]).errors[0] for h in (0.02, 0.01)]
    assert errors[0] < 1e-6 and np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.4)


def exudyn_errors(p: Problem, steps: tuple[float, ...]) -> dict[str, list[float]]:
    """Errors of q at the stop time by method, the largest step first; every run is repeated and must not change."""
    if find_spec("exudyn") is None:
        pytest.skip("exudyn is not installed: pip install exudyn")
    from phfmu.bench import exudyn_particles

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
    from phfmu.bench import exudyn_particles, mujoco_chain, sundae

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
    from phfmu.bench import exudyn_particles

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
