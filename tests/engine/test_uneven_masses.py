"""Chains whose masses are a million times apart: the light ones swing faster than any step, the heavy ones move as if alone.

Two rods that stay stretched carry the heavy end as one rod of 2 m does; the elbow between them swings at some 1e3 rad/s.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from phfmu import Monolithic, NativeInstance, Options, PythonInstance, StepFailure, build_model, default_scheme, run
from phfmu.components.mechanical.chain import chain
from phfmu.discretise.model import Model
from phfmu.outcome.limits import LIMITS
from phfmu.outcome.status import Status, remedy
from tests.wide import wide

STEPS = (0.02, 0.01, 0.005, 0.002)


def model(order: int, n: int = 2, ratio: float = 1e6, dim: int = 2) -> Model:
    declaration = chain(n, dim=dim, mass=1.0 / ratio, last=ratio, speed=0.0)
    return build_model(declaration, default_scheme(declaration, order))


def one_rod(stop: float) -> tuple[np.ndarray, float]:
    """Place of the heavy end after its fall from the horizontal on one rod of 2 m, and the force in that rod."""
    found = solve_ivp(lambda _, s: [s[1], -9.81 / 2 * np.cos(s[0])], (0, stop), [0.0, 0.0], rtol=1e-12, atol=1e-13)
    angle, w = found.y[:, -1]
    return 2 * np.array([np.cos(angle), np.sin(angle)]), float(2 * w**2 - 9.81 * np.sin(angle))


@pytest.mark.parametrize("h", wide(STEPS, 0.01))
def test_the_heavy_end_moves_as_on_one_rod(h: float, compiler: None) -> None:
    """At every step: at 0.01 s Newton's method once found solutions with rods pressed by 148 N, then none at 0.97 s."""
    unit, stop = NativeInstance(model(6)), 1.5
    rows = unit.run(0.0, h, round(stop / h), ["stored", "moved", "signals"])
    assert np.abs(rows["stored"]).max() <= 1e-14 * rows["moved"].max()
    place, _ = one_rod(stop)
    assert unit.x[2:4] == pytest.approx(place, abs=2e-6)
    force = rows["signals"][:, unit.layout["a"]]
    for i in range(round(0.2 / h), round(stop / h), round(0.1 / h)):
        assert force[i] == pytest.approx(one_rod((i + 0.5) * h)[1], rel=0.02)
    assert unit.counts["iterations"] <= 12 * stop / h


#: more than one light mass in steps of 0.02 s: where rods go slack, solutions with rods pressed hard are as near
CHAINS = [
    (n, order, dim, h) for n in (2, 3, 10) for order in (2, 6) for dim in (2, 3) for h in STEPS if n == 2 or h < 0.02
]


@pytest.mark.parametrize(("n", "order", "dim", "h"), wide(CHAINS, (2, 6, 2, 0.005)))
def test_every_step_size_runs_and_closes(n: int, order: int, dim: int, h: float, compiler: None) -> None:
    """Also past the turn, where the rods go slack for an instant; with delta steps were accepted that missed 1e-11 J."""
    m = model(order, n, dim=dim)
    result = run(Monolithic(m, NativeInstance(m)), Options(stop=3.0, step=h))
    assert result.ledger.summary().closed


@pytest.mark.parametrize("ratio", wide([1e4, 1e6], 1e6))
@pytest.mark.parametrize("order", [2, 6])
def test_both_engines_find_the_same_steps(order: int, ratio: float, compiler: None) -> None:
    """And steps after a restored state are those that were taken, to the last bit."""
    m = model(order, ratio=ratio)
    units: list[Any] = [NativeInstance(m), PythonInstance(m), NativeInstance(m)]
    for unit in units[:2]:
        unit.run(0.0, 0.01, 20)
    units[2].set_state(units[0].get_state())
    for unit in units:
        unit.run(0.2, 0.01, 10)
    assert units[0].x == pytest.approx(units[1].x, abs=1e-8)
    assert units[0].x.tobytes() == units[2].x.tobytes()


def test_where_iterations_run_out_no_more_is_said_than_was_tried() -> None:
    """Shorter substeps were not tried: a shorter step is the remedy; where they were, it is none."""
    out, all_tried = (
        StepFailure(
            Status.NO_CONVERGENCE, "chain", 0.975, 1.25e-3, residual=3e-3, floor=6e-16, update=1.86, spent=spent
        )
        for spent in (int(LIMITS["MOST_ITERATIONS"]) + 20, 400)
    )
    assert "take steps of 0.00125 s or shorter" in remedy(out) and "no step may take more" in str(out)
    assert "substeps down to 0.00125 s failed too" in remedy(all_tried)
    assert "smallest" not in str(out)


def test_the_remedy_for_iterations_that_ran_out_is_true(compiler: None) -> None:
    """A mass 1e9 times lighter is too much for order 6 in steps of 0.05 s; those that are advised pass the place."""
    m = model(6, ratio=1e9)
    with pytest.raises(StepFailure) as refused:
        NativeInstance(m).run(0.0, 0.05, 10)
    failure = refused.value
    assert failure.ran_out and f"take steps of {failure.h:.3g} s or shorter" in str(failure)
    assert "substeps down to" in failure.tried
    unit = NativeInstance(m)
    unit.run(0.0, failure.h, round(0.5 / failure.h))
    assert unit.x[2:4] == pytest.approx(one_rod(unit.time)[0], abs=1e-4)
