"""The induction machine against an integration in the synchronous frame with complex fluxes."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from phfmu import DeclarationError, check
from phfmu.components.electrical import induction_machine
from tests.components.orders import orders, steps

CAGES = {1: ((0.228, 0.8e-3),), 2: ((0.228, 0.8e-3), (1.0, 0.4e-3))}
V, W, PHASE, END, PAIRS, J = 375.6, 120 * np.pi, 0.3, 0.1, 2, 1.662


@cache
def reference(cages):
    """Stator flux (complex, stator frame, peak values) and speed after a start across the line: DOP853 at 1e-12."""
    own, mutual = np.array([0.8e-3, *(x for _, x in CAGES[cages])]), 34.7e-3
    R = np.array([0.087, *(r for r, _ in CAGES[cages])])
    L = np.linalg.inv(np.diag(own) + mutual)
    n = len(own)

    def rates(t, y):
        psi, speed = y[:n] + 1j * y[n : 2 * n], y[-1]
        i = L @ psi
        slip = np.full(n, W - PAIRS * speed)
        slip[0] = W
        v = np.zeros(n, complex)
        v[0] = V * np.exp(1j * PHASE)
        psi_rate = v - R * i - 1j * slip * psi
        torque = 1.5 * PAIRS * (np.conj(psi[0]) * i[0]).imag
        return [*psi_rate.real, *psi_rate.imag, torque / J]

    end = solve_ivp(rates, (0, END), np.zeros(2 * n + 1), method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    return (end[0] + 1j * end[n]) * np.exp(1j * W * END), end[-1]


def voltages(t):
    return [*(V * np.cos(W * t + PHASE - a) for a in (0.0, 2 * np.pi / 3, -2 * np.pi / 3)), 0.0]


@pytest.mark.parametrize("cages", CAGES)
@pytest.mark.parametrize(("k", "n"), [(1, 400), (2, 150), (3, 80)])
def test_start_across_the_line_has_the_order_of_the_scheme(cages, k, n):
    flux, speed = reference(cages)
    errors = []
    for m in (n, 2 * n):
        unit, worst = steps(induction_machine(cages=CAGES[cages]), k, END / m, m, voltages)
        x = unit.signals()["x"]
        alpha, beta = x[0] * 2 / 3 - (x[1] + x[2]) / 3, (x[1] - x[2]) / np.sqrt(3)
        errors.append(max(abs(alpha + 1j * beta - flux) / abs(flux), abs(x[-1] / J - speed) / speed))
        assert worst < 1e-15
    assert orders(errors)[0] == pytest.approx(2 * k, abs=0.35)
    assert errors[-1] < {1: 1e-2, 2: 1e-5, 3: 1e-6}[k]


def test_zero_sequence_is_a_coil_of_its_own():
    """Equal voltages in all phases: i = V/R (1 - exp(-R t/L0)) each, no torque."""
    unit, _ = steps(induction_machine(L_0=2e-3), 2, 1e-4, 200, lambda t: [10.0, 10.0, 10.0, 0.0])
    x = unit.signals()["x"]
    assert x[:3] / 2e-3 == pytest.approx(10 / 0.087 * (1 - np.exp(-0.087 * 0.02 / 2e-3)), rel=1e-10)
    assert abs(x[-1]) < 1e-18


def test_steady_torque_is_that_of_the_equivalent_circuit():
    """At a held speed the torque settles at 3 pairs |I_r|^2 R_r / (s w)."""
    speed, s = 180.0, 1 - 2 * 180.0 / W
    unit, _ = steps(induction_machine(J=1e9, speed=speed), 3, 5e-4, 1000, voltages)
    Zr, Zm = 0.228 / s + 1j * W * 0.8e-3, 1j * W * 34.7e-3
    i = V / (0.087 + 1j * W * 0.8e-3 + Zr * Zm / (Zr + Zm))
    rotor = abs(i * Zm / (Zr + Zm))
    names = dict(zip(("Te", "ia", "ib", "ic", "slip"), unit.signals()["observables"], strict=False))
    assert names["Te"] == pytest.approx(1.5 * PAIRS * rotor**2 * 0.228 / (s * W), rel=1e-6)
    assert names["slip"] == pytest.approx(s, rel=1e-7)  # its inertia is not infinite


def test_check_finds_nothing_and_values_are_asked_for():
    assert check(induction_machine(cages=CAGES[2])) == []
    with pytest.raises(DeclarationError, match=r"L_m = -1 is not positive, R_1 = -0.1 ohm is negative"):
        induction_machine(L_m=-1.0, cages=[(-0.1, 1e-3)])
    with pytest.raises(DeclarationError, match="there is no cage"):
        induction_machine(cages=[])
