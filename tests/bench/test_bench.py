"""Work-precision bench: index reduction against independent solutions, judging, costs at equal errors."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from phfmu import NativeInstance, Scene, algebraic, build_model, damping, energy, skew, state
from phfmu.components.library import LIBRARY, SWITCHED, build
from phfmu.components.mechanical.four_particle import four_particle
from phfmu.components.scenes.electrical.two_machine import two_machine
from phfmu.declare.block import block
from phfmu.declare.phdae import PHDAE
from phfmu.studies.bench.precision import own
from phfmu.studies.bench.precision.candidate import Candidate, CandidateRun, NotAvailable
from phfmu.studies.bench.precision.peers import ProblemFunctions, _Scipy
from phfmu.studies.bench.precision.problem import InitialValueProblem, SolutionErrors, problem_of
from phfmu.studies.bench.precision.reduced import reduced
from phfmu.studies.bench.precision.work_precision import (
    WorkPrecisionRow,
    WorkPrecisionTable,
    cost_at,
    costs_at,
    front,
    measure,
)
from tests.bench.rows import REFERENCE, declaration, rows, solved
from tests.wide import wide

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
    if name in (
        "heavy_top",
        "bricard",
        "car_axis",
        "gear_train",
    ):  # directors, midpoints, a wheel, counters without mass
        with pytest.raises(ValueError, match="zeros on its diagonal"):
            reduced(d)
        return
    if name == "panda":  # falls, where its motors would hold it at rest
        d = d.with_starts({n: 0.0 for p in d.ports for n in p.input_names()})
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
    x = _Scipy(p, ProblemFunctions(p), "DOP853", 1e-8)([0.03, 0.04]).x
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


def decay() -> InitialValueProblem:
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


def row(method: str, error: float, cpu: float, own: bool = False) -> WorkPrecisionRow:
    return WorkPrecisionRow(method, "", own, cpu, 0.0, SolutionErrors((error,), 0.0, 0.0), None, None, None)


def test_cost_lies_on_the_double_logarithmic_line_through_the_best_rows() -> None:
    """cpu = error^(-1/2), one row that is beaten by others."""
    line = [row("a", e, e**-0.5) for e in (1e-2, 1e-4, 1e-6)] + [row("a", 1e-3, 1e4)]
    assert front(line, 0) == [(1e-2, pytest.approx(10.0)), (1e-4, pytest.approx(100.0)), (1e-6, pytest.approx(1e3))]
    found = cost_at(1e-5, line, 0)
    assert found is not None and not found.bound and found.cpu == pytest.approx(10**2.5)
    coarse = cost_at(0.1, line, 0)
    assert coarse is not None and coarse.bound and coarse.cpu == pytest.approx(10.0)
    assert cost_at(1e-7, line, 0) is None
    table = WorkPrecisionTable([*line, row("b", 1e-8, 1.0, own=True)], [])
    assert [(c.method, c.own) for c in costs_at(table, 1e-5, 0)] == [("b", True), ("a", False)]


def test_what_fails_is_a_remark_and_no_row() -> None:
    p = decay()

    def exact(times, watch=False) -> CandidateRun:
        return CandidateRun(np.exp(-np.array(times))[:, None])

    def fails(times, watch=False) -> CandidateRun:
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
