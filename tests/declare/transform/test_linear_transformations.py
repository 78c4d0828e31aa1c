"""Random models under linear transformations: schemes that commute with them, forth and back, the general form."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from phfmu import (
    PHDAE,
    ROTATIONAL,
    Collocated,
    DeclarationError,
    Port,
    PythonInstance,
    SystemTransformation,
    algebraic,
    block,
    build_model,
    check,
    energy,
    state,
)


def random_model(seed: int) -> tuple[PHDAE, tuple]:
    """E11 x1' = .., 0 = ..; 3 states with a full E11, 2 algebraic variables, J(x1), R(x1), one port; H of degree 4."""
    rng = np.random.default_rng(seed)
    x, a = state("x", 3, start=rng.uniform(-1, 1, 3)), algebraic("a", 2)
    E, S = (rng.uniform(-1, 1, (3, 3)) + 2 * np.eye(3) for _ in range(2))
    # (J - R) has a fixed regular part on a, so that the rows of a give a
    J, F = (rng.uniform(-1, 1, (5, 5)) for _ in range(2))
    skewed = ca.SX(J - J.T) * (1 + 0.3 * x[0])
    quadratic = 0.5 * ca.mtimes([x.sx.T, S @ S.T, x.sx])
    w = rng.uniform(-1, 1, 3)
    model = PHDAE(
        "random",
        states=(x,),
        algebraics=(a,),
        energies=(energy(quadratic), energy(ca.dot(w, x.sx) ** 4 / 4)),
        E={x: E},
        structure=(block([x, a], skewed),),
        dissipation=(block([x, a], ca.SX(F @ F.T + 0.2 * np.eye(5)) * (1 + x[1] ** 2)),),
        ports=(Port("shaft", ROTATIONAL, "effort", {x: rng.uniform(-1, 1, (3, 1)), a: rng.uniform(-1, 1, (2, 1))}),),
    )
    return model, (x, a)


def linear_map(variables, seed: int) -> SystemTransformation:
    """x = A x~ with D_(x~2) phi1 = 0, and U with U12 = 0 (Proposition 3), random."""
    rng = np.random.default_rng(seed)
    x, a = variables
    y, b = state("y", 3), algebraic("b", 2)
    A11, A22 = rng.uniform(-1, 1, (3, 3)) + 2 * np.eye(3), rng.uniform(-1, 1, (2, 2)) + 2 * np.eye(2)
    A21, U21 = rng.uniform(-1, 1, (2, 3)), rng.uniform(-1, 1, (2, 3))
    U11, U22 = rng.uniform(-1, 1, (3, 3)) + 2 * np.eye(3), rng.uniform(-1, 1, (2, 2)) + 2 * np.eye(2)
    phi = {x: ca.mtimes(ca.SX(A11), y.sx), a: ca.mtimes(ca.SX(A21), y.sx) + ca.mtimes(ca.SX(A22), b.sx)}
    return SystemTransformation(phi, (y, b), ca.SX(np.block([[U11, np.zeros((3, 2))], [U21, U22]])))


@pytest.mark.parametrize("k", [1, 2, 3])
def test_semi_explicit_schemes_commute_with_linear_transformations(k):
    """Theorem 10 in the engine: the discrete solution is the transformed one to 1e-12, for every order."""
    model, variables = random_model(7)
    T = linear_map(variables, 8)
    new = T(model)
    assert check(new) == []
    inputs = np.sin(np.arange(30))[:, None]
    old_rows, new_rows = (
        PythonInstance(build_model(m, Collocated(k))).run(0.0, 0.1, 30, ("x", "y_step"), inputs=inputs)
        for m in (model, new)
    )
    A = np.array(ca.DM(ca.jacobian(T.phi[variables[0]], T.new[0].sx)))
    assert np.abs(new_rows["x"] @ A.T - old_rows["x"]).max() <= 1e-12
    assert np.abs(new_rows["y_step"] - old_rows["y_step"]).max() <= 1e-12


def test_the_joint_gonzalez_gradient_does_not_commute():
    """Example 10 in the engine: the same construction in other coordinates is another scheme, by much more than rounding."""
    model, variables = random_model(7)
    T = linear_map(variables, 8)
    scheme = Collocated(1, gradient="joint-gonzalez")
    a, b = (PythonInstance(build_model(m, scheme)).run(0.0, 0.1, 30, ("x",))["x"] for m in (model, T(model)))
    A = np.array(ca.DM(ca.jacobian(T.phi[variables[0]], T.new[0].sx)))
    assert np.abs(b @ A.T - a).max() > 1e-5


def test_forth_and_back_is_the_model_itself():
    """Appendix D.1: (phi, U)^-1 undoes (phi, U), and a composition is the two transformations in turn."""
    model, variables = random_model(3)
    first, second = linear_map(variables, 4), linear_map((state("y", 3), algebraic("b", 2)), 5)
    second = SystemTransformation(
        {v: e for v, e in zip(first.new, second.phi.values(), strict=True)}, second.new, second.U
    )
    inputs = np.cos(np.arange(10))[:, None]

    def trajectory(m):
        return PythonInstance(build_model(m, Collocated(2))).run(0.0, 0.1, 10, ("x",), inputs=inputs)["x"]

    there = first(model)
    assert np.abs(trajectory(first.inverse()(there)) - trajectory(model)).max() <= 1e-12
    both, chained = trajectory((first @ second)(model)), trajectory(second(there))
    assert np.abs(both - chained).max() <= 1e-12


def test_semi_explicitness_is_required_of_phi_and_u():
    """Proposition 3: D_(x~2) phi1 = 0 and U12 = 0, or the algebraic rows of E~ do not vanish."""
    model, (x, a) = random_model(1)
    T = linear_map((x, a), 2)
    y, b = T.new
    bent = SystemTransformation({**T.phi, x: T.phi[x] + ca.vertcat(b[0], 0, 0)}, T.new, T.U)
    with pytest.raises(DeclarationError, match="column of 'b"):
        bent(model)
    U = ca.SX(T.U)
    U[0, 3] = 1.0
    with pytest.raises(DeclarationError, match="row of 'b"):
        SystemTransformation(T.phi, T.new, U)(model)


def test_the_general_form_is_a_declaration_that_reduces_again():
    """All new variables states: E~ of rank 3 in 5 dimensions, with z as data; the constant E~ reduces to the same solution."""
    from phfmu import reduce_descriptor

    model, (x, a) = random_model(1)
    y = state("y", 5)
    rng = np.random.default_rng(9)
    A, U = (ca.SX(rng.uniform(-1, 1, (5, 5)) + 2 * np.eye(5)) for _ in range(2))
    image = ca.mtimes(A, y.sx)
    grad = ca.gradient(model.hamiltonian, x.sx)
    (E,) = model.E.values()
    given = replace(model, z={x: ca.mtimes(np.linalg.inv(np.asarray(E)).T, grad)})
    general = SystemTransformation({x: image[:3], a: image[3:]}, (y,), U)(given)
    assert [p.rule for p in check(general)] == ["mass"] and "reduce_descriptor" in check(general)[0].remedy
    inputs = np.sin(np.arange(20))[:, None]
    reduced = reduce_descriptor(general)
    rows = [PythonInstance(build_model(m, Collocated(2))).run(0.0, 0.05, 20, ("y_step",), inputs=inputs)["y_step"]
            for m in (model, reduced)]  # fmt: skip
    assert np.abs(rows[0] - rows[1]).max() <= 1e-12
