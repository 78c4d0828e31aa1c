"""Discrete gradients and Jacobians between two points: Definitions 4-6 for random energies, down to x' = x."""

from __future__ import annotations

import math
from fractions import Fraction
from functools import cache

import casadi as ca
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from phfmu import (
    discrete_gradient,
    energy,
    parameter,
    state,
    strain_energy,
)
from phfmu.gradients.gradient_names import GRADIENTS
from tests.gradients.polynomials import EPS, EXPONENTS, POLYNOMIAL, N, P, X, coefficients, increments, points, unit

_a, _b, _c = (ca.dot(P[3 * i : 3 * i + 3], X) for i in range(3))
SMOOTH = P[9] * ca.exp(_a) + P[10] * ca.sin(_b + P[11]) + P[12] * ca.sqrt(1 + _c**2) + P[13] * ca.log(8 + _a) * X[1]
ENERGIES = {"polynomial": POLYNOMIAL, "smooth": SMOOTH}
SYMMETRIC = [m for m in GRADIENTS if m != "itoh-abe"]


@cache
def gradient(name: str, method: str):
    return discrete_gradient(ENERGIES[name], X, method, parameters=P)


@cache
def analytic(name: str):
    h = ENERGIES[name]
    return ca.Function("h", [X, P], [h, ca.gradient(h, X), ca.hessian(h, X)[0]])


def exact(x, p) -> Fraction:
    """The polynomial in rational arithmetic."""
    at = [Fraction(v) for v in x]
    return sum((Fraction(c) * math.prod(at[j] ** e[j] for j in range(N)) for c, e in zip(p, EXPONENTS, strict=True)),
               Fraction(0))  # fmt: skip


@pytest.mark.parametrize("method", GRADIENTS)
@settings(max_examples=20, deadline=None)
@example(x=np.full(N, 0.9), d=np.full(N, 5e-7), p=np.ones(len(EXPONENTS)))  # just below the guard of other energies
@given(x=points, d=increments, p=coefficients)
def test_directionality_of_polynomials_loses_no_digits(method, x, d, p):
    """W^T (x' - x) against the difference in rational arithmetic, relative to the increment and not to the energy."""
    x1 = x + d
    step = x1 - x
    w = gradient("polynomial", method)(x, x1, p)
    difference = float(exact(x1, p) - exact(x, p))
    assert abs(w @ step - difference) <= 20 * EPS * np.sum(abs(step)) * (1.0 + np.sum(abs(p)))


@pytest.mark.parametrize("method", GRADIENTS)
@settings(max_examples=20, deadline=None)
@given(x=points, d=increments, p=coefficients)
def test_directionality_of_other_energies_holds_to_the_rounding_of_the_energy(method, x, d, p):
    x1 = x + d
    w = gradient("smooth", method)(x, x1, p)
    start, end = (float(analytic("smooth")(v, p)[0]) for v in (x, x1))
    assert np.isfinite(w).all()
    assert abs(w @ (x1 - x) - (end - start)) <= 500 * EPS * 25.0  # each of the four terms is at most exp(3)


@pytest.mark.parametrize("name", ENERGIES)
@pytest.mark.parametrize("method", GRADIENTS)
@settings(max_examples=12, deadline=None)
@given(x=points, d=increments, p=coefficients)
def test_consistency_is_approached_at_first_order_at_least(method, name, x, d, p):
    """W(x, x) = grad H(x) to rounding, and |W(x, x') - grad H(x)| <= C |x' - x|."""
    _, grad, _ = analytic(name)(x, p)
    grad = np.array(grad).ravel()
    at_rest = gradient(name, method)(x, x, p)
    assert np.max(abs(at_rest - grad)) <= 500 * EPS * (1.0 + np.sum(abs(p)))
    w = gradient(name, method)(x, x + d, p)
    size = np.linalg.norm((x + d) - x)
    allowed = 100.0 * (1.0 + np.sum(abs(p))) * (size + 10 * EPS)
    assert np.max(abs(w - grad)) <= allowed


@pytest.mark.parametrize("name", ENERGIES)
@pytest.mark.parametrize("method", SYMMETRIC)
@settings(max_examples=12, deadline=None)
@given(x=points, d=increments, p=coefficients)
def test_symmetric_ones_do_not_know_which_point_is_first(method, name, x, d, p):
    x1 = x + d
    dg = gradient(name, method)
    size = 1.0 + np.sum(abs(p))
    # of other energies: rounding divided by |d|, which is 1e-3 at least where a quotient is formed
    assert np.max(abs(dg(x, x1, p) - dg(x1, x, p))) <= 100 * EPS * size * (1.0 if name == "polynomial" else 1e3)


def test_coordinate_increments_know_which_point_is_first():
    p = np.linspace(-1.0, 1.0, len(EXPONENTS))
    one, two = np.array([0.3, -0.2, 0.5]), np.array([-0.4, 0.6, 0.1])
    dg = gradient("polynomial", "itoh-abe")
    assert np.max(abs(dg(one, two, p) - dg(two, one, p))) > 1e-2


@pytest.mark.parametrize("name", ENERGIES)
@settings(max_examples=20, deadline=None)
@given(x=points, d=points, p=coefficients)
def test_the_gonzalez_gradient_is_definition_5(name, x, d, p):
    """The quotient as published, where it is well conditioned, and its action across the increment."""
    step = (x + d) - x
    if np.linalg.norm(step) < 0.3:
        return
    h0, h1 = (float(analytic(name)(v, p)[0]) for v in (x, x + step))
    mid = np.array(analytic(name)(x + step / 2, p)[1]).ravel()
    expected = mid + (h1 - h0 - mid @ step) / (step @ step) * step
    w = gradient(name, "joint-gonzalez")(x, x + step, p)
    assert np.max(abs(w - expected)) <= 3000 * EPS * (1.0 + np.sum(abs(p)))
    across = np.cross(step, [0.3, -0.5, 0.8])
    assert w @ across == pytest.approx(mid @ across, abs=3000 * EPS * (1.0 + np.sum(abs(p))))


# -- terms: quadratic, strain, sums -------------------------------------------------------------------------


Q = state("q", 6)
STIFFNESS = parameter("k", 2.0)
LENGTH2 = ca.sumsqr(Q[3:] - Q[:3])
SPRINGS = {
    "quartic": strain_energy(LENGTH2, lambda c: STIFFNESS * (c - 1.0) ** 2),
    "linear": strain_energy(LENGTH2, lambda c: STIFFNESS * (ca.sqrt(c + 0.5) - 1.0) ** 2),
}


@cache
def spring_gradient(name: str):
    return discrete_gradient(SPRINGS[name], Q, parameters=STIFFNESS)


def rotation(v) -> np.ndarray:
    """Orthogonal matrix exp of the skew matrix of v (Rodrigues)."""
    angle = float(np.linalg.norm(v))
    if angle < 1e-12:
        return np.eye(3)
    k = np.cross(np.eye(3), np.asarray(v) / angle)
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


@pytest.mark.parametrize("spring", SPRINGS)
@settings(max_examples=20, deadline=None)
@given(x=arrays(float, 6, elements=unit), d=arrays(float, 6, elements=unit), scale=st.integers(-16, 0),
       turn=points, shift=points)  # fmt: skip
def test_strain_form_is_equivariant_and_keeps_momenta(spring, x, d, scale, turn, shift):
    """W(R x + c, R x' + c) = R W(x, x'), sum of forces 0, sum of torques about the mean points 0."""
    dg, x1 = spring_gradient(spring), x + 10.0**scale * d
    R = np.kron(np.eye(2), rotation(3 * turn))
    w = dg(x, x1, 2.0)
    moved = dg(R @ x + np.tile(shift, 2), R @ x1 + np.tile(shift, 2), 2.0)
    size = 100.0
    # moving rounds the increment: eps / |d| of the secant is amplified up to the guard |C' - C| > 1e-3
    assert np.max(abs(moved - R @ w)) <= 2e3 * EPS * size * (1.0 if spring == "quartic" else 1e3)
    assert np.max(abs(w[:3] + w[3:])) == 0.0
    middle = (x + x1) / 2
    torque = np.cross(middle[:3], w[:3]) + np.cross(middle[3:], w[3:])
    assert np.max(abs(torque)) <= 20 * EPS * size


def test_coordinate_increments_are_not_equivariant_and_gonzalez_has_a_torque():
    x, x1 = np.array([0.0, 0.0, 0.0, 1.0, 0.3, 0.2]), np.array([0.1, -0.2, 0.0, 0.4, 1.0, 0.9])
    R = np.kron(np.eye(2), rotation([0.4, 0.9, -0.3]))
    abe = discrete_gradient(SPRINGS["quartic"], Q, "itoh-abe-symmetric", parameters=STIFFNESS)
    assert np.max(abs(abe(R @ x, R @ x1, 2.0) - R @ abe(x, x1, 2.0))) > 1e-2
    w = discrete_gradient(SPRINGS["quartic"], Q, "joint-gonzalez", parameters=STIFFNESS)(x, x1, 2.0)
    middle = (x + x1) / 2
    assert np.max(abs(np.cross(middle[:3], w[:3]) + np.cross(middle[3:], w[3:]))) > 1e-2


def test_the_strain_form_is_the_secant_times_the_gradient_of_the_invariant():
    x, x1 = np.array([0.0, 0.0, 0.0, 1.0, 0.3, 0.2]), np.array([0.1, -0.2, 0.0, 0.4, 1.0, 0.9])
    c0, c1 = (float(np.sum((v[3:] - v[:3]) ** 2)) for v in (x, x1))
    phi = lambda c: 2.0 * (np.sqrt(c + 0.5) - 1.0) ** 2  # noqa: E731
    relative = (x[3:] + x1[3:] - x[:3] - x1[:3]) / 2
    expected = (phi(c1) - phi(c0)) / (c1 - c0) * 2 * np.concatenate([-relative, relative])
    w = discrete_gradient(SPRINGS["linear"], Q, parameters=STIFFNESS)(x, x1, 2.0)
    assert w == pytest.approx(expected, rel=1e-13)


@settings(max_examples=10, deadline=None)
@given(x=points, d=increments)
def test_quadratic_terms_have_the_gradient_at_the_midpoint_whatever_the_method(x, d):
    H = 1.5 * X[0] ** 2 + X[0] * X[1] - 0.5 * X[2] ** 2 + 2 * X[1] * X[2] + X[2]
    m = x + ((x + d) - x) / 2
    expected = [3 * m[0] + m[1], m[0] + 2 * m[2], -m[2] + 2 * m[1] + 1]
    for method in GRADIENTS:
        if method != "itoh-abe":
            assert discrete_gradient(H, X, method)(x, x + d) == pytest.approx(expected, abs=1e-14)


def test_a_sum_of_terms_has_the_sum_of_their_gradients_and_correct_names_who_takes_the_correction():
    a, b = state("a", nominal=2.0), state("b")
    terms = [energy(a**2 / 2), energy(ca.exp(a.sx) * ca.cos(b.sx), correct=(b,))]
    x, x1 = np.array([0.2, -0.3]), np.array([0.9, 0.6])
    both = discrete_gradient(terms, (a, b))(x, x1)
    parts = [discrete_gradient(t, (a, b))(x, x1) for t in terms]
    assert both == pytest.approx(parts[0] + parts[1], rel=1e-15)
    plain = discrete_gradient(terms[1].expr, (a, b), "mean-value")(x, x1)
    assert parts[1] @ (x1 - x) == pytest.approx(plain @ (x1 - x), rel=1e-14)
    t, weight = np.polynomial.legendre.leggauss(3)
    at = x + np.outer((t + 1) / 2, x1 - x)
    assert parts[1][0] == pytest.approx(np.sum(weight / 2 * np.exp(at[:, 0]) * np.cos(at[:, 1])), rel=1e-14)


# -- arguments ----------------------------------------------------------------------------------------------


def test_symbols_in_symbols_out():
    a, b = ca.SX.sym("a", N), ca.SX.sym("b", N)
    dg = gradient("polynomial", "mean-value")
    f = ca.Function("f", [a, b, P], [dg(a, b, P)])
    x, x1, p = np.array([0.1, 0.2, 0.3]), np.array([0.5, -0.2, 0.0]), np.linspace(0, 1, len(EXPONENTS))
    assert np.array(f(x, x1, p)).ravel() == pytest.approx(dg(x, x1, p), rel=1e-15)
    assert np.array(dg.function(x, x1, p)).ravel() == pytest.approx(dg(x, x1, p), rel=1e-15)


def test_what_does_not_fit_is_named():
    with pytest.raises(ValueError, match="'gonzales' unknown.*joint-gonzalez"):
        discrete_gradient(POLYNOMIAL, X, "gonzales", parameters=P)
    with pytest.raises(ValueError, match="depends on k; list it"):
        discrete_gradient(SPRINGS["quartic"], Q)
    with pytest.raises(ValueError, match="x1 has 2 entries, expected 3"):
        gradient("polynomial", "mean-value")([0.0] * 3, [0.0] * 2, np.zeros(len(EXPONENTS)))
    with pytest.raises(ValueError, match="p has 0 entries"):
        gradient("polynomial", "mean-value")([0.0] * 3, [0.0] * 3)
