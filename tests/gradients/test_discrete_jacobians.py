"""Discrete Jacobians and rows of constraints between two points: Definition 6 for random maps."""

from __future__ import annotations

import itertools
from functools import cache

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from phfmu import (
    PHDAE,
    Holonomic,
    algebraic,
    discrete_jacobian,
    energy,
    parameter,
    skew,
    state,
)
from phfmu.declare.variable import ValueKind
from phfmu.gradients.gradient_names import GRADIENTS
from phfmu.gradients.quadrature import nodes
from phfmu.plan import address
from phfmu.plan.address import Address
from phfmu.schemes.constraints import constraints
from phfmu.schemes.constraints.velocities import velocity_costate
from phfmu.terms.extraction.extract import extract
from phfmu.terms.term import CONSTRAINT
from tests.gradients.polynomials import EPS, POLYNOMIAL, N, P, X, coefficients, increments, points, unit

MAP = ca.vertcat(POLYNOMIAL, P[0] * X[0] * X[1] - X[2], ca.sin(X[0]) * X[1], X[2])


@cache
def jacobian(method: str):
    return discrete_jacobian(MAP, X, method, parameters=P)


_map = ca.Function("f", [X, P], [MAP, ca.jacobian(MAP, X)])


@pytest.mark.parametrize("method", GRADIENTS)
@settings(max_examples=12, deadline=None)
@given(x=points, d=increments, p=coefficients)
def test_jacobians_have_definition_6(method, x, d, p):
    x1, size = x + d, 1.0 + np.sum(abs(p))
    D = jacobian(method)(x, x1, p)
    start, end = (np.array(_map(v, p)[0]).ravel() for v in (x, x1))
    assert D.shape == (4, N)
    assert np.max(abs(D @ (x1 - x) - (end - start))) <= 500 * EPS * size
    assert np.max(abs(jacobian(method)(x, x, p) - np.array(_map(x, p)[1]))) <= 500 * EPS * size
    if method != "itoh-abe":
        assert np.max(abs(D - jacobian(method)(x1, x, p))) <= 1e5 * EPS * size


CONSTRAINTS = {
    "bar": ca.sumsqr(X) - 1,
    "surface": X[0] ** 4 + P[0] * X[1] ** 2 * X[2] ** 2 + P[1] * X[2] ** 3 - X[1],
    "helix": P[0] * ca.sin(X[0]) + X[1] - ca.exp(P[1] * X[2]),
}


@cache
def rows(name: str, k: int):
    """G (N x k) as the kernel of the constraint has it, and its slopes by D; g itself."""
    q, v, lam = state("q", N), state("v", N), algebraic("lambda")
    p = parameter("p", 0.0, P.numel())
    g = ca.substitute(CONSTRAINTS[name], ca.vertcat(X, P), ca.vertcat(q.sx, p.sx))
    model = PHDAE(
        "constrained", states=(q, v), algebraics=(lam,), parameters=(p,), energies=(energy(ca.sumsqr(v.sx) / 2),),
        structure=(skew(q, v, 1.0),), constraints=(Holonomic(lam, g),),
    )  # fmt: skip
    (term,) = (t for t in extract(model).terms if t.kind is CONSTRAINT)
    (spec,) = constraints.collocated(term, nodes(k))
    symbols, expr = dict(spec.y), {a: e for a, _, e in spec.out}
    place = {j: i for i, j in enumerate(term.index[ValueKind.STATE])}
    z, d = (ca.SX(N, k) for _ in range(2))
    for j, i in itertools.product(range(N), range(k)):
        z[j, i] = symbols[Address(velocity_costate, place[j], i)]
        d[j, i] = symbols[Address(address.increment, place[j], i)]
    G = ca.horzcat(*(-ca.gradient(expr[Address(address.row, 0, i)], z[:, i]) for i in range(k)))
    x, coefficient = spec.x[[place[j] for j in range(N)]], ca.SX.sym("p", P.numel())
    used = term.indices(ValueKind.PARAMETER)
    (G,) = ca.substitute([G], [spec.p], [coefficient[list(used)]]) if used else (G,)
    slope = ca.jacobian(ca.vec(G), ca.vec(d))
    return ca.Function("g", [x, d, coefficient], [G, slope]), ca.Function("g", [X, P], [CONSTRAINTS[name]])


@pytest.mark.parametrize("k", [1, 2, 3])
@pytest.mark.parametrize("name", CONSTRAINTS)
@settings(max_examples=10, deadline=None)
@given(x=points, d=arrays(float, (N, 3), elements=unit), scale=st.integers(-16, 0), p=coefficients)
def test_rows_of_constraints_are_exact_along_the_path(name, k, x, d, scale, p):
    """sum b_i G_i D_i = g(q') - g(q), exchange of the ends, finite slopes."""
    D, nd = 10.0**scale * d[:, :k], nodes(k)
    evaluate, g = rows(name, k)
    G, slope = (np.array(v) for v in evaluate(x, D, p))
    end = x + D @ nd.b
    work = float(np.sum(nd.b * np.sum(G * D, axis=0)))
    assert abs(work - float(g(end, p) - g(x, p))) <= 200 * EPS * 20 + 1e-17  # below the guard: |D|^3 of the midpoint
    back = np.array(evaluate(end, -D[:, ::-1], p)[0])
    assert np.max(abs(back[:, ::-1] - G)) <= (1e-8 if name == "helix" else 1e-13)
    assert np.isfinite(slope).all() and np.max(abs(slope)) < (1e4 if name == "helix" else 200.0)
