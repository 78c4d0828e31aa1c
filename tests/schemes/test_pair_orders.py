"""Proposition 1, observed orders, Example 8."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from phfmu import (
    PHDAE,
    TRANSLATIONAL,
    ClosedPair,
    Collocated,
    DiracDissipative,
    GradientPair,
    NativeInstance,
    Port,
    SemiExplicit,
    Status,
    StepFailure,
    build_model,
    state,
)
from phfmu.components.electrical import synchronous_machine
from tests.engines import ENGINES
from tests.schemes.pairs import BOTH, current, declaration, steps
from tests.schemes.test_orders import BETA, END, START, reference, rlc, rlc_exact, rlc_rate, slope
from tests.wide import slow

# -- Proposition 1 and observed orders ----------------------------------------------------------------------------


@cache
def circuit_at(t):
    run = solve_ivp(rlc_rate("algebraic"), (0.0, t), START, method="DOP853", rtol=3e-14, atol=1e-15, max_step=0.01)
    q = run.y[0, -1]
    return run.y[:, -1], current(q + BETA * q**3)


@pytest.mark.parametrize(
    ("make", "point"),
    [(SemiExplicit, "end"), slow((SemiExplicit, "start")), slow((SemiExplicit, "midpoint"))]
    + [slow((DiracDissipative, "end")), (DiracDissipative, "start"), slow((DiracDissipative, "midpoint"))]
    + [slow((lambda p: GradientPair(closure=p), "end")), (lambda p: GradientPair(closure=p), "midpoint")],
)
def test_proposition_1_order_two_of_x1_and_of_x2_at_its_instant(make, point):
    """x2 of the closures end and start belongs to the middle of the step; read at its end it has order 1."""
    model, counts = build_model(rlc("source", "algebraic"), make(point)), (20, 40, 80)
    x_errors, own, late = [], [], []
    for n in counts:
        x, a, worst = steps(model, END / n, n)
        x_errors.append(np.max(np.abs(x[-1] - rlc_exact("algebraic"))))
        instant = END if point == "midpoint" else END - END / n / 2
        own.append(abs(a[-1, 0] - circuit_at(instant)[1]))
        late.append(abs(a[-1, 0] - circuit_at(END)[1]))
        assert worst <= 1e-13
    assert slope(counts, x_errors) == pytest.approx(-2.0, abs=0.1)
    assert slope(counts, own) == pytest.approx(-2.0, abs=0.1)
    if point != "midpoint":
        assert slope(counts, late) == pytest.approx(-1.0, abs=0.15)


@pytest.mark.parametrize("scheme", BOTH, ids=lambda s: s.name)
def test_order_on_the_drive(scheme):
    """Against the matrix exponential."""
    exact, model = reference("drive"), build_model(declaration("drive"), scheme)
    names, sizes, errors = [n for v in model.declaration.states for n in v.names()], (5e-5, 2.5e-5, 1.25e-5), []
    for h in sizes:
        x, _, worst = steps(model, h, round(0.005 / h), NativeInstance)
        speed = x[-1, names.index("load.w")] - exact["w2"][1]
        errors.append(abs(speed) + abs(x[-1, names.index("motor.w")] - exact["w1"][1]))
        assert worst <= 1e-13
    assert slope(sizes, errors) == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("scheme", BOTH, ids=lambda s: s.name)
def test_order_on_the_oscillator(scheme):
    """Against the closed form, at half a period."""
    model = build_model(declaration("oscillator"), scheme)
    names, sizes, errors = [n for v in model.declaration.states for n in v.names()], (0.01, 0.005, 0.0025), []
    q = [names.index(f"mass{i}.q") for i in (1, 2)]
    for h in sizes:
        x, _, worst = steps(model, h, round(0.3 / h), NativeInstance)
        slow, fast = np.cos(2 * np.pi * 0.3), np.cos(6 * np.pi * 0.3)
        errors.append(np.max(np.abs(x[-1, q] - [(slow + fast) / 2, (slow - fast) / 2])))
        assert worst <= 1e-13
    assert slope(sizes, errors) == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("scheme", BOTH, ids=lambda s: s.name)
def test_order_on_four_particles(scheme):
    """Positions; the velocities of the one-level form alternate around the constraint."""
    exact, model = reference("four_particle"), build_model(declaration("four_particle"), scheme)
    final, sizes, errors = np.array([exact[f"q[{j + 1}]"][-1] for j in range(12)]), (1 / 400, 1 / 800, 1 / 1600), []
    for h in sizes:
        x, _, worst = steps(model, h, round(1 / h), NativeInstance)
        errors.append(np.linalg.norm(x[-1, :12] - final))
        assert worst <= 1e-13
    assert slope(sizes, errors) == pytest.approx(2.0, abs=0.1)


@cache
def machine_truth(t):
    """Rotor angle and momentum from dq fluxes with order 6 at a small step."""
    model = build_model(synchronous_machine(coordinates="dq-flux"), Collocated(3))
    x = NativeInstance(model).run(0.0, t / 400, 400, ("x",))["x"][-1]
    names = [n for v in model.declaration.states for n in v.names()]
    return np.array([x[names.index("p")] / 1e6, x[names.index("theta")]])


@pytest.mark.parametrize("scheme", BOTH, ids=lambda s: s.name)
def test_order_on_the_machine_in_current_coordinates(scheme):
    """E(x) is full and depends on the angle: the closed-form pair, and a discrete gradient with E at the midpoint."""
    model = build_model(synchronous_machine(coordinates="current"), scheme)
    names, sizes, errors = [n for v in model.declaration.states for n in v.names()], (4e-4, 2e-4, 1e-4), []
    for h in sizes:
        x, _, worst = steps(model, h, round(0.02 / h), NativeInstance)
        last = np.array([x[-1, names.index("p")] / 1e6, x[-1, names.index("theta")]])
        errors.append(np.max(np.abs(last - machine_truth(0.02))))
        assert worst <= 1e-13
    assert slope(sizes, errors) == pytest.approx(2.0, abs=0.15)


# -- Example 8 ----------------------------------------------------------------------------------------------------


def example_8(a=1.0, y=0.0, pair=False) -> PHDAE:
    """H = exp(x1^2/2) - 1 + x2^2/2, E = (1, 1)^T grad H^T, z = (1, 1)/2, and an input that asks for x1 = a/2.

    The input acts as (psi, -psi) with psi = x1 - a/2: its power is zero, and a step from (a, .) must end at x1' = 0.
    """
    x = state("x", 2, start=(a, y))
    h = ca.exp(x[0] ** 2 / 2) - 1 + x[1] ** 2 / 2
    half, psi = ca.SX([0.5, 0.5]), x[0] - a / 2

    def ebar(x, d):  # (1, 1)^T DG H^T with one divided difference a coordinate
        first = ca.if_else(d[0] == 0, x[0] * ca.exp(x[0] ** 2 / 2),
                           (ca.exp((x[0] + d[0]) ** 2 / 2) - ca.exp(x[0] ** 2 / 2)) / ca.if_else(d[0] == 0, 1, d[0]))  # fmt: skip
        return ca.repmat(first * d[0] + (x[1] + d[1] / 2) * d[1], 2)

    return PHDAE(
        "example_8",
        states=(x,),
        closed=(ClosedPair((x,), h, ca.mtimes(ca.SX([1.0, 1.0]), ca.gradient(h, x.sx).T), half,
                           ebar if pair else None, (lambda x, d: half) if pair else None),),
        ports=(Port("hold", TRANSLATIONAL, "effort", {x: ca.vertcat(psi, -psi)}, start=1.0),),
    )  # fmt: skip


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("y", [0.0, 0.3])
@pytest.mark.parametrize("closure", ["minimal", lambda x, new, f: ca.SX(0, 1)], ids=["minimal", "none"])
def test_example_8_has_no_solution_and_says_so(closure, y, engine):
    """The input moves x across grad H, where E^T f = DG H has no f; the state stays where it was."""
    instance = engine(build_model(example_8(y=y), DiracDissipative(closure)))
    with pytest.raises(StepFailure, match="example_8 at t = 0") as failure:
        instance.do_step(0.0, 0.1)
    assert failure.value.status in (Status.SINGULAR, Status.NO_CONVERGENCE)
    assert "costate of x" in str(failure.value) or "least distance" in str(failure.value)
    assert instance.x == pytest.approx([1.0, y], abs=0)


def test_example_8_the_numbers_of_the_appendix():
    """x = (a, 0), x' = (0, b), b = a exp(a^2/16): grad H at the midpoint is normal to x' - x although H changes."""
    a = 1.0
    b = a * np.exp(a**2 / 16)
    x, new = np.array([a, 0.0]), np.array([0.0, b])
    d, mid = new - x, (x + new) / 2
    grad = np.array([mid[0] * np.exp(mid[0] ** 2 / 2), mid[1]])
    dh = b**2 / 2 - (np.exp(a**2 / 2) - 1)
    assert grad @ d == pytest.approx(0.0, abs=1e-15) and abs(dh) > 0.08
    for w in (0.0, 1.0, -3.0):  # every discrete gradient is dh d/|d|^2 plus something normal to d, i.e. along grad
        found = dh * d / (d @ d) + w * grad
        assert np.linalg.matrix_rank(np.column_stack([grad, found])) == 2


@pytest.mark.parametrize("engine", ENGINES)
def test_example_8_steps_with_a_discrete_pair(engine):
    """Ebar = (1, 1)^T DG H^T is a pair without that defect: H is kept, and the input's condition met."""
    instance = engine(build_model(example_8(y=0.9, pair=True), GradientPair()))
    before = instance.signal("H")[0]
    instance.do_step(0.0, 0.1)
    assert instance.x[0] == pytest.approx(0.0, abs=1e-12)
    assert instance.signal("H")[0] == pytest.approx(before, rel=1e-12)
