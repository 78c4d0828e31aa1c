"""Operating points of a synchronous machine: from given currents, and the steady state at a given power."""

from __future__ import annotations

from cmath import exp, phase
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import pi, sqrt
from typing import Any

import numpy as np

from phfmu.components.electrical.machines.machine_data import COUPLING, MachineData, MachineDataError, machine_set
from phfmu.components.electrical.phases import ALPHA


@dataclass(frozen=True)
class OperatingPoint:
    """Start values of a machine with n windings a, b, c, rotor, and of its inputs.

    I, psi (n) [A, Wb]: currents into the windings and their fluxes.  dq (n) [Wb]: fluxes d, q, 0, rotor in
    orthonormal Park coordinates.  p [kg m2/s], theta [rad]: momentum and angle of the d axis, electrical.
    v (3) [V]: phase voltages.  Vf [V]: field voltage.  tau [N m]: shaft torque, positive for a generator.
    """

    I: tuple[float, ...]
    psi: tuple[float, ...]
    dq: tuple[float, ...]
    p: float
    theta: float
    v: tuple[float, ...] = (0.0, 0.0, 0.0)
    Vf: float = 0.0
    tau: float = 0.0


def park(theta: float) -> np.ndarray:
    """Orthonormal Park matrix (3 x 3), rows d, q, 0; q leads d by 90 degrees."""
    a = theta - np.array(ALPHA)
    return sqrt(2.0 / 3.0) * np.array([np.cos(a), -np.sin(a), np.full(3, sqrt(0.5))])


def operating_point(
    machine: MachineData,
    I: Sequence[float],
    p: float,
    theta: float,
    *,
    v: Sequence[float] = (0.0, 0.0, 0.0),
    Vf: float = 0.0,
    tau: float = 0.0,
) -> OperatingPoint:
    """The operating point with winding currents I (n), momentum p and angle theta; it need not be steady."""
    if len(I) != machine.n:
        raise MachineDataError(
            f"machine '{machine.name}'", f"has {machine.n} windings, I has {len(I)} entries", "give a current for each"
        )
    T = park(theta)
    currents = np.concatenate([T @ np.asarray(I[:3], float), np.asarray(I[3:], float)])
    dq = _fluxes(machine, currents)
    psi = [*(T.T @ dq[:3]).tolist(), *dq[3:].tolist()]
    return OperatingPoint(tuple(I), tuple(psi), tuple(dq.tolist()), p, theta, tuple(v), Vf, tau)


def _fluxes(m: MachineData, currents: np.ndarray) -> np.ndarray:
    """Fluxes (d, q, 0, rotor) of the currents.

    A main flux mu of the linear machine is m = mu/(1 + S Lm/Lmd) of the saturated one; each winding loses turns times mu - m.
    """
    linear = m.constant_inductance() @ currents
    if m.saturation is None or m.Ll is None:
        return linear
    Lm, rated = np.array([m.Ld, m.Lq]) - m.Ll, m.Vn_rms_ll / m.omega
    mu = (linear[:2] - m.Ll * currents[:2]) / rated
    share = Lm / Lm[0] * (1.0 if m.saturation.axes == "dq" else np.array([1.0, 0.0]))
    part = share * _saturation(m, lambda S: float(np.linalg.norm((mu / (1.0 + share * S))[share > 0])))
    lost = rated * mu * part / (1.0 + part)
    turns = np.zeros((2, m.n))
    turns[0, 0] = turns[1, 1] = 1.0
    for j, (axis, mutual) in enumerate(zip(m.axis, m.M_stator_rotor, strict=True)):
        row = "dq".index(axis)
        turns[row, 3 + j] = COUPLING * mutual / Lm[row]
    return linear - lost @ turns


def _saturation(m: MachineData, flux: Callable[[float], float]) -> float:
    """S at the main flux r = flux(S), in per unit, which falls as S rises."""
    assert m.saturation is not None
    curve, most = m.saturation, flux(0.0)
    if most == 0.0:
        return 0.0
    from scipy.optimize import root_scalar

    def gap(r: float) -> float:
        return r - flux(curve.S(r))

    return curve.S(float(root_scalar(gap, bracket=(0.0, most), xtol=1e-15).root))


def steady_state(
    machine: str | Mapping[str, Any] | MachineData,
    P: float | None = None,
    Q: float | None = None,
    V: float | None = None,
    angle: float = 0.0,
) -> OperatingPoint:
    """Balanced steady state that DELIVERS P [W] and Q [var] at V [V rms, line-line] and `angle` [rad].

    Defaults: 0.8 and 0.2 of the rated power, rated voltage.  The torque covers the losses of stator and
    friction: tau omega = P + 3/2 Ra |I|^2 + d omega^2.  The main flux is that behind Ra and Ll; where it saturates
    1/Lmq grows by S/Lmd, which turns the rotor, and the field brings Lmd i_d + M_f i_f = (1 + S) m_d.
    MachineDataError if the field has no mutual M.
    """
    m = machine_set(machine)
    w = m.omega
    P, Q = 0.8 * m.Sn if P is None else P, 0.2 * m.Sn if Q is None else Q
    V = m.Vn_rms_ll if V is None else V
    M_f = m.M_stator_rotor[0]
    if M_f == 0 or not V > 0:
        wrong = f"M_stator_rotor[1] = {M_f} H is 0" if M_f == 0 else f"V = {V} V is not > 0"
        raise MachineDataError(
            f"machine '{m.name}'", f"{wrong}: there is no such steady state", "give both from above 0"
        )
    v = V * sqrt(2.0 / 3.0) * exp(1j * angle)
    i = -(complex(P, Q) / (1.5 * v)).conjugate()
    Lq = _saturated_q(m, abs(v - (m.Ra + 1j * w * (m.Ll or 0.0)) * i) / w)
    theta = phase(v - (m.Ra + 1j * w * Lq) * i) - pi / 2.0
    v_r, i_r = v * exp(-1j * theta), i * exp(-1j * theta)
    psi_d, psi_q = (v_r.imag - m.Ra * i_r.imag) / w, Lq * i_r.imag
    iron = _field_of_iron(m, complex(psi_d, psi_q) - (m.Ll or 0.0) * i_r)
    i_f = (psi_d - m.Ld * i_r.real + iron) / M_f
    # torque 3/2 (psi_d i_q - psi_q i_d) in peak values; motor sign, so negative for a generator
    psi_d = m.Ld * i_r.real + M_f * i_f - iron
    torque = COUPLING**2 * (psi_d * i_r.imag - psi_q * i_r.real)
    return operating_point(
        m,
        [*((i * exp(-1j * a)).real for a in ALPHA), i_f, *[0.0] * (m.n - 4)],
        m.J_electrical * w,
        theta,
        v=[(v * exp(-1j * a)).real for a in ALPHA],
        Vf=m.R_rotor[0] * i_f,
        tau=m.pole_pairs * (m.d_electrical * w - torque),
    )


def _saturated_q(m: MachineData, flux: float) -> float:
    """Lq at the main flux |m| [Wb], peak value of a phase."""
    if m.saturation is None or m.Ll is None or m.saturation.axes == "d":
        return m.Lq
    rated = sqrt(2.0 / 3.0) * m.Vn_rms_ll / m.omega
    return m.Ll + 1.0 / (1.0 / (m.Lq - m.Ll) + m.saturation.S(flux / rated) / (m.Ld - m.Ll))


def _field_of_iron(m: MachineData, flux: complex) -> float:
    """S m_d [Wb] of the main flux m_d + j m_q, peak values of a phase."""
    if m.saturation is None:
        return 0.0
    rated = sqrt(2.0 / 3.0) * m.Vn_rms_ll / m.omega
    size = abs(flux) if m.saturation.axes == "dq" else abs(flux.real)
    return m.saturation.S(size / rated) * flux.real
