"""Saturated synchronous machines against their equations in currents, and their operating points against phasors."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, fsolve

from phfmu import Collocated, NativeInstance, PythonInstance, build_model, check
from phfmu.components.electrical import (
    MachineDataError,
    Saturation,
    from_per_unit,
    machine_at_bus,
    machine_names,
    machine_set,
    steady_state,
    synchronous_machine,
)
from phfmu.terms import extract
from tests.components.orders import orders
from tests.wide import wide

POINTS = ((0.7, 0.7), (0.9, 1.0), (1.1, 1.6), (1.2, 2.3))
CURVES = {
    "quadratic": Saturation(0.1, 0.4),
    "from 1": Saturation(0.0, 0.3),
    "exponential": Saturation(0.1, 0.4, "exponential"),
    "table": Saturation(points=POINTS, rounding=0.4),
    "salient": Saturation(0.1, 0.4, axes="d"),
}
ANGLES = np.array([0.0, 2 * np.pi / 3, -2 * np.pi / 3])


def extra(curve: Saturation, u: float) -> float:
    """S(u) u, from the definitions and not from the package."""
    if curve.points:
        f, i = np.array([(0.0, 0.0), *curve.points]).T
        g, w = np.diff(i) / np.diff(f), curve.rounding * np.diff(f).min()
        bends = zip(g, g[1:], f[1:], strict=False)
        s = lambda x: (x + np.hypot(x, w)) / 2.0  # noqa: E731
        return g[0] * u + sum((b - a) * (s(u - k) - s(-u - k)) for a, b, k in bends) - u
    if curve.kind == "exponential":
        return curve.S10 * u ** (1.0 + np.log(curve.S12 / curve.S10) / np.log(1.2))
    q = np.sqrt(1.2 * curve.S12 / curve.S10) if curve.S10 else np.inf
    A = (q - 1.2) / (q - 1.0) if curve.S10 else 1.0
    B = 1.2 * curve.S12 / (1.2 - A) ** 2
    return B * max(u - A, 0.0) ** 2


class CurrentMachine:
    """The saturated machine with the currents (d, q, 0, rotor) as states: (Lambda + n dm/dF n^T) i' = v - R i + omega J psi.

    m_a (1/Lm_a + S(|m|)/Lmd) = F_a = n_a^T i with the m of the salient form in d alone.
    """

    def __init__(self, data, curve: Saturation):
        self.data, self.curve, k = data, curve, np.sqrt(1.5)
        self.n = 3 + len(data.axis)
        self.Lm = np.array([data.Ld, data.Lq]) - data.Ll
        self.rated = data.Vn_rms_ll / data.omega
        self.turns = np.zeros((2, self.n))
        self.turns[0, 0] = self.turns[1, 1] = 1.0
        for j, (a, M) in enumerate(zip(data.axis, data.M_stator_rotor, strict=True)):
            row = "dq".index(a)
            self.turns[row, 3 + j] = k * M / self.Lm[row]
        full = np.zeros((self.n, self.n))
        full[:3, :3] = np.diag([data.Ld, data.Lq, data.L0])
        full[3:, 3:] = data.L_rotor
        for j, (a, M) in enumerate(zip(data.axis, data.M_stator_rotor, strict=True)):
            row = "dq".index(a)
            full[row, 3 + j] = full[3 + j, row] = k * M
        self.leakage = full - self.turns.T @ np.diag(self.Lm) @ self.turns
        self.mask = np.array([1.0, 1.0 if curve.axes == "dq" else 0.0])
        self.R = np.array([data.Ra] * 3 + list(data.R_rotor))

    def _s(self, r: float) -> float:
        return extra(self.curve, r / self.rated) / (r / self.rated) / self.Lm[0] if r else 0.0

    def main(self, F: np.ndarray) -> np.ndarray:
        def flux(r: float) -> np.ndarray:
            return F / (1 / self.Lm + self.mask * self._s(r))

        most = np.linalg.norm(flux(0.0) * self.mask)
        r = brentq(lambda r: r - np.linalg.norm(flux(r) * self.mask), 0.0, most, xtol=1e-13, rtol=1e-15) if most else 0.0
        return flux(r)

    def fluxes(self, i: np.ndarray) -> np.ndarray:
        return self.leakage @ i + self.turns.T @ self.main(self.turns @ i)

    def rates(self, x: np.ndarray, v: np.ndarray, Vf: float, tau: float) -> np.ndarray:
        i, w, theta = x[: self.n], x[-2] / self.data.J, x[-1]
        m = self.main(self.turns @ i)
        psi = self.leakage @ i + self.turns.T @ m
        c, h = m * self.mask, 1e-5 * self.rated
        r = np.linalg.norm(c)
        slope = (self._s(r - 2 * h) - 8 * self._s(r - h) + 8 * self._s(r + h) - self._s(r + 2 * h)) / (12 * h)
        inverse = np.diag(1 / self.Lm + self.mask * self._s(r)) + slope / r * np.outer(c, c)
        L = self.leakage + self.turns.T @ np.linalg.solve(inverse, self.turns)
        a = theta - ANGLES
        T = np.sqrt(2 / 3) * np.array([np.cos(a), -np.sin(a), np.full(3, np.sqrt(0.5))])
        u = -self.R * i
        u[:3] += T @ v + w * np.array([psi[1], -psi[0], 0.0])
        u[3] += Vf
        torque = psi[0] * i[1] - psi[1] * i[0]
        return np.concatenate([np.linalg.solve(L, u), [tau + torque - self.data.d * w, w]])


def inputs(data, start):
    """Phase voltages that are 6 % above those of the start and dip, with constant field and torque."""
    V = data.Vn_rms_ll * np.sqrt(2 / 3)

    def at(t):
        return np.array([*(V * (1.06 - 0.04 * np.sin(30 * t)) * np.cos(data.omega * t - ANGLES)), start.Vf, start.tau])

    return at


END = 0.1


@cache
def reference(name: str, kind: str) -> np.ndarray:
    """Currents (d, q, 0, rotor), momentum and angle at END: DOP853 in currents."""
    data = machine_set(name, saturation=CURVES[kind])
    start, machine = steady_state(data, P=0.7 * data.Sn, Q=0.4 * data.Sn), CurrentMachine(data, CURVES[kind])
    x0 = np.array([*fsolve(lambda i: machine.fluxes(i) - start.dq, np.ones(machine.n), xtol=1e-14), start.p, start.theta])
    u = inputs(data, start)
    end = solve_ivp(lambda t, x: machine.rates(x, u(t)[:3], *u(t)[3:]), (0, END), x0, "DOP853", rtol=1e-12, atol=1e-9)
    return end.y[:, -1]


def ran(model, k: int, n: int, at, engine=NativeInstance, h: float | None = None):
    """An instance after n steps, and the worst ledger gap beside the energy."""
    plan = build_model(model, Collocated(k))
    instance, worst, h = engine(plan), 0.0, h or END / n
    for j in range(n):
        instance.set_node_inputs(np.array([at(h * (j + c)) for c in plan.nodes]))
        instance.do_step(h * j, h)
        row = instance.ledger()
        gap = abs(float(np.sum(row["stored"] + row["dissipated"] - row["supplied"])))
        worst = max(worst, gap / float(np.sum(instance.signals()["H"])))
    instance.set_node_inputs(np.array([at(h * n)] * k))
    return instance, worst


def error(name: str, kind: str, coordinates: str, k: int, n: int) -> float:
    data = machine_set(name, saturation=CURVES[kind])
    start = steady_state(data, P=0.7 * data.Sn, Q=0.4 * data.Sn)
    unit, worst = ran(synchronous_machine(data, coordinates=coordinates, start=start), k, n, inputs(data, start))
    assert worst < 1e-12
    exact, machine = reference(name, kind), CurrentMachine(data, CURVES[kind])
    psi = machine.fluxes(exact[: machine.n])
    x = unit.x[:-2].copy()
    if coordinates == "abc-flux":
        a = unit.x[-1] - ANGLES
        x[:3] = np.sqrt(2 / 3) * np.array([np.cos(a), -np.sin(a), np.full(3, np.sqrt(0.5))]) @ x[:3]
    size = np.array([machine.rated] * 3 + list(np.abs(psi[3:])))
    return float(max(np.max(np.abs(x - psi) / size), abs(unit.x[-1] - exact[-1])))


WAYS = [(m, c, f, k) for m in machine_names() for c in CURVES for f in ("dq-flux", "abc-flux") for k in (1, 2, 3)]
FEW = [("kundur555_1q", "quadratic", "dq-flux", k) for k in (1, 2, 3)] + [("krause_hydro325", "salient", "dq-flux", 2)]
COUNT = {"dq-flux": {1: 100, 2: 40, 3: 25}, "abc-flux": {1: 400, 2: 100, 3: 50}}


@pytest.mark.parametrize(("name", "kind", "coordinates", "k"), wide(WAYS, *FEW))
def test_a_saturated_machine_converges_to_its_equations_in_currents(name, kind, coordinates, k):
    n = COUNT[coordinates][k]
    found = [error(name, kind, coordinates, k, m) for m in (n, 2 * n)]
    assert found[1] < {1: 5e-3, 2: 1e-5, 3: 1e-6}[k]
    assert orders(found)[0] == pytest.approx(2 * k, abs=0.4), found
