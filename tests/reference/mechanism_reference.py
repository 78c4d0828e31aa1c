"""Mechanisms in other coordinates, and published values: no code of the package is in them."""

from __future__ import annotations

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp

G = 9.81

#: at 0.03 s; E. Hairer, G. Wanner; Test Set for IVP Solvers, problem andrews
ANDREWS = {
    "beta": 15.81077119629904, "theta": -15.75637105984298, "gamma": 0.04082224013073101, "phi": -0.5347301163226948,
    "delta": 0.5244099658805304, "omega": 0.5347301163226948, "epsilon": 1.048080741042263,
}  # fmt: skip

#: at t = 3: F. Mazzia, C. Magherini, Test Set for Initial Value Problem Solvers, car axis
CAR_AXIS = (0.0493455784275402809, 0.496989460230171154, 1.04174252488542151, 0.373911027265361257)


def parallel(n: int, times: np.ndarray) -> np.ndarray:
    """B0 of n windows: all cranks turn like one pendulum."""
    rate = G * ((n + 1) / 2 + n) / ((n + 1) / 3 + n)
    s = solve_ivp(
        lambda _, y: [y[1], rate * np.sin(y[0])], (0, times[-1]), [0.0, 1.0], "DOP853", times, rtol=1e-13, atol=1e-13
    )
    return np.stack([np.sin(s.y[0]), np.cos(s.y[0])])


def governor(stop: float) -> np.ndarray:
    """s and the dissipated energy of the flyball governor in shaft angle, arm angle and s, by a stiff method."""
    bar, cube, ball, k, c = 0.3, 3.0, 5.0, 8e5, 4e4
    q, w = (
        ca.SX.sym("q", 2),
        ca.SX.sym("w", 3),
    )  # angle of the arms from the downward vertical, s; rates with the shaft's
    thin, long = bar * 2e-4 / 12, bar * (1.0 + 1e-4) / 12
    arm = long + bar * 0.25 + ball
    r = 0.05 + ca.sin(q[0]) * 0.5
    across = long * ca.sin(q[0]) ** 2 + thin * ca.cos(q[0]) ** 2 + bar * r**2 + ball * (0.05 + ca.sin(q[0])) ** 2
    shaft = thin + cube * 0.01 / 6
    kinetic = 0.5 * shaft * w[2] ** 2 + across * w[2] ** 2 + arm * w[0] ** 2 + 0.5 * cube * w[1] ** 2
    d = ca.sqrt((0.5 * ca.sin(q[0])) ** 2 + (1.0 - 0.5 * ca.cos(q[0]) - q[1]) ** 2)
    potential = G * (cube * q[1] - 2 * (0.5 * bar + ball) * ca.cos(q[0])) + k * (d - 0.5) ** 2
    rate = ca.jacobian(d, q) @ w[:2]
    m = ca.hessian(kinetic, w)[0]
    force = ca.gradient(kinetic, q) - ca.gradient(potential, q) - 2 * c * rate * ca.gradient(d, q)
    force = ca.vertcat(force, 0) - ca.jacobian(m @ w, q) @ w[:2]
    f = ca.Function("f", [q, w], [ca.vertcat(w[:2], ca.solve(m, force), 2 * c * rate**2)])
    start = np.array([np.pi / 3, 0.5, 0, 0, 2 * np.pi, 0])
    jac = ca.Function("J", [q, w], [ca.jacobian(f(q, w), ca.vertcat(q, w))])
    s = solve_ivp(
        lambda _, x: np.array(f(x[:2], x[2:5])).ravel(), (0, stop), start, "Radau", rtol=1e-10, atol=1e-12,
        jac=lambda _, x: np.hstack([np.array(jac(x[:2], x[2:5])), np.zeros((6, 1))]),
    )  # fmt: skip
    return s.y[[1, 5], -1]
