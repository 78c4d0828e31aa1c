"""Energies in pieces (stops, contacts, tables): the balance against H itself, the motion against located impacts."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import casadi as ca
import numpy as np
import pytest

from phfmu import (
    PHDAE,
    Collocated,
    PythonInstance,
    build_model,
    energy,
    skew,
    state,
    strain_energy,
)
from phfmu.declare.energy import Energy
from phfmu.declare.error import DeclarationError
from phfmu.declare.expressions.operations import ANALYTIC, degree, piecewise
from phfmu.gradients import gradients
from phfmu.gradients.coordinate import itoh_abe
from phfmu.gradients.quadrature import nodes
from tests.checks.kinked import (
    OPERATIONS,
    SCHEMES,
    STOPS,
    applied,
    energies,
    instance,
    oscillator,
    run,
)
from tests.wide import wide

EPS = np.finfo(float).eps
Q = ca.SX.sym("q")
SCHEMES |= {g: Collocated(1, g) for g in ("joint-gonzalez", "mean-value", "itoh-abe", "itoh-abe-symmetric")}


@pytest.mark.parametrize(
    ("name", "scheme"),
    wide(
        product(STOPS, SCHEMES),
        *product(STOPS, ("order 2",)),
        *product(("contact",), SCHEMES),
        *(("two sides", "order 4"), ("table", "order 6"), ("if_else", "joint-gonzalez")),
    ),
)
def test_a_kink_costs_no_energy_and_none_is_invented(name, scheme):
    """At every phase of the impact: H stays, and what the books store is the difference of H."""
    for start in np.linspace(1.3, 2.3, 4):
        states, stored = run(instance(name, scheme), (float(start), 0.3), 0.11, 25)
        h = energies(name, states)
        assert np.max(np.abs(h - h[0])) <= 1e-12 * h.max()
        assert np.cumsum(stored) == pytest.approx(h[1:] - h[0], abs=1e-12 * h.max())


@pytest.mark.parametrize(
    ("name", "scheme"),
    wide(product(("stop", "Hertz", "table"), ("order 2", "order 6")), ("stop", "order 2"), ("table", "order 6")),
)
def test_engines_agree_on_kinks(compiler, name, scheme):
    (a, stored_a), (b, stored_b) = (
        run(instance(name, scheme, native), (1.9, 0.0), 0.037, 60) for native in (False, True)
    )
    h = energies(name, b)
    assert np.max(np.abs(h - h[0])) <= 1e-12 * h.max()
    assert np.max(np.abs(a - b)) <= 1e-9
    assert stored_a == pytest.approx(stored_b, abs=1e-10)


def swing(push: Callable[[float], float]) -> Callable[[float, np.ndarray], list[float]]:
    return lambda _, x: [x[1], -x[0] - push(x[0])]


def located(t: float, force: Callable[[float], float]) -> np.ndarray:
    """(q, p) at time t from (2, 0), integrated piece by piece between the passages of q = 1."""
    from scipy.integrate import solve_ivp

    def passage(_, x):
        return x[0] - 1

    passage.terminal = True  # pyright: ignore[reportFunctionMemberAccess]
    now, x = 0.0, np.array([2.0, 0.0])
    while now < t:
        rates = swing(force if x[0] > 1 else lambda q: 0.0)
        found = solve_ivp(rates, (now, t), x, "DOP853", rtol=1e-12, atol=1e-13, events=passage)
        now, x = found.t[-1], found.y[:, -1]
        if found.status == 1:
            x[0] = 1 + 1e-14 * np.sign(x[1])
    return x


@pytest.mark.parametrize(
    ("name", "force", "scheme", "order"),
    [
        ("stop", lambda q: 20.0, "order 2", 1.6),
        ("stop", lambda q: 20.0, "order 6", 1.6),
        ("contact", lambda q: 100 * (q - 1), "order 2", 1.8),
        ("contact", lambda q: 100 * (q - 1), "order 4", 2.3),
        ("contact", lambda q: 100 * (q - 1), "order 6", 2.3),
    ],
)
def test_the_motion_converges_to_that_with_located_impacts(compiler, name, force, scheme, order):
    """Order 2 over a kink of H, 3 over one of its gradient; means over four phases."""
    exact, unit = located(5.0, force), instance(name, scheme, native=True)
    errors = [
        np.mean([np.max(np.abs(run(unit, (2.0, 0.0), 5.0 / m, m)[0][-1] - exact)) for m in range(n, n + 4)])
        for n in (100, 400)
    ]
    assert np.log2(errors[0] / errors[1]) / 2 >= order


def test_period_of_the_constant_force_stop():
    """2 acos(21/22) in the stop, where q + 20 swings with 22, and the rest of a circle through q = 1 outside."""
    outer = np.sqrt(1 + 22**2 - 21**2)
    period = 2 * np.arccos(21 / 22) + 2 * (np.pi - np.arccos(1 / outer))
    n = 400
    q, p = run(instance("stop", "order 4"), (2.0, 0.0), period / n, n)[0][-1]
    assert (q, p) == pytest.approx((2.0, 0.0), abs=2e-2)


def test_an_impact_costs_few_iterations():
    """Every phase, down to a kink in the last bit of a step: never more than a step over a smooth energy by much."""
    unit = instance("stop", "order 2")
    for shift in [*np.linspace(-0.1, 0.2, 31), 1e-3, 1e-6, 1e-9, 1e-12, 1e-15, 0.0]:
        states, _ = run(unit, (1.0 - shift, 1.0), 0.1, 3)
        h = energies("stop", states)
        assert np.max(np.abs(h - h[0])) <= 1e-13 * h.max()


def test_a_slanted_wall_keeps_the_momentum_along_it():
    """The force of the kink is normal to the wall, in a term of two states."""
    q, p = state("q", 2, start=[0.0, 0.0]), state("p", 2, start=[1.0, 0.2])
    normal = ca.DM([0.6, 0.8])
    model = PHDAE(
        "wall", states=(q, p), structure=(skew(q, p, 1.0),),
        energies=(energy(ca.sumsqr(p.sx) / 2), energy(30 * ca.fmax(ca.dot(normal, q.sx) - 0.5, 0))),
    )  # fmt: skip
    for k in (1, 2, 3):
        unit = PythonInstance(build_model(model, Collocated(k)))
        unit.initialise()
        for i in range(60):
            unit.do_step(0.05 * i, 0.05)
        p1 = unit.x[2:]
        assert p1[0] * 0.8 - p1[1] * 0.6 == pytest.approx(0.8 - 0.12, abs=1e-13)  # along the wall
        assert p1[0] * 0.6 + p1[1] * 0.8 == pytest.approx(-0.76, abs=1e-12)  # back
        assert np.sum(p1**2) == pytest.approx(1.04, rel=1e-12)


@pytest.mark.parametrize("k", [1, 2, 3])
def test_a_rope_keeps_the_angular_momentum(k):
    """A strain energy with a kink: phi(C) that acts in extension only."""
    q, p = state("q", 2, start=[1.0, 0.0]), state("p", 2, start=[0.3, 1.1])
    rope = strain_energy(ca.sumsqr(q.sx), lambda s: 5 * ca.fmax(s - 1.2, 0) ** 2)
    model = PHDAE("rope", states=(q, p), structure=(skew(q, p, 1.0),), energies=(energy(ca.sumsqr(p.sx) / 2), rope))
    unit = PythonInstance(build_model(model, Collocated(k)))
    unit.initialise()
    for i in range(80):
        unit.do_step(0.05 * i, 0.05)
    (a, b), (c, d) = unit.x[:2], unit.x[2:]
    assert a * d - b * c == pytest.approx(1.1, abs=1e-13)
    end = (c * c + d * d) / 2 + 5 * max(a * a + b * b - 1.2, 0) ** 2
    assert end == pytest.approx((0.09 + 1.21) / 2, rel=1e-12)


# -- operations ---------------------------------------------------------------------------------------------------


def test_degree_is_read_from_the_operations():
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p")
    a, b = x[0], x[1]
    assert degree(ca.SX(3), x) == 0 and degree(p**2, x) == 0 and degree(ca.fmax(p, 0) * a * b, x) == 2
    assert degree((a * b + p) ** 3 / p - a, x) == 6 and degree(ca.if_else(p > 0, a**2, b), x) == 2
    for pieces in (ca.fmax(a, 0), ca.fabs(a) * b, ca.if_else(a > 0, a, b), ca.floor(a), ca.sign(a), ca.fmod(a, 2)):
        assert degree(pieces, x) is None
    assert degree(1 / a, x) is None and degree(a**2.5, x) is None and degree(a**9, x) is None


def test_operations_in_pieces_are_named():
    x, p = ca.SX.sym("x"), ca.SX.sym("p")
    assert piecewise(ca.sin(x) * ca.exp(x) + x**2.5, x) == ()
    assert piecewise(ca.fmax(p, 0) * x**2, x) == ()
    assert piecewise(ca.fmax(x, 0) + ca.fabs(x), x) == ("fmax", "fabs")
    assert piecewise(ca.if_else(x > p, x, 0), x) == ("if_else",)
    assert piecewise((x > 1) * x, x) == ("a comparison",)


def test_a_kind_that_is_declared_wrongly_is_refused():
    """What would be booked with a Hessian that is none."""
    for wrong in (
        lambda q: Energy(ca.fmax(q, 0) ** 2, "quadratic"),
        lambda q: strain_energy(ca.fabs(q), lambda s: s**2),
    ):
        with pytest.raises(DeclarationError, match=r"use energy\(H\)"):
            build_model(oscillator(wrong))


def random_energy(rng: np.random.Generator, x: ca.SX) -> ca.SX:
    """A sum of products of operations nested two deep."""
    total = ca.SX(0)
    for _ in range(2):
        inner = [applied(rng.choice(OPERATIONS), x[int(rng.integers(2))] * rng.uniform(0.5, 2), x[int(rng.integers(2))])
                 for _ in range(2)]  # fmt: skip
        total += applied(rng.choice(OPERATIONS), *inner) * rng.uniform(-1, 1)
    return total


@pytest.mark.parametrize(
    ("rule", "k"),
    wide(
        [("general", 1), ("general", 2), ("general", 3), ("joint", 1), ("itoh-abe", 1)],
        *(("general", 2), ("joint", 1)),
    ),
)
def test_directionality_of_random_energies_of_all_operations(rule, k):
    """sum b_i D_i^T W_i = dH = H(x') - H(x), for steps from 1 to 1e-9."""
    rng, x, d, b = np.random.default_rng(17 * k + len(rule)), ca.SX.sym("x", 2), ca.SX.sym("d", 2, k), nodes(k).b
    assert len(OPERATIONS) >= 40 and {getattr(ca, "OP_" + n) for n in OPERATIONS} >= ANALYTIC - {
        ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST
    }  # fmt: skip
    for _ in range(30):
        h = random_energy(rng, x)
        if rule == "general":
            w, dh = gradients.general(h, x, d, nodes(k), np.ones(2))
        else:
            w, dh = (
                gradients.joint_gonzalez(h, x, d, nodes(1)) if rule == "joint" else itoh_abe(h, x, d, symmetric=True)
            )
        f = ca.Function("f", [x, d], [w, dh])
        value = ca.Function("h", [x], [h])
        for size in (1.0, 0.3, 1e-2, 1e-5, 1e-9):
            x0, step = rng.uniform(-2, 2, 2), rng.uniform(-1, 1, (2, k)) * size
            found, change = (v.full() for v in f(x0, step))
            start, end = float(value(x0)), float(value(x0 + step @ b))
            work = float(np.sum(b * np.sum(step * found, axis=0)))
            scale = 1.0 + abs(start) + abs(end) + float(np.sum(np.abs(step) * np.abs(found)))
            assert np.isfinite(found).all(), h
            assert abs(work - change.item()) <= 1e-13 * scale, (h, size)
            assert abs(change.item() - (end - start)) <= 1e-13 * scale, (h, size)
