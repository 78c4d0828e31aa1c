"""Kernels in differences of their arguments; the update in runs."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from phfmu.components.mechanical.four_particle import four_particle
from phfmu.discretise.model import build_model, default_scheme
from phfmu.engine.build.derived import update_runs
from phfmu.plan.address import Address, gradient, increment
from phfmu.plan.differences import differences, in_differences
from phfmu.plan.spec import Spec


def spring(energy: object) -> Spec:
    """energy((x1 - x0)^2 at the step's end) of two coordinates, two nodes; a force and the energy of the ledger."""
    x, d = ca.SX.sym("x", 2), ca.SX.sym("D", 2, 2)
    y = [(Address(increment, j, i), d[j, i]) for i in range(2) for j in range(2)]
    end = x + ca.mtimes(d, ca.DM([0.5, 0.5]))
    expr = energy((end[1] - end[0]) ** 2)  # pyright: ignore[reportCallIssue]
    return Spec(0, x, ca.SX(0, 1), y, [(Address(gradient), 0, ca.gradient(expr, x)[0])], stored=expr)


def values(spec: Spec, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    symbols = ca.vertcat(*(s for _, s in spec.y))
    f = ca.Function("f", [spec.x, symbols], [spec.out[0][2], ca.SX(spec.stored)])
    return np.array(f(x, y)).ravel()


def test_a_spring_is_worked_out_in_its_length() -> None:
    """The same function with fewer operations; far from the origin it keeps the digits the sum of both loses."""
    plain = spring(lambda s: ca.sin(s) + s**2)
    better = in_differences(plain)
    size = [ca.Function("f", [s.x, *(e for _, e in s.y)], [s.stored]).n_instructions() for s in (plain, better)]
    assert size[1] < size[0]
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-1, 1, 2), rng.uniform(-1, 1, 4)
    assert values(better, x, y) == pytest.approx(values(plain, x, y), rel=1e-13)
    far = values(better, x + 2.0**40, y)
    assert far == pytest.approx(values(better, (x + 2.0**40) - 2.0**40, y), rel=1e-13)
    assert values(plain, x + 2.0**40, y) != pytest.approx(far, rel=1e-6)


def test_what_depends_on_more_than_differences_stays() -> None:
    """A branch that sampling would not meet, and a function of the coordinates themselves."""
    branch = spring(lambda s: ca.if_else(s > 1e3, s, s**2))
    assert in_differences(branch) is branch
    x, y = ca.SX.sym("x", 2), ca.SX.sym("y")
    ground = Spec(0, x, ca.SX(0, 1), [(Address(increment), y)], [(Address(gradient), 0, x[0] * x[1] + y)])
    assert in_differences(ground) is ground


def test_pairs_are_found() -> None:
    x = ca.SX.sym("x", 5)
    f = ca.Function("f", [x], [ca.sqrt((x[3] - x[0]) ** 2) + x[1] * (x[4] - x[2])])
    assert set(differences(f, 0).pairs) == {(3, 0), (4, 2), (1, -1)}


@pytest.mark.parametrize("order", [2, 6])
def test_runs_of_the_update(order: int) -> None:
    """Four particles: one run over all 24 states; it gives what the table of the plan gives."""
    d = four_particle()
    plan = build_model(d, default_scheme(d, order)).step
    runs = update_runs(plan)
    assert (runs["nupdate"], runs["update_x"], runs["update_n"]) == (1, [0], [24])
    w = np.random.default_rng(1).uniform(-1, 1, plan.nw)
    change = sum(c * w[first : first + 24] for first, c in zip(runs["update_w"], runs["update_c"], strict=True))
    assert change == pytest.approx(np.bincount(plan.update_x, plan.update_c * w[plan.update_w], plan.nx), rel=1e-14)


def test_what_cancels_is_no_difference() -> None:
    """x1/|x| squared and added up is 1 everywhere; in differences it would be 0/0."""
    x, y = ca.SX.sym("x", 2), ca.SX.sym("y")
    r = ca.sqrt(ca.sumsqr(x))
    one = Spec(
        0, x, ca.SX(0, 1), [(Address(increment), y)], [(Address(gradient), 0, ((x[0] / r) ** 2 + (x[1] / r) ** 2) * y)]
    )
    assert in_differences(one) is one
