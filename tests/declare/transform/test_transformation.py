"""System transformations: continuous (section 5.1), in the engines, and what is refused."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from phfmu import (
    PHDAE,
    TRANSLATIONAL,
    Collocated,
    DeclarationError,
    NativeInstance,
    Port,
    PythonInstance,
    SystemTransformation,
    algebraic,
    build_model,
    check,
    damping,
    energy,
    keeping_E,
    parameter,
    skew,
    state,
    with_closed_pair,
)
from tests.wide import wide

# -- a plane oscillator: q' = p/m, p' = -grad V - d p/m + F, V = k |q|^2/2 + c q1^4/4 ---------------------------

M, K, C, D = 1.3, 2.0, 0.8, 0.15
Q0, P0 = (0.9, 0.4), (-0.3, 0.7)


def plane() -> tuple[PHDAE, tuple]:
    q, p = state("q", 2, unit="m", start=Q0), state("p", 2, unit="N.s", start=P0)
    m, k = parameter("m", M, unit="kg"), parameter("k", K, unit="N/m")
    model = PHDAE(
        "plane",
        states=(q, p),
        parameters=(m, k),
        energies=(energy(ca.sumsqr(p.sx) / (2 * m.sx)), energy(k * ca.sumsqr(q.sx) / 2), energy(C * q[0] ** 4 / 4)),
        structure=(skew(q, p, 1.0),),
        dissipation=(damping(p, D),),
        ports=(Port("arm", TRANSLATIONAL, "effort", {p: [0.0, 1.0]}),),
    )
    return model, (q, p)


def polar_map(variables, **options):
    """q = r (cos phi, sin phi), p = (cos phi, sin phi) p_r + (-sin phi, cos phi) p_t."""
    q, p = variables
    r, angle = state("r", unit="m", start=1.0), state("phi", unit="rad", start=0.1)
    pr, pt = state("p_r", unit="N.s"), state("p_t", unit="N.s")
    radial, across = ca.vertcat(ca.cos(angle.sx), ca.sin(angle.sx)), ca.vertcat(-ca.sin(angle.sx), ca.cos(angle.sx))
    return {q: r * radial, p: pr * radial + pt * across}, (r, angle, pr, pt)


H0 = 1.3  # J, at the start


def force(t):
    return 0.8 * np.cos(2.0 * t)


def exact(end):
    def rate(t, y):
        q, p = y[:2], y[2:]
        v = p / M
        return [*v, -K * q[0] - C * q[0] ** 3 - D * v[0], -K * q[1] - D * v[1] + force(t)]

    return solve_ivp(rate, (0, end), [*Q0, *P0], method="DOP853", rtol=3e-14, atol=1e-15).y[:, -1]


@pytest.mark.parametrize("keep", [False, True])
@pytest.mark.parametrize("k", wide([1, 2, 3], 2))
def test_polar_coordinates_solve_the_same_problem(k, keep):
    """The transformed declaration, with E(x) or with E = 1 (Remark 8), has order 2k and an exact balance."""
    model, variables = plane()
    phi, new = polar_map(variables)
    declaration = (keeping_E(phi, new) if keep else SystemTransformation(phi, new))(model)
    assert check(declaration) == []
    assert bool(declaration.E) is not keep
    built, errors, end = build_model(declaration, Collocated(k)), [], 1.0
    steps = {1: (20, 40, 80), 2: (8, 16, 32), 3: (6, 9, 12)}[k]
    instance = PythonInstance(built)
    for n in steps:
        instance.reset()
        for s in range(n):
            instance.set_node_inputs(force((s + built.nodes) * end / n)[:, None])
            instance.do_step(s * end / n, end / n)
            row = instance.ledger()
            assert abs(np.sum([row["stored"], row["dissipated"], -row["supplied"]])) <= 1e-15 * H0
        q_and_p = instance.signals()["observables"]  # the old variables are reported by their old names
        errors.append(np.abs(q_and_p - exact(end)).max())
    assert built.observable_names == ("q[1]", "q[2]", "p[1]", "p[2]")
    assert np.polyfit(np.log(1 / np.array(steps)), np.log(errors), 1)[0] == pytest.approx(2 * k, abs=0.3)


def test_starts_units_names_and_ports_carry_over():
    model, variables = plane()
    declaration = SystemTransformation(*polar_map(variables))(model)
    start = {n: s for v in declaration.states for n, s in zip(v.names(), v.start, strict=True)}
    r, angle = np.hypot(*Q0), np.arctan2(Q0[1], Q0[0])
    assert start["r"] == pytest.approx(r, rel=1e-14) and start["phi"] == pytest.approx(angle, rel=1e-14)
    assert start["p_r"] == pytest.approx(P0[0] * np.cos(angle) + P0[1] * np.sin(angle), rel=1e-13)
    assert [p.name for p in declaration.ports] == ["arm"]
    assert [(o.name, o.unit) for o in declaration.observables] == [("q", "m"), ("p", "N.s")]
    assert [v.name for v in declaration.states] == ["r", "phi", "p_r", "p_t"]


@pytest.mark.parametrize("engine", [PythonInstance, pytest.param(NativeInstance, marks=pytest.mark.slow)])
def test_the_pair_of_the_old_coordinates_gives_the_same_steps(engine):
    """Theorem 9 in the engines: nonlinear phi, constant U, J, R, B: phi(x~_k) = x_k to rounding, for 100 large steps."""
    model, variables = plane()
    T = SystemTransformation(*polar_map(variables))
    declaration = with_closed_pair(model, T)
    assert check(declaration) == []
    inputs = force(0.1 * np.arange(100))[:, None]
    old = engine(build_model(model)).run(0.0, 0.1, 100, ("x",), inputs=inputs)["x"]
    new = engine(build_model(declaration)).run(0.0, 0.1, 100, ("x", "stored", "dissipated", "supplied"), inputs=inputs)
    phi = ca.Function("phi", [T.x], [T.image])
    assert np.abs(np.array(phi(new["x"].T)).T - old).max() <= 1e-12
    assert np.abs(new["stored"] + new["dissipated"] - new["supplied"]).max() <= 1e-14
    # E at the midpoint instead of the transformed pair: another second-order method (Remark 10)
    other = engine(build_model(T(model))).run(0.0, 0.1, 100, ("x",), inputs=inputs)["x"]
    assert np.abs(np.array(phi(other.T)).T - old).max() > 1e-4


def test_a_nonlinear_inverse_is_given_and_checked():
    model, (q, _) = plane()
    r, angle = state("r", start=1.0), state("phi", start=0.1)
    T = SystemTransformation({q: r * ca.vertcat(ca.cos(angle.sx), ca.sin(angle.sx))}, (r, angle))
    psi = {r: ca.sqrt(ca.sumsqr(q.sx)), angle: ca.atan2(q[1], q[0])}
    back = T.inverse(psi)(T(model))
    a, b = (
        PythonInstance(build_model(m)).run(0.0, 0.01, 10, ("x",), inputs=np.zeros((10, 1)))["x"] for m in (model, back)
    )
    # E~~ = U~^T E~ Dpsi is 1 up to rounding, and is recognised as such
    assert back.E == {} and np.abs(a - b).max() <= 1e-12
    with pytest.raises(DeclarationError, match="psi is not the inverse"):
        T.inverse(psi | {angle: ca.atan2(q[0], q[1])})
    with pytest.raises(DeclarationError, match="not affine; give psi"):
        T.inverse()


def test_members_may_be_transformed_before_they_are_composed():
    from phfmu import Network
    from phfmu.components.mechanical.translational import mass, spring

    def network(unit):
        net = Network("pair")
        net.add("left", unit)
        net.add("spring", spring(3.0, elongation=0.2))
        net.add("right", mass(2.0))
        net.connect("left.flange", "spring.a")
        net.connect("right.flange", "spring.b")
        return net.compose()

    plain = mass(1.5, k=4.0, q=0.3)
    s = state("s", 2, unit="m")
    turned = SystemTransformation({v: s[i] + (0.25 if i else 2.0) * s[1 - i] for i, v in enumerate(plain.states)}, (s,))
    a, b = (PythonInstance(build_model(network(m), Collocated(2))) for m in (plain, turned(plain)))
    for unit in (a, b):
        unit.run(0.0, 0.05, 20, ("x",))
    names = b.model.observable_names
    assert b.signals()["observables"][list(names).index("left.q")] == pytest.approx(a.x[0], abs=1e-12)


# -- what is refused --------------------------------------------------------------------------------------------


def refused(transformation, model=None):
    base, variables = plane()
    return transformation(*variables)(model or base)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda q, p: SystemTransformation({q: state("w", 3)[:2]}, (state("w", 3),)), "keeps their number"),
        (lambda q, p: SystemTransformation({q: (w := state("w", 2)).sx * p[0]}, (w,)), "depends on 'p', which is not"),
        (lambda q, p: SystemTransformation({q: (w := state("w", 2)).sx * ca.SX.sym("c")}, (w,)), "not a parameter"),
        (lambda q, p: SystemTransformation({q: (w := state("w", 2)).sx ** 2}, (w,)), "Dphi is singular at w"),
        (
            lambda q, p: SystemTransformation({q: ca.vertcat((w := state("w", 2))[0], w[0])}, (w,)),
            "Dphi is singular at w",
        ),
        (lambda q, p: SystemTransformation({q: ca.log((w := state("w", 2)).sx)}, (w,)), "is missed by"),
        (
            lambda q, p: SystemTransformation({q: (w := state("w", 2)).sx}, (w,), [[1, 2], [2, 4]]),
            "structurally|U is singular",
        ),
        (
            lambda q, p: SystemTransformation({q: (w := state("w", 2)).sx}, (w,), np.eye(3)),
            "U: is 3 x 3, expected 2 x 2",
        ),
        (lambda q, p: SystemTransformation({state("q", 2): (w := state("w", 2)).sx}, (w,)), "no state or algebraic"),
        (lambda q, p: SystemTransformation({q: (w := algebraic("w", 2)).sx}, (w,)), "is not zero"),
    ],
)
def test_what_is_no_transformation_is_named(make, words):
    with pytest.raises((DeclarationError, np.linalg.LinAlgError), match=words):
        refused(make)
