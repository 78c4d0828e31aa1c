"""The four-particle system: published numbers, large steps, conservation; fallbacks, failures of Newton."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from phfmu import (
    ELECTRICAL,
    PHDAE,
    Collocated,
    NativeInstance,
    Port,
    PythonInstance,
    Status,
    StepFailure,
    TwoLevel,
    algebraic,
    build_model,
    damping,
    energy,
    parameter,
    skew,
    state,
    time,
)
from phfmu.components.mechanical.four_particle import four_particle
from tests.engines import ENGINES
from tests.wide import slow

JOINT = Collocated(1, gradient="joint-gonzalez", name="semi-explicit")
MIDPOINT = Collocated(1, gradient="nodal", name="midpoint")
THIRD = TwoLevel(3)
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
    drift = np.max(np.abs(checks(instance, rows)[:, :2]))  # the plain scheme keeps g only
    assert drift == pytest.approx(2.8e-4, rel=0.02)
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


@pytest.mark.slow
def test_sixth_order_takes_the_same_large_steps():
    for h, end in ((0.1, 0.68504), (0.4, 0.68536), (1.0, 0.68557)):
        instance = NativeInstance(model(THIRD))
        rows = instance.run(0.0, h, round(10.0 / h), LEDGER)
        assert np.max(np.diff(np.append(H0, rows["energy"][:, 0]))) < 0.0
        assert np.max(np.abs(checks(instance, rows))) <= 1e-12
        assert rows["energy"][-1, 0] == pytest.approx(end, abs=6e-6)


@pytest.mark.parametrize(("scheme", "h", "steps", "bound"), [(None, 0.01, 10_000, 1e-12), (THIRD, 0.05, 2_500, 1e-11)])
def test_undamped_motion_keeps_energy_and_momenta(scheme, h, steps, bound):
    instance = NativeInstance(model(scheme, eta0=0.0))
    rows = instance.run(0.0, h, steps, LEDGER)
    assert np.max(np.abs(rows["energy"] - H0)) <= bound
    linear, angular = momenta(rows["x"])
    assert np.max(np.abs(linear - [0, 0, 2.0])) <= bound  # m4 v4 = 1.7 * 20/17 along the third axis
    assert np.max(np.abs(angular - [2.0, -2.0, 0])) <= bound  # at q4 = (1, 1, 0)
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


@cache
def well(q: float):
    return build_model(double_well(q), Collocated(2))


FALLBACKS = {
    "restarts": [(lambda: model(JOINT), 0.25, 40), (lambda: well(0.01), 3.0, 30)],
    "line_searches": [(lambda: model(JOINT), 0.6, 25), (lambda: model(JOINT), 1.0, 25)],
    "substeps": [(lambda: well(0.01), 5.0, 30), (lambda: model(JOINT, k24=5e6), 0.4, 20)],
}
CASES = [(counter, i) for counter, cases in FALLBACKS.items() for i in range(len(cases))]


@pytest.mark.parametrize(
    ("engine", "counter", "case"),
    [(NativeInstance, *case) for case in CASES]
    + [(PythonInstance, *case) if case[1] == 0 else slow((PythonInstance, *case)) for case in CASES],
)
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


# -- a step without solution ---------------------------------------------------------------------------------


def fading(offset: float = 1.0, x: float = 0.1) -> PHDAE:
    """x' = -x + a, 0 = offset - t - x - a^2: a = sqrt(offset - t - x) until there is no solution."""
    s, a, c = state("x", start=x), algebraic("a", start=1.0), parameter("offset", offset)
    return PHDAE(
        "fading",
        states=(s,),
        algebraics=(a,),
        parameters=(c,),
        energies=(energy(s**2 / 2),),
        structure=(skew(s, a, 1.0),),
        dissipation=(damping(s, 1.0), damping(a, a.sx)),
        ports=(Port("level", ELECTRICAL, "effort", {a: 1.0}, source=c.sx - time),),
    )


def bitwise(instance):
    """Everything a later step depends on, as bytes."""
    saved = instance.get_state()
    if isinstance(saved, bytes):
        return saved
    fields = {k: v for k, v in vars(saved).items() if k not in ("end", "counts", "last")} | saved.last
    return {name: np.asarray(value).tobytes() for name, value in fields.items()}


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("k", [1, 2])
def test_a_step_without_solution_is_refused_and_leaves_no_trace(engine, k):
    plan = build_model(fading(), Collocated(k))
    instance, twin = engine(plan), engine(plan)
    for i in range(4):
        instance.do_step(0.1 * i, 0.1)
        twin.do_step(0.1 * i, 0.1)
    before, seen, booked = bitwise(instance), instance.x.tobytes(), instance.ledger()
    with pytest.raises(StepFailure) as failure:
        instance.do_step(0.4, 1.6)
    assert bitwise(instance) == before and instance.x.tobytes() == seen and instance.time == twin.time
    assert all((instance.ledger()[name] == booked[name]).all() for name in booked)
    assert failure.value.status in (Status.NO_CONVERGENCE, Status.NOT_FINITE, Status.SINGULAR)
    assert failure.value.component == "fading" and "equation of a" in failure.value.equation
    assert 0.4 <= failure.value.time < 1.0 and failure.value.h == pytest.approx(1.6 / 64)
    for text in ("fading at t =", "equation of a", "tried", "Next:"):
        assert text in str(failure.value)
    instance.do_step(0.4, 0.05)
    twin.do_step(0.4, 0.05)
    assert bitwise(instance) == bitwise(twin)
    instance.reset()
    assert instance.x[0] == 0.1 and instance.time == 0.0


@pytest.mark.parametrize("engine", ENGINES)
def test_an_equation_without_solution_at_the_start_is_named(engine):
    """0 = a^2 + 1."""
    plan = build_model(fading(-1.0, x=0.0))
    with pytest.raises(StepFailure, match="equation of a") as failure:
        engine(plan)
    assert failure.value.time == 0.0 and failure.value.h == 0.0


@pytest.mark.parametrize("engine", ENGINES)
def test_a_failure_inside_a_run_keeps_what_was_recorded(engine):
    instance = engine(build_model(fading()))
    with pytest.raises(StepFailure) as failure:
        instance.run(0.0, 0.2, 10, ("x", "stored"))
    kept = failure.value.recorded
    n = len(kept["x"])
    assert 1 <= n < 5 and kept["stored"].shape == (n, 1)
    assert (kept["x"][-1] == instance.x).all() and instance.time == pytest.approx(0.2 * n)
