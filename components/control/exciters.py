"""Excitation systems of IEEE Std 421.5 and of stability programs: signals in, the field voltage as a signal out."""

from __future__ import annotations

from math import exp, log, sqrt
from typing import Any

import casadi as ca

from phfmu import PHDAE, signal_output
from phfmu.components.control.bases import PER_UNIT, Bases
from phfmu.components.control.diagram import Diagram


def sexs(
    *, TA: float = 1.0, TB: float = 10.0, K: float = 100.0, TE: float = 0.05, EMIN: float = 0.0, EMAX: float = 4.0,
    Vref: float = 1.01, base: Bases = PER_UNIT,
) -> PHDAE:  # fmt: skip
    """SEXS, the simplified excitation system.

        Efd = K/(1 + s TE) (1 + s TA)/(1 + s TB) (Vref + Vs - V),    EMIN <= Efd <= EMAX without wind-up

    H:  0: its states have no energy, and it does no work
    Signal inputs:   V [1] measured voltage, Vs [1] from a stabiliser;  signal outputs: field [V], Efd_pu [1]
    States:          lead, Efd [1];  parameters: Vref, TA, TB, TE [s], K, EMIN, EMAX [1], Ebase [V]
    Modes:           Efd_at
    Source: Siemens PTI, PSS/E model library, SEXS (there TA/TB is one number).
    """
    d = Diagram("sexs")
    p = d.data({"TA": TA, "TB": TB, "K": K, "TE": TE, "EMIN": EMIN, "EMAX": EMAX}, ("TA", "TB", "TE"))
    e = _error(d, Vref)
    efd = d.lag("Efd", d.lead_lag("lead", e, "TA", "TB"), "TE", p["K"], (p["EMIN"], p["EMAX"]))
    return _exciter(d, efd, base, "simplified excitation system SEXS")


def exac1(
    *, TR: float = 0.0, TB: float = 0.0, TC: float = 0.0, KA: float = 400.0, TA: float = 0.02, VRMAX: float = 6.03,
    VRMIN: float = -5.43, TE: float = 0.8, KF: float = 0.03, TF: float = 1.0, KC: float = 0.2, KD: float = 0.38,
    KE: float = 1.0, E1: float = 4.18, SE1: float = 0.1, E2: float = 3.14, SE2: float = 0.03, Vref: float = 1.01,
    base: Bases = PER_UNIT,
) -> PHDAE:  # fmt: skip
    """EXAC1, the rotating AC exciter with diode rectifiers (AC1A without limits at its gates).

        VR = KA/(1 + s TA) (1 + s TC)/(1 + s TB) (Vref + Vs - V/(1 + s TR) - VF),    VRMIN <= VR <= VRMAX without wind-up
        TE VE' = VR - VFE,    VE >= 0,     VFE = (KE + SE(VE)) VE + KD Ifd,    VF = s KF/(1 + s TF) VFE
        Efd = FEX(IN) VE,     IN = KC Ifd/VE

    FEX is the regulation of the rectifier: 1 - IN/sqrt(3) to IN = sqrt(3)/4, sqrt(3/4 - IN^2) to 3/4, sqrt(3) (1 - IN) to 1.
    SE(VE) = A exp(B VE) through (E1, SE1), (E2, SE2); SE1 = 0: no saturation.

    E1, SE1, E2, SE2 [1], KF [s].
    Signal inputs:   V, Vs [1], Ifd [A] field current;  signal outputs: field [V], Efd_pu [1]
    States:          measured, lead, VR, VE, rate [1];  modes: VR_at, VE_at
    Source: IEEE Std 421.5-2005, figure 6-1 (AC1A) and table of sample data; Siemens PTI, PSS/E model library, EXAC1.
    """
    d = Diagram("exac1")
    given = {"TR": TR, "TB": TB, "TC": TC, "KA": KA, "TA": TA, "VRMAX": VRMAX, "VRMIN": VRMIN, "TE": TE, "KF": KF,
             "TF": TF, "KC": KC, "KD": KD, "KE": KE}  # fmt: skip
    p = d.data(given, ("TR", "TB", "TC", "TA", "TE", "TF"), {"KF": "s"})
    if not TE > 0:
        raise ValueError(f"exac1: TE = {TE:g} s must be positive")
    current = d.input("Ifd", base.Ibase, "field current", unit="A") / d.parameter(
        "Ibase", base.Ibase, unit="A", positive=True
    )
    VE = d.state("VE", 1.0, "voltage behind the commutating reactance")
    VFE = (p["KE"] + saturation(d, E1, SE1, E2, SE2, VE.sx)) * VE.sx + p["KD"] * current
    VF = d.feedback("rate", VFE, p["KF"], "TF")
    u = d.lead_lag("lead", _error(d, Vref, "TR") - VF, "TC", "TB")
    VR = d.lag("VR", u, "TA", p["KA"], (p["VRMIN"], p["VRMAX"]))
    d.drive(VE, (VR - VFE) / p["TE"], (0.0, None), TE)
    return _exciter(d, rectified(p["KC"] * current / VE.sx) * VE.sx, base, "AC exciter EXAC1 (AC1A)")


def ieeex1(
    *, TR: float = 0.0, KA: float = 40.0, TA: float = 0.1, TB: float = 0.0, TC: float = 0.0, VRMAX: float = 7.3,
    VRMIN: float = -7.3, KE: float = 1.0, TE: float = 0.8, KF: float = 0.03, TF1: float = 1.0, E1: float = 3.0,
    SE1: float = 0.03, E2: float = 4.0, SE2: float = 0.1, Vref: float = 1.01, base: Bases = PER_UNIT,
) -> PHDAE:  # fmt: skip
    """IEEEX1, the DC commutator exciter (DC1A).

        VR = KA/(1 + s TA) (1 + s TC)/(1 + s TB) (Vref + Vs - V/(1 + s TR) - VF),    VRMIN <= VR <= VRMAX without wind-up
        TE Efd' = VR - (KE + SE(Efd)) Efd,    VF = s KF/(1 + s TF1) Efd

    SE(Efd) = A exp(B Efd) through (E1, SE1), (E2, SE2); SE1 = 0: no saturation.

    E1, SE1, E2, SE2 [1], KF [s].
    Signal inputs:   V, Vs [1];  signal outputs: field [V], Efd_pu [1]
    States:          measured, lead, VR, Efd, rate [1];  modes: VR_at
    Source: IEEE Std 421.5-2005, figure 5-1 (DC1A); Siemens PTI, PSS/E model library, IEEEX1.
    """
    d = Diagram("ieeex1")
    given = {"TR": TR, "KA": KA, "TA": TA, "TB": TB, "TC": TC, "VRMAX": VRMAX, "VRMIN": VRMIN, "KE": KE, "TE": TE,
             "KF": KF, "TF1": TF1}  # fmt: skip
    p = d.data(given, ("TR", "TB", "TC", "TA", "TE", "TF1"), {"KF": "s"})
    if not TE > 0:
        raise ValueError(f"ieeex1: TE = {TE:g} s must be positive")
    efd = d.state("Efd", 1.0, "field voltage")
    VF = d.feedback("rate", efd.sx, p["KF"], "TF1")
    u = d.lead_lag("lead", _error(d, Vref, "TR") - VF, "TC", "TB")
    VR = d.lag("VR", u, "TA", p["KA"], (p["VRMIN"], p["VRMAX"]))
    d.drive(efd, (VR - (p["KE"] + saturation(d, E1, SE1, E2, SE2, efd.sx)) * efd.sx) / p["TE"])
    return _exciter(d, efd.sx, base, "DC exciter IEEEX1 (DC1A)")


def st1a(
    *, TR: float = 0.0, VIMAX: float = 999.0, VIMIN: float = -999.0, TC: float = 1.0, TB: float = 10.0, TC1: float = 0.0,
    TB1: float = 0.0, KA: float = 190.0, TA: float = 0.02, VAMAX: float = 14.5, VAMIN: float = -14.5, VRMAX: float = 7.8,
    VRMIN: float = -6.7, KC: float = 0.08, KF: float = 0.0, TF: float = 1.0, KLR: float = 0.0, ILR: float = 0.0,
    Vref: float = 1.01, base: Bases = PER_UNIT,
) -> PHDAE:  # fmt: skip
    """ST1A, the potential-source controlled rectifier.

        VI = clip(Vref + Vs - V/(1 + s TR) - VF, VIMIN, VIMAX),    VF = s KF/(1 + s TF) Efd
        VA = KA/(1 + s TA) (1 + s TC)(1 + s TC1)/((1 + s TB)(1 + s TB1)) VI,    VAMIN <= VA <= VAMAX without wind-up
        Efd = clip(VA - KLR max(Ifd - ILR, 0), V VRMIN, V VRMAX - KC Ifd)

    KLR, ILR [1], KF, TF [s].  Its gates for limiters of excitation have no input.

    Signal inputs:   V, Vs [1], Ifd [A] field current;  signal outputs: field [V], Efd_pu [1]
    States:          measured, lead, lead1, VA, rate [1];  modes: VI_at, VA_at, Efd_at, over_second
    Source: IEEE Std 421.5-2005, figure 7-1 and table of sample data.
    """
    d = Diagram("st1a")
    given = {"TR": TR, "VIMAX": VIMAX, "VIMIN": VIMIN, "TC": TC, "TB": TB, "TC1": TC1, "TB1": TB1, "KA": KA, "TA": TA,
             "VAMAX": VAMAX, "VAMIN": VAMIN, "VRMAX": VRMAX, "VRMIN": VRMIN, "KC": KC}  # fmt: skip
    p = d.data(given, ("TR", "TC", "TB", "TC1", "TB1", "TA"))
    current = d.input("Ifd", base.Ibase, "field current", unit="A") / d.parameter(
        "Ibase", base.Ibase, unit="A", positive=True
    )
    limits = (p["VAMIN"], p["VAMAX"])
    over: Any = 0.0
    if KLR:
        q = d.data({"KLR": KLR, "ILR": ILR})
        over = q["KLR"] * d.lesser("over", 0.0, q["ILR"] - current)
    voltage = _measured(d)

    def output(VA: ca.SX) -> ca.SX:
        return d.clip("Efd", VA + over, voltage * p["VRMIN"], voltage * p["VRMAX"] - p["KC"] * current)

    def compensated(VF: Any) -> ca.SX:
        VI = d.clip("VI", _error(d, Vref, "TR", voltage) - VF, p["VIMIN"], p["VIMAX"])
        return d.lead_lag("lead1", d.lead_lag("lead", VI, "TC", "TB"), "TC1", "TB1")

    if TA:
        VA = d.state("VA", 1.0, "regulator output")
        efd = output(VA.sx)
        VF = d.feedback("rate", efd, d.parameter("KF", KF, unit="s", least=0.0), d.time("TF", TF)) if KF else 0.0
        d.drive(VA, (p["KA"] * compensated(VF) - VA.sx) / p["TA"], limits, TA)
    elif KF:
        raise ValueError(f"st1a: KF = {KF:g} needs TA > 0: Efd would depend on itself at once")
    else:
        efd = output(d.lag("VA", compensated(0.0), "TA", p["KA"], limits))
    return _exciter(d, efd, base, "static exciter ST1A")


def rectified(IN: ca.SX) -> ca.SX:
    """FEX(IN): what the commutation of a diode bridge leaves of its voltage."""
    first, second, third = 1.0 - IN / sqrt(3.0), ca.sqrt(ca.fmax(0.75 - IN**2, 0.0)), sqrt(3.0) * (1.0 - IN)
    falling = ca.if_else(IN <= sqrt(3.0) / 4.0, first, ca.if_else(IN <= 0.75, second, third))
    return ca.if_else(IN <= 0.0, 1.0, ca.if_else(IN >= 1.0, 0.0, falling))


def saturation(d: Diagram, E1: float, SE1: float, E2: float, SE2: float, E: ca.SX) -> ca.SX:
    """SE(E) = A exp(B E) through (E1, SE1) and (E2, SE2), with the parameters A and B; 0 at SE1 = 0.

    ValueError for two points that no such curve goes through.
    """
    if not SE1:
        return ca.SX(0)
    if not (SE1 > 0 and SE2 > 0 and E1 != E2):
        raise ValueError(
            f"{d.name}: saturation needs SE1, SE2 > 0 at two voltages, not ({E1}, {SE1}) and ({E2}, {SE2})"
        )
    B = log(SE1 / SE2) / (E1 - E2)
    a, b = d.parameter("A_SE", SE1 / exp(B * E1)), d.parameter("B_SE", B)
    return a * ca.exp(b * E)


def _measured(d: Diagram) -> ca.SX:
    return d.input("V", 1.0, "measured voltage in per unit")


def _error(d: Diagram, Vref: float, TR: str | None = None, voltage: ca.SX | None = None) -> ca.SX:
    """Vref + Vs - V/(1 + s TR)."""
    V = _measured(d) if voltage is None else voltage
    Vs = d.input("Vs", 0.0, "signal of a stabiliser in per unit")
    reference = d.parameter("Vref", Vref, "reference of the voltage")
    return reference + Vs - d.lag("measured", V, TR, start=1.0)


def _exciter(d: Diagram, efd: ca.SX, base: Bases, description: str) -> PHDAE:
    volt = d.parameter("Ebase", base.Ebase, "field voltage of one per unit", unit="V", positive=True)
    outputs = (
        signal_output("field", volt * efd, unit="V", description="field voltage"),
        signal_output("Efd_pu", efd, description="field voltage in per unit"),
    )
    return d.declaration(outputs, description)
