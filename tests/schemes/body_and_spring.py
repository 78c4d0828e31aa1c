"""A damped body and a spring: their plans, their units, and their motion in closed form."""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.integrate import solve_ivp

from phfmu import (
    PHDAE,
    TRANSLATIONAL,
    Collocated,
    Port,
    build_model,
    damping,
    energy,
    parameter,
    skew,
    state,
)

M, K, D, K2, END = 1.3, 4.0, 0.2, 2.5, 1.5
START = (0.4, -0.3, 0.2)


def body(size: int | None = None) -> PHDAE:
    """A mass on a hardening spring with a force port (vector or scalar)."""
    q, v = state("q", size, unit="m", start=START[0]), state("v", size, unit="m/s", start=START[1])
    m = parameter("m", M, unit="kg")
    n = q.n
    return PHDAE(
        "body",
        states=(q, v),
        parameters=(m,),
        energies=tuple(energy(K * (q[i] ** 2 / 2 + q[i] ** 4 / 4)) for i in range(n))
        + tuple(energy(m * v[i] ** 2 / 2) for i in range(n)),
        E={v: m},
        structure=(skew(q, v, 1.0),),
        dissipation=(damping(v, D),),
        ports=(Port("flange", TRANSLATIONAL, "effort", {v: 1.0}, size=size),),
    )


def spring() -> PHDAE:
    """x' = velocity, force K2 (x + x^3) on the joint."""
    x = state("x", unit="m", start=START[2])
    return PHDAE(
        "spring",
        states=(x,),
        energies=(energy(K2 * (x**2 / 2 + x**4 / 4)),),
        ports=(Port("end", TRANSLATIONAL, "flow", {x: 1.0}),),
    )


def force(t):
    return 3.0 * np.sin(4.0 * t) + np.exp(-t)


@cache
def driven_exact():
    rate = lambda t, x: [x[1], (force(t) - K * (x[0] + x[0] ** 3) - D * x[1]) / M]  # noqa: E731
    return solve_ivp(rate, (0.0, END), START[:2], "DOP853", rtol=3e-14, atol=1e-15).y[:, -1]


def slope(steps, errors):
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])


@cache
def plan(name: str, k: int, size: int | None = None):
    return build_model(body(size) if name == "body" else spring(), Collocated(k))
