"""E of constant rank that no transformation makes semi-explicit: (38a) + (38b), Theorem 8, Corollary 3, Remark 11."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from phfmu import (
    ELECTRICAL,
    PHDAE,
    Collocated,
    DeclarationError,
    Parametrised,
    Port,
    PythonInstance,
    algebraic,
    block,
    build_model,
    check,
    energy,
    skew,
    state,
)
from tests.engines import ENGINES

# Two LC circuits loaded by a resistor R(theta) each and joined by a gyrator; theta is the area the current vector
# (a, b) sweeps, plus a leak and what the source adds:  theta' + (b a' - a b')/2 = eps v1 + 0.2 u.
CAP, IND, GYR, EPS, END = 0.8, 1.3, 0.7, 0.3, 1.5
Q0, PHI0, THETA0 = (1.0, -0.4), (0.3, 0.8), 0.2


def resistance(theta, sin):
    return 1.5 + 0.6 * sin(theta)


def swept(**changes) -> Parametrised:
    q, phi = state("q", 2, unit="C", start=Q0), state("phi", 2, unit="Wb", start=PHI0)
    i, theta = algebraic("i", 2, unit="A"), state("theta", start=THETA0)
    R = resistance(theta.sx, ca.sin)
    part = PHDAE(
        "swept",
        states=(q, phi),
        algebraics=(i,),
        energies=(energy(ca.sumsqr(q.sx) / (2 * CAP)), energy(ca.sumsqr(phi.sx) / (2 * IND))),
        structure=(skew(q, phi, 1.0), skew(q, i, -1.0), block([i], [[0.0, -GYR], [GYR, 0.0]])),
        dissipation=(block([i], R * ca.SX.eye(2)),),
        ports=(Port("source", ELECTRICAL, "effort", {phi: [1.0, 0.0]}),),
    )
    data = dict(
        part=part,
        theta=(theta,),
        E32={i: 0.5 * ca.horzcat(i[1], -i[0])},
        A={q: [[EPS, 0.0]]},
        B={"source": 0.2},
    )
    return Parametrised(**(data | changes))


def source(t):
    return 0.9 * np.sin(3.0 * t)


def exact() -> np.ndarray:
    """(q, phi, theta) at END; currents and their rates in closed form."""

    def rate(t, x):
        q, phi, theta = x[:2], x[2:4], x[4]
        M = np.array([[resistance(theta, np.sin), GYR], [-GYR, resistance(theta, np.sin)]])
        slope = 0.6 * np.cos(theta) * np.eye(2)
        i = np.linalg.solve(M, q / CAP)
        dq = phi / IND - i
        # i' = first + second theta'
        first, second = np.linalg.solve(M, dq / CAP), -np.linalg.solve(M, slope @ i)
        area = lambda w: 0.5 * (i[0] * w[1] - i[1] * w[0])  # noqa: E731
        dtheta = (area(first) + EPS * q[0] / CAP + 0.2 * source(t)) / (1.0 - area(second))
        return [*dq, -q[0] / CAP + source(t), -q[1] / CAP, dtheta]

    return solve_ivp(rate, (0, END), [*Q0, *PHI0, THETA0], method="DOP853", rtol=3e-14, atol=1e-15).y[:, -1]


@pytest.mark.parametrize("k", [1, 2, 3])
def test_order_2k_and_an_exact_balance(k):
    declaration = swept().assembled()
    assert check(declaration) == []
    model, truth, errors = build_model(declaration, Collocated(k)), exact(), []
    steps = {1: (20, 40, 80), 2: (10, 20, 40), 3: (5, 10, 20)}[k]
    instance = PythonInstance(model)
    for n in steps:
        instance.reset()
        for s in range(n):
            instance.set_node_inputs(source((s + model.nodes) * END / n)[:, None])
            instance.do_step(s * END / n, END / n)
            row = instance.ledger()
            assert abs(np.sum([row["stored"], row["dissipated"], -row["supplied"]])) <= 1e-15
        errors.append(np.abs(instance.x - truth).max())
    assert np.polyfit(np.log(1 / np.array(steps)), np.log(errors), 1)[0] == pytest.approx(2 * k, abs=0.25)


@pytest.mark.slow
def test_both_engines_agree():
    model = build_model(swept().assembled(), Collocated(2))
    inputs = source(0.02 * np.arange(100))[:, None]
    a, b = (kind(model).run(0.0, 0.02, 100, ("x", "dissipated"), inputs=inputs) for kind in ENGINES)
    for name in a:
        assert np.abs(a[name] - b[name]).max() <= 1e-13 * np.abs(a[name]).max()


def test_the_rest_does_not_touch_the_balance():
    """Remark 11: with any A31, A32, B3, E32 the balance of (38a) closes, at every step size that solves."""
    rng = np.random.default_rng(1)
    base = swept()
    (q, phi), (i,) = base.part.states, base.part.algebraics
    wild = replace(
        base,
        A={v: rng.uniform(-1, 1, (1, 2)) for v in (q, phi, i)},
        B={"source": 3.0},
        E32={i: ca.horzcat(ca.sin(i[1]), q[0] ** 2 * i[0])},
    )
    for h in (0.4, 0.05):
        inputs = rng.uniform(-1, 1, (20, 1))
        rows = PythonInstance(build_model(wild.assembled())).run(
            0.0, h, 20, ("stored", "dissipated", "supplied"), inputs=inputs
        )
        size = sum(np.abs(rows[name]).max() for name in rows)
        assert np.abs(rows["stored"] + rows["dissipated"] - rows["supplied"]).max() <= 1e-15 * size + 1e-15


def descriptor() -> tuple[ca.SX, ca.SX]:
    """x = (q, phi, i, theta) and E of (37) for the example."""
    base = swept()
    x = ca.vertcat(base.part.x, base.part.algebraics[0].sx, base.theta[0].sx)
    E = ca.diag(ca.vertcat(ca.SX.ones(4), ca.SX(2, 1), 1))
    E[6, 4:6] = base.E32[base.part.algebraics[0]]
    return x, E


def test_constant_rank_does_not_give_a_semi_explicit_form():
    """The kernel of E is not involutive, so it is no image of D_(x~2) phi: Theorem 7 is necessary, not sufficient.

    ker E is spanned by X1 = d/da - b/2 d/dtheta and X2 = d/db + a/2 d/dtheta; [X1, X2] = d/dtheta lies outside.
    """
    x, E = descriptor()
    a, b = x[4], x[5]
    X1, X2 = ca.SX(7, 1), ca.SX(7, 1)
    X1[4], X1[6], X2[5], X2[6] = 1, -b / 2, 1, a / 2
    bracket = ca.mtimes(ca.jacobian(X2, x), X1) - ca.mtimes(ca.jacobian(X1, x), X2)
    f = ca.Function("f", [x], [E, ca.mtimes(E, X1), ca.mtimes(E, X2), ca.mtimes(E, bracket)])
    rng = np.random.default_rng(2)
    for _ in range(10):
        value, k1, k2, outside = (np.array(v) for v in f(rng.uniform(-2, 2, 7)))
        assert np.linalg.matrix_rank(value) == 5
        assert np.abs(k1).max() <= 1e-15 and np.abs(k2).max() <= 1e-15
        assert outside.ravel() == pytest.approx([0, 0, 0, 0, 0, 0, 1], abs=1e-15)


def test_without_e32_theta_is_a_plain_state():
    """theta' = A31 grad H1 + B3 u is a row of J against z_theta = 0: nothing is eliminated, and ports may act on x2."""
    data = swept(E32={})
    (i,) = data.part.algebraics
    fed = Port("load", ELECTRICAL, "effort", {i: [1.0, 0.0]})
    declaration = replace(data, part=replace(data.part, ports=(*data.part.ports, fed))).assembled()
    assert check(declaration) == []
    rows = PythonInstance(build_model(declaration, Collocated(2))).run(
        0.0, 0.1, 20, ("stored", "dissipated", "supplied"), inputs=np.ones((20, 2))
    )
    total = rows["stored"].sum(axis=1) + rows["dissipated"].sum(axis=1) - rows["supplied"].sum(axis=1)
    assert np.abs(total).max() <= 1e-15


def fed_by_a_port() -> Parametrised:
    data = swept()
    (i,) = data.part.algebraics
    return replace(
        data, part=replace(data.part, ports=(Port("load", ELECTRICAL, "effort", {i: [1.0, 0.0]}),), name="fed"), B={}
    )


def index_two() -> Parametrised:
    data = swept()
    return replace(data, part=replace(data.part, structure=data.part.structure[:2], dissipation=()))


def energetic() -> Parametrised:
    data = swept()
    theta = data.theta[0]
    return replace(data, part=replace(data.part, energies=(energy(theta.sx**2),)))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (fed_by_a_port, "x2 would jump with the input"),
        (index_two, "needs algebraic variables of index 1"),
        (energetic, "H depends on theta"),
        (lambda: swept(B={"sauce": 1.0}), "no port 'sauce' for B3; it has: source"),
        (lambda: swept(A={swept().part.states[0]: [[1.0, 0.0]]}), "no variable of the part"),
        (lambda: swept(theta=()), "theta is not a tuple"),
        (lambda: (d := swept()) and replace(d, A={d.part.states[0]: [[1.0]]}), "expected \\(1, 2\\)"),
        (lambda: (d := swept()) and replace(d, E32={d.part.states[0]: [[1.0, 0.0]]}), "acts on algebraic variables"),
    ],
)
def test_what_is_not_of_the_form_is_named(make, words):
    with pytest.raises(DeclarationError, match=words):
        make().assembled()
