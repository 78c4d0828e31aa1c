"""The multibody builder and its components against independent solutions; invariances, redundancy, refusals."""

from __future__ import annotations

from functools import cache
from itertools import product

import casadi as ca
import chain_reference
import heavy_top_reference
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from phfmu import (
    DeclarationError,
    Monolithic,
    NativeInstance,
    Options,
    PythonInstance,
    TwoLevel,
    build_model,
    constraint_rank,
    run,
)
from phfmu.components.mechanical.chain import chain
from phfmu.components.mechanical.heavy_top import heavy_top
from phfmu.components.mechanical.multibody import Multibody
from tests.wide import slow, wide

FIRST, THIRD = (TwoLevel(k) for k in (1, 3))
SWING = {"n": 5, "damping": 0.3, "bending": 10.0, "speed": 2.0}


def slopes(errors):
    return [float(np.log2(a / b)) for a, b in zip(errors, errors[1:], strict=False)]


# -- orders ------------------------------------------------------------------------------------------------------


@cache
def swing_reference():
    """q, v, lambda at 0.4 s."""
    q, v, lam = chain_reference.chain(0.4, **SWING)
    return q.ravel(), v.ravel(), lam


def mean_multiplier(h):
    """Mean of the exact multipliers over the last step of length h before 0.4 s."""
    t, w = np.polynomial.legendre.leggauss(5)
    ends = [chain_reference.chain(0.4 - h * (1 - s) / 2, **SWING)[2] for s in t]
    return sum(weight / 2 * lam for weight, lam in zip(w, ends, strict=True))


@pytest.mark.parametrize(
    ("scheme", "order", "steps", "tolerance"),
    [(FIRST, 2, (40, 80, 160), 0.1), pytest.param(THIRD, 6, (10, 20, 40), 0.15, marks=pytest.mark.slow)],
)
def test_damped_chain_has_full_order_in_positions_velocities_and_multipliers(scheme, order, steps, tolerance):
    exact, errors, model = swing_reference(), [], build_model(chain(**SWING), scheme)
    for n in steps:
        instance = NativeInstance(model)
        rows = instance.run(0.0, 0.4 / n, n, ("x", "a", "stored", "dissipated", "signals"))
        x = rows["x"][-1]
        assert np.max(np.abs(rows["stored"] + rows["dissipated"])) <= 2e-12  # H is 150 J
        assert np.max(np.abs(rows["signals"][:, instance.layout["observables"]])) <= 1e-12
        numbers = (x[:15], x[15:], instance.signal("a_end"))
        errors.append([float(np.linalg.norm(a - b)) for a, b in zip(numbers, exact, strict=True)])
        errors[-1].append(float(np.linalg.norm(rows["a"][-1] - mean_multiplier(0.4 / n))))
    *plain, mean = np.array(errors).T
    for column in plain:
        assert all(abs(s - order) <= tolerance for s in slopes(column)), column
    assert abs(slopes(mean)[-1] - order) <= 0.2, mean


@pytest.mark.parametrize(("scheme", "order", "steps"), [(FIRST, 2, (50, 100, 200)), slow((THIRD, 6, (16, 32, 64)))])
def test_top_with_singular_mass_matrix_has_full_order(scheme, order, steps):
    q, v = heavy_top_reference.heavy_top(0.1, precession=1.0)
    model, errors = build_model(heavy_top(precession=1.0), scheme), []
    for n in steps:
        instance = NativeInstance(model)
        rows = instance.run(0.0, 0.1 / n, n, ("x", "stored", "signals"))
        x = rows["x"][-1]
        assert np.max(np.abs(rows["stored"])) <= 1e-12 * 1500.0
        assert np.max(np.abs(rows["signals"][:, instance.layout["observables"]])) <= 1e-12
        errors.append([np.linalg.norm(x[:12] - q), np.linalg.norm(x[12:21] - v[:9]), np.linalg.norm(x[21:] - v[9:])])
    for column in np.array(errors).T:
        assert all(abs(s - order) <= 0.15 for s in slopes(column)), column


def test_top_keeps_energy_and_vertical_spin():
    instance = NativeInstance(build_model(heavy_top(precession=1.0)))
    rows = instance.run(0.0, 1e-3, 3000, ("x", "energy"))
    assert np.ptp(rows["energy"]) <= 1e-10 * rows["energy"][0, 0]
    m = np.repeat([15.0, 15.0 / 16, 15.0 / 16, 0.0], 3)
    q, p = rows["x"][:, :12].reshape(-1, 4, 3), (rows["x"][:, 12:] * m).reshape(-1, 4, 3)
    vertical = np.cross(q, p).sum(axis=1)[:, 2]
    assert np.ptp(vertical) <= 1e-10 * abs(vertical[0])


def test_ten_links_keep_both_constraint_levels_over_ten_thousand_steps():
    instance = NativeInstance(build_model(chain(10, speed=1.0)))
    rows = instance.run(0.0, 0.005, 10_000, ("signals", "energy"))
    assert np.max(np.abs(rows["signals"][:, instance.layout["observables"]])) <= 1e-12
    assert np.ptp(rows["energy"]) <= 1e-9


@pytest.mark.slow
def test_free_chain_keeps_linear_and_angular_momentum():
    """Four particles on three bars and two springs, thrown; no support, no gravity."""
    body = Multibody("thrown")
    p = [body.particle(1.0 + i, (float(i), 0.0, 0.0), (0.3, 0.5 * (-1) ** i, 0.2 * i)) for i in range(4)]
    for a, b in zip(p, p[1:], strict=False):
        body.bar(a, b)
    body.linear_spring(p[0], p[2], 30.0, 1.8)
    body.quartic_spring(p[1], p[3], 20.0, 1.9)
    instance = NativeInstance(build_model(body.build()))
    x = instance.run(0.0, 0.01, 10_000, ("x",))["x"]
    momentum = (x[:, 12:] * np.repeat([1.0, 2.0, 3.0, 4.0], 3)).reshape(-1, 4, 3)
    turning = np.cross(x[:, :12].reshape(-1, 4, 3), momentum)
    assert np.max(np.ptp(momentum.sum(axis=1), axis=0)) <= 1e-12
    # positions grow to 30 m while turning is a difference of numbers of that size
    assert np.max(np.ptp(turning.sum(axis=1), axis=0)) <= 1e-11


# -- other choices of the same constraints -----------------------------------------------------------------------


def hung(order, scale=(1.0, 1.0, 1.0), again=(), length=1.0):
    """Three links; `order` of the bars, their scales, bars listed twice (the last with its own length)."""
    body = Multibody("hung")
    body.gravity((0, 0, -9.81))
    points = [body.support((0, 0, 0))]
    points += [body.particle(1.0 + i, (i + 1.0, 0, 0), (0, 0.5 * i, 0)) for i in range(3)]

    def bar(i, factor, length):
        a, b = points[i], points[i + 1]
        body.constraint(lambda at: factor * 0.5 * (ca.sumsqr(at(b) - at(a)) - length**2), f"bar {i + 1}")

    for i in order:
        bar(i, scale[i], 1.0)
    for i in again:
        bar(i, 1.0, length)
    return body.build()


@pytest.mark.parametrize(
    ("engine", "scheme"),
    wide(product((NativeInstance, PythonInstance), (FIRST, THIRD)), (PythonInstance, THIRD)),
)
def test_permuted_scaled_and_repeated_constraints_move_alike(engine, scheme):
    steps = 50 if engine is NativeInstance else 10
    base = engine(build_model(hung((0, 1, 2)), scheme))
    x = base.run(0.0, 0.01, steps, ("x",))["x"]
    for other in (hung((2, 0, 1)), hung((0, 1, 2), (3.0, 0.01, -7.0)), hung((0, 1, 2), again=(1, 1))):
        instance = engine(build_model(other, scheme))
        assert np.max(np.abs(instance.run(0.0, 0.01, steps, ("x",))["x"] - x)) <= 1e-12
    lam, shared = base.signal("a_end"), instance.signal("a_end")
    # least norm: equal parts, up to rounding over the regularisation (1e-16 / 1e-10)
    assert shared[[1, 3, 4]] == pytest.approx(np.full(3, lam[1] / 3), rel=1e-4)
    assert np.sum(shared[[1, 3, 4]]) == pytest.approx(lam[1], rel=1e-11)


def test_redundant_rows_are_reported_and_contradictions_refused():
    rank = constraint_rank(hung((0, 1, 2), (1.0, 2.0, 1.0), again=(1,)))
    assert (rank.rows, rank.rank) == (4, 3)
    assert rank.redundant[0].name == "lambda[4]" and rank.redundant[0].of == pytest.approx({"lambda[2]": 0.5})
    assert "constraint lambda[4] is redundant: Dg row = 0.5 lambda[2]" in rank.report()
    wrong = hung((0, 1, 2), again=(1,), length=1.0 + 1e-6)
    assert constraint_rank(wrong).redundant[0].gap == pytest.approx(-1e-6, rel=1e-3)
    model = build_model(wrong)
    with pytest.raises(ValueError, match=r"lambda\[4\]: position residual"):
        run(Monolithic(model, PythonInstance(model)), Options(stop=0.01, step=0.01))
    with pytest.raises(DeclarationError, match=r"lambda\[4\] contradicts lambda\[2\] by 1e-06"):
        run(Monolithic(model, PythonInstance(model)), Options(stop=0.01, step=0.01, project=True))


def test_moving_support_books_its_work_under_its_own_name():
    """A link swung from a support that accelerates sideways: in its frame gravity is tilted."""
    body = Multibody("crane", 2)
    body.gravity((0.0, -9.81))
    trolley = body.moving_support("trolley", lambda t: (0.25 * t**2, 0.0))
    load = body.particle(3.0, (0.0, -1.0))
    body.bar(trolley, load)
    model = build_model(body.build(), THIRD)
    instance = PythonInstance(model)
    result = run(Monolithic(model, instance), Options(stop=1.0, step=0.05))
    th = solve_ivp(lambda t, y: [y[1], -9.81 * np.sin(y[0]) - 0.5 * np.cos(y[0])], (0, 1), [0, 0], "DOP853",
                   rtol=1e-12, atol=1e-12).y[0, -1]  # fmt: skip
    assert instance.x[:2] == pytest.approx([0.25 + np.sin(th), -np.cos(th)], abs=1e-9)
    ports = {p.port: p.supplied for p in result.ledger.summary().ports}
    stored = result.column("energy.stored")
    assert ports["trolley"] == pytest.approx(stored[-1] - stored[0], abs=1e-13)
    assert result.column("trolley.energy")[-1] == pytest.approx(ports["trolley"], abs=1e-15)


@pytest.mark.slow
def test_parallel_links_pass_the_flat_position_on_their_branch():
    """Three cranks and two rods turn for 20 s: at the flat position, twice a turn, the rank of Dg drops."""
    body, n, rate, angle = Multibody("cranks", 2), 3, 3.0, 1.0
    arm, speed = np.array([np.cos(angle), np.sin(angle)]), rate * np.array([-np.sin(angle), np.cos(angle)])
    body.gravity((0.0, -1.0))
    pins = [body.particle(1.0, arm + [i, 0.0], speed) for i in range(n)]
    for i, p in enumerate(pins):
        body.bar(body.support((float(i), 0.0)), p)
    for a, b in zip(pins, pins[1:], strict=False):
        body.bar(a, b)
    instance = NativeInstance(build_model(body.build()))
    rows = instance.run(0.0, 0.01, 2000, ("x", "energy"))
    q = rows["x"][:, : 2 * n].reshape(-1, n, 2)
    assert np.max(np.abs(np.diff(q, axis=1) - [1.0, 0.0])) <= 1e-6
    assert np.ptp(rows["energy"]) <= 1e-9 and instance.counts["substeps"] == 0
