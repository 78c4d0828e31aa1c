"""The step-down converter of the library, solved exactly by matrix exponentials from one instant of switching to the next."""

from __future__ import annotations

from math import ceil, exp
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.optimize import brentq

F, L, C, R, COIL = 20e3, 100e-6, 47e-6, 4.0, 0.05


def exact(stop: float, duty: Any, r: float = R) -> NDArray[np.float64]:
    """[flux of the coil, charge of the capacitor] at `stop`; `duty`: of the period that begins at t."""

    def over(x: NDArray[np.float64], h: float, u: float) -> NDArray[np.float64]:
        A = np.array([[-COIL / L, -1 / C, u], [1 / L, -1 / (r * C), 0.0], [0.0, 0.0, 0.0]])
        return (expm(A * h) @ [*x, 1.0])[:2]

    x = np.zeros(2)
    for n in range(ceil(stop * F - 1e-9)):
        t = n / F
        on = min(duty(t) / F, stop - t)
        x, left = over(x, on, 24.0), min(1 / F, stop - t) - on
        if left <= 0:
            break
        if over(x, left, -0.1)[0] > 0:  # the diode conducts until the next period
            x = over(x, left, -0.1)
            continue
        ends = brentq(lambda h, x=x: over(x, h, -0.1)[0], 1e-12, left, xtol=1e-22, rtol=1e-15) if x[0] > 0 else 0.0
        x = np.array([0.0, over(x, ends, -0.1)[1] * exp(-(left - ends) / (r * C))])
    return x
