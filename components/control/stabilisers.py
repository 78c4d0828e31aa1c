"""Power system stabilisers of IEEE Std 421.5: a measured signal in, the signal Vs of the exciter out."""

from __future__ import annotations

import casadi as ca
import numpy as np

from phfmu import PHDAE, signal_output
from phfmu.components.control.diagram import Diagram


def pss1a(
    *, A1: float = 0.061, A2: float = 0.0017, T1: float = 0.3, T2: float = 0.03, T3: float = 0.3, T4: float = 0.03,
    T5: float = 10.0, T6: float = 0.0, KS: float = 5.0, VSTMAX: float = 0.05, VSTMIN: float = -0.05, rest: float = 0.0,
    u_base: float = 1.0, unit: str = "1",
) -> PHDAE:  # fmt: skip
    """PSS1A, a stabiliser of one input.

        y = 1/(1 + s A1 + s^2 A2) KS/(1 + s T6) s T5/(1 + s T5) (u/u_base - rest)
        Vs = clip((1 + s T1)/(1 + s T2) (1 + s T3)/(1 + s T4) y, VSTMIN, VSTMAX)

    `u_base`: of one per unit;  `rest` [1]: what u is at rest;  A1 [s], A2 [s2].

    H:  0: its states have no energy, and it does no work
    Signal inputs:   u [`unit`] (speed, frequency or power);  signal outputs: Vs [1]
    States:          input, washout, filter1, filter2, lead1, lead2 [1];  modes: Vs_at;  parameters by their standard names
    Source: IEEE Std 421.5-2005, figure 8-1.
    """
    d = Diagram("pss1a")
    given = {"A1": A1, "A2": A2, "T1": T1, "T2": T2, "T3": T3, "T4": T4, "T5": T5, "T6": T6, "KS": KS}
    p = d.data(given, ("T1", "T2", "T3", "T4", "T5", "T6"), {"A1": "s", "A2": "s2"})
    u = _deviation(d, rest, u_base, unit)
    y = d.washout("washout", d.lag("input", u, "T6", p["KS"]), 1.0, "T5", "T5")
    y = d.transfer("filter", y, (1.0,), (1.0, p["A1"], p["A2"]), _order((1.0, A1, A2)))
    y = d.lead_lag("lead2", d.lead_lag("lead1", y, "T1", "T2"), "T3", "T4")
    return _stabiliser(d, y, "VSTMIN", VSTMIN, "VSTMAX", VSTMAX, "stabiliser PSS1A")


def ieeest(
    *, A1: float = 0.0, A2: float = 0.0, A3: float = 0.0, A4: float = 0.0, A5: float = 0.0, A6: float = 0.0,
    T1: float = 0.3, T2: float = 0.03, T3: float = 0.3, T4: float = 0.03, T5: float = 10.0, T6: float = 10.0,
    KS: float = 5.0, LSMAX: float = 0.05, LSMIN: float = -0.05, rest: float = 0.0,
    u_base: float = 1.0, unit: str = "1",
) -> PHDAE:  # fmt: skip
    """IEEEST, a stabiliser of one input.

        y = (1 + A5 s + A6 s^2)/((1 + A1 s + A2 s^2)(1 + A3 s + A4 s^2)) (u/u_base - rest)
        Vs = clip(KS s T5/(1 + s T6) (1 + s T1)/(1 + s T2) (1 + s T3)/(1 + s T4) y, LSMIN, LSMAX)

    `u_base`: of one per unit;  `rest` [1]: what u is at rest;  A1, A3, A5 [s], A2, A4, A6 [s2].
    Its cut-off at voltages above VCU and below VCL is left out (VCU = VCL = 0, as in most data).

    H:  0: its states have no energy, and it does no work
    Signal inputs:   u [`unit`] (speed, frequency or power);  signal outputs: Vs [1]
    States:          filter1 .. filter4, lead1, lead2, washout [1];  modes: Vs_at;  parameters by their standard names
    Source: Siemens PTI, PSS/E model library, IEEEST.
    """
    d = Diagram("ieeest")
    given = {"A1": A1, "A2": A2, "A3": A3, "A4": A4, "A5": A5, "A6": A6, "T1": T1, "T2": T2, "T3": T3, "T4": T4,
             "T5": T5, "T6": T6, "KS": KS}  # fmt: skip
    notches = {n: "s" if n in ("A1", "A3", "A5") else "s2" for n in ("A1", "A2", "A3", "A4", "A5", "A6")}
    p = d.data(given, ("T1", "T2", "T3", "T4", "T5", "T6"), notches)
    u = _deviation(d, rest, u_base, unit)
    above = (1.0, p["A5"], p["A6"])[: _order((1.0, A5, A6)) + 1]
    below = (1.0, p["A1"] + p["A3"], p["A2"] + p["A1"] * p["A3"] + p["A4"], p["A1"] * p["A4"] + p["A2"] * p["A3"],
             p["A2"] * p["A4"])  # fmt: skip
    y = d.transfer("filter", u, above, below, _order(np.polymul((A2, A1, 1.0), (A4, A3, 1.0))[::-1]))
    y = d.lead_lag("lead2", d.lead_lag("lead1", y, "T1", "T2"), "T3", "T4")
    return _stabiliser(
        d, d.washout("washout", y, p["KS"], "T5", "T6"), "LSMIN", LSMIN, "LSMAX", LSMAX, "stabiliser IEEEST"
    )


def _deviation(d: Diagram, rest: float, u_base: float, unit: str) -> ca.SX:
    """u/u_base - rest."""
    u = d.input("u", rest * u_base, "measured signal", unit=unit)
    return u / d.parameter("u_base", u_base, "of one per unit", unit=unit, positive=True) - d.parameter("rest", rest)


def _order(coefficients: object) -> int:
    """The order of a polynomial, its coefficients from the constant one on."""
    return int(np.flatnonzero(np.asarray(coefficients, float))[-1])


def _stabiliser(d: Diagram, y: ca.SX, least: str, lo: float, most: str, hi: float, description: str) -> PHDAE:
    Vs = d.clip("Vs", y, d.parameter(least, lo), d.parameter(most, hi), max(abs(lo), abs(hi)))
    return d.declaration((signal_output("Vs", Vs, description="signal to the exciter"),), description)
