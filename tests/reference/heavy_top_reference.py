"""A heavy symmetric top from its Euler equations and a rotation matrix, for the disc on a stem in directors.

    J w' = (J w) x w + m (stem e3) x (R^T g),   R' = R [w]x,   J = diag(E + m stem^2, E + m stem^2, 2 E),   E = m r^2/4

in the body frame; directors are the columns of R, the centre is stem d3.
"""

import numpy as np
from scipy.integrate import solve_ivp


def heavy_top(stop, mass=15.0, radius=0.5, stem=1.0, spin=40.0, tilt=1.0, precession=0.0):
    """Return q (12: centre, d1, d2, d3) and v (12) at `stop`."""
    inertia = mass * radius**2 / 4
    J = np.array([inertia + mass * stem**2] * 2 + [2 * inertia])
    R = np.array([[np.cos(tilt), 0, np.sin(tilt)], [0, 1, 0], [-np.sin(tilt), 0, np.cos(tilt)]])
    w = R.T @ (spin * R[:, 2] + precession * np.array([0, 0, 1.0]))

    def rhs(_, y):
        w, R = y[:3], y[3:].reshape(3, 3)
        torque = mass * stem * np.cross([0, 0, 1.0], R.T @ [0, 0, -9.81])
        return np.concatenate([(np.cross(J * w, w) + torque) / J, (R @ cross(w)).ravel()])

    y = solve_ivp(rhs, (0, stop), np.concatenate([w, R.ravel()]), "DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    w, R = y[:3], y[3:].reshape(3, 3)
    rate = R @ cross(w)
    q = np.concatenate([stem * R[:, 2], *R.T])
    return q, np.concatenate([stem * rate[:, 2], *rate.T])


def cross(w):
    """Return the matrix of w x."""
    return np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
