"""Compositions: orders 4 and 6 without dissipation, a named refusal with it."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from phfmu import Collocated, DeclarationError, NativeInstance, PythonInstance, TwoLevel, build_model
from phfmu.components.library import build
from phfmu.components.mechanical.chain import chain
from phfmu.studies.bench.precision.compositions import KAHAN_LI, SUZUKI, ComposedSteps
from tests.engines import ENGINES
from tests.wide import slow

END, LINKS = 0.4, 3
SCHEMES = {
    "two-level": TwoLevel(1),
    "semi-explicit": Collocated(1, name="semi-explicit"),
}
MASS = np.repeat(1.0 + np.arange(LINKS) / (LINKS - 1), 3)


@cache
def exact():
    """DOP853 with the multipliers of the twice differentiated constraints, written out for the chain."""

    def rate(_, x):
        q, v = (
            np.vstack([np.zeros(3), x[: 3 * LINKS].reshape(-1, 3)]),
            np.vstack([np.zeros(3), x[3 * LINKS :].reshape(-1, 3)]),
        )
        G, gamma = np.zeros((LINKS, 3 * LINKS)), np.zeros(LINKS)
        for i in range(LINKS):
            d, w = q[i + 1] - q[i], v[i + 1] - v[i]
            G[i, 3 * i : 3 * i + 3], gamma[i] = d, -w @ w
            if i:
                G[i, 3 * i - 3 : 3 * i] = -d
        free = np.tile([0.0, 0.0, -9.81], LINKS)
        force = np.linalg.solve(G / MASS @ G.T, gamma - G @ free)
        return np.concatenate([x[3 * LINKS :], free + G.T @ force / MASS])

    start = build_model(chain(LINKS)).x0
    return solve_ivp(rate, (0.0, END), start, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]


def take(composed, t, h):
    """One composed step over [t, t + h]."""
    for _ in composed.substeps(t, h):
        pass


def errors(scheme, composition, steps):
    """Errors of q and v at END for each number of steps."""
    model, out = build_model(chain(LINKS), SCHEMES[scheme]), []
    for n in steps:
        instance = NativeInstance(model)
        composed = ComposedSteps(instance, composition)
        for k in range(n):
            take(composed, k * END / n, END / n)
        e = np.abs(instance.x - exact())
        out.append((e[: 3 * LINKS].max(), e[3 * LINKS :].max()))
        assert abs(instance.signal("residual")[0]) < 1e-11
    return np.array(out)


def slopes(e):
    """log2 of the last ratio, for q and v."""
    return np.log2(e[-2] / e[-1])


@pytest.mark.parametrize(
    ("composition", "steps"), [slow((SUZUKI, (20, 40))), (KAHAN_LI, (10, 20))], ids=["suzuki", "kahan-li"]
)
def test_order_is_full_in_positions_and_velocities_of_the_two_level_scheme(composition, steps):
    assert sum(composition.substeps) == pytest.approx(1.0, abs=1e-15)
    assert slopes(errors("two-level", composition, steps)) == pytest.approx(composition.order, abs=0.3)


@pytest.mark.parametrize(
    ("composition", "steps"), [(SUZUKI, (20, 40)), (KAHAN_LI, (20, 40))], ids=["suzuki", "kahan-li"]
)
def test_without_the_velocity_level_velocities_stay_at_order_2_and_positions_at_4(composition, steps):
    q, v = slopes(errors("semi-explicit", composition, steps))
    assert q == pytest.approx(4.0, abs=0.4)
    assert v == pytest.approx(2.0, abs=0.4)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_composed_step_and_the_same_step_back_meet(engine):
    instance = engine(build_model(chain(LINKS), SCHEMES["two-level"]))
    start, composed = instance.x, ComposedSteps(instance, SUZUKI)
    for k in range(4):
        take(composed, k * 0.02, 0.02)
    moved = instance.x
    for k in reversed(range(4)):
        take(composed, (k + 1) * 0.02, -0.02)
    assert np.abs(moved - start).max() > 1e-2
    assert np.abs(instance.x - start).max() < 1e-10


def test_dissipation_is_refused_with_what_fits():
    damped, motor = build("four_particle"), build("dc_motor")
    with pytest.raises(DeclarationError, match=r"four_particle: .*two-level of order 6"):
        ComposedSteps(PythonInstance(build_model(damped)), SUZUKI)
    with pytest.raises(DeclarationError, match="collocated of order 4 or 6"):
        ComposedSteps(PythonInstance(build_model(motor)), SUZUKI)
    undamped = build_model(damped.with_starts({"eta0": 0.0}))
    assert ComposedSteps(PythonInstance(undamped), KAHAN_LI).composition.order == 6
