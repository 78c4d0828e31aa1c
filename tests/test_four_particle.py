"""The four-particle system: published numbers, large steps, conservation, fallbacks of Newton's method, failures."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from phfmu import (
    PHDAE,
    Collocated,
    NativeInstance,
    Port,
    PythonInstance,
    Status,
    StepFailure,
    algebraic,
    block,
    build_model,
    energy,
    parameter,
    skew,
    state,
    time,
)
from phfmu.components.mechanical.four_particle import four_particle
from phfmu.declare.port import ELECTRICAL

ENGINES = (PythonInstance, NativeInstance)
JOINT = Collocated(1, gradient="joint-gonzalez", name="semi-explicit")
MIDPOINT = Collocated(1, gradient="nodal", name="midpoint")
THIRD = Collocated(3, two_level=True, name="two-level")
H0 = 20.0 / 17.0
MASS = np.repeat([1.0, 3.0, 2.3, 1.7], 3)
LEDGER = ("x", "stored", "dissipated", "energy", "signals")
Q4, V4 = slice(9, 12), slice(21, 24)


@cache
def model(scheme=None, **starts):
    return build_model(four_particle().with_starts(starts), scheme)


def checks(instance, rows):
    """Dg v (2) and g (2) after every step: the last observables."""
    return rows["signals"][:, instance.layout["observables"]]


def defect(rows):
    return float(np.max(np.abs(rows["stored"] + rows["dissipated"])))


def momenta(x):
    """Linear (n x 3) and angular (n x 3) momentum of states (n x 24)."""
    q, p = x[:, :12].reshape(-1, 4, 3), (x[:, 12:] * MASS).reshape(-1, 4, 3)
    return p.sum(axis=1), np.cross(q, p).sum(axis=1)


# -- the published runs ------------------------------------------------------------------------------------


def test_joint_gradient_reproduces_the_published_run():
    instance = NativeInstance(model(JOINT))
    rows = instance.run(0.0, 0.01, 1000, LEDGER)
    assert defect(rows) <= 1e-14
    direct = np.diff(np.append(H0, rows["energy"][:, 0])) + rows["dissipated"][:, 0]
    assert np.max(np.abs(direct)) <= 1e-14
    assert np.max(np.diff(rows["energy"][:, 0])) < 0.0
    assert np.max(np.abs(checks(instance, rows)[:, 2:])) <= 1e-13
    assert rows["energy"][-1, 0] == pytest.approx(0.685017, abs=5e-7)
    assert np.max(np.abs(checks(instance, rows)[:, :2])) == pytest.approx(2.8e-4, rel=0.02)  # plain: Dg v drifts
    assert instance.counts["substeps"] == 0


def test_python_engine_agrees_on_the_published_run():
    python, native = PythonInstance(model(JOINT)), NativeInstance(model(JOINT))
    one, two = (i.run(0.0, 0.01, 100, ("x", "stored", "dissipated")) for i in (python, native))
    assert np.max(np.abs(one["x"] - two["x"])) <= 1e-12
    assert defect(one) <= 1e-14


@cache
def joint_reference():
    return NativeInstance(model(JOINT)).run(0.0, 1e-4, 1000, ("x",))["x"][-1]


@pytest.mark.parametrize(
    ("h", "q4", "v4"),
    [
        (0.01, 3.4107e-5, 2.3783e-4),
        (0.005, 8.6659e-6, 5.2660e-5),
        (0.002, 1.3900e-6, 8.1020e-6),
        (0.001, 3.4512e-7, 1.9994e-6),
    ],
)
def test_joint_gradient_reproduces_the_published_convergence(h, q4, v4):
    x, exact = NativeInstance(model(JOINT)).run(0.0, h, round(0.1 / h), ("x",))["x"][-1], joint_reference()
    for part, published in ((Q4, q4), (V4, v4)):
        error = np.linalg.norm(x[part] - exact[part]) / np.linalg.norm(exact[part])
        assert error == pytest.approx(published, rel=1e-3)


def test_midpoint_baseline_has_the_published_energy_error():
    rows = NativeInstance(model(MIDPOINT)).run(0.0, 0.01, 1000, LEDGER)
    assert defect(rows) == pytest.approx(1.11e-5, rel=0.01)
    rises = rows["stored"][rows["stored"] > 0.0]
    assert len(rises) == 4 and np.max(rises) == pytest.approx(5.4e-6, rel=0.01)


# -- the default scheme --------------------------------------------------------------------------------------


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(("h", "end"), [(0.1, 0.68543), (0.25, 0.68671), (0.4, 0.68854), (1.0, 0.70080)])
def test_default_scheme_takes_large_steps(engine, h, end):
    instance = engine(model())
    rows = instance.run(0.0, h, round(10.0 / h), LEDGER)
    assert np.max(np.diff(np.append(H0, rows["energy"][:, 0]))) < 0.0
    assert np.max(np.abs(checks(instance, rows))) <= 1e-12
    assert defect(rows) <= 1e-13
    assert rows["energy"][-1, 0] == pytest.approx(end, abs=6e-6)
    assert {instance.counts[n] for n in ("restarts", "line_searches", "substeps")} == {0}


def test_sixth_order_takes_the_same_large_steps():
    for h, end in ((0.1, 0.68504), (0.4, 0.68536), (1.0, 0.68557)):
        instance = NativeInstance(model(THIRD))
        rows = instance.run(0.0, h, round(10.0 / h), LEDGER)
        assert np.max(np.diff(np.append(H0, rows["energy"][:, 0]))) < 0.0
        assert np.max(np.abs(checks(instance, rows))) <= 1e-12
        assert rows["energy"][-1, 0] == pytest.approx(end, abs=6e-6)


@pytest.mark.parametrize(("scheme", "h"), [(None, 0.01), (None, 0.25), (THIRD, 0.05)])
def test_undamped_motion_keeps_energy_and_momenta(scheme, h):
    instance = NativeInstance(model(scheme, eta0=0.0))
    rows = instance.run(0.0, h, 10_000, LEDGER)
    assert np.max(np.abs(rows["energy"] - H0)) <= 1e-12
    linear, angular = momenta(rows["x"])
    assert np.max(np.abs(linear - [0, 0, 2.0])) <= 1e-12  # m4 v4 = 1.7 * 20/17 along the third axis
    assert np.max(np.abs(angular - [2.0, -2.0, 0])) <= 1e-12  # at q4 = (1, 1, 0)
    assert np.max(np.abs(checks(instance, rows))) <= 1e-12
    assert np.max(np.abs(rows["dissipated"])) == 0.0


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(("k24", "h"), [(5e6, 0.4), (5e6, 1.0), (5e8, 0.4), (5e8, 1.0)])
def test_stiff_spring_keeps_the_ledger_closed(engine, k24, h):
    instance = engine(model(k24=k24))
    rows = instance.run(0.0, h, round(8.0 / h), LEDGER)
    assert defect(rows) <= 1e-10
    assert np.max(np.diff(rows["energy"][:, 0])) <= 1e-10


# -- fallbacks of Newton's method ----------------------------------------------------------------------------


def double_well(q: float) -> PHDAE:
    """H = v^2/2 + (q^2 - 1)^2/4."""
    Q, V = state("q", start=q), state("v")
    return PHDAE(
        "double_well",
        states=(Q, V),
        energies=(energy((Q**2 - 1) ** 2 / 4), energy(V**2 / 2)),
        structure=(skew(Q, V, 1.0),),
    )


FALLBACKS = {
    "restarts": [(lambda: model(JOINT), 0.25, 40), (lambda: build_model(double_well(0.01), Collocated(2)), 3.0, 30)],
    "line_searches": [(lambda: model(JOINT), 0.1, 100), (lambda: model(JOINT), 0.4, 25)],
    "substeps": [
        (lambda: build_model(double_well(0.01), Collocated(2)), 5.0, 30),
        (lambda: build_model(double_well(0.3), Collocated(2)), 5.0, 30),
        (lambda: model(JOINT, k24=5e6), 0.4, 20),
    ],
}


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(("counter", "case"), [(c, i) for c, cases in FALLBACKS.items() for i in range(len(cases))])
def test_each_fallback_is_reached_and_keeps_the_ledger_closed(engine, counter, case):
    make, h, n = FALLBACKS[counter][case]
    instance = engine(make())
    rows = instance.run(0.0, h, n, ("stored", "dissipated", "energy"))
    counts = instance.counts
    assert counts[counter] >= 1 and counts["steps"] == n
    assert defect(rows) <= 1e-10
    total = np.append(np.sum(rows["energy"][0] - rows["stored"][0]), np.sum(rows["energy"], axis=1))
    assert np.max(np.diff(total)) <= 1e-10  # energy never rises
    assert np.max(np.abs(np.diff(total) - np.sum(rows["stored"], axis=1))) <= 1e-10


@pytest.mark.parametrize(("h", "end"), [(0.1, 0.5362), (0.4, 0.6914)])
def test_both_engines_pass_the_steps_at_which_plain_newton_fails(h, end):
    ends = [e(model(JOINT)).run(0.0, h, round(10.0 / h), ("energy",))["energy"] for e in ENGINES]
    assert ends[0][-1, 0] == pytest.approx(end, abs=1e-4)
    assert np.max(np.diff(ends[0][:, 0])) < 0.0
    assert ends[1] == pytest.approx(ends[0], abs=1e-9)


# -- a step without solution -----------------------------------------------------------------------------------


def fading(offset: float = 1.0) -> PHDAE:
    """0 = a^2 - (offset - t): a = sqrt(offset - t) ends at t = offset; beside it x' = -x + a."""
    x, a, c = state("x", start=0.5), algebraic("a", start=1.0), parameter("offset", offset)
    return PHDAE(
        "fading",
        states=(x,),
        algebraics=(a,),
        parameters=(c,),
        energies=(energy(x**2 / 2),),
        structure=(skew(x, a, 1.0),),
        dissipation=(block([x], 1.0), block([a], a.sx)),
        ports=(Port("level", ELECTRICAL, "effort", {a: 1.0}, source=c.sx - time),),
    )


def bitwise(instance):
    state = instance.get_state()
    if isinstance(state, bytes):
        return state
    return b"".join(np.asarray(getattr(state, n)).tobytes() for n in ("x", "carry", "w", "h_last", "a", "u", "p", "t",
        "y_step", "energy", "stored", "dissipated", "supplied")) + b"".join(v.tobytes() for v in state.last.values())  # fmt: skip


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("k", [1, 2, 3])
def test_a_step_without_solution_is_refused_and_leaves_no_trace(engine, k):
    plan = build_model(_started(fading(), x_row=-1.0), Collocated(k))
    instance, twin = engine(plan), engine(plan)
    for i in range(9):
        instance.do_step(0.1 * i, 0.1)
        twin.do_step(0.1 * i, 0.1)
    before, seen = bitwise(instance), instance.x.tobytes()
    with pytest.raises(StepFailure) as failure:
        instance.do_step(0.9, 0.4)
    assert bitwise(instance) == before and instance.x.tobytes() == seen
    assert failure.value.status in (Status.NO_CONVERGENCE, Status.NOT_FINITE, Status.SINGULAR)
    assert failure.value.component == "fading" and "equation of a" in failure.value.equation
    assert 0.9 <= failure.value.time <= 1.05 and 0 < failure.value.h <= 0.4 / 64 * 1.0001
    for text in ("fading at t =", "equation of a", "tried", "Next:"):
        assert text in str(failure.value)
    instance.do_step(0.9, 0.05)
    twin.do_step(0.9, 0.05)
    assert bitwise(instance) == bitwise(twin)
    instance.reset()
    assert instance.x[0] == 0.5 and instance.time == 0.0


def _started(model: PHDAE, x_row: float) -> PHDAE:
    """The row of a without x: R(a) a = u; x is driven through an own block."""
    x, a = model.states[0], model.algebraics[0]
    return replace(model, structure=(), ports=(*model.ports, Port("drive", ELECTRICAL, "effort", {x: x_row}, source=a.sx)))


@pytest.mark.parametrize("engine", ENGINES)
def test_an_equation_without_solution_at_the_start_is_named(engine):
    """0 = a^2 + 1."""
    plan = build_model(_started(fading(-1.0), x_row=-1.0))
    with pytest.raises(StepFailure, match="equation of a") as failure:
        engine(plan)
    assert failure.value.time == 0.0 and failure.value.h == 0.0


@pytest.mark.parametrize("engine", ENGINES)
def test_a_failure_inside_a_run_keeps_what_was_recorded(engine):
    plan = build_model(_started(fading(), x_row=-1.0))
    instance = engine(plan)
    with pytest.raises(StepFailure) as failure:
        instance.run(0.0, 0.3, 10, ("x", "stored"))
    assert failure.value.recorded["x"].shape == (3, 1) and failure.value.recorded["stored"].shape == (3, 1)
    assert failure.value.recorded["x"][-1] == instance.x and instance.time == pytest.approx(0.9)
