"""Plans of random models: matrix, derivatives and sensitivity against differences; kernels; ordering."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pytest

import phfmu as ph
from phfmu import PHDAE, Collocated, Port, PythonInstance, TwoLevel, block, build_model, energy
from phfmu.components.library import build
from phfmu.engine.reference.chain import Tangents
from phfmu.engine.reference.evaluate import Evaluator
from tests.wide import wide

SEEDS, EL = range(4), ph.ELECTRICAL


def random_model(seed: int) -> PHDAE:
    """All kinds of terms at once, with seeded coefficients.

    x (3): diagonal E of parameters; y (2): constant non-diagonal E; w (2): identity.  J, R, ports depend on
    the state, R on an algebraic variable; three energies of one kind share states; one source is fed by time.
    """
    rng = np.random.default_rng(seed)

    def numbers(*shape):
        return ca.DM(np.round(rng.uniform(-1.0, 1.0, shape), 3))

    x, y, w = (ph.state(n, s, start=rng.uniform(-0.5, 0.5, s)) for n, s in (("x", 3), ("y", 2), ("w", 2)))
    a, i = ph.algebraic("a", 2, start=[0.1, -0.2]), ph.algebraic("i", start=0.2)
    m = ph.parameter("m", rng.uniform(0.5, 2.0, 3), 3)
    c = ph.parameter("c", rng.uniform(0.5, 1.5, 2), 2)
    z = ca.vertcat(x.sx, y.sx, w.sx)

    def well(u, v):
        return energy(c[0] * (u - v) ** 4 / 4 + c[1] * (u**2 + v**2) / 2)

    energies = (
        well(x[0], x[1]), well(x[1], y[0]), well(y[1], w[0]),
        energy((ca.dot(numbers(7), z)) ** 4 / 8 + ca.sumsqr(z) / 2),
        energy(ca.exp(0.3 * x[2]) + ca.cos(w[1])),
        ph.strain_energy(ca.sumsqr(x[:2] - w[:2]), lambda s: ca.sqrt(1 + s)),
        ph.strain_energy(ca.sumsqr(y[:2]) + x[0] ** 2, lambda s: c[0] * (s - 1) ** 2),
    )  # fmt: skip
    varying = numbers(7, 7) + x[0] * numbers(7, 7) + ca.sin(w[1]) * numbers(7, 7)
    root = numbers(7, 7) + y[0] * numbers(7, 7)
    resistance = ca.SX.eye(2) + 0.5 * ca.mtimes(a.sx, a.sx.T) + 0.2 * x[1] ** 2 * ca.SX.eye(2)
    return PHDAE(
        f"random_{seed}",
        states=(x, y, w),
        algebraics=(a, i),
        parameters=(m, c),
        energies=energies,
        E={x: m.sx, y: np.array([[1.5, 0.4], [-0.2, 0.8]])},
        structure=(
            block([x, y, w], varying - varying.T),
            ph.skew(x, a, numbers(3, 2) * (1 + x[2])),
            ph.skew(w, i, numbers(2, 1)),
            ph.skew(a, i, ca.vertcat(0.3, y[1])),
        ),
        dissipation=(block([x, y, w], root @ root.T), block([a], resistance), block([i], 0.7 + i.sx**2)),
        ports=(
            Port("in", EL, "effort", {x: numbers(3, 2) * (1 + w[0] ** 2), a: numbers(2, 2)}, size=2),
            Port("out", EL, "flow", {y: numbers(2, 1), i: 1.0 + x[0] ** 2}),
            Port("fed", EL, "effort", {w: ca.vertcat(1.0, x[1])}, source=c[0] * ca.sin(3 * ph.time)),
        ),
        observables=(ph.observable("o", ca.vertcat(x.z[0] * a[0], w[1] + i.sx)),),
    )


def pendulums(seed: int) -> PHDAE:
    """Two constrained points, the second constraint cubic if `seed`, a state-dependent damper and a port."""
    rng = np.random.default_rng(100 + seed)
    q, v = ph.state("q", 4, start=[1.0, 0.0, 1.0, 1.0]), ph.state("v", 4)
    lam, m = ph.algebraic("lambda", 2), ph.parameter("m", rng.uniform(0.5, 2.0, 4), 4)
    cubic = 0.1 * q[0] ** 3 if seed else 0
    g = ca.vertcat((ca.sumsqr(q[:2]) - 1) / 2, (ca.sumsqr(q[2:] - q[:2]) - 1) / 2 + cubic)
    return PHDAE(
        f"pendulums_{seed}",
        states=(q, v),
        algebraics=(lam,),
        parameters=(m,),
        energies=(*(energy(m[j] * v[j] ** 2 / 2) for j in range(4)), energy(3 * q[1] + q[3] ** 4 / 4)),
        E={v: m.sx},
        structure=(ph.skew(q, v, 1.0),),
        dissipation=(block([v], ca.diag(0.1 + q.sx**2)),),
        constraints=(ph.Holonomic(lam, g),),
        ports=(Port("push", ph.TRANSLATIONAL, "effort", {v: ca.vertcat(0, 0, 1, q[0])}),),
    )


@cache
def random_plan(seed, k):
    return build_model(random_model(seed), Collocated(k))


def differences(function, at, step=1e-3):
    """Jacobian of `function` by central differences of order 6 (n x len(at))."""
    columns = []
    for j in range(len(at)):
        total = 0.0
        for shift, weight in ((1, 45.0), (2, -9.0), (3, 1.0)):
            d = np.zeros(len(at))
            d[j] = shift * step
            total = total + weight * (function(at + d) - function(at - d))
        columns.append(total / (60.0 * step))
    return np.array(columns).T.reshape(-1, len(at))


def assert_plan_is_the_derivative(plan, model, seed, h):
    """Matrix and derivative blocks of a plan at a random point; mean outputs and held inputs beside w."""
    rng, evaluator = np.random.default_rng(seed), Evaluator(plan)
    x = np.append(model.x0 + rng.uniform(-0.1, 0.1, plan.nx), 0.3)
    inside = rng.uniform(-0.3, 0.3, plan.nw + plan.nu)

    def rows(v):
        full = np.concatenate([v[: plan.nw], np.tile(v[plan.nw :], plan.k), [h]])
        r = evaluator.residual(x, full, model.p0, h)
        means = plan.weights @ r[plan.nw : plan.nw + plan.nq * plan.k].reshape(plan.k, plan.nq)
        return np.concatenate([r[: plan.nw], means[: plan.nu]])

    expected = differences(rows, inside)
    rows(inside)
    got = np.zeros_like(expected)
    for block_ in (plan.matrix, plan.derivative):
        np.add.at(got, (block_.row, block_.col), evaluator.products(block_, h))
    assert np.max(np.abs(got - expected)) <= 1e-9 * max(1.0, np.max(np.abs(expected)))
    inner = expected[: plan.nw, : plan.nw]
    outside = np.ones_like(inner, bool)
    outside[plan.matrix.row, plan.matrix.col] = False
    assert np.max(np.abs(inner * outside), initial=0.0) <= 1e-9
    assert (np.diff(plan.colptr) == np.bincount(plan.matrix.col, minlength=plan.nw)).all()
    assert sorted(plan.order) == sorted(plan.pivot_row) == list(range(plan.nw))
    full = np.concatenate([inside[: plan.nw], np.tile(inside[plan.nw :], plan.k), [h]])

    def residual(states):
        return evaluator.residual(np.append(states, x[plan.nx :]), full, model.p0, h)[: plan.nw].copy()

    by_states = differences(residual, x[: plan.nx])
    residual(x[: plan.nx])
    got = Tangents(evaluator).by_states(x, model.p0, h).toarray()
    assert np.max(np.abs(got - by_states), initial=0.0) <= 1e-9 * max(1.0, np.max(np.abs(by_states), initial=0.0))


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("k", wide([1, 2, 3], 2))
def test_matrix_of_a_random_model_is_the_derivative_of_its_residual(seed, k):
    model = random_plan(seed, k)
    assert_plan_is_the_derivative(model.step, model, seed, 0.13)
    if k == 1:
        assert_plan_is_the_derivative(model.instant, model, seed, 1.0)


@pytest.mark.parametrize(
    ("seed", "scheme"),
    [(0, Collocated(1)), (1, Collocated(1)), (0, TwoLevel(1)), (1, TwoLevel(1)), (0, TwoLevel(3))],
)
def test_matrix_of_a_constrained_model_is_the_derivative_of_its_residual(seed, scheme):
    model = build_model(pendulums(seed), scheme)
    assert_plan_is_the_derivative(model.step, model, seed, 0.07)
    assert_plan_is_the_derivative(model.instant, model, seed, 1.0)


@pytest.mark.parametrize("name", ["smib", "two_machine"])
def test_matrix_of_a_scene_is_the_derivative_of_its_residual(name):
    """Bare nodes, sources and junctions in SI units, compared row by row."""
    model = build_model(build(name).declaration())
    for plan, h in ((model.step, 1e-4), (model.instant, 1.0)):
        evaluator, x = Evaluator(plan), np.append(model.x0, 0.01)
        tail = np.append(np.tile(model.u0, plan.k), h)

        def rows(s, plan=plan, evaluator=evaluator, x=x, tail=tail, h=h):
            v = np.concatenate([s * plan.nominal, tail])
            return evaluator.residual(x, v, model.p0, h)[: plan.nw].copy()

        at = np.random.default_rng(3).uniform(-1e-3, 1e-3, plan.nw)
        expected = differences(rows, at, 1e-2)
        rows(at)
        got = np.zeros((plan.nw, plan.nw))
        got[plan.matrix.row, plan.matrix.col] = evaluator.products(plan.matrix, h)
        size = np.max(np.abs(expected), axis=1, keepdims=True)
        assert np.max(np.abs(got * plan.nominal - expected) / size) <= 1e-8


def step_map(seed, k):
    """A Python instance after a step with inputs u, how the step began, and the derivative by differences."""
    model, h = random_plan(seed, k), 0.1
    instance = PythonInstance(model)
    instance.run(0.0, h, 2)
    base, u = instance.get_state(), np.array([0.3, -0.2, 0.1])

    def outputs(values):
        instance.set_state(base)
        instance.set_input(values)
        instance.do_step(2 * h, h)
        return instance.output()

    expected = differences(outputs, u, 1e-2)
    outputs(u)
    return instance, u, h, expected


@pytest.mark.parametrize("seed", SEEDS[:2])
@pytest.mark.parametrize("k", wide([1, 2, 3], 2))
def test_sensitivity_is_the_derivative_of_the_step_map(seed, k):
    instance, _, _, expected = step_map(seed, k)
    assert instance.sensitivity() == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("k", wide([1, 2, 3], 1))
def test_sensitivity_of_the_native_engine_is_the_derivative_of_the_step_map(k):
    instance, u, h, expected = step_map(0, k)
    native = ph.NativeInstance(instance.model)
    native.run(0.0, h, 2)
    native.set_input(u)
    native.do_step(2 * h, h)
    assert native.sensitivity() == pytest.approx(expected, abs=1e-9)
    assert native.output() == pytest.approx(instance.output(), abs=1e-13)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("k", wide([1, 2, 3], 1, 2))
def test_random_models_balance(seed, k):
    instance = PythonInstance(random_plan(seed, k))
    for n in range(10):
        instance.set_input(np.sin([n, 2.0 * n, 3.0 * n]))
        instance.do_step(0.1 * n, 0.1)
        row = instance.ledger()
        assert abs(np.sum(row["stored"] + row["dissipated"] - row["supplied"])) <= 2e-14
        assert np.sum(row["dissipated"]) >= 0.0
        assert row["supplied"][0] == pytest.approx(np.sum(row["pairs"]), abs=1e-15)
