"""Discrete gradient pairs under system transformations: Theorems 6, 9, 10, Lemma 3, and Examples 9 and 10.

The scheme (18) is solved here with NumPy only, so that the statements do not rest on the engines.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from phfmu import (
    PHDAE,
    ROTATIONAL,
    DeclarationError,
    Port,
    SystemTransformation,
    algebraic,
    block,
    damping,
    discrete_gradient,
    discrete_jacobian,
    discrete_pair,
    energy,
    inverse_jacobian,
    state,
    with_closed_pair,
)

STEPS, DT = 25, 0.1


def rotation(angle):
    return ca.vertcat(ca.horzcat(ca.cos(angle), -ca.sin(angle)), ca.horzcat(ca.sin(angle), ca.cos(angle)))


def nonlinear() -> tuple[PHDAE, tuple]:
    """States x (3) with E(x) regular, algebraic a (2); J, R, B, z depend on x; H quartic."""
    x, a = state("x", 3, start=(0.6, -0.4, 0.3)), algebraic("a", 2, start=(0.1, 0.2))
    E = ca.vertcat(ca.horzcat(1.5, 0.3 * x[1], 0), ca.horzcat(0, 1 + 0.2 * x[0] ** 2, 0.1), ca.horzcat(0.2, 0, 2))
    # (E, z) is a gradient pair whatever H: z = E^-T grad H
    full = ca.SX(5, 5)
    full[0, 1], full[0, 2], full[1, 2] = 1 + x[2] ** 2, x[0], 0.7
    full[0, 3], full[1, 4], full[2, 3], full[3, 4] = 1.0, 1.0 + 0.1 * x[0], -0.4, 0.5
    return PHDAE(
        "nonlinear",
        states=(x,),
        algebraics=(a,),
        energies=(energy(ca.sumsqr(x.sx) + 0.3 * (x[0] + x[1] * x[2]) ** 2),),
        E={x: E},
        structure=(block([x, a], full - full.T),),
        dissipation=(damping(x, 0.1 * (1 + x.sx**2)), block([a], [[1.2, 0.3], [0.3, 0.9]])),
        ports=(Port("shaft", ROTATIONAL, "effort", {x: ca.vertcat(1, x[0], 0), a: [0.0, 0.4]}),),
    ), (x, a)


def bend(variables) -> SystemTransformation:
    """x = phi11(y), a = phi2(y, b), U lower block triangular, all nonlinear: structure (15) is kept (Proposition 3)."""
    x, a = variables
    y, b = state("y", 3, start=(0.5, -0.4, 0.3)), algebraic("b", 2)
    phi11 = y.sx + 0.2 * ca.vertcat(y[1] ** 2, ca.sin(y[2]), y[0] ** 3)
    phi2 = 1.3 * b.sx + 0.1 * b.sx**3 + ca.vertcat(y[0] * y[1], y[2])
    U = ca.SX.eye(5)
    U[0, 1], U[1, 1], U[3, 0], U[4, 2], U[3, 3], U[3, 4] = 0.3 * y[0], 1 + y[1] ** 2, y[2], 0.5, 1.5, 0.2 * b[0]
    return SystemTransformation({x: phi11, a: phi2}, (y, b), U)


def solved(pair, start: np.ndarray, u: np.ndarray, dt: float = DT) -> np.ndarray:
    """Trajectory of scheme (18) by Newton with a NumPy solve."""
    h, port = ca.SX.sym("h"), ca.SX.sym("u", u.shape[1])
    r = pair.residual(h, port)
    f = ca.Function("r", [pair.x, pair.x1, h, port], [ca.densify(r), ca.densify(ca.jacobian(r, pair.x1))])
    out = [np.asarray(start, float)]
    for value in u:
        x1 = out[-1].copy()
        for _ in range(30):
            r0, jac = (np.array(a) for a in f(out[-1], x1, dt, value))
            step = np.linalg.solve(jac, r0.ravel())
            x1 = x1 - step
            if np.abs(step).max() < 1e-15:
                break
        out.append(x1)
    return np.array(out)


def inputs() -> np.ndarray:
    return np.sin(0.4 * np.arange(STEPS))[:, None]


def image(T: SystemTransformation, points: np.ndarray) -> np.ndarray:
    return np.array(ca.Function("phi", [T.x], [T.image])(points.T)).T


def start_of(model: PHDAE) -> np.ndarray:
    return np.array([s for v in (*model.states, *model.algebraics) for s in v.start])


@pytest.mark.parametrize("method", ["per-term", "mean-value", "joint-gonzalez", "itoh-abe"])
@pytest.mark.parametrize("rows", ["mean-value", "joint-gonzalez"])
def test_the_transformed_pair_is_a_discrete_gradient_pair(method, rows):
    """Theorem 6: z^T E (x' - x) = H(phi(x')) - H(phi(x)), and E, z -> U^T (E o phi) Dphi, U^-1 (z o phi) for x' -> x."""
    model, variables = nonlinear()
    T = bend(variables)
    pair = discrete_pair(model, method).transformed(T, discrete_jacobian(T.image, T.x, rows))
    declared = T(model)
    z = ca.vertcat(*(declared.effort(v) for v in (*declared.states, *declared.algebraics)))
    rng = np.random.default_rng(1)
    f = ca.Function("pair", [pair.x, pair.x1], [pair.E, pair.z])
    h = ca.Function("H", [ca.vertcat(*(v.sx for v in variables))], [model.hamiltonian])
    scale, x0 = 0.5, start_of(declared)
    for _ in range(20):
        x, x1 = x0 + scale * rng.uniform(-1, 1, 5), x0 + scale * rng.uniform(-1, 1, 5)
        E, zbar = (np.array(a) for a in f(x, x1))
        dH = float(h(image(T, x1[None])[0])) - float(h(image(T, x[None])[0]))
        assert float(zbar.ravel() @ E @ (x1 - x)) == pytest.approx(dH, abs=2e-14)
    (E11,) = declared.E.values()
    (y, b) = T.new
    grad = ca.gradient(declared.hamiltonian, y.sx)
    z1 = ca.solve(ca.SX(E11).T, grad)
    (z,) = ca.substitute([z], [y.z], [z1])
    exact = ca.Function("c", [T.x], [ca.diagcat(E11, ca.SX(2, 2)), z])
    E, zbar = (np.array(a) for a in f(x0, x0 + 1e-7))
    for a, c in zip((E, zbar), exact(x0 + 0.5e-7), strict=True):
        assert np.abs(a - np.array(c)).max() <= 1e-6


@pytest.mark.parametrize("method", ["per-term", "joint-gonzalez"])
def test_the_scheme_is_the_same_in_both_coordinates(method):
    """Theorems 9 and 10: with the transformed pair and coefficients phi(x~_k) = x_k, J, R, B, U, E all depending on x."""
    model, variables = nonlinear()
    T = bend(variables)
    pair, start = discrete_pair(model, method), start_of(T(model))
    old = solved(pair, image(T, start[None])[0], inputs())
    new = solved(pair.transformed(T), start, inputs())
    assert np.abs(image(T, new) - old).max() <= 1e-12
    # a second choice of Dphi is another method in the new coordinates, and the same one in the old
    other = solved(pair.transformed(T, discrete_jacobian(T.image, T.x, "joint-gonzalez")), start, inputs())
    assert np.abs(image(T, other) - old).max() <= 1e-12


def test_the_same_construction_in_other_coordinates_is_another_scheme():
    """Remark 10: a pair built after the transformation is a second-order scheme of its own; the distance is measured."""
    model, variables = nonlinear()
    T = bend(variables)
    declared, start = T(model), start_of(T(model))
    distance = {}
    for dt in (0.1, 0.05):
        u = np.zeros((round(2.5 / dt), 1))
        old = solved(discrete_pair(model), image(T, start[None])[0], u, dt)
        new = image(T, solved(discrete_pair(declared), start, u, dt))
        distance[dt] = np.abs(new[-1, :3] - old[-1, :3]).max()
    assert distance[0.1] > 1e-5
    assert np.log2(distance[0.1] / distance[0.05]) == pytest.approx(2.0, abs=0.3)


# -- Lemma 3 and Example 9 ------------------------------------------------------------------------------------


def planar(expr) -> tuple[SystemTransformation, tuple]:
    q, w = state("q", 2, start=(0.7, -0.3)), state("w", 2, start=(0.7, -0.3))
    return SystemTransformation({q: expr(w)}, (w,)), (q, w)


def twist(w):
    """Example 9: every circle turned by its squared radius."""
    return ca.mtimes(rotation(ca.sumsqr(w.sx)), w.sx)


def untwist(T, q):
    return T.inverse({T.new[0]: ca.mtimes(rotation(-ca.sumsqr(q.sx)), q.sx)})


def function(D, n=2):
    x, x1 = ca.SX.sym("x", n), ca.SX.sym("x1", n)
    f = ca.Function("D", [x, x1], [D(x, x1)])
    return lambda a, b: np.array(f(a, b))


def test_the_inverse_discrete_jacobian():
    """Lemma 3: (Dphi o psi)^-1 is a discrete Jacobian of psi = phi^-1, and it is not the Gonzalez one of psi."""
    T, (q, _) = planar(twist)
    inverse = untwist(T, q)
    D = discrete_jacobian(T.image, T.x, "joint-gonzalez")
    back = function(inverse_jacobian(T, inverse, D))
    psi = ca.Function("psi", [q.sx], [inverse.image])
    rng = np.random.default_rng(2)
    for _ in range(10):
        x, x1 = rng.uniform(-0.8, 0.8, 2), rng.uniform(-0.8, 0.8, 2)
        assert back(x, x1) @ (x1 - x) == pytest.approx(np.array(psi(x1) - psi(x)).ravel(), abs=1e-13)
        jacobian = np.array(ca.Function("J", [q.sx], [ca.jacobian(inverse.image, q.sx)])(x))
        assert back(x, x) == pytest.approx(jacobian, abs=1e-13)
    own = function(discrete_jacobian(inverse.image, q.sx, "joint-gonzalez"))
    assert np.abs(own(np.zeros(2), np.array([0.8, 0.5])) - back(np.zeros(2), np.array([0.8, 0.5]))).max() > 0.05


def test_forth_and_back_leaves_the_pair_alone():
    """With Dpsi of Lemma 3 and V = U^-1 o psi the pair transformed by (phi, U) and back is (Ebar, zbar) again."""
    q = state("q", 2, start=(0.7, -0.3))
    w = state("w", 2, start=(0.7, -0.3))
    U = ca.vertcat(ca.horzcat(1 + w[0] ** 2, 0.2), ca.horzcat(w[1], 1.5))
    T = SystemTransformation({q: twist(w)}, (w,), U)
    inverse = untwist(T, q)
    skewed = block([q], (1 + q[0] ** 2) * ca.SX([[0.0, 1.0], [-1.0, 0.0]]))
    model = PHDAE("spring", (q,), energies=(energy(q[0] ** 4 / 4 + ca.sumsqr(q.sx)),),
                  structure=(skewed,))  # fmt: skip
    pair = discrete_pair(model, "joint-gonzalez")
    Dphi = discrete_jacobian(T.image, T.x, "mean-value")
    middle = lambda x, x1: ca.substitute([T.U], [T.x], [(x + x1) / 2])[0]  # noqa: E731

    def V(x, x1):  # noqa: N802
        ends = [ca.substitute([inverse.image], [inverse.x], [point])[0] for point in (x, x1)]
        return ca.inv(middle(*ends))

    there = pair.transformed(T, Dphi, middle)
    again = there.transformed(inverse, inverse_jacobian(T, inverse, Dphi), V)
    one, two = (ca.Function("f", [p.x, p.x1], [p.E, p.z, p.J, p.R]) for p in (pair, again))
    rng = np.random.default_rng(3)
    for _ in range(10):
        x, x1 = rng.uniform(-0.6, 0.6, 2), rng.uniform(-0.6, 0.6, 2)
        for a, b in zip(one(x, x1), two(x, x1), strict=True):
            assert np.abs(np.array(a - b)).max() <= 1e-12


def test_a_composition_of_discrete_jacobians():
    """(Dphi o phi~) Dphi~ is a discrete Jacobian of phi o phi~ (chain rule (35))."""
    T, (q, w) = planar(twist)
    S = SystemTransformation({w: (v := state("v", 2)).sx + 0.3 * ca.vertcat(v[1] ** 2, 0)}, (v,))
    both = T @ S
    D = lambda x, x1: ca.mtimes(  # noqa: E731
        discrete_jacobian(T.image, T.x)(*(ca.substitute([S.image], [S.x], [p])[0] for p in (x, x1))),
        discrete_jacobian(S.image, S.x)(x, x1),
    )
    f, phi = function(D), ca.Function("phi", [both.x], [both.image])
    x, x1 = np.array([0.2, -0.5]), np.array([0.6, 0.1])
    assert f(x, x1) @ (x1 - x) == pytest.approx(np.array(phi(x1) - phi(x)).ravel(), abs=1e-13)


def test_example_9_a_diffeomorphism_with_a_singular_discrete_jacobian():
    """D phi is invertible everywhere, the Gonzalez discrete Jacobian at x = 0, x' = sqrt(2 pi) e1 is [[1, -1], [0, 0]]."""
    T, _ = planar(twist)
    gonzalez = function(discrete_jacobian(T.image, T.x, "joint-gonzalez"))
    x, x1 = np.zeros(2), np.array([np.sqrt(2 * np.pi), 0.0])
    assert gonzalez(x, x1) == pytest.approx(np.array([[1.0, -1.0], [0.0, 0.0]]), abs=1e-14)
    slope = ca.Function("D", [T.x], [T.jacobian])
    angle = np.linspace(0.0, 2 * np.pi, 17)
    for r in (0.0, 0.5, 1.7, np.sqrt(2 * np.pi), 4.0):
        for t in angle:
            assert np.linalg.det(np.array(slope([r * np.cos(t), r * np.sin(t)]))) == pytest.approx(1.0, abs=1e-11)
    # so the inverse discrete Jacobian of Lemma 3 does not exist there; near x' = x it does
    assert abs(np.linalg.det(gonzalez(x, 0.3 * x1))) > 0.5


def test_example_10_the_gonzalez_gradient_does_not_commute_with_a_shear():
    """f = |x|^4/4, phi = (x1 + x2, x2): along e2 the gradient of f o phi gives 1, the chain rule (35) gives 2."""
    x = state("x", 2)
    f = lambda v: ca.sumsqr(v) ** 2 / 4  # noqa: E731
    shear = ca.SX([[1.0, 1.0], [0.0, 1.0]])
    direct = discrete_gradient(f(ca.mtimes(shear, x.sx)), x, "joint-gonzalez")
    original = discrete_gradient(f(x.sx), x, "joint-gonzalez")
    a, b, e2 = np.zeros(2), np.array([2.0, 0.0]), np.array([0.0, 1.0])
    D = np.array(ca.DM(shear))
    assert direct(a, b) @ e2 == pytest.approx(1.0, abs=1e-14)
    assert (D.T @ original(D @ a, D @ b)) @ e2 == pytest.approx(2.0, abs=1e-14)
    # the mean value gradient does commute with linear maps
    direct, original = (discrete_gradient(h, x, "mean-value") for h in (f(ca.mtimes(shear, x.sx)), f(x.sx)))
    assert direct(a, b) == pytest.approx(D.T @ original(D @ a, D @ b), abs=1e-14)


def test_a_closed_pair_refuses_what_it_cannot_keep():
    model, variables = nonlinear()
    T = bend(variables)
    with pytest.raises(DeclarationError, match="b is algebraic"):
        with_closed_pair(model, T)
    q, w = state("q", 2, start=(0.7, -0.3)), state("w", 2, start=(0.7, -0.3))
    other = state("s")
    joined = PHDAE("joined", (q, other), energies=(energy(q[0] * other.sx + q[1] ** 2),))
    with pytest.raises(DeclarationError, match="joins replaced states with s"):
        with_closed_pair(joined, SystemTransformation({q: twist(w)}, (w,)))
