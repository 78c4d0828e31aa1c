"""A scheme with unknowns of its own, written on a page of the docs and nowhere else: the package knows it by its protocol only.

Midpoint collocation keeps g(q) of a holonomic model, its velocities come off the constraint.  At the end of each step an
impulse puts them back, what that costs is a numerical loss:

    v' = v* + s,   s = Dg(q')^T mu,   Dg(q') v' = 0,   loss = -(H(v') - H(v*)) = -s^T (v* + s/2)        (M = 1)
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import root

from phfmu import PHDAE, Holonomic, PythonInstance, algebraic, build_model, energy, skew, state
from phfmu.schemes.scheme import Scheme
from tests.engines import ENGINES

PAGE = Path(__file__).parents[2] / "docs" / "internals" / "add-a-part.md"


@pytest.fixture(scope="module")
def Kicked() -> Callable[[], Scheme]:
    """The class as the page has it."""
    (block,) = re.findall(r"^```python\n(# kicked\.py\n.*?)^```$", PAGE.read_text(encoding="utf-8"), re.M | re.S)
    space: dict[str, Callable[[], Scheme]] = {}
    exec(compile(block, PAGE.name, "exec"), space)
    return space["Kicked"]


GRAVITY = 9.81
START = np.array([0.6, -0.8, 0.8, 0.6])  # on the unit circle, velocity along it


@pytest.fixture(scope="module")
def pendulum() -> PHDAE:
    q, v = state("q", 2, start=START[:2]), state("v", 2, start=START[2:])
    lam = algebraic("lambda")
    return PHDAE(
        "pendulum", states=(q, v), algebraics=(lam,), structure=(skew(q, v, 1.0),),
        energies=(energy(ca.sumsqr(v.sx) / 2), energy(GRAVITY * q.sx[1])),
        constraints=(Holonomic(lam, (ca.sumsqr(q.sx) - 1) / 2),),
    )  # fmt: skip


def by_hand(x: np.ndarray, h: float) -> np.ndarray:
    """One step from its equations, without the package."""

    def residual(w: np.ndarray) -> np.ndarray:
        q1, v1, lam, mu = w[:2], w[2:4], w[4], w[5]
        middle, force = (x[:2] + q1) / 2, np.array([0.0, -GRAVITY])
        star = x[2:] + h * (force - middle * lam)  # v*
        return np.concatenate([q1 - x[:2] - h * (x[2:] + star) / 2, v1 - star - q1 * mu, [(q1 @ q1 - 1) / 2, q1 @ v1]])

    return root(residual, np.concatenate([x, [10.0, 0.0]]), tol=1e-13).x[:4]


@pytest.mark.parametrize("engine", ENGINES)
def test_a_scheme_with_unknowns_of_its_own_runs_in_both_engines(
    pendulum: PHDAE, Kicked: Callable[[], Scheme], engine: type
) -> None:
    """Its steps are those of the equations solved by hand; both constraints hold, the ledger closes with its loss."""
    model = build_model(pendulum, Kicked())
    assert model.step.nw == 5 + 1 + 2 and model.loses_energy and "impulse on v[1]" in model.row_names
    instance, x, h, lost = engine(model), START, 0.02, 0.0
    for k in range(40):
        instance.do_step(k * h, h)
        x = by_hand(x, h)
        assert instance.x == pytest.approx(x, abs=1e-10)
        now = instance.x
        assert abs(now[:2] @ now[:2] - 1) <= 1e-13 * (k + 1) and abs(now[:2] @ now[2:]) <= 1e-12
        row = instance.ledger()
        balance = np.sum(row["stored"] + row["dissipated"] + row["numerical"] - row["supplied"])
        assert abs(balance) <= 1e-12
        lost += float(np.sum(row["numerical"]))
    energies = [y[2:] @ y[2:] / 2 + GRAVITY * y[1] for y in (START, instance.x)]
    assert lost == pytest.approx(energies[0] - energies[1], abs=1e-11) and abs(lost) > 1e-9


def test_it_converges_with_its_order(pendulum: PHDAE, Kicked: Callable[[], Scheme]) -> None:
    """Against the angle of the pendulum by another method."""
    model, stop = build_model(pendulum, Kicked()), 0.4
    start = [np.arctan2(START[0], -START[1]), START[2] * -START[1] + START[3] * START[0]]
    found = solve_ivp(lambda t, y: [y[1], -GRAVITY * np.sin(y[0])], (0, stop), start, rtol=1e-12, atol=1e-12)
    angle = found.y[0, -1]
    exact, errors = np.array([np.sin(angle), -np.cos(angle)]), []
    for n in (20, 40, 80):
        instance = PythonInstance(model)
        for k in range(n):
            instance.do_step(k * stop / n, stop / n)
        errors.append(float(np.max(np.abs(instance.x[:2] - exact))))
    assert np.log2(np.array(errors[:-1]) / errors[1:]) == pytest.approx(2.0, abs=0.1)
