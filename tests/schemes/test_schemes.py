"""The one-step schemes of section 4 of Kinon, Morandin, Schulze (2026): its examples and theorems, engines, units."""

from __future__ import annotations

from functools import cache
from itertools import product

import casadi as ca
import numpy as np
import pytest

from phfmu import (
    PHDAE,
    ClosedPair,
    DiracDissipative,
    FMUInstance,
    GradientPair,
    NativeInstance,
    Port,
    PythonInstance,
    SemiExplicit,
    block,
    build_model,
    check,
    damping,
    export,
    skew,
    state,
    time,
)
from tests.engines import ENGINES
from tests.schemes.linear import linear, linear_descriptor
from tests.schemes.pairs import BOTH, H, current, declaration, steps
from tests.schemes.test_orders import BETA, START, G, L, R, drive, rlc
from tests.wide import wide

POINTS = ("end", "start", "midpoint")


#: x1 after each step, and the means (x1 + x1')/2
X1 = ((2 - H) / (2 + H)) ** np.arange(6)
MEANS = (X1[:-1] + X1[1:]) / 2
OUTCOMES = {"end": -MEANS, "start": -MEANS, "midpoint": -X1[1:]}


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("point", POINTS)
@pytest.mark.parametrize("make", [DiracDissipative, lambda p: DiracDissipative("minimal", at=p)], ids=["z2", "minimal"])
def test_example_6_has_three_outcomes(make, point, engine):
    """x1 is the midpoint rule for all; x2' is -(x1 + x1')/2, the same filed as x2, or -x1' from a consistent start."""
    x, a, worst = steps(build_model(linear(), make(point)), H, 5, engine)
    assert x[:, 0] == pytest.approx(X1[1:], rel=1e-14)
    assert a[:, 0] == pytest.approx(OUTCOMES[point], rel=1e-13)
    assert worst <= 1e-14


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("point", ["end", "midpoint"])
def test_example_6_with_a_singular_descriptor_matrix(point, engine):
    """The least |f - zbar| finds the same without knowing which states are algebraic."""
    x, _, worst = steps(build_model(linear_descriptor(), DiracDissipative("minimal", at=point)), H, 5, engine)
    assert x == pytest.approx(np.column_stack([X1[1:], OUTCOMES[point]]), rel=1e-13)
    assert worst <= 1e-14


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("declaration", [linear, linear_descriptor])
def test_a_closure_of_the_user(declaration, engine):
    """The algebraic equation itself, 0 = x1' + x2', is the first of the completions that Example 6 names."""
    model = build_model(declaration(), DiracDissipative(lambda x, new, f: new[0] + new[1]))
    x, a, _ = steps(model, H, 5, engine)
    both = np.hstack([x, a])
    assert both == pytest.approx(np.column_stack([X1[1:], -X1[1:]]), rel=1e-14)


def test_an_inconsistent_start_alternates_with_the_midpoint_closure():
    model = build_model(linear(), SemiExplicit("midpoint"))
    instance = PythonInstance(model)
    instance._s.a = np.array([-0.5])  # x2 = -1/2 instead of -1
    for k in range(4):
        instance.do_step(k * H, H)
        assert instance.signal("a")[0] + X1[k + 1] == pytest.approx(0.5 * (-1) ** (k + 1), rel=1e-13)


# -- Theorems 2, 4 and 5, Corollary 1 -----------------------------------------------------------------------------


def rlc_descriptor() -> PHDAE:
    """The circuit of test_orders with x = (q, phi, i) and the pair of Theorem 4 written out."""
    q, phi, i = state("q", start=START[0]), state("phi", start=START[1]), state("i", start=0.5)
    h = q**2 / 2 + BETA * q**4 / 4 + phi**2 / (2 * L)

    def zbar(x, d):
        y = x + d
        slope = (x[0] + y[0]) / 2 + BETA / 4 * (y[0] ** 3 + y[0] ** 2 * x[0] + y[0] * x[0] ** 2 + x[0] ** 3)
        return ca.vertcat(slope, (x[1] + y[1]) / (2 * L), (x[2] + y[2]) / 2)

    pair = ClosedPair(
        (q, phi, i), h, ca.diag(ca.SX([1.0, 1.0, 0.0])), ca.vertcat(q + BETA * q**3, phi / L, i),
        lambda x, d: ca.vertcat(d[0], d[1], 0), zbar,
    )  # fmt: skip
    return PHDAE(
        "rlc_descriptor",
        states=(q, phi, i),
        closed=(pair,),
        structure=(skew(q, phi, 1.0), skew(q, i, -1.0)),
        dissipation=(damping(phi, R), block([i], G + i**2 / 2)),
        ports=(Port("terminal", rlc("source", "algebraic").ports[0].domain, "effort", {phi: 1.0},
                    source=ca.SX(drive(time, ca.sin, ca.cos))),),
    )  # fmt: skip


@cache
def consistent_current():
    """i(0) of the circuit: v = (G + i^2/2) i."""
    v = START[0] + BETA * START[0] ** 3
    return current(v)


@pytest.mark.parametrize("engine", ENGINES)
def test_corollary_1_the_pair_of_theorem_4_gives_the_semi_explicit_scheme(engine):
    h, n = 0.04, 50
    general = rlc_descriptor().with_starts({"i": consistent_current()})
    assert check(general) == []
    x, _, worst = steps(build_model(general, GradientPair()), h, n, engine)
    semi = build_model(rlc("source", "algebraic"), SemiExplicit("midpoint"))
    x1, x2, _ = steps(semi, h, n, engine)
    assert x == pytest.approx(np.hstack([x1, x2]), rel=1e-12, abs=1e-12)
    assert worst <= 1e-13
    own = steps(build_model(rlc("source", "algebraic"), GradientPair()), h, n, engine)
    assert np.array_equal(own[0], x1) and np.array_equal(own[1], x2)


SIZES = {"rlc": 0.05, "drive": 1e-4, "four_particle": 0.01, "oscillator": 0.01, "machine": 1e-4, "smib": 1e-4}


@pytest.mark.parametrize(
    ("name", "point"),
    wide(
        product(SIZES, POINTS),
        *product(("rlc",), POINTS),
        *(("drive", "end"), ("four_particle", "midpoint"), ("machine", "start"), ("smib", "end")),
    ),
)
def test_theorem_5_the_closed_dirac_dissipative_scheme_is_the_semi_explicit_one(name, point):
    d, h = declaration(name), SIZES[name]
    x, a, _ = steps(build_model(d, SemiExplicit(point)), h, 20)
    y, b, worst = steps(build_model(d, DiracDissipative(point)), h, 20)
    assert np.max(np.abs(x - y)) <= 1e-12 * max(1.0, np.max(np.abs(x)))
    assert np.max(np.abs(a - b), initial=0.0) <= 1e-9 * max(1.0, np.max(np.abs(a), initial=0.0))
    assert worst <= 1e-13


@pytest.mark.parametrize("point", POINTS)
@pytest.mark.parametrize("name", ["rlc", "drive"])
def test_the_least_distance_is_zero_where_x2_is_free(name, point):
    """Semi-explicit models whose E does not depend on x2: minimal and point closures are one."""
    d, h = declaration(name), SIZES[name]
    x, a, _ = steps(build_model(d, DiracDissipative(point)), h, 20)
    y, b, worst = steps(build_model(d, DiracDissipative("minimal", at=point)), h, 20)
    assert y == pytest.approx(x, rel=1e-11, abs=1e-11) and b == pytest.approx(a, rel=1e-10, abs=1e-10)
    assert worst <= 1e-13


# -- engines, substeps, units, refusals ---------------------------------------------------------------------------

SCHEMES = [
    *BOTH,
    DiracDissipative("minimal"),
    SemiExplicit("midpoint"),
    DiracDissipative("end", gradient="itoh-abe"),
]


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: f"{s.name}-{s.closure}")
@pytest.mark.parametrize(
    "name", ["rlc", pytest.param("drive", marks=pytest.mark.slow), pytest.param("machine", marks=pytest.mark.slow)]
)
def test_both_engines_agree_also_in_parts_and_after_restoring(name, scheme):
    model, h = build_model(declaration(name), scheme), SIZES[name]
    python, native = PythonInstance(model), NativeInstance(model)
    for k in range(6):
        if k == 3:
            saved = python.get_state(), native.get_state()
        for instance in (python, native):
            instance.do_step(k * h, h, parts=2)
    last = native.signal("a")
    for block_name in ("x", "a", "y_step", "energy", "a_end"):
        p, q = python.signal(block_name), native.signal(block_name)
        assert p == pytest.approx(q, rel=1e-11, abs=1e-11 * max(1.0, np.max(np.abs(q), initial=0.0))), block_name
    for instance, state_ in zip((python, native), saved, strict=True):
        instance.set_state(state_)
        for k in range(3, 6):
            instance.do_step(k * h, h, parts=2)
    assert np.array_equal(native.signal("a"), last)


def test_parts_of_a_step_are_steps_where_x2_is_carried():
    model = build_model(rlc("source", "algebraic"), GradientPair())
    one, other = PythonInstance(model), NativeInstance(model)
    for k in range(8):
        one.do_step(k * 0.025, 0.025)
    for k in range(2):
        other.do_step(k * 0.1, 0.1, parts=4)
    assert other.signal("a") == pytest.approx(one.signal("a"), rel=1e-12)
    assert other.x == pytest.approx(one.x, rel=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("scheme", BOTH, ids=lambda s: s.name)
def test_sensitivities_are_slopes_of_the_step(scheme, engine):
    model = build_model(rlc("free", "algebraic"), scheme)
    instance = engine(model)
    instance.do_step(0.0, 0.1)
    saved = instance.get_state()

    def output(u):
        instance.set_state(saved)
        instance.set_input(np.array([u]))
        instance.do_step(0.1, 0.1)
        return instance.output()[0]

    eps = 1e-5
    slope_ = (output(0.4 + eps) - output(0.4 - eps)) / (2 * eps)
    output(0.4)
    assert instance.sensitivity()[0, 0] == pytest.approx(slope_, rel=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: f"{s.name}-{s.closure}")
def test_units_equal_the_native_engine(scheme, tmp_path):
    d, h = declaration("drive"), 1e-4
    model = build_model(d, scheme)
    native = NativeInstance(model)
    x, a, _ = steps(model, h, 50, NativeInstance)
    native.reset()
    for path in export(model, tmp_path, step=h):
        with FMUInstance(path) as unit:
            for k in range(50):
                unit.do_step(k * h, h)
            names = [n for v in d.states for n in v.names()]
            assert unit.get(names) == pytest.approx(x[-1], rel=1e-12, abs=1e-13)
            algebraics = [n for v in d.algebraics for n in v.names()]
            assert unit.get(algebraics) == pytest.approx(a[-1], rel=1e-11, abs=1e-11)
