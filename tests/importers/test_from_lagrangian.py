"""Lagrangians of SymPy beside Lagrange's equations in minimal coordinates, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from phfmu import (
    TRANSLATIONAL,
    DeclarationError,
    Monolithic,
    NativeInstance,
    Options,
    Port,
    PythonInstance,
    build_model,
    check,
    default_scheme,
    export,
    run,
    state,
)
from phfmu.importers import from_lagrangian
from tests.wide import wide

sympy = pytest.importorskip("sympy", reason="SymPy is not installed (pip install sympy)")
mechanics = pytest.importorskip("sympy.physics.mechanics")

t = mechanics.dynamicsymbols._t
DAMPING, FORCE, M1, M2, LENGTH, G = 0.2, 0.7, 1.3, 0.6, 0.8, 9.81
START = [0.9, -0.4, 1.0, 0.5]  # angles from the horizontal and their rates


def pendulum() -> Any:
    """Two points on bars in Cartesian coordinates, the first with a damper and the second with a horizontal force."""
    x, y, a, b = q = mechanics.dynamicsymbols("x y a b")
    m1, m2, g, l, d = sympy.symbols("m1 m2 g l d")
    kinetic = (m1 * (x.diff(t) ** 2 + y.diff(t) ** 2) + m2 * (a.diff(t) ** 2 + b.diff(t) ** 2)) / 2
    return from_lagrangian(
        kinetic - g * (m1 * y + m2 * b), q,
        constraints={"first": (x**2 + y**2 - l**2) / 2, "second": ((a - x) ** 2 + (b - y) ** 2 - l**2) / 2},
        dissipation=d * (x.diff(t) ** 2 + y.diff(t) ** 2) / 2, B=sympy.Matrix([0, 0, 1, 0]),
        inputs=[Port("push", TRANSLATIONAL, "effort", {})],
        parameters={m1: M1, m2: M2, g: G, l: LENGTH, d: DAMPING}, name="double",
    ).with_starts(starts(START) | {"push.force": FORCE})  # fmt: skip


def starts(x: Any) -> dict[str, float]:
    """Positions and velocities of both points, of the angles and rates x."""
    out, at, speed = {}, np.zeros(2), np.zeros(2)
    for names, angle, rate in zip(("xy", "ab"), x[:2], x[2:], strict=True):
        at = at + LENGTH * np.array([np.cos(angle), np.sin(angle)])
        speed = speed + LENGTH * rate * np.array([-np.sin(angle), np.cos(angle)])
        out |= {name: float(v) for name, v in zip(names, at, strict=True)}
        out |= {f"{name}_dot": float(v) for name, v in zip(names, speed, strict=True)}
    return out


def in_angles(stop: float) -> dict[str, float]:
    """The same by Lagrange's equations in the angles."""
    p, s = mechanics.dynamicsymbols("p s")
    x, y = LENGTH * sympy.cos(p), LENGTH * sympy.sin(p)
    a, b = x + LENGTH * sympy.cos(s), y + LENGTH * sympy.sin(s)
    L = M1 * (x.diff(t) ** 2 + y.diff(t) ** 2) / 2 + M2 * (a.diff(t) ** 2 + b.diff(t) ** 2) / 2 - G * (M1 * y + M2 * b)
    rates = [p.diff(t), s.diff(t)]
    names = sympy.symbols("p s dp ds")
    forces = [FORCE * a.diff(c) - DAMPING * (x.diff(t) * x.diff(c) + y.diff(t) * y.diff(c)) for c in (p, s)]
    equations = sympy.Matrix([L.diff(r).diff(t) - L.diff(c) - f for r, c, f in zip(rates, (p, s), forces, strict=True)])
    accelerations = sympy.symbols("app ass")
    plain = dict(zip([r.diff(t) for r in rates], accelerations, strict=True))
    equations = equations.subs(plain).subs(dict(zip([*rates, p, s], [*names[2:], *names[:2]], strict=True)))
    solved = sympy.lambdify(names, sympy.linear_eq_to_matrix(list(equations), accelerations))

    def slope(_: float, z: np.ndarray) -> np.ndarray:
        mass, force = solved(*z)
        return np.concatenate([z[2:], np.linalg.solve(mass, force).ravel()])

    return starts(solve_ivp(slope, (0.0, stop), START, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1])


def error(
    declaration: Any, exact: dict[str, float], order: int, step: float, stop: float, engine: Any = NativeInstance
) -> float:
    model = build_model(declaration, default_scheme(declaration, order))
    found = run(Monolithic(model, engine(model)), Options(stop=stop, step=step))
    total = found.ledger.summary().network
    assert total is not None and abs(total.unexplained) <= 1e-12
    return max(abs(found.column(name)[-1] - value) for name, value in exact.items())


@pytest.mark.parametrize("order, step, most", [(2, 4e-3, 5e-4), (6, 0.02, 1e-6)])
@pytest.mark.parametrize("engine", wide([NativeInstance, PythonInstance], NativeInstance))
def test_points_on_bars_move_as_in_their_angles(engine: Any, order: int, step: float, most: float) -> None:
    declaration, exact = pendulum(), in_angles(0.8)
    assert check(declaration) == []
    first, second = (error(declaration, exact, order, h, 0.8, engine) for h in (step, step / 2))
    assert second <= most and order - 0.4 < np.log2(first / second) < order + 1.5


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_a_unit_has_the_same_bits(tmp_path: Path, version: str) -> None:
    """In steps of 1/128 s, whose times are exact: FMPy's step sizes are differences of times."""
    from fmpy import simulate_fmu

    declaration, h = pendulum(), 2.0**-7
    model = build_model(declaration, default_scheme(declaration, 6))
    own = run(Monolithic(model, NativeInstance(model)), Options(stop=0.25, step=h))
    (unit,) = export(model, tmp_path, versions=(version,), step=h)
    rows = simulate_fmu(str(unit), stop_time=0.25, output_interval=h, output=["x", "b_dot", "push.energy"])
    assert rows["x"][-1] == own.column("x")[-1] and rows["b_dot"][-1] == own.column("b_dot")[-1]
    assert abs(rows["push.energy"][-1] - own.ledger.summary().ports[0].supplied) <= 1e-12


def test_terms_linear_in_velocities_turn_the_motion() -> None:
    """A charge in a uniform magnetic field and a saddle: a Penning trap, whose motion is linear."""
    x, y, z, u, v, w, field, k = sympy.symbols("x y z u v w c k")
    L = (u**2 + v**2 + w**2) / 2 + field * (x * v - y * u) / 2 + k * (x**2 + y**2 - 2 * z**2) / 4
    lines: list[str] = []
    declaration = from_lagrangian(
        L, [x, y, z], [u, v, w], parameters={field: 5.0, k: 2.0}, name="trap", show=lines.append
    )
    assert check(declaration) == [] and {"gyroscopic[u, v] = c", "M[w, w] = 1"} <= set(lines)
    A = np.zeros((6, 6))
    A[:3, 3:], A[3:, :3] = np.eye(3), np.diag([1.0, 1.0, -2.0])
    A[3, 4], A[4, 3] = 5.0, -5.0
    start = np.array([0.3, 0.0, 0.1, 0.0, 0.4, 0.2])
    names = ["x", "y", "z", "u", "v", "w"]
    values, vectors = np.linalg.eig(A)
    exact = np.real(vectors @ (np.exp(values * 2.0) * np.linalg.solve(vectors, start.astype(complex))))
    begun = declaration.with_starts(dict(zip(names, start.tolist(), strict=True)))
    assert error(begun, dict(zip(names, exact, strict=True)), 6, 0.02, 2.0) <= 1e-8


def test_coupled_masses_and_vectors() -> None:
    """Two oscillators whose mass matrix is full, as entries of a vector with a unit."""
    a, b, p, r = (sympy.Symbol(s) for s in ("s[1]", "s[2]", "s_dot[1]", "s_dot[2]"))
    L = (2 * p**2 + p * r + r**2) - 5 * a**2 - 7 * (a - b) ** 2
    declaration = from_lagrangian(L, [state("s", 2, unit="m", start=[0.3, -0.1])])
    assert check(declaration) == [] and declaration.states[1].unit == "m/s"
    M, K = np.array([[4.0, 1.0], [1.0, 2.0]]), np.array([[24.0, -14.0], [-14.0, 14.0]])
    squares, modes = np.linalg.eig(np.linalg.solve(M, K))
    exact = modes @ (np.cos(np.sqrt(squares)) * np.linalg.solve(modes, [0.3, -0.1]))
    assert error(declaration, {"s[1]": exact[0], "s[2]": exact[1]}, 6, 0.02, 1.0) <= 1e-8


def test_a_moving_constraint_books_its_work() -> None:
    """A point on a track that is lifted: the drive does the work of the weight and of the acceleration."""
    x, y = mechanics.dynamicsymbols("x y")
    L = (x.diff(t) ** 2 + y.diff(t) ** 2) / 2 - 10 * y
    declaration = from_lagrangian(L, [x, y], constraints={"lift": y - t**2}, name="lift").with_starts({"x_dot": 1.0})
    model = build_model(declaration, default_scheme(declaration, 6))
    found = run(Monolithic(model, NativeInstance(model)), Options(stop=1.0, step=0.02))
    assert found.column("y")[-1] == pytest.approx(1.0, abs=1e-12)
    assert found.ledger.summary().ports[0].supplied == pytest.approx(10.0 + 0.5 * 2.0**2, abs=1e-9)


q, v, m = sympy.symbols("q v m")


@pytest.mark.parametrize(
    ("L", "more", "words"),
    [
        (m * v**2 * sympy.cos(q), {}, ["M[v, v]", "depends on q", "not constant", "from_sympy"]),
        (-m * sympy.sqrt(1 - v**2), {}, ["M[v, v]", "not of degree two in the velocities"]),
        (m * v**2 - sympy.Symbol("kk") * q, {}, ["symbol 'kk' is no state or parameter"]),
        (m * v**2, {"dissipation": abs(v) ** 3}, ["dissipation", "not of degree two in v", "Rayleigh"]),
        (m * v**2, {"dissipation": v}, ["dissipation", "not of degree two in v"]),
        (m * v**2, {"inputs": ["u"]}, ["B: is missing, there are 1 inputs"]),
        (m * v**2, {"inputs": ["u"], "B": sympy.eye(2)}, ["B: is 2 x 2, expected 1 x 1"]),
        (m * v**2, {"velocities": ["v", "w"]}, ["velocities", "q (1) and v (1), w (1)"]),
        (m * v**2, {"constraints": [sympy.besselj(0, q)]}, ["constraint 1", "(besselj)"]),
        (m * sympy.Function("q")(t).diff(t, 2), {}, ["(Derivative)"]),
    ],
    ids=str,
)  # fmt: skip
def test_what_is_no_such_lagrangian_is_refused(L: Any, more: dict[str, Any], words: list[str]) -> None:
    with pytest.raises(DeclarationError) as error:
        from_lagrangian(L, ["q"], **({"velocities": ["v"], "parameters": {"m": 1.0}} | more))
    assert all(w in str(error.value) for w in words), str(error.value)


def test_a_mass_that_only_seems_to_depend_is_simplified() -> None:
    L = m * v**2 * (sympy.sin(q) ** 2 + sympy.cos(q) ** 2) / 2 - q**2
    assert check(from_lagrangian(L, ["q"], ["v"], parameters={"m": 1.0})) == []
