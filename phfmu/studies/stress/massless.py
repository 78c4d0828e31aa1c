"""Four particles whose first has no mass left: the exact motion that the scheme must tend to.

Springs and bars lead a light particle: with m_1 -> 0 the bar 1-2 and the spring 1-3, at rest, keep |q1 - q2| = |q1 - q3|
= 1 and pull at nothing.  Particles 2 to 4 move as if it were not there; along the circle left to it, particle 1 is free,
its acceleration lies in the plane of q1 - q2 and q1 - q3, whatever its mass.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
M2, M3, M4, K24 = 3.0, 2.3, 1.7, 500.0


def accelerations(q: Array, v: Array) -> Array:
    """Accelerations of the four particles (4 x 3), index reduced: constraints twice differentiated."""
    pull = 2.0 * K24 * ((q[3] - q[1]) @ (q[3] - q[1]) - 1.0) * (q[3] - q[1])  # spring 2-4, on particle 2
    a2, a4, bar, w = pull / M2, -pull / M4, q[3] - q[2], v[3] - v[2]
    tension = (w @ w + bar @ a4) / (bar @ bar * (1.0 / M3 + 1.0 / M4))
    a3, a4 = tension * bar / M3, a4 - tension * bar / M4
    g, rates = q[0] - q[1:3], v[0] - v[1:3]
    curved = np.array([g[0] @ a2, g[1] @ a3]) - (rates**2).sum(axis=1)
    return np.array([g.T @ np.linalg.solve(g @ g.T, curved), a2, a3, a4])


def motion(times: Array) -> Array:
    """Positions (times x 12) without damping, from the start of `four_particle`, by DOP853."""
    from scipy.integrate import solve_ivp

    def rates(_: float, y: Array) -> Array:
        return np.concatenate([y[12:], accelerations(y[:12].reshape(4, 3), y[12:].reshape(4, 3)).ravel()])

    start = np.array([0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0, *[0] * 11, 20.0 / 17.0], float)
    found = solve_ivp(rates, (0.0, times[-1]), start, "DOP853", rtol=1e-11, atol=1e-11, t_eval=times)
    return found.y[:12].T
