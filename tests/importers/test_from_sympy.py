"""Expressions of SymPy: converted one by one, refused by name, and solved."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from phfmu import ROTATIONAL, Collocated, DeclarationError, Port, PythonInstance, build_model, check, parameter, state
from phfmu.importers import from_sympy

sympy = pytest.importorskip("sympy", reason="SymPy is not installed (pip install sympy)")

q, p, m, k = sympy.symbols("q p m k")
J = sympy.Matrix([[0, 1], [-1, 0]])


def pendulum(**more: Any) -> Any:
    inertia, weight, d = sympy.symbols("I mgl d")
    H = p**2 / (2 * inertia) + weight * (1 - sympy.cos(q))
    return from_sympy(
        H, [q, p], J, sympy.diag(0, d), sympy.Matrix([0, 1]), inputs=["tau"],
        parameters={"I": 0.5, "mgl": 9.81, d: 0.05}, name="pendulum", **more,
    )  # fmt: skip


def test_a_pendulum_follows_an_independent_solution() -> None:
    model = pendulum().with_starts({"q": 2.0})
    assert check(model) == [] and [v.name for v in model.parameters] == ["I", "mgl", "d"]
    exact = solve_ivp(lambda t, x: [x[1] / 0.5, -9.81 * np.sin(x[0]) - 0.05 * x[1] / 0.5 + 0.4], (0, 1), [2.0, 0.0],
                      "DOP853", rtol=1e-13, atol=1e-14).y[:, -1]  # fmt: skip
    errors = []
    for steps in (25, 50):
        unit = PythonInstance(build_model(model, Collocated(2)))
        unit.run(0.0, 1 / steps, steps, (), inputs=[[0.4]] * steps)
        errors.append(np.abs(unit.x - exact).max())
    assert 3.7 < np.log2(errors[0] / errors[1]) < 4.3
    assert unit.signals()["y_end"][0] == pytest.approx(exact[1] / 0.5, abs=1e-5)


def test_names_units_and_domains_may_be_given() -> None:
    inertia = parameter("I", 0.5, unit="kg.m2")
    model = from_sympy(
        p**2 / (2 * sympy.Symbol("I")) + k / 2 * sympy.Symbol("a[2]") ** 2,
        [state("a", 2, unit="rad"), state("p", unit="kg.m2/s", start=0.1)],
        sympy.Matrix([[0, 0, 0], [0, 0, 1], [0, -1, 0]]), B=sympy.Matrix([0, 0, 1]),
        inputs=[Port("shaft", ROTATIONAL, "effort", {})], parameters=[inertia, parameter("k", 2.0, unit="N.m/rad")],
    )  # fmt: skip
    assert check(model, strict=True) == [] and model.ports[0].input_names() == ["shaft.torque"]


def test_a_row_without_e_is_an_algebraic_variable() -> None:
    """A resistor joins a capacitor (charge q) and a node of a conductance to the ground: 0 = (q/C - v) g1 - g2 v."""
    v = sympy.Symbol("v")
    R = sympy.Matrix([[3, -3], [-3, 3 + 2]])
    model = from_sympy(q**2 / 4, [q, v], sympy.zeros(2), R, E=sympy.diag(1, 0)).with_starts({"q": 1.0})
    assert [a.name for a in model.algebraics] == ["v"] and check(model) == []
    unit = PythonInstance(build_model(model, Collocated(3)))
    unit.run(0.0, 0.1, 10, ())
    assert unit.x[0] == pytest.approx(np.exp(-(3 * 2 / 5) / 2), abs=1e-9)


@pytest.mark.parametrize(
    "e",
    [
        q**3 / 3 - sympy.Rational(1, 7), sympy.sqrt(1 + q**2), 1 / sympy.sqrt(2 + p), q ** sympy.Rational(3, 2), sympy.pi * q,
        sympy.exp(-q) * sympy.tanh(p), sympy.log(1 + p) * sympy.atan2(q, p), sympy.Max(q, p, 0) + sympy.Min(q, 1), 2**q, q**p,
        abs(q - p) * sympy.sign(p), sympy.Piecewise((q**2, q < p), (p, sympy.And(q > 1, q < 2)), (q + p, True)),
        sympy.asinh(q) + sympy.erf(p) + sympy.E * q, (q + p) ** -1, sympy.Piecewise((q, ~(q > p) | (q > 3)), (0, True)),
    ],
    ids=str,
)  # fmt: skip
def test_conversions_have_sympys_values(e: Any) -> None:
    from phfmu.importers.sympy_expressions import Converter

    x = ca.SX.sym("x", 2)
    f = ca.Function("f", [x], [Converter("m", {"q": x[0], "p": x[1]}).expression("H", e)])
    for values in ((0.3, 0.8), (1.7, 0.4), (2.5, 3.5)):
        assert float(f(values)) == pytest.approx(float(e.subs({q: values[0], p: values[1]})), rel=1e-13)


def test_the_conversion_is_printed_back() -> None:
    lines: list[str] = []
    pendulum(show=lines.append)
    assert lines[0].startswith("H = ") and "cos(q)" in lines[0]
    assert {"J[q, p] = 1", "J[p, q] = -1", "R[p, p] = d", "B[p, tau.u] = 1"} <= set(lines)


@pytest.mark.parametrize(
    ("H", "words"),
    [
        (q**2 * sympy.Symbol("kk"), ["H: symbol 'kk' is no state or parameter", "did you mean k?"]),
        (sympy.Function("f")(q), ["'f(q)' (f) cannot be part", ".subs(f(q), Symbol('f'))"]),
        (sympy.Function("q")(sympy.Symbol("t")) ** 2, ["'q(t)' (q)", ".subs(q(t), Symbol('q'))"]),
        (sympy.Derivative(sympy.Function("q")(p), p), ["(Derivative)", "functions of states and parameters"]),
        (sympy.Heaviside(q), ["'Heaviside(q)' (Heaviside)", "Max(x, 0)"]),
        (sympy.I * q, ["(ImaginaryUnit)", "quantities are real"]),
        (sympy.besselj(0, q), ["(besselj)", "known are numbers"]),
        (sympy.Piecewise((q, q > 0)), ["no value where no condition holds", "(value, True)"]),
    ],
    ids=str,
)
def test_what_is_not_known_is_refused_by_name(H: Any, words: list[str]) -> None:
    with pytest.raises(DeclarationError) as error:
        from_sympy(H, [q, p], J, parameters={"k": 1.0})
    assert all(w in str(error.value) for w in words), str(error.value)


def test_shapes_are_compared() -> None:
    with pytest.raises(DeclarationError, match="R: is 1 x 1, expected 2 x 2"):
        from_sympy(q**2, [q, p], J, sympy.Matrix([1]))
    with pytest.raises(DeclarationError, match="B: is missing, there are 1 inputs"):
        from_sympy(q**2, [q, p], J, inputs=["u"])
