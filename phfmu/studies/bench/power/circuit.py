"""One machine at a stiff grid over a line, with a fault at its terminal: the circuit of a notebook of DPsim, in SI.

A turbo generator of 555 MVA (Kundur 1994: field, one damper in d, two in q) delivers 300 MW at 1.05 per unit; the line has half
of its charging and its conductance at the machine's bus, where a resistor to ground is switched on at 0.1 s.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, sqrt

import numpy as np

SN, VN, FREQUENCY = 555e6, 24e3, 60.0
W = 2 * pi * FREQUENCY
#: per unit of the machine: leakages l, magnetising m, rotor windings fd, kd, kq1, kq2, inertia constant H in s
PU = {
    "Rs": 0.003, "Ll": 0.15, "Lmd": 1.6599, "Lmq": 1.61, "Rfd": 0.0006, "Llfd": 0.1648, "Rkd": 0.0284, "Llkd": 0.1713,
    "Rkq1": 0.0062, "Llkq1": 0.7252, "Rkq2": 0.0237, "Llkq2": 0.125, "H": 3.7,
}  # fmt: skip
P, V1 = 300e6, 1.05 * VN
_RATIO = (24.0 / 230.0) ** 2
R_LINE, L_LINE = 1.27e-4 * 52900 * _RATIO, 9.05e-4 * 52900 * _RATIO / W
C_LINE, G_LINE = 1.81e-3 / 5.29 / _RATIO / W, 8e-2
R_FAULT, T_FAULT, STOP = 0.05, 0.1, 0.2
#: peak phase voltage, current, impedance and inductance of one per unit
VB = VN * sqrt(2 / 3)
IB = SN / (1.5 * VB)
ZB = VB / IB
LB = ZB / W
ALPHA = np.array([0.0, 2 * pi / 3, -2 * pi / 3])


@dataclass(frozen=True)
class PowerFlow:
    """Phasors [V, rms, line to line] of machine and grid, and the power that the machine delivers [VA]."""

    machine: complex
    grid: complex
    power: complex


def power_flow() -> PowerFlow:
    """The angle at which the machine delivers P."""
    from scipy.optimize import brentq

    series, shunt = 1 / (R_LINE + 1j * W * L_LINE), G_LINE / 2 + 1j * W * C_LINE / 2

    def delivered(angle: float) -> complex:
        v = V1 * np.exp(1j * angle)
        return v * np.conj((v - VN) * series + v * shunt)

    angle: float = brentq(lambda d: delivered(d).real - P, 0.0, 1.2, xtol=1e-15, rtol=1e-15)  # type: ignore[assignment]
    return PowerFlow(complex(V1 * np.exp(1j * angle)), complex(VN), complex(delivered(angle)))


def phases(phasor: complex) -> list[float]:
    """Values of the three phases at t = 0."""
    return [float((phasor * np.exp(-1j * a)).real) for a in ALPHA]
