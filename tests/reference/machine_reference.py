"""Synchronous machine in flux coordinates, three phases a b c and rotor windings (f, kd, kq).

State x = (psi, p, theta); psi_k in Wb, p = J omega in kg m2 rad/s, theta the electrical angle of the d axis
from phase a in rad (one pole pair). Motor sign: v and I into the machine, a positive tau accelerates.

    psi'   = (v_abc, V_f, 0, 0) - R I,    I = L(theta)^-1 psi
    p'     = -d omega + 1/2 I^T L'(theta) I + tau
    theta' = omega = p / J

L(theta), with alpha = (0, 2 pi/3, -2 pi/3) and the q axis 90 degrees ahead of d:

    L_ij = (Laa0 if i = j else -Lab0) + Laa2 cos(2 theta - alpha_i - alpha_j)      stator, i, j in a b c
    L_ij = M_j cos(theta - alpha_i)  (j on d),   -M_j sin(theta - alpha_i)  (j on q)
    L_ij = constant                                                                rotor

A series line (Rx, Lx per phase) that carries the stator current is lumped into the machine: Rx is added to the
stator resistances and Lx to the abc diagonal of L; psi_abc is then the total flux (machine + Lx I) and v the
voltage at the far end of the line. Source: notes/power.md 1.1, checked against notes/power.md 1.5 (steady state).
"""

from dataclasses import dataclass, field

import numpy as np

ALPHA = np.array([0.0, 2.0, -2.0]) * np.pi / 3.0
ALPHA_SUM = ALPHA[:, None] + ALPHA[None, :]


@dataclass(frozen=True)
class MachineReference:
    """Machine with optional series line; `data` is one entry of machines.json, d the friction in N m s/rad."""

    data: dict
    d: float
    Rx: float = 0.0
    Lx: float = 0.0
    R: np.ndarray = field(init=False)
    J: float = field(init=False)
    _constant: np.ndarray = field(init=False)
    _on_d: np.ndarray = field(init=False)
    _on_q: np.ndarray = field(init=False)

    def __post_init__(self):
        data, n = self.data, 3 + len(self.data["axis"])
        constant = np.zeros((n, n))
        constant[:3, :3] = -data["Lab0"]
        np.fill_diagonal(constant[:3, :3], data["Laa0"] + self.Lx)
        constant[3:, 3:] = data["L_rotor"]
        mutual = np.array(data["M_stator_rotor"])
        direct = np.array([axis == "d" for axis in data["axis"]])
        for name, value in (
            ("R", np.array([data["Ra"] + self.Rx] * 3 + list(data["R_rotor"]))),
            ("J", data["J"]),
            ("_constant", constant),
            ("_on_d", np.where(direct, mutual, 0.0)),
            ("_on_q", np.where(direct, 0.0, mutual)),
        ):
            object.__setattr__(self, name, value)

    def inductance(self, theta):
        """Return L(theta), n x n, in H (line included)."""
        L = self._constant.copy()
        L[:3, :3] += self.data["Laa2"] * np.cos(2.0 * theta - ALPHA_SUM)
        angle = theta - ALPHA
        coupling = np.outer(np.cos(angle), self._on_d) - np.outer(np.sin(angle), self._on_q)
        L[:3, 3:], L[3:, :3] = coupling, coupling.T
        return L

    def inductance_derivative(self, theta):
        """Return dL/dtheta, n x n, in H/rad."""
        dL = np.zeros_like(self._constant)
        dL[:3, :3] = -2.0 * self.data["Laa2"] * np.sin(2.0 * theta - ALPHA_SUM)
        angle = theta - ALPHA
        coupling = -np.outer(np.sin(angle), self._on_d) - np.outer(np.cos(angle), self._on_q)
        dL[:3, 3:], dL[3:, :3] = coupling, coupling.T
        return dL

    def currents(self, psi, theta):
        """Return I = L(theta)^-1 psi in A."""
        return np.linalg.solve(self.inductance(theta), psi)

    def fluxes(self, I, theta):
        """Return psi = L(theta) I in Wb."""
        return self.inductance(theta) @ np.asarray(I)

    def rhs(self, psi, p, theta, v, Vf, tau):
        """Return (psi', p', omega, I) for the terminal (far-end) voltage v, field voltage Vf and torque tau."""
        I = self.currents(psi, theta)
        omega = p / self.J
        psi_dot = -self.R * I
        psi_dot[:3] += v
        psi_dot[3] += Vf
        torque = 0.5 * I @ self.inductance_derivative(theta) @ I
        return psi_dot, -self.d * omega + torque + tau, omega, I

    def current_rate(self, psi_dot, omega, theta, I):
        """Return I' = L^-1 (psi' - omega L' I) in A/s (differentiated psi = L I)."""
        return np.linalg.solve(self.inductance(theta), psi_dot - omega * self.inductance_derivative(theta) @ I)

    def node_voltage(self, v, I_abc, I_abc_dot):
        """Return the voltage between line and machine, v - Rx I - Lx I', in V."""
        return v - self.Rx * I_abc - self.Lx * I_abc_dot
