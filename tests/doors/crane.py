"""A trolley with a hanging load, and its motions by Opti."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from phfmu import PHDAE, TRANSLATIONAL, Port, casadi_function, energy, parameter, skew, state
from phfmu.doors.step_function import StepFunction


def crane() -> PHDAE:
    """Trolley M at x, load m on a rope l at an angle; M(q) = [[M + m, m l cos], [m l cos, m l^2]],

    H = (p, L) M(q)^-1 (p, L)/2 + m g l (1 - cos angle).
    """
    x, angle = state("x", unit="m", nominal=1.0), state("angle", unit="rad", nominal=0.1)
    p, L = state("p", unit="kg.m/s", nominal=100.0), state("L", unit="kg.m2/s", nominal=100.0)
    M, m = parameter("M", 200.0, unit="kg"), parameter("m", 100.0, unit="kg")
    rope, g = parameter("l", 3.0, unit="m"), parameter("g", 9.81, unit="m/s2")
    c, s = ca.cos(angle.sx), ca.sin(angle.sx)
    own = m * rope**2 * p**2 - 2 * m * rope * c * p * L + (M + m) * L**2
    return PHDAE(
        "crane",
        states=(x, angle, p, L),
        parameters=(M, m, rope, g),
        energies=(energy(own / (2 * m * rope**2 * (M + m * s**2))), energy(m * g * rope * (1 - c))),
        structure=(skew(x, p, 1.0), skew(angle, L, 1.0)),
        ports=(Port("trolley", TRANSLATIONAL, "effort", {p: 1.0}, description="drive"),),
        description="trolley with a hanging load",
    )


def moved(step: StepFunction, way: float, n: int, options: dict[str, Any] | None = None) -> tuple[Any, Any, Any]:
    """Forces (n) that move the crane by `way` from rest to rest at least sum of u^2, states (4 x n+1), the solved problem."""
    opti, f = ca.Opti(), casadi_function(step, ["x", "u"])
    X, U = opti.variable(4, n + 1), opti.variable(1, n)
    scale = ca.DM([way, way, 300 * way, 300 * way])
    force = 300.0 * way
    for k in range(n):
        opti.subject_to((f(scale * X[:, k], force * U[:, k])[0] - scale * X[:, k + 1]) / scale == 0)
    opti.subject_to(X[:, 0] == 0)
    opti.subject_to(scale * X[:, n] == ca.DM([way, 0, 0, 0]))
    opti.minimize(ca.sumsqr(U) / n)
    opti.set_initial(X[0, :], np.linspace(0, 1, n + 1))
    opti.solver(
        "ipopt", {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-10, **(options or {})}
    )
    found = opti.solve()
    return force * np.atleast_1d(found.value(U)), np.array(scale * ca.DM(found.value(X))), opti
