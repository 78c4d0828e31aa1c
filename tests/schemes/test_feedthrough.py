"""Feedthrough y = (B + P)^T z + (S + N) u: ports in blocks of J and R (Remark 2)."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from phfmu import (
    ELECTRICAL,
    PHDAE,
    Collocated,
    DiracDissipative,
    FMUInstance,
    GradientPair,
    NativeInstance,
    Port,
    PythonInstance,
    SystemTransformation,
    algebraic,
    block,
    build_model,
    check,
    damping,
    energy,
    export,
    parameter,
    skew,
    state,
)
from tests.engines import ENGINES

SCHEMES = [Collocated(1), Collocated(2), Collocated(3), GradientPair(), DiracDissipative()]


def random_parts():
    """Gamma (skew) and W (positive definite) on (x1, x2, a, u1, u2), fixed seed."""
    rng = np.random.default_rng(4)
    gamma, w = rng.uniform(-1, 1, (5, 5)), rng.uniform(-0.6, 0.6, (5, 5))
    return gamma - gamma.T, w @ w.T + 0.1 * np.eye(5)


def mixed(bend: float = 0.0) -> PHDAE:
    """Two states, one algebraic variable, two ports; every entry of J, B, N, R, P, S is there.

    `bend`: W gets the factor 1 + bend x1^2 and H the term bend x1^4/4.
    """
    gamma, w = random_parts()
    x, a = state("x", 2, start=(0.8, -0.5)), algebraic("a")
    ports = tuple(Port(f"p{i}", ELECTRICAL, "effort", {}, start=s) for i, s in ((1, 0.7), (2, -0.4)))
    rows = [x, a, *ports]
    return PHDAE(
        "mixed",
        states=(x,),
        algebraics=(a,),
        energies=(energy(x[0] ** 2 + x[1] ** 2 / 2 + bend * x[0] ** 4 / 4),),
        structure=(block(rows, gamma),),
        dissipation=(block(rows, (1 + bend * x[0] ** 2) * ca.SX(w)),),
        ports=ports,
    )


def by_hand(bend, x, u):
    """x' and y of `mixed`, from [E x'; 0; -y] = (Gamma - W)[z; a; u] with a eliminated."""
    gamma, w = random_parts()
    m = gamma - (1 + bend * x[0] ** 2) * w
    z = np.array([2 * x[0] + bend * x[0] ** 3, x[1]])
    a = -(m[2, :2] @ z + m[2, 3:] @ u) / m[2, 2]
    full = np.concatenate([z, [a], u])
    return m[:2] @ full, -m[3:] @ full


U = np.array([0.7, -0.4])


@cache
def exact(bend, t):
    rate = lambda _, x: by_hand(bend, x, U)[0]  # noqa: E731
    return solve_ivp(rate, (0, t), (0.8, -0.5), method="DOP853", rtol=3e-14, atol=1e-15, max_step=0.02).y[:, -1]


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("bend", [0.0, 0.5])
def test_outputs_at_one_instant(engine, bend):
    instance = engine(build_model(mixed(bend)))
    assert instance.signal("y_end") == pytest.approx(by_hand(bend, np.array([0.8, -0.5]), U)[1], rel=1e-13)


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: f"{s.name}-{s.order}")
def test_order_and_balance(scheme):
    """Constant inputs: order 2k; the loss of W = [R, P; P^T, S] is booked, none of its parts alone."""
    model, errors, counts = build_model(mixed(0.5), scheme), [], {2: (20, 40), 4: (8, 16), 6: (4, 8)}[scheme.order]
    for n in counts:
        instance = PythonInstance(model)
        for k in range(n):
            instance.do_step(k / n, 1 / n)
            row = instance.ledger()
            left = np.sum(row["stored"] + row["dissipated"] - row["supplied"])
            assert abs(left) <= 1e-14 and row["dissipated"][0] > 0
        errors.append(np.max(np.abs(instance.x - exact(0.5, 1.0))))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(scheme.order, abs=0.25)


def test_dissipated_power_is_the_quadratic_form_of_W():
    """k = 1: h [z; a; u]^T W [z; a; u] with the costates of the step."""
    gamma, w = random_parts()
    instance, h = PythonInstance(build_model(mixed(), Collocated(1))), 0.2
    before = instance.x
    instance.do_step(0.0, h)
    mid = (before + instance.x) / 2
    v = np.concatenate([[2 * mid[0], mid[1]], instance.signal("a"), U])
    assert instance.ledger()["dissipated"][0] == pytest.approx(h * v @ w @ v, rel=1e-13)
    assert instance.output() == pytest.approx(-((gamma - w) @ v)[3:], rel=1e-13)


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: f"{s.name}-{s.order}")
def test_both_engines_and_their_sensitivities_agree(scheme):
    model = build_model(mixed(0.5), scheme)
    python, native = PythonInstance(model), NativeInstance(model)
    for instance in (python, native):
        instance.set_input(np.array([0.3, 0.9]))
        instance.do_step(0.0, 0.1)
    assert native.x == pytest.approx(python.x, rel=1e-13)
    assert native.output() == pytest.approx(python.output(), rel=1e-13)
    for end in (False, True):
        assert native.sensitivity(end) == pytest.approx(python.sensitivity(end), rel=1e-10)
    m = random_parts()[0] - (1 + 0.5 * python.x[0] ** 2) * random_parts()[1]
    direct = -(m[3:, 3:] - np.outer(m[3:, 2], m[2, 3:]) / m[2, 2])
    assert python.sensitivity(end=True) == pytest.approx(direct, rel=1e-10)


def test_units_have_the_outputs(tmp_path):
    d = mixed(0.5)
    model = build_model(d)
    native = NativeInstance(model)
    for k in range(20):
        native.do_step(0.05 * k, 0.05)
    for path in export(model, tmp_path, step=0.05):
        with FMUInstance(path) as unit:
            for k in range(20):
                unit.do_step(0.05 * k, 0.05)
            seen = unit.get(["p1.i", "p2.i", "p1.i_step", "p2.i_step", "energy.dissipated"])
    expected = [*native.signal("y_end"), *native.output(), native.signal("dissipated")[0]]
    assert seen == pytest.approx(expected, rel=1e-12)


def test_transformed_models_keep_their_feedthrough():
    """x = T x~ with U = T: the same outputs and the same steps."""
    d, T = mixed(0.5), np.array([[2.0, 0.5], [-0.3, 1.0]])
    y = state("y", 2)
    new = SystemTransformation({d.states[0]: ca.mtimes(ca.SX(T), y.sx)}, (y,), U=T)(d)
    assert check(new) == []
    one, other = PythonInstance(build_model(d)), PythonInstance(build_model(new))
    for k in range(5):
        for instance in (one, other):
            instance.do_step(0.1 * k, 0.1)
    assert T @ other.x == pytest.approx(one.x, rel=1e-11)
    assert other.output() == pytest.approx(one.output(), rel=1e-11)
    assert other.ledger()["dissipated"] == pytest.approx(one.ledger()["dissipated"], rel=1e-11)


def test_inputs_of_a_feedthrough_may_meet_state_dependent_blocks():
    """R(x) on a port and a skew part that turns with x: the output is the closed form."""
    x, k = state("x", start=0.5), parameter("k", 3.0)
    a, b = (Port(n, ELECTRICAL, "effort", {x: 1.0} if n == "a" else {}, start=2.0) for n in "ab")
    d = PHDAE("turning", states=(x,), parameters=(k,), energies=(energy(x**2 / 2),),
              structure=(skew(a, b, ca.sin(x.sx)),), dissipation=(damping(b, k * x.sx**2),), ports=(a, b))  # fmt: skip
    assert check(d) == []
    y = PythonInstance(build_model(d)).signal("y_end")
    assert y == pytest.approx([0.5 - np.sin(0.5) * 2.0, np.sin(0.5) * 2.0 + 3.0 * 0.25 * 2.0])
