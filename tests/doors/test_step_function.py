"""A step as a function: its derivatives against differences of steps, forward against backwards, its values those of a run."""

from __future__ import annotations

import gc

import numpy as np
import pytest

from phfmu import (
    PHDAE,
    Collocated,
    NativeInstance,
    PythonInstance,
    Scene,
    StepFailure,
    StepFunction,
    TwoLevel,
    build_model,
    casadi_function,
    default_scheme,
)
from phfmu.components.library import LIBRARY, build
from phfmu.doors.function import Differentiable
from tests.derivatives.differences import richardson
from tests.doors.crane import crane
from tests.wide import turning

pytestmark = pytest.mark.usefixtures("compiler")

CASES = {
    "dc_motor": (Collocated(1), 1e-3, 3),
    "dc_motor-4": (Collocated(2), 1e-3, 1),
    "dc_motor-6": (Collocated(3), 1e-3, 2),
    "crane": (Collocated(2), 0.1, 2),
    "four_particle": (TwoLevel(1), 1e-2, 1),
}


def step(case: str, engine: type = NativeInstance) -> StepFunction:
    scheme, h, n = CASES[case]
    model = build_model(crane() if case == "crane" else build(case.partition("-")[0]), scheme)
    return StepFunction(model, engine(model), h, n)


def point(of: Differentiable) -> list[np.ndarray]:
    """Arguments off the start, where states may be."""
    found = [v.copy() for v in of.start]
    if of.name != "four_particle":
        found[0] += [0.3, 0.4, 50.0, -20.0][: len(found[0])]
    found[1] += np.arange(1, len(found[1]) + 1)
    found[3] += 0.2
    return found


def dense(of: Differentiable, at: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """J column by column (forward) and row by row (back)."""

    def split(v: np.ndarray, blocks) -> list[np.ndarray]:
        return np.split(v, np.cumsum([b.n for b in blocks])[:-1])

    n, m = (sum(b.n for b in blocks) for blocks in (of.inputs, of.outputs))
    columns = [np.concatenate(of.forward(at, split(e, of.inputs))) for e in np.eye(n)]
    rows = [np.concatenate(of.reverse(at, split(e, of.outputs))) for e in np.eye(m)]
    return np.column_stack(columns), np.vstack(rows)


@pytest.mark.parametrize("engine", [NativeInstance, PythonInstance])
@pytest.mark.parametrize("case", CASES)
def test_derivatives_are_those_of_differences(case: str, engine: type) -> None:
    own = step(case, engine)
    at = point(own)
    J, back = dense(own, at)
    size = np.abs(J).max(axis=0)
    np.testing.assert_allclose(back, J, rtol=1e-11, atol=1e-13 * size.max())
    column = 0
    for i, block in enumerate(own.inputs):
        for j in range(block.n):

            def values(v: float, i: int = i, j: int = j) -> np.ndarray:
                given = [a.copy() for a in at]
                given[i][j] = v
                return np.concatenate(own.values(*given))

            if case != "four_particle" or block.name != "x":  # positions have to stay on their constraints
                slopes = richardson(values, at[i][j], 1e-3 * (abs(at[i][j]) or 1.0))
                rounding = 50 * np.finfo(float).eps * np.abs(values(at[i][j])).max() / (1e-3 * (abs(at[i][j]) or 1.0))
                np.testing.assert_allclose(J[:, column], slopes, atol=1e-7 * np.abs(slopes).max() + rounding)
            column += 1


@pytest.mark.parametrize("case", CASES)
def test_values_are_those_of_a_run_and_its_ledger(case: str) -> None:
    own = step(case)
    x, u, p, t = point(own)
    x1, y, lost = own(x, u, p, t)
    _, h, n = CASES[case]
    instance = NativeInstance(own.model)
    instance.set_x(float(t[0]), x)
    instance.set_input(u)
    instance.initialise()
    r = instance.run(float(t[0]), h, n, record=("x", "supplied", "dissipated"))
    np.testing.assert_allclose(x1, r["x"][-1], rtol=1e-11, atol=1e-12)
    assert n * h * u @ y == pytest.approx(r["supplied"].sum(), rel=1e-11, abs=1e-14)
    assert lost[0] == pytest.approx(r["dissipated"].sum(), rel=1e-11, abs=1e-14)


@pytest.mark.parametrize("engine", [NativeInstance, PythonInstance])
def test_a_value_does_not_depend_on_what_was_asked_before(engine: type) -> None:
    own = step("crane", engine)
    at = point(own)
    first = own(*at)
    own(at[0] + 1.0, at[1] * 30, at[2] * 1.2)
    for again, value in zip(own(*at), first, strict=True):
        np.testing.assert_array_equal(again, value)


@pytest.mark.parametrize(("name", "order"), turning(LIBRARY, [2, 4, 6]))
def test_models_of_the_library(name: str, order: int) -> None:
    """One step from the start: the states of an instance to the bit or its rounding, and both ways of J in one product."""
    found = build(name)
    d = found if isinstance(found, PHDAE) else found.declaration()
    h = found.step if isinstance(found, Scene) and found.step else 1e-3
    try:
        model = build_model(d, default_scheme(d, order))
        own = StepFunction(model, NativeInstance(model), h)
    except ValueError as error:
        pytest.skip(str(error))
    instance = NativeInstance(model)
    x1 = instance.run(model.t0, h, 1, record=("x",))["x"][-1]
    rng = np.random.default_rng(0)
    along, bars = ([rng.normal(size=b.n) for b in blocks] for blocks in (own.inputs, own.outputs))
    np.testing.assert_allclose(own()[0], x1, rtol=1e-12, atol=1e-14 * np.abs(x1).max(initial=0.0))
    try:
        forward, back = own.forward(own.start, along), own.reverse(own.start, bars)
    except ValueError as error:
        assert name in ("flyball", "surge_arrester"), (
            error
        )  # dependent rows at order 6; no voltage to the power of an exponent
        pytest.skip(str(error))
    products = [a @ b for a, b in zip(forward, bars, strict=True)]
    size = sum(np.abs(a) @ np.abs(b) for a, b in zip(forward, bars, strict=True))
    assert abs(sum(products) - sum(a @ b for a, b in zip(back, along, strict=True))) <= 1e-10 * size


def test_many_steps_are_the_chain_of_their_halves() -> None:
    model = build_model(crane(), Collocated(1))
    whole, half = (StepFunction(model, NativeInstance(model), 0.02, n) for n in (40, 20))
    x, u, p, t = point(whole)
    between = half(x, u, p, t)
    end = half(between[0], u, p, t + 0.4)
    found = whole(x, u, p, t)
    np.testing.assert_allclose(found[0], end[0], rtol=1e-12)
    np.testing.assert_allclose(found[1], (between[1] + end[1]) / 2, rtol=1e-12)
    bar = np.array([1.0, 2.0, 0.01, 0.03])
    none = np.zeros(1)
    later = half.reverse([between[0], u, p, t + 0.4], [bar, none, none])
    first = half.reverse([x, u, p, t], [later[0], none, none])
    found = whole.reverse([x, u, p, t], [bar, none, none])
    np.testing.assert_allclose(found[0], first[0], rtol=1e-10)
    np.testing.assert_allclose(found[1], first[1] + later[1], rtol=1e-10)
    np.testing.assert_allclose(found[2], first[2] + later[2], rtol=1e-9)


def test_casadi_takes_it_and_keeps_it() -> None:
    own = step("crane")
    f, (x, u, *_) = casadi_function(own, ["x", "u"]), point(own)
    expected = own(x, u)
    J = dense(own, [x, u, *own.start[2:]])[0]
    del own
    gc.collect()
    for found, value in zip(f(x, u), expected, strict=True):
        np.testing.assert_array_equal(np.array(found).reshape(-1), value)
    jac = f.jacobian()(x, u, *f(x, u))
    np.testing.assert_allclose(np.hstack([np.array(jac[0]), np.array(jac[1])]), J[:4, :5], rtol=1e-12, atol=1e-12)


def test_second_derivatives_are_those_of_differences() -> None:
    """What an exact Hessian of a solver takes: the gradient of l^T x1, along a direction."""
    import casadi as ca

    own = step("crane")
    f, (x, u, *_) = casadi_function(own, ["x", "u"]), point(own)
    z, weights = ca.MX.sym("z", 5), np.array([1.0, 2.0, 0.01, 0.03])
    hessian = ca.Function("H", [z], [ca.hessian(ca.dot(weights, f(z[:4], z[4])[0]), z)[0]])
    at = np.append(x, u)

    def slope(v: np.ndarray) -> np.ndarray:
        bars = (weights, np.zeros(1), np.zeros(1))
        return np.concatenate(own.reverse([v[:4], v[4:], *own.start[2:]], bars)[:2])

    H = np.array(hessian(at))
    np.testing.assert_allclose(H, H.T, atol=1e-12)
    for j, e in enumerate(np.eye(5)):
        slopes = richardson(lambda v, e=e: slope(at + v * e), 0.0, 1e-3 * (abs(at[j]) or 1.0))
        np.testing.assert_allclose(H[:, j], slopes, atol=1e-7 * np.abs(H).max())


def test_what_is_refused() -> None:
    model = build_model(crane(), Collocated(1))
    instance = NativeInstance(model)
    with pytest.raises(ValueError, match="of this very model, got NativeInstance"):
        StepFunction(build_model(crane(), Collocated(2)), instance, 0.1)
    with pytest.raises(ValueError, match="steps of 0"):
        StepFunction(model, instance, 0.0)
    with pytest.raises(ValueError, match="whole number from 1"):
        StepFunction(model, instance, 0.1, 0)
    own = StepFunction(model, instance, 0.1)
    with pytest.raises(ValueError, match=r"x: 2 values given, expected 4 \(x, angle, p, L\)"):
        own([0.0, 1.0])
    with pytest.raises(ValueError, match="x: angle must be finite"):
        own([0.0, np.nan, 0.0, 0.0])
    with pytest.raises(KeyError, match="no argument 'force'; there are: x, u, p, t"):
        casadi_function(own, ["force"])
    with pytest.raises(StepFailure, match="crane"):
        own([0.0, 0.1, 1.0, 1.0], [1.0], [0.0, 0.0, 3.0, 9.81])  # without masses
    bouncing = build_model(build("bouncing_ball").declaration())
    with pytest.raises(ValueError, match="state events"):
        StepFunction(bouncing, NativeInstance(bouncing), 1e-3)
