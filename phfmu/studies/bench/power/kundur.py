"""The independent reference: Kundur's equations in the rotor's frame and per unit, the network in phases, by DOP853."""

from __future__ import annotations

from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.studies.bench.power.circuit import (
    ALPHA,
    C_LINE,
    FREQUENCY,
    G_LINE,
    IB,
    L_LINE,
    LB,
    PU,
    R_FAULT,
    R_LINE,
    SN,
    T_FAULT,
    VB,
    VN,
    ZB,
    W,
    phases,
    power_flow,
)
from phfmu.studies.bench.precision.array_function import ArrayFunction, compiled_expression

Array = NDArray[np.float64]


class Kundur:
    """States: fluxes of stator and rotor in d (3) and q (3), zero flux, speed deviation, angle, line currents, voltages."""

    def __init__(self) -> None:
        p, flow = PU, power_flow()
        md, mq, l = p["Lmd"], p["Lmq"], p["Ll"]
        Ld = np.full((3, 3), md) + np.diag([l, p["Llfd"], p["Llkd"]])
        Lq = np.full((3, 3), mq) + np.diag([l, p["Llkq1"], p["Llkq2"]])
        self.Gd, self.Gq = np.linalg.inv(Ld), np.linalg.inv(Lq)
        self.Rd, self.Rq = np.array([p["Rs"], p["Rfd"], p["Rkd"]]), np.array([p["Rs"], p["Rkq1"], p["Rkq2"]])
        v = flow.machine / VN
        i = -np.conj(flow.power / SN / v)  # into the machine
        theta = np.angle(v - (p["Rs"] + 1j * (mq + l)) * i) - np.pi / 2
        vr, ir = v * np.exp(-1j * theta), i * np.exp(-1j * theta)
        field = (vr.imag - p["Rs"] * ir.imag - (md + l) * ir.real) / md
        psid, psiq = Ld @ [ir.real, field, 0.0], Lq @ [ir.imag, 0.0, 0.0]
        self.vfd, self.tm = p["Rfd"] * field, -(psid[0] * ir.imag - psiq[0] * ir.real)
        peak = np.sqrt(2 / 3)
        line = np.array(phases((flow.machine - flow.grid) * peak / (R_LINE + 1j * W * L_LINE))) / IB
        self.grid = abs(flow.grid) / VN
        self.x0 = np.concatenate([psid, psiq, [0.0, 0.0, theta], line, np.array(phases(flow.machine * peak)) / VB])

    @cached_property
    def rate(self) -> ArrayFunction:
        """(t, x, conductance of the fault in per unit) -> x' [1/s], compiled."""
        p, t, x, fault = PU, ca.SX.sym("t"), ca.SX.sym("x", 15), ca.SX.sym("fault")
        psid, psiq, il, vc = x[:3], x[3:6], x[9:12], x[12:]
        a = W * t + x[8] - ALPHA
        c, s = ca.cos(a), ca.sin(a)
        i_d, i_q, i_0 = ca.DM(self.Gd) @ psid, ca.DM(self.Gq) @ psiq, x[6] / p["Ll"]
        speed, d, q = 1 + x[7], -self.Rd * i_d, -self.Rq * i_q
        v_d, v_q, v_0 = 2 / 3 * ca.dot(c, vc), -2 / 3 * ca.dot(s, vc), ca.sum1(vc) / 3
        d += ca.vertcat(v_d + speed * psiq[0], self.vfd, 0)
        q += ca.vertcat(v_q - speed * psid[0], 0, 0)
        torque = psid[0] * i_q[0] - psiq[0] * i_d[0]
        into = c * i_d[0] - s * i_q[0] + i_0
        grid = self.grid * ca.cos(W * t - ALPHA)
        r, l, cc, g = R_LINE / ZB, L_LINE / LB, C_LINE / 2 * W * ZB, G_LINE / 2 * ZB + fault
        slow = [W * (v_0 - p["Rs"] * i_0), (self.tm + torque) / (2 * p["H"]), W * x[7]]
        rates = ca.vertcat(W * d, W * q, *slow, W * (vc - grid - r * il) / l, W * (-into - il - g * vc) / cc)
        return compiled_expression("kundur", [t, x, fault], rates)

    def currents(self, times: Array, t_clear: float, rtol: float = 1e-11) -> Array:
        """Stator currents [A] (times x 3); the fault is cut off at t_clear [s]."""
        from scipy.integrate import solve_ivp

        x, out, last = self.x0, list[Array](), float(times[-1])
        for begin, until, g in ((0.0, T_FAULT, 0.0), (T_FAULT, t_clear, ZB / R_FAULT), (t_clear, last, 0.0)):
            end = min(until, last)
            if end <= begin:
                continue
            inside = times[(times >= begin - 1e-12) & (times < end - 1e-12 if end < last else times <= end + 1e-12)]
            stops = np.unique(np.clip(np.append(inside, end), begin, end))
            s = solve_ivp(self.rate, (begin, end), x, "DOP853", stops, args=(g,), rtol=rtol, atol=1e-2 * rtol)
            if not s.success:
                raise RuntimeError(s.message)
            x = s.y[:, -1]
            out.append(s.y[:, : len(inside)])
        y = np.concatenate(out, axis=1)
        a = 2 * np.pi * FREQUENCY * times + y[8] - ALPHA[:, None]
        i_d, i_q, i_0 = self.Gd[0] @ y[:3], self.Gq[0] @ y[3:6], y[6] / PU["Ll"]
        return (np.cos(a) * i_d - np.sin(a) * i_q + i_0).T * IB
