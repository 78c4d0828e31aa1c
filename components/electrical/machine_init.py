"""Steady state of a synchronous machine at a given terminal power."""

from __future__ import annotations

from cmath import exp, phase
from dataclasses import dataclass
from math import pi, sqrt

import numpy as np

from phfmu.components.electrical.machine_data import COUPLING, MachineData, MachineDataError

ALPHA = (0.0, 2.0 * pi / 3.0, -2.0 * pi / 3.0)


@dataclass(frozen=True)
class SteadyState:
    """Values at t = 0 of a balanced steady state.

    v (3): phase voltages.  I, psi (n): currents into the windings a b c, rotor, and phase fluxes.  dq (n): fluxes
    d, q, 0, rotor in orthonormal Park coordinates.  p, theta: momentum and electrical angle of the d axis.  Vf: field
    voltage.  tau: shaft torque, positive for a generator (mechanical if the set has pole pairs).
    """

    v: tuple[float, ...]
    I: tuple[float, ...]
    psi: tuple[float, ...]
    dq: tuple[float, ...]
    p: float
    theta: float
    Vf: float
    tau: float


def park(theta: float) -> np.ndarray:
    """Orthonormal Park matrix (3 x 3), rows d, q, 0; q leads d by 90 degrees."""
    a = theta - np.array(ALPHA)
    return sqrt(2.0 / 3.0) * np.array([np.cos(a), -np.sin(a), np.full(3, sqrt(0.5))])


def steady_state(
    machine: MachineData, P: float | None = None, Q: float | None = None, V: float | None = None, angle: float = 0.0
) -> SteadyState:
    """Balanced steady state that DELIVERS P [W] and Q [var] at V [V rms, line-line] and `angle` [rad].

    Defaults: 0.8 and 0.2 of the rated power, rated voltage.  The torque covers the losses of stator and friction:
    tau omega = P + 3/2 Ra |I|^2 + d omega^2.  MachineDataError if the machine cannot be excited (no mutual M_f).
    """
    m, w = machine, machine.omega
    P, Q, V = (0.8 * m.Sn if P is None else P, 0.2 * m.Sn if Q is None else Q, m.Vn_rms_ll if V is None else V)
    M_f = m.M_stator_rotor[0]
    if M_f == 0 or V <= 0:
        raise MachineDataError(f"machine '{m.name}': M_stator_rotor[1] = {M_f} H and V = {V} V must not be zero")
    v = V * sqrt(2.0 / 3.0) * exp(1j * angle)
    i = -(complex(P, Q) / (1.5 * v)).conjugate()
    theta = phase(v - (m.Ra + 1j * w * m.Lq) * i) - pi / 2.0
    v_r, i_r = v * exp(-1j * theta), i * exp(-1j * theta)
    i_f = ((v_r.imag - m.Ra * i_r.imag) / w - m.Ld * i_r.real) / M_f
    currents = np.zeros(m.n)
    currents[[0, 1, 3]] = COUPLING * i_r.real, COUPLING * i_r.imag, i_f
    dq = m.constant_inductance() @ currents
    torque = dq[0] * currents[1] - dq[1] * currents[0]
    T = park(theta).T
    phases = [float((v * exp(-1j * a)).real) for a in ALPHA]
    stator = [float((i * exp(-1j * a)).real) for a in ALPHA]
    return SteadyState(
        v=tuple(phases),
        I=tuple([*stator, *currents[3:].tolist()]),
        psi=tuple([*(T @ dq[:3]).tolist(), *dq[3:].tolist()]),
        dq=tuple(dq.tolist()),
        p=m.J_electrical * w,
        theta=theta,
        Vf=m.R_rotor[0] * i_f,
        tau=m.pole_pairs * (m.d_electrical * w - float(torque)),
    )
