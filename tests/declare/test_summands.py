"""One energy that is a sum, and the same as separate terms: one plan, few kernels."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from phfmu import (
    PHDAE,
    Collocated,
    Energy,
    PythonInstance,
    build_model,
    discrete_gradient,
    energy,
    parameter,
    skew,
    state,
)
from phfmu.declare.energy import resolve_kind
from phfmu.declare.expressions.summands import summands

N = 6


def system(split: bool) -> PHDAE:
    """N points in a plane that attract each other with the potential -c log(1 + r^2)."""
    q, p = state("q", 2 * N, start=np.sin(np.arange(2 * N) * 1.7)), state("p", 2 * N)
    c = parameter("c", 0.3)
    pairs = [
        -c.sx * ca.log(1 + ca.sumsqr(q.sx[2 * i : 2 * i + 2] - q.sx[2 * j : 2 * j + 2]))
        for i in range(N)
        for j in range(i)
    ]
    terms = [energy(e) for e in pairs] if split else [energy(sum(pairs[1:], pairs[0]))]
    return PHDAE(
        "points", states=(q, p), parameters=(c,), structure=(skew(q, p, 1.0),),
        energies=(energy(ca.sumsqr(p.sx) / 2), *terms),
    )  # fmt: skip


@pytest.mark.parametrize("k", [1, 2])
def test_a_sum_and_its_summands_give_one_plan(k):
    one, many = (build_model(system(split), Collocated(k)) for split in (False, True))
    kernels = [sorted((g.kernel.name, g.n) for g in m.step.groups) for m in (one, many)]
    assert kernels[0] == kernels[1] and (max(n for _, n in kernels[0]), len(kernels[0])) == (N * (N - 1) // 2, 2)
    ends = []
    for model in (one, many):
        unit = PythonInstance(model)
        unit.initialise()
        for i in range(5):
            unit.do_step(0.1 * i, 0.1)
        ends.append(unit.x)
    assert (ends[0] == ends[1]).all()


def parts(expr: ca.SX, x: ca.SX, **kwargs) -> list[Energy]:
    states = {x[i].element_hash() for i in range(x.numel())}
    return summands(resolve_kind(energy(expr, **kwargs), states), states)


def test_summands_of_the_same_states_stay_together_and_add_up_to_the_whole():
    x = ca.SX.sym("x", 3)
    h = ca.cos(x[0]) - (x[0] ** 2 - (7 - ca.exp(x[1] * x[0]))) + x[1] * x[0] - (-(x[2] ** 2))
    found = parts(h, x)
    assert [len(ca.symvar(e.expr)) for e in found] == [1, 2, 1] and found[2].kind == "quadratic"
    total = ca.Function("f", [x], [h - sum((e.expr for e in found), ca.SX(0))])
    for point in np.random.default_rng(1).uniform(-1, 1, (5, 3)):
        assert abs(float(total(point))) <= 1e-15


def test_factors_without_states_are_distributed():
    """-1/2 c (log a + log b) / m is two terms; a product of states stays one."""
    x, c, m = ca.SX.sym("x", 3), ca.SX.sym("c"), ca.SX.sym("m")
    h = -0.5 * c * (ca.log(1 + x[0]) + 2 * (ca.cos(x[1]) - ca.exp(x[2]) / m)) / m
    found = parts(h, x)
    assert [str(s) for e in found for s in ca.symvar(e.expr) if str(s).startswith("x")] == ["x_0", "x_1", "x_2"]
    total = ca.Function("f", [x, c, m], [h - sum((e.expr for e in found), ca.SX(0))])
    assert abs(float(total([0.3, 0.4, 0.5], 1.7, 0.6))) <= 1e-15
    assert len(parts(ca.cos(x[0]) * (x[1] + ca.cos(x[2])), x)) == 1


def square(x: ca.SX) -> ca.SX:
    return ca.sumsqr(x[:3] - x[3:])


@pytest.mark.parametrize(
    "law",
    [
        lambda x, c: -c * ca.log(square(x)),
        lambda x, c: c * (ca.norm_2(x[:3] - x[3:]) - 0.5) ** 2 / 2 + ca.log(square(x)),  # the length is written twice
        lambda x, c: 4 * c * (square(x) ** -6 - square(x) ** -3),
        lambda x, c: (c * square(x) - 1) ** 2,  # a polynomial
        lambda x, c: ca.fmax(0, ca.sqrt(square(x)) - c) ** 2,
    ],
)
def test_functions_of_a_length_are_strain_terms(law):
    x, c = ca.SX.sym("x", 6), ca.SX.sym("c")
    (term,) = parts(law(x, c), x)
    assert term.kind == "strain" and term.invariant is not None and term.phi is not None
    f = ca.Function("f", [x, c], [law(x, c), term.phi(term.invariant), term.expr])
    for point in np.random.default_rng(1).uniform(-1, 1, (5, 6)):
        declared, *found = (float(v) for v in f(point, 0.7))
        assert found == pytest.approx([declared] * 2, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize(
    "law",
    [
        lambda x: ca.cos(x[0] ** 2),  # one coordinate has no rotation
        lambda x: ca.cos(x[0] * x[1]),  # no length
        lambda x: ca.log(square(x)) * x[0],
        lambda x: ca.log(square(x)) * ca.sqrt(ca.sumsqr(x[:3])),  # two of them
        lambda x: ca.exp(ca.sqrt(square(x)) + x[0]),
    ],
)
def test_other_functions_are_general(law):
    x = ca.SX.sym("x", 6)
    assert [e.kind for e in parts(law(x), x)] == ["general"]


def test_what_belongs_together_stays_whole():
    x, v = ca.SX.sym("x", 2), state("v", 2)
    assert len(parts(ca.sumsqr(x), x)) == 1  # quadratic
    assert len(parts(ca.cos(x[0]) * (x[0] + x[1]) + 5, x)) == 1  # a product and a constant
    assert len(parts(ca.cos(v.sx[0]) + ca.cos(v.sx[1]), v.sx)) == 2
    assert len(parts(ca.cos(v.sx[0]) + ca.cos(v.sx[1]), v.sx, correct=(v,))) == 2
    w = state("w")
    both = ca.vertcat(v.sx, w.sx)
    assert (
        len(parts(ca.cos(v.sx[0]) + ca.cos(w.sx), both, correct=(v,))) == 1
    )  # the correction of the second is to go to v


def test_discrete_gradients_of_a_sum_are_those_of_the_scheme():
    """W of a sum is that of its summands, in one declaration as in two."""
    x = state("x", 2)
    a, b = ca.cos(3 * x.sx[0]), ca.exp(x.sx[1])
    whole, apart = discrete_gradient(a + b, x), discrete_gradient([energy(a), energy(b)], x)
    assert (whole([0.1, 0.2], [1.3, -0.4]) == apart([0.1, 0.2], [1.3, -0.4])).all()


def test_a_large_sum_is_built_and_compiled_like_its_springs():
    """The size of the code does not grow with the number of equal summands."""
    texts = [
        len("".join(g.kernel.function.serialize() for g in build_model(system(s)).step.groups)) for s in (False, True)
    ]
    assert texts[0] == texts[1] < 60_000
