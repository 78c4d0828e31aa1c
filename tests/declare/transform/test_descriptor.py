"""Constant singular E: reduce_descriptor (Proposition 2) and the mass-spring system with a singular mass matrix."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import brentq

from phfmu import (
    PHDAE,
    ROTATIONAL,
    Collocated,
    DeclarationError,
    Holonomic,
    Port,
    PythonInstance,
    algebraic,
    block,
    build_model,
    check,
    damping,
    energy,
    parameter,
    reduce_descriptor,
    skew,
    state,
)
from phfmu.components.mechanical.mass_spring import mass_spring
from tests.engines import ENGINES

M1, M2, K1, K2, D1, D2, L10, W = 1.3, 0.5, 40.0, 25.0, 0.6, 0.4, 0.4, 0.1
DATA = dict(m1=M1, m2=M2, k1=K1, k2=K2, d1=D1, d2=D2, l10=L10, w=W, elongations=(0.1, -0.05), speeds=(0.3, -0.8))
FORCE, END = 1.7, 0.8


def slope(steps, errors):
    """Exponent of errors ~ steps^slope by linear regression."""
    assert min(errors) > 0.0
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])


def truth(cubic: float = 0.0) -> np.ndarray:
    """(s1, s2, s1', s2') at END for the positions s of the two masses: m1 s1'' = .., m2 s2'' = .., no third coordinate.

    Linear: matrix exponential.  With a hardening spring 1: DOP853 at 3e-14.
    """
    start = np.array([0.1, 0.05, 0.3, -0.5])  # s1 = x1, s2 = x1 + x2, both without their rest lengths

    def rate(t, y):
        s1, s2, r1, r2 = y
        f2 = K2 * (s2 - s1) + D2 * (r2 - r1)
        f1 = K1 * s1 + cubic * s1**3 + D1 * r1
        return [r1, r2, (f2 - f1) / M1, (FORCE - f2) / M2]

    if cubic:
        return solve_ivp(rate, (0.0, END), start, method="DOP853", rtol=3e-14, atol=1e-15, max_step=0.01).y[:, -1]
    A = np.array([np.array(rate(0, e)) - np.array(rate(0, np.zeros(4))) for e in np.eye(4)]).T
    big = np.zeros((5, 5))
    big[:4, :4], big[:4, 4] = A, rate(0, np.zeros(4))
    return expm(big * END)[:4] @ np.append(start, 1.0)


def masses(x: np.ndarray) -> np.ndarray:
    """(s1, s2, s1', s2') from the states (x1, q2, x2, v1, (v2 + v3)/sqrt 2)."""
    return np.array([x[0], x[0] + x[2], x[3], np.sqrt(2.0) * x[4]])


def hardened(cubic: float) -> PHDAE:
    model = mass_spring(**DATA, reduced=False)
    q = model.states[0]
    return reduce_descriptor(replace(model, energies=(*model.energies, energy(cubic * q[0] ** 4 / 4))))


STEPS = {1: (20, 40, 80), 2: (10, 20, 40), 3: (5, 10, 20)}


@pytest.mark.parametrize("cubic", [0.0, 3000.0])
@pytest.mark.parametrize("k", [1, 2, 3])
def test_the_singular_mass_matrix_has_order_2k_and_an_exact_balance(k, cubic):
    model = build_model(hardened(cubic) if cubic else mass_spring(**DATA), Collocated(k))
    exact, errors = truth(cubic), []
    for n in STEPS[k]:
        names = ("x", "stored", "dissipated", "supplied")
        rows = PythonInstance(model).run(0.0, END / n, n, names, inputs=[[FORCE]] * n)
        size = sum(np.abs(rows[name]).sum() for name in names[1:4])
        assert np.abs(rows["stored"] + rows["dissipated"] - rows["supplied"]).max() <= 1e-14 * size
        assert np.abs(rows["x"][:, 1] - rows["x"][:, 0] - L10 - W).max() <= 1e-14
        errors.append(np.abs(masses(rows["x"][-1]) - exact).max())
    assert slope([END / n for n in STEPS[k]], errors) == pytest.approx(2 * k, abs={1: 0.1, 2: 0.2, 3: 0.3}[k])


def test_the_multiplier_is_the_force_of_the_second_spring():
    """lambda = k2 x2 + d2 v3, which the two-degree-of-freedom system gives without any multiplier."""
    model = build_model(mass_spring(**DATA), Collocated(3))
    instance = PythonInstance(model)
    instance.run(0.0, END / 40, 40, ("x",), inputs=[[FORCE]] * 40)
    s1, s2, r1, r2 = truth()
    value = instance.signals()["a_end"][[v.name for v in model.declaration.algebraics].index("lambda")]
    assert value == pytest.approx(K2 * (s2 - s1) + D2 * (r2 - r1), abs=1e-7)


def test_both_engines_agree():
    model = build_model(mass_spring(**DATA), Collocated(2))
    inputs = [[FORCE * np.sin(0.3 * i)] for i in range(200)]
    a, b = (kind(model).run(0.0, 0.01, 200, ("x", "supplied"), inputs=inputs) for kind in ENGINES)
    for name in a:
        assert np.abs(a[name] - b[name]).max() <= 1e-13 * np.abs(a[name]).max()


def test_masses_remain_parameters():
    """Sigma1 = diag(m1, 2 m2) as in appendix E, for any values set later."""
    model = mass_spring().with_starts({"m1": 3.0, "m2": 0.7})
    (matrix,) = model.E.values()
    p = ca.vertcat(*(q.sx for q in model.parameters))
    value = ca.Function("E", [p], [matrix])([s for q in model.parameters for s in q.start])
    assert np.array(value) == pytest.approx(np.diag([3.0, 1.4]), rel=1e-14)
    assert check(model) == []


# -- a singular E that is not symmetric, with a nonlinear effort ---------------------------------------------

R, G = 0.7, 0.4


def sheared(grad: float = 1.0) -> PHDAE:
    """E = [[1, 1], [0, 0]]:  s = x1 + x2,  s' = -R z1 + z2,  0 = -z1 - G z2,  z1 = s + s^3, z2 = x2 + x2^3."""
    x = state("x", 2, start=(0.9, -0.2))
    s = x[0] + x[1]
    z = ca.vertcat(grad * (s + s**3), x[1] + x[1] ** 3)
    return PHDAE(
        "sheared",
        states=(x,),
        energies=(energy(s**2 / 2 + s**4 / 4),),
        E={x: [[1.0, 1.0], [0.0, 0.0]]},
        z={x: z},
        structure=(block([x], [[0.0, 1.0], [-1.0, 0.0]]),),
        dissipation=(block([x], [[R, 0.0], [0.0, G]]),),
        ports=(Port("shaft", ROTATIONAL, "effort", {x: [1.0, 0.0]}),),
    )


@pytest.mark.parametrize("k", [1, 2, 3])
def test_an_effort_that_is_no_variable(k):
    """z2 = U2^T z(V x~) depends on both new variables; s follows a scalar equation, x2 a cubic."""
    declaration = reduce_descriptor(sheared())
    assert [v.name for v in declaration.z] == ["x.algebraic"]
    assert check(declaration) == []
    rate = lambda t, s: -(R + 1 / G) * (s + s**3) + 0.3  # noqa: E731
    end = solve_ivp(rate, (0, 1), [0.7], method="DOP853", rtol=1e-13, atol=1e-15).y[0, -1]
    x2 = brentq(lambda x: x + x**3 + (end + end**3) / G, -5, 5, xtol=1e-15)
    steps, errors = {1: (20, 40, 80), 2: (8, 16, 32), 3: (4, 8, 16)}[k], []
    for n in steps:
        instance = PythonInstance(build_model(declaration, Collocated(k)))
        rows = instance.run(0.0, 1 / n, n, ("stored", "dissipated", "supplied"), inputs=[[0.3]] * n)
        assert np.abs(rows["stored"] + rows["dissipated"] - rows["supplied"]).max() <= 1e-15
        errors.append(np.abs(instance.signals()["observables"] - [end - x2, x2]).max())
    assert slope([1 / n for n in steps], errors) == pytest.approx(2 * k, abs=0.3)


# -- refused ---------------------------------------------------------------------------------------------------


def broken(**changes) -> PHDAE:
    return replace(mass_spring(reduced=False), **changes)


def moving_kernel() -> PHDAE:
    x, c = state("x", 2), parameter("c", 2.0)
    return PHDAE("moving", (x,), parameters=(c,), E={x: ca.vertcat(ca.horzcat(1, c.sx), ca.SX(1, 2))}, z={x: x.sx})


def singular_at_the_start() -> PHDAE:
    x = state("x", 2)
    return PHDAE("bent", (x,), E={x: ca.vertcat(ca.horzcat(1, x[0]), ca.SX(1, 2))}, z={x: x.sx})


@pytest.mark.parametrize(
    ("model", "words"),
    [
        (lambda: broken(z={}), "give z of v"),
        (lambda: replace(m := broken(), z={m.states[1]: 2 * m.states[1].sx}), "E\\^T z - grad H = "),
        (lambda: sheared(grad=2.0), "E\\^T z - grad H = "),
        (moving_kernel, "kernel changes with it .* numbers into E"),
        (singular_at_the_start, "depends on the state"),
    ],
)
def test_what_cannot_be_reduced_is_named(model, words):
    with pytest.raises(DeclarationError, match=words):
        reduce_descriptor(model())


def test_constraints_violated_at_the_start_are_named():
    with pytest.raises(DeclarationError, match=r"g\(q\) = 0\.25 at the start"):
        reduce_descriptor(mass_spring(reduced=False).with_starts({"q[2]": 0.85}))


def test_the_check_names_the_remedy():
    problems = check(mass_spring(reduced=False))
    assert [p.rule for p in problems] == ["mass"]
    assert "reduce_descriptor" in problems[0].remedy
    wrong = sheared(grad=2.0)
    assert {p.rule for p in check(wrong)} == {"mass", "costate"}


def test_a_regular_model_is_returned_as_it_is():
    x = state("x", 2)
    model = PHDAE("plain", (x,), energies=(energy(ca.dot(x.sx, x.sx)),), E={x: [[2.0, 1.0], [1.0, 2.0]]},
                  structure=(skew(x, x, ca.SX(2, 2)),), dissipation=(damping(x, 1.0),))  # fmt: skip
    assert reduce_descriptor(model) is model


def test_a_singular_model_is_refused_before_it_is_stepped():
    with pytest.raises(DeclarationError, match=r"E of 'v': is singular.* reduce_descriptor\(model\)"):
        build_model(mass_spring(reduced=False), Collocated(1))


# -- a nonlinear constraint that leaves index 2 -----------------------------------------------------------------


def split_pendulum() -> PHDAE:
    """A pendulum of length 1 in x and y = y1 + y2, mass matrix [[1, 0, 0], [0, 1, 1], [0, 1, 1]], y2 = x^2/2 - 1/2."""
    q, v = state("q", 3, start=(0.6, -0.8 + 0.32, -0.32)), state("v", 3)
    force = algebraic("lambda", 2)
    return PHDAE(
        "split",
        states=(q, v),
        algebraics=(force,),
        energies=(energy(0.5 * v[0] ** 2 + 0.5 * (v[1] + v[2]) ** 2), energy(9.81 * (q[1] + q[2]))),
        E={v: [[1.0, 0.0, 0.0], [0.0, 1.0, 1.0], [0.0, 1.0, 1.0]]},
        z={v: v.sx},
        structure=(skew(q, v, 1.0),),
        constraints=(
            Holonomic(force, ca.vertcat((q[0] ** 2 + (q[1] + q[2]) ** 2 - 1) / 2, q[2] - q[0] ** 2 / 2 + 0.5)),
        ),
    )


@pytest.mark.parametrize("k", [1, 3])
def test_quadratic_constraints_stay_exact(k):
    """g is quadratic, so its velocity form keeps it; the rod remains an index-2 constraint; H is constant."""
    declaration = reduce_descriptor(split_pendulum())
    assert check(declaration) == []
    swing = lambda t, y: [y[1], -9.81 * np.sin(y[0])]  # noqa: E731
    end = solve_ivp(swing, (0, 0.5), [np.arcsin(0.6), 0.0], method="DOP853", rtol=1e-13, atol=1e-14).y[0, -1]
    steps, errors = {1: (20, 40, 80), 3: (5, 10, 20)}[k], []
    for n in steps:
        rows = PythonInstance(build_model(declaration, Collocated(k))).run(0.0, 0.5 / n, n, ("x", "stored"))
        x, y1, y2 = rows["x"][:, :3].T
        assert np.abs(x**2 + (y1 + y2) ** 2 - 1).max() <= 1e-13
        assert np.abs(y2 - x**2 / 2 + 0.5).max() <= 1e-13
        assert np.abs(np.cumsum(rows["stored"])).max() <= 1e-13
        errors.append(abs(x[-1] - np.sin(end)))
    assert slope([0.5 / n for n in steps], errors) == pytest.approx(2 * k, abs=0.3)


def test_a_given_effort_composes():
    """The reduced model in a network, its port bound: the shaft of E [x; x]' turns an inertia; equal to the closed form."""
    from phfmu import Network
    from phfmu.components.mechanical.rotational import rotational_inertia

    x = state("x", 2, start=(0.9, -0.2))
    s = x[0] + x[1]
    unit = PHDAE(
        "unit",
        states=(x,),
        energies=(energy(s**2 / 2),),
        E={x: [[1.0, 1.0], [0.0, 0.0]]},
        z={x: ca.vertcat(s, x[1] + x[1] ** 3)},
        dissipation=(block([x], [[0.0, 0.0], [0.0, G]]),),
        ports=(Port("shaft", ROTATIONAL, "flow", {x: [1.0, 0.5]}),),
    )
    net = Network("pair")
    net.add("unit", reduce_descriptor(unit))
    net.add("rotor", rotational_inertia(2.0, speed=0.3))
    net.connect("unit.shaft", "rotor.a")
    model = build_model(net.compose(), Collocated(3))
    assert check(model.declaration) == []
    instance = PythonInstance(model)
    rows = instance.run(0.0, 0.05, 20, ("stored", "dissipated"), inputs=np.zeros((20, model.step.nu)))
    # s' = -w... the shaft is given w = rotor speed: s' = w, 0 = -G z2 + w/2, torque on the rotor = -(s + z2/2)
    rate = lambda t, y: [y[1], -(y[0] + 0.25 * y[1] / G) / 2.0]  # noqa: E731
    end = solve_ivp(rate, (0, 1), [0.7, 0.3], method="DOP853", rtol=1e-13, atol=1e-15).y[:, -1]
    signals = dict(zip(model.observable_names, instance.signals()["observables"], strict=True))
    total = signals["unit.x[1]"] + signals["unit.x[2]"]
    assert total == pytest.approx(end[0], abs=1e-9)
    assert signals["unit.x[2]"] + signals["unit.x[2]"] ** 3 == pytest.approx(0.5 * end[1] / G, abs=1e-9)
    assert np.abs(rows["stored"].sum(axis=1) + rows["dissipated"].sum(axis=1)).max() <= 1e-15
