"""Synchronous machines and networks in phase coordinates: equations of their own, integrated by DOP853, for comparison.

The fluxes of the windings a, b, c, rotor are L(theta) I with every entry of L written out, psi' = v - R I,
p' = tau - d omega + 1/2 I L' I.  A series R, L in front of the stator stands on the diagonal.  Nothing but the constants of the
machine sets is taken from the package.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp

ANGLES = np.array([0.0, 2 * np.pi / 3, -2 * np.pi / 3])


class PhaseMachine:
    """Inductances of a machine, with R [ohm] and L [H] of a line in series with each phase."""

    def __init__(self, data, R: float = 0.0, L: float = 0.0):
        self.n = 3 + len(data.axis)
        self.a0 = (data.Ld + data.Lq + data.L0) / 3.0
        self.a2 = (data.Ld - data.Lq) / 3.0
        self.b0 = ((data.Ld + data.Lq) / 2.0 - data.L0) / 3.0
        self.M, self.d_axis = np.array(data.M_stator_rotor), np.array([a == "d" for a in data.axis])
        self.constant = np.zeros((self.n, self.n))
        self.constant[3:, 3:] = data.L_rotor
        self.constant[:3, :3] = -self.b0 + (self.a0 + self.b0 + L) * np.eye(3)
        self.R = np.array([data.Ra + R] * 3 + list(data.R_rotor))
        self.J, self.d = data.J / data.pole_pairs**2, data.d / data.pole_pairs**2
        self.sum = ANGLES[:, None] + ANGLES[None, :]

    def inductance(self, theta: float) -> tuple[np.ndarray, np.ndarray]:
        """L(theta) and its derivative."""
        L, slope = self.constant.copy(), np.zeros((self.n, self.n))
        L[:3, :3] += self.a2 * np.cos(2 * theta - self.sum)
        slope[:3, :3] = -2 * self.a2 * np.sin(2 * theta - self.sum)
        c, s = np.cos(theta - ANGLES)[:, None], np.sin(theta - ANGLES)[:, None]
        L[:3, 3:] = self.M * np.where(self.d_axis, c, -s)
        slope[:3, 3:] = self.M * np.where(self.d_axis, -s, -c)
        L[3:, :3], slope[3:, :3] = L[:3, 3:].T, slope[:3, 3:].T
        return L, slope

    def rates(self, x: np.ndarray, v: np.ndarray, Vf: float, tau: float) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of (psi, p, theta) at phase voltages v, and the currents."""
        L, slope = self.inductance(x[-1])
        I = np.linalg.solve(L, x[: self.n])
        u = np.zeros(self.n)
        u[:3], u[3] = v, Vf
        w = x[-2] / self.J
        return np.concatenate([u - self.R * I, [tau - self.d * w + 0.5 * I @ slope @ I, w]]), I


def integrated(
    rates: Callable, start: np.ndarray, times: np.ndarray, stops: tuple[float, ...] = (), atol: float = 1e-9
) -> np.ndarray:
    """States at `times` (n x states); `rates(t, x, k)` with k the number of `stops` passed, where the integration begins anew."""
    out, x, marks = [], start, [times[0], *stops, times[-1]]
    for k, (a, b) in enumerate(zip(marks[:-1], marks[1:], strict=True)):
        if b <= a:
            continue
        inside = times[(times >= a) & (times < b)]
        found = solve_ivp(lambda t, y, k=k: rates(t, y, k), (a, b), x, "DOP853", [*inside, b], rtol=1e-12, atol=atol)
        assert found.success, found.message
        out.append(found.y[:, :-1].T)
        x = found.y[:, -1]
    return np.vstack([*out, x])
