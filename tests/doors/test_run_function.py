"""A run as a function: against differences, in SciPy and CasADi, either way, and what is refused."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from phfmu import (
    Collocated,
    Event,
    NativeInstance,
    Options,
    PythonInstance,
    RunFunction,
    build_model,
    casadi_function,
    gradient,
)
from phfmu.components.library import build
from tests.derivatives.differences import richardson

pytestmark = pytest.mark.usefixtures("compiler")

OF, BY = ["max(terminal.i)", "last(energy.dissipated)", "rms(shaft.speed)"], ["R", "L", "terminal.v", "flux"]
AT = np.array([0.5, 0.003, 12.0, 1e-3])
OPTIONS = Options(stop=0.05, step=1e-3)


def motor(mode: str = "auto", order: int = 2, engine: type = NativeInstance) -> RunFunction:
    model = build_model(build("dc_motor"), Collocated(order // 2))
    by = ["R", "L", "terminal.v", model.declaration.states[0].names()[0]]
    return RunFunction(model, engine(model), OPTIONS, OF, by, mode=mode)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize(
    ("mode", "engine"), [("forward", NativeInstance), ("reverse", NativeInstance), ("forward", PythonInstance)]
)
def test_the_jacobian_is_that_of_differences(mode: str, engine: type, order: int) -> None:
    f = motor(mode, order, engine)
    J = f.jacobian(AT)
    for j, e in enumerate(np.eye(4)):
        slopes = richardson(lambda v, e=e: f(AT + v * e), 0.0, 1e-3 * AT[j])
        np.testing.assert_allclose(J[:, j], slopes, rtol=2e-6, atol=1e-7 * np.abs(slopes).max())
    bars = np.array([[1.0, 0.0], [-2.0, 1.0], [0.5, 3.0]])
    other = motor(mode, order, engine)  # products before there is a matrix
    np.testing.assert_allclose(other.reverse([AT], [bars])[0], J.T @ bars, rtol=1e-11, atol=1e-13 * np.abs(J).max())
    np.testing.assert_allclose(other.reverse([AT], [bars[:, 0]])[0], J.T @ bars[:, 0], rtol=1e-11)
    np.testing.assert_allclose(f.forward([AT], [np.ones(4)])[0], J.sum(axis=1), rtol=1e-13)


def test_it_is_the_gradient_of_that_run_whatever_was_asked_before() -> None:
    f = motor("reverse")
    first = f.jacobian(AT)
    f.jacobian(f.start[0] + [0.1, 0, 3.0, 0])
    np.testing.assert_array_equal(f.jacobian(AT), first)
    by = f.inputs[0].names
    model = build_model(build("dc_motor").with_starts({by[0]: AT[0], by[1]: AT[1], by[3]: AT[3]}), Collocated(1))
    start = Options(stop=0.05, step=1e-3, events=[Event(0.0, "terminal.v", AT[2])])
    found = gradient(model, NativeInstance(model), start, OF, by, mode="reverse")
    np.testing.assert_allclose(first, found.slopes, rtol=1e-12)
    np.testing.assert_allclose(f(AT), found.values, rtol=1e-13)


def test_scipy_finds_values_that_were_taken() -> None:
    from scipy.optimize import least_squares

    model = build_model(build("dc_motor"), Collocated(1))
    options = Options(stop=0.05, step=1e-3, events=[Event(0.0, "terminal.v", 12.0)])
    of = [f"terminal.i@{t:g}" for t in np.linspace(2e-3, 0.05, 25)]
    f = RunFunction(model, NativeInstance(model), options, of, ["R", "L"])
    data = f([0.55, 0.0031])
    found = least_squares(
        lambda v: f(v) - data, f.start[0], f.jacobian, x_scale=f.start[0], xtol=1e-14, ftol=1e-14, gtol=1e-14
    )
    np.testing.assert_allclose(found.x, [0.55, 0.0031], rtol=1e-8)


def test_casadi_has_both_ways_of_a_run() -> None:
    own = motor("reverse")
    f, J = casadi_function(own), own.jacobian(AT)
    np.testing.assert_array_equal(np.array(f(AT)).reshape(-1), own(AT))
    seeds, bars = np.arange(8.0).reshape(4, 2), np.arange(6.0).reshape(3, 2)
    np.testing.assert_allclose(f.forward(2)(AT, f(AT), seeds), J @ seeds, rtol=1e-12)
    np.testing.assert_allclose(f.reverse(2)(AT, f(AT), bars), J.T @ bars, rtol=1e-11)
    x = ca.MX.sym("x", 4)
    np.testing.assert_allclose(ca.Function("J", [x], [ca.jacobian(f(x), x)])(AT), J, rtol=1e-11)


def test_ipopt_takes_a_run_with_first_derivatives() -> None:
    """The voltage and resistance at which peak and loss are those of another run."""
    model = build_model(build("dc_motor"), Collocated(1))
    f = casadi_function(RunFunction(model, NativeInstance(model), OPTIONS, OF[:2], ["terminal.v", "R"]))
    data, opti = f([12.0, 0.5]), ca.Opti()
    v = opti.variable(2)
    opti.minimize(ca.sumsqr(f(ca.vertcat(10 * v[0], v[1])) / data - 1))
    opti.subject_to(v[1] >= 0.1)
    opti.set_initial(v, [0.6, 1.0])
    quiet = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-12}
    opti.solver("ipopt", quiet | {"ipopt.hessian_approximation": "limited-memory"})
    np.testing.assert_allclose(opti.solve().value(v), [1.2, 0.5], rtol=1e-5)


def test_what_is_refused() -> None:
    model = build_model(build("dc_motor"), Collocated(1))
    options = Options(stop=0.05, step=1e-3, events=[Event(0.0, "terminal.v", 12.0)])
    with pytest.raises(ValueError, match="event terminal.v = 12 at t = 0 s sets terminal.v, which is an argument"):
        RunFunction(model, NativeInstance(model), options, OF, ["terminal.v"])
    with pytest.raises(KeyError, match="no_such"):
        RunFunction(model, NativeInstance(model), OPTIONS, OF, ["no_such"])
    f = RunFunction(model, NativeInstance(model), OPTIONS, OF, ["R"])
    with pytest.raises(ValueError, match=r"theta: 2 values given, expected 1 \(R\)"):
        f([1.0, 2.0])
    with pytest.raises(ValueError, match="theta: R must be finite"):
        f([np.inf])
