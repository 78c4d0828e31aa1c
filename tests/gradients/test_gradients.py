"""Properties of the discrete gradients: directionality, consistency, symmetry, smoothness, momentum maps."""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal, localcontext
from fractions import Fraction
from functools import cache

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from phfmu import discrete_gradient, strain_energy
from phfmu.gradients import gradients
from phfmu.gradients.quadrature import gauss, nodes
from tests.wide import wide

EPS = np.finfo(float).eps
LEAST = np.finfo(float).smallest_subnormal  # what a product of such small numbers loses, whatever they are
N = 6  # states of every example: two points in space
COEFFICIENTS = 8
ORDERS = (1, 2, 3)

X, P = ca.SX.sym("x", N), ca.SX.sym("p", COEFFICIENTS)
S = ca.SX.sym("s")
DISTANCE = ca.sumsqr(X[3:] - X[:3])
#: strain energies by name: (invariant C(x), phi(s)); coefficients are symbols, so that an example is one draw
STRAIN = {
    "strain_linear": (DISTANCE, P[0] * S),
    "strain_quadratic": (DISTANCE, P[0] * (S - P[1]) ** 2),
    "strain_cubic": (DISTANCE, P[0] * S**3 + P[1] * S**2 - P[2] * S),
    "strain_product": (X[0] * X[4] - X[2] * X[3] + P[3] * X[5], P[0] * S**4 + P[1] * S),
    "strain_root": (DISTANCE + 1, P[0] * (ca.sqrt(S) - P[1]) ** 2),
    "strain_exp": (DISTANCE, P[0] * ca.exp(-S) + P[1] * ca.sin(S)),
}
_tilt = ca.dot(P[:N], X)
ENERGIES = {
    "quadratic": ca.dot(P[:N] * X, X) + P[6] * X[0] * X[3] + P[7] * X[1],
    "quartic": P[0] * X[0] ** 4 + P[1] * X[0] * X[1] ** 3 + P[2] * (X[2] * X[3]) ** 2 + _tilt**2 + X[5],
    "sextic": P[0] * X[0] ** 6 + P[1] * X[1] ** 3 * X[2] ** 2 + _tilt**3,
    "exponential": P[6] * ca.exp(_tilt / 4) + P[7] * X[0] ** 2,
    "pendulum": P[6] * ca.sin(X[0] + P[7]) - ca.cos(X[1]) * X[2] ** 2 + _tilt**2,
}
ENERGIES |= {name: ca.substitute(phi, S, c) for name, (c, phi) in STRAIN.items()}
GENERAL = ("quartic", "sextic", "exponential", "pendulum")
SMOOTH = ("exponential", "pendulum", "strain_root", "strain_exp")  # not polynomial: corrected by a quotient
CASES = [("quadratic", "quadratic"), *(("strain", n) for n in STRAIN), *(("general", n) for n in GENERAL)]
CASES_AND_ORDERS = [(rule, name, k) for rule, name in CASES for k in ORDERS]
CASES_AND_ORDERS += [("joint", name, 1) for name in ENERGIES]
#: each rule with energies that are polynomials and such that are not, each order
CASES_AND_ORDERS = wide(
    CASES_AND_ORDERS,
    *(("quadratic", "quadratic", k) for k in ORDERS),
    *(
        ("strain", name, k)
        for name, k in (("strain_cubic", 1), ("strain_product", 2), ("strain_exp", 2), ("strain_root", 3))
    ),
    *(("general", name, k) for name, k in (("pendulum", 1), ("sextic", 2), ("exponential", 2), ("quartic", 3))),
    *(("joint", name, 1) for name in ("quartic", "pendulum", "strain_linear")),
)


@dataclass(frozen=True)
class Example:
    """A gradient as functions of (x, D, p): W (N x k) and dH, their derivatives by D, and H of (x, p)."""

    value: ca.Function
    slope: ca.Function
    energy: ca.Function


@cache
def example(rule: str, name: str, k: int) -> Example:
    h, d, nd = ENERGIES[name], ca.SX.sym("d", N, k), nodes(k)
    if rule == "strain":
        w, dh = gradients.strain(*STRAIN[name], S, X, d, nd)
    elif rule == "general":
        w, dh = gradients.general(h, X, d, nd, np.array([1.0, 1.0, 0.5, 1.0, 2.0, 1.0]))
    elif rule == "quadratic":
        w, dh = gradients.quadratic(h, ca.gradient(h, X), X, d, nd)
    else:
        w, dh = gradients.joint_gonzalez(h, X, d, nd)
    both = ca.vertcat(ca.vec(w), dh)
    return Example(
        ca.Function("w", [X, d, P], [w, dh]),
        ca.Function("s", [X, d, P], [ca.jacobian(both, ca.vec(d))]),
        ca.Function("h", [X, P], [h, ca.gradient(h, X)]),
    )


unit = st.floats(-1.0, 1.0, allow_subnormal=False)
states = arrays(float, N, elements=unit)
coefficients = arrays(float, COEFFICIENTS, elements=unit)
scales = st.integers(-16, 0).map(lambda n: 10.0**n)


def increments(k: int) -> st.SearchStrategy:
    return st.tuples(arrays(float, (N, k), elements=unit), scales).map(lambda pair: pair[0] * pair[1])


def evaluate(rule: str, name: str, k: int, x, d, p):
    w, dh = example(rule, name, k).value(x, d, p)
    return np.array(w).reshape(N, k), float(dh)


def energy(rule: str, name: str, k: int, x, p):
    h, grad = example(rule, name, k).energy(x, p)
    return float(h), np.array(grad).ravel()


@pytest.mark.parametrize(("rule", "name", "k"), CASES_AND_ORDERS)
@settings(max_examples=12, deadline=None)
@given(data=st.data())
def test_directionality_holds_to_the_rounding_of_the_term(rule, name, k, data):
    x, d, p = data.draw(states), data.draw(increments(k)), data.draw(coefficients)
    w, dh = evaluate(rule, name, k, x, d, p)
    b = nodes(k).b
    work = float(np.sum(b * np.sum(d * w, axis=0)))
    start, end = energy(rule, name, k, x, p)[0], energy(rule, name, k, x + d @ b, p)[0]
    size = 5.0 + abs(start) + abs(end)  # coefficients and states are at most 1
    # dH loses no digits of the difference, the gradients those of the coefficients and states
    moved = 10.0 * float(np.sum(b * np.sum(abs(d), axis=0)))
    assert abs(work - dh) <= 200 * (EPS * moved + LEAST)
    assert abs(dh - (end - start)) <= 200 * EPS * size
    assert abs(work - (end - start)) <= 200 * EPS * size


@pytest.mark.parametrize(("rule", "name", "k"), CASES_AND_ORDERS)
@settings(max_examples=8, deadline=None)
@given(x=states, p=coefficients, data=st.data())
def test_consistent_and_finite_at_rest(rule, name, k, x, p, data):
    grad = energy(rule, name, k, x, p)[1]
    size = 10.0 + float(np.max(abs(grad)))
    w, dh = evaluate(rule, name, k, x, np.zeros((N, k)), p)
    assert dh == 0.0
    assert np.max(abs(w - grad[:, None])) <= 100 * EPS * size
    for scale in (0.0, 1e-200, 1e-14, 1e-9, 1e-6, 1e-4, 1e-3, 2e-3):
        d = scale * data.draw(arrays(float, (N, k), elements=unit))
        w, _ = evaluate(rule, name, k, x, d, p)
        slope = np.array(example(rule, name, k).slope(x, d, p))
        assert np.isfinite(w).all() and np.isfinite(slope).all()
        assert np.max(abs(w - grad[:, None])) <= 300 * size * scale + 300 * EPS * size


@pytest.mark.parametrize(("rule", "name", "k"), CASES_AND_ORDERS)
@settings(max_examples=8, deadline=None)
@given(data=st.data())
def test_exchange_of_the_end_points_gives_the_same_gradients(rule, name, k, data):
    """From x' with increments -D in reverse order the path is the same, so are the gradients at its nodes."""
    x, d, p = data.draw(states), data.draw(increments(k)), data.draw(coefficients)
    w, dh = evaluate(rule, name, k, x, d, p)
    back, dh_back = evaluate(rule, name, k, x + d @ nodes(k).b, -d[:, ::-1], p)
    size = 10.0 + float(np.max(abs(w)))
    assert np.max(abs(back[:, ::-1] - w)) <= 100 * EPS * size
    assert abs(dh + dh_back) <= 300 * EPS * size


@pytest.mark.parametrize("name", STRAIN)
@pytest.mark.parametrize("k", ORDERS)
@settings(max_examples=10, deadline=None)
@given(data=st.data())
def test_strain_form_keeps_linear_and_angular_momentum(name, k, data):
    """Forces at each node sum to zero exactly and have no torque, if C depends on the distance only."""
    if name == "strain_product":
        return
    x, d, p = 3.0 * data.draw(states), data.draw(increments(k)), data.draw(coefficients)
    w, _ = evaluate("strain", name, k, x, d, p)
    assert (w[:3] + w[3:] == 0.0).all()
    for i in range(k):
        at = x + d @ nodes(k).a[i]
        torque = np.cross(at[:3], w[:3, i]) + np.cross(at[3:], w[3:, i])
        assert np.max(abs(torque)) <= 50 * EPS * (1.0 + np.max(abs(at))) * np.max(abs(w[:, i]))


@pytest.mark.parametrize("k", ORDERS)
def test_other_rules_lose_momentum_that_the_strain_form_keeps(k):
    """The comparison has teeth: exact quadrature of the same energy has a torque."""
    p = np.array([1.0, 0.5, 0, 0, 0, 0, 0, 0])
    x, d = np.array([0, 0, 0, 1.0, 0.3, 0.2]), np.zeros((N, k))
    d[3:] = np.array([[-0.4, 0.2, 0.9], [0.7, -0.5, 0.3], [0.2, 0.8, -0.6]])[:, :k]
    w = np.array(_full_quadrature(k).value(x, d, p)[0]).reshape(N, k)
    at = [x + d @ nodes(k).a[i] for i in range(k)]
    torque = sum(nodes(k).b[i] * np.cross(at[i][3:] - at[i][:3], w[3:, i]) for i in range(k))
    assert np.max(abs(torque)) > 1e-3


@cache
def _full_quadrature(k: int) -> Example:
    d = ca.SX.sym("d", N, k)
    w, dh = gradients.general(ENERGIES["strain_quadratic"], X, d, nodes(k), np.ones(N))
    return Example(ca.Function("w", [X, d, P], [w, dh]), None, None)


@pytest.mark.parametrize("k", ORDERS)
@pytest.mark.parametrize("rule", ["strain", "general", "joint"])
def test_energy_difference_of_a_polynomial_has_no_cancellation(rule, k):
    """H(x') - H(x) against rational arithmetic: relative accuracy though both energies are 1e9 larger."""
    if rule == "joint" and k > 1:
        with pytest.raises(ValueError, match="order 2 only"):
            gradients.joint_gonzalez(ENERGIES["quartic"], X, ca.SX.sym("d", N, k), nodes(k))
        return
    p = np.array([0.75, 0.125, 0, 0, 0, 0, 0, 0])
    x = np.array([0.5, -1.25, 2.0, 1.5, 0.25, -3.0])
    d = 1e-9 * np.outer([0.3, -0.7, 0.2, 0.9, -0.1, 0.4], np.ones(k))
    dh = float(example(rule, "strain_quadratic", k).value(x, d, p)[1])

    def exact(q):
        c = sum((b - a) ** 2 for a, b in zip(q[:3], q[3:], strict=True))
        return Fraction(p[0]) * (c - Fraction(p[1])) ** 2

    old = [Fraction(v) for v in x]
    new = [o + sum((Fraction(v) * Fraction(w) for v, w in zip(row, nodes(k).b, strict=True)), Fraction(0))
           for o, row in zip(old, d, strict=True)]  # fmt: skip
    difference = float(exact(new) - exact(old))
    assert dh == pytest.approx(difference, rel=1e-13)


@pytest.mark.parametrize("m", range(1, 9))
def test_gauss_rule_is_exact_up_to_degree_2m_minus_1(m):
    t, w = gauss(m)
    for degree in range(2 * m):
        assert w @ t**degree == pytest.approx(1 / (degree + 1), rel=1e-14)
    assert abs(w @ t ** (2 * m) - 1 / (2 * m + 1)) > 1e-12


@pytest.mark.parametrize("k", ORDERS)
def test_collocation_coefficients_integrate_polynomials(k):
    nd = nodes(k)
    for degree in range(k):
        assert nd.a @ nd.c**degree == pytest.approx(nd.c ** (degree + 1) / (degree + 1), rel=1e-14)
        assert nd.integral(0.3) @ nd.c**degree == pytest.approx(0.3 ** (degree + 1) / (degree + 1), rel=1e-13)
        assert nd.value(0.3) @ nd.c**degree == pytest.approx(0.3**degree, rel=1e-13)
    assert nd.integral(1.0) == pytest.approx(nd.b, rel=1e-14)


def test_degree_of_polynomials_and_of_others():
    assert [gradients.degree(ENERGIES[n], X) for n in ("quadratic", "quartic", "sextic")] == [2, 4, 6]
    assert gradients.degree(P[0] * X[0] ** 9, X) is None
    assert all(gradients.degree(ENERGIES[n], X) is None for n in SMOOTH)


@pytest.mark.parametrize("form", ["strain", "general"])
@pytest.mark.parametrize("unit", [1.0, 1e-2, 1e-4])
def test_directionality_does_not_depend_on_the_units(form: str, unit: float) -> None:
    """1/2 k (|x| - l)^2 of a spring of 0.1 units: work along the increments beside the difference in 40 digits."""
    x, length, rng = ca.SX.sym("x", 3), 0.095 * unit, np.random.default_rng(2)
    law = lambda s: 500 * (ca.sqrt(s) - length) ** 2  # noqa: E731
    gradient = discrete_gradient(strain_energy(ca.sumsqr(x), law), x, "per-term" if form == "strain" else "mean-value")
    with localcontext() as context:
        context.prec = 40
        for size in 10.0 ** np.arange(-7.0, 0.0):
            a = unit * (np.array([0.1, 0.0, 0.0]) + 0.01 * rng.standard_normal(3))
            b = a + 0.1 * unit * size * rng.standard_normal(3)
            p, q = ([Decimal(float(v)) for v in point] for point in (a, b))
            ends = [500 * (sum(v * v for v in point).sqrt() - Decimal(length)) ** 2 for point in (p, q)]
            force = gradient(a, b)
            work = sum(Decimal(float(w)) * (v1 - v0) for w, v0, v1 in zip(force, p, q, strict=True))
            pulled = float(np.linalg.norm(force) * np.linalg.norm(b - a)) + 500 * unit * length * 1e-3 * size
            assert abs(float(work - (ends[1] - ends[0]))) <= 1e-13 * pulled


def test_the_difference_of_a_logarithm_near_its_pole_keeps_its_digits():
    """log1p(b) - log1p(a) = log1p((b - a)/(1 + a)): near -1 the slope changes within steps that are short beside 1."""
    x, d = ca.SX.sym("x"), ca.SX.sym("d")
    change = ca.Function("change", [x, d], [gradients.difference(ca.log1p(x), x, d)])
    for a, step in ((-1 + 2.0**-20, 2.0**-12), (-1 + 2.0**-10, 2.0**-30), (0.5, 2.0**-40)):
        assert float(change(a, step)) == pytest.approx(np.log1p(step / (1 + a)), rel=1e-14)
