"""Linkages through singular positions: rows of parallel cranks that lie flat twice per turn."""

from __future__ import annotations

from typing import Any

import numpy as np

from phfmu.studies.stress.case import StressCase, StressOutcome
from phfmu.studies.stress.drive import effort, instance, record

TARGET = "four_bar"
G = 9.81


def cranks(n: int) -> Any:
    """n windows: n + 1 parallel cranks of 1 m with 1 kg at their ends, joined by bars of 1 m; 1 m/s at the top.

    Windows share their cranks; when all bars lie in one line the constraints lose rank and the cranks may fold
    the other way.  Source: benchmark A02 of the IFToMM library (geometry, start velocity), point masses here.
    """
    from phfmu.components.mechanical.multibody import Multibody

    body = Multibody("four_bar", dim=2)
    ends = [body.particle(1.0, (float(i), 1.0), v=(1.0, 0.0)) for i in range(n + 1)]
    for i, end in enumerate(ends):
        body.bar(body.support((float(i), 0.0)), end)
        if i:
            body.bar(ends[i - 1], end)
    body.gravity((0.0, -G))
    return body.build()


def pendulum(times: np.ndarray) -> np.ndarray:
    """Angle from the top of one crank: the exact motion of all, theta'' = g sin theta."""
    from scipy.integrate import solve_ivp

    s = solve_ivp(
        lambda t, y: [y[1], G * np.sin(y[0])],
        (0.0, times[-1]),
        [0.0, 1.0],
        "DOP853",
        rtol=1e-12,
        atol=1e-12,
        t_eval=times,
    )
    return s.y[0]


def flat(n: int, h: float, order: int) -> StressOutcome:
    """20 s with some ten turns: the links stay parallel and follow the pendulum."""
    r = record(instance(cranks(n), order=order), h, round(20.0 / h))
    q = r.x[:, : 2 * (n + 1)].reshape(-1, n + 1, 2) - np.column_stack([np.arange(n + 1), np.zeros(n + 1)])
    parallel = float(np.abs(q - q[:, :1]).max())
    theta = pendulum(h * np.arange(1, len(q) + 1))
    error = float(np.hypot(q[:, 0, 0] - np.sin(theta), q[:, 0, 1] - np.cos(theta)).max())
    turns = float(np.abs(theta).max() / (2 * np.pi))
    text = f"{turns:.1f} turns; parallel to {parallel:.1e}, position error {error:.1e} m, energy {r.drift:.1e} H0; {effort(r)}"
    return StressOutcome(text, parallel <= 1e-6 and error <= 1e-3)


def stopped_flat() -> StressOutcome:
    """A step that ends 3e-5 rad from the flat position, where the constraints have lost rank to rounding."""
    from phfmu.outcome.status import StepFailure, remedy

    try:
        return flat(1, 0.0005, 6)
    except StepFailure as failure:
        return StressOutcome(
            f"typed error: {failure}", failure.equation.startswith("equation of lambda") and bool(remedy(failure))
        )


def short_steps(h: float, order: int) -> StressOutcome:
    """The heavy top about its centre, a singular mass matrix; delta of the factors beside h^2."""
    from phfmu.components.mechanical.heavy_top import heavy_top

    r = record(instance(heavy_top(precession=1.0), order=order), h, 20)
    text = f"{effort(r)}; balance {r.balance:.1e}, g {r.position:.1e}, Dg v {r.velocity:.1e}"
    return StressOutcome(
        text, r.position <= 1e-12 and r.velocity <= 1e-10 and r.balance <= 1e-11 and "substep" not in r.solved
    )


CRITERION = "parallel to 1e-6, error <= 1e-3"
CASES = (
    *(StressCase(TARGET, f"{n} windows through the flat position, h = {h} s, order {o}", CRITERION,
                 lambda n=n, h=h, o=o: flat(n, h, o))
      for n, h, o in ((2, 0.002, 2), (2, 0.002, 6), (2, 0.001, 6), (40, 0.002, 2))),
    StressCase(TARGET, "1 window, h = 0.0005 s, order 6: a step ends 3e-5 rad from flat",
               f"{CRITERION}; or an error with the row", stopped_flat),
    *(StressCase("heavy_top", f"20 steps of {h:g} s from the start, order {o}",
                 "g <= 1e-12, Dg v <= 1e-10, balance <= 1e-11, unhalved",
                 lambda h=h, o=o: short_steps(h, o)) for h, o in ((1e-6, 2), (1e-7, 6))),
)  # fmt: skip
