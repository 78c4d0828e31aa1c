"""Turbines with their governors, of stability programs: the speed as a signal in, the torque as a signal out."""

from __future__ import annotations

import casadi as ca

from phfmu import PHDAE, signal_output
from phfmu.components.control.bases import PER_UNIT, Bases
from phfmu.components.control.diagram import Diagram


def tgov1(
    *, R: float = 0.05, T1: float = 0.5, VMAX: float = 1.0, VMIN: float = 0.0, T2: float = 2.1, T3: float = 7.0,
    Dt: float = 0.0, Pref: float = 0.8, base: Bases = PER_UNIT,
) -> PHDAE:  # fmt: skip
    """TGOV1, a steam turbine with its governor.

        valve = (Pref - dw/R)/(1 + s T1),    VMIN <= valve <= VMAX without wind-up
        Pm = valve (1 + s T2)/(1 + s T3) - Dt dw,    dw = w/w_base - 1

    Pref is in per unit of power, so that Pm = Pref at rated speed.

    H:  0: its states have no energy, and it does no work
    Signal inputs:   w [rad/s];  signal outputs: torque [N.m], Pm [1]
    States:          valve, reheat [1];  parameters: Pref, R, VMAX, VMIN, Dt [1], T1, T2, T3 [s], w_base [rad/s], T_base [N.m]
    Modes:           valve_at
    Source: Siemens PTI, PSS/E model library, TGOV1; Kundur 1994, section 9.
    """
    d = Diagram("tgov1")
    p = d.data({"R": R, "T1": T1, "VMAX": VMAX, "VMIN": VMIN, "T2": T2, "T3": T3, "Dt": Dt}, ("T1", "T2", "T3"))
    dw = _deviation(d, base)
    wanted = d.parameter("Pref", Pref, "reference of the power") - dw / p["R"]
    valve = d.lag("valve", wanted, "T1", 1.0, (p["VMIN"], p["VMAX"]))
    return _turbine(d, d.lead_lag("reheat", valve, "T2", "T3") - p["Dt"] * dw, base, "steam turbine and governor TGOV1")


def hygov(
    *, R: float = 0.05, r: float = 0.3, Tr: float = 5.0, Tf: float = 0.05, Tg: float = 0.5, VELM: float = 0.2,
    GMAX: float = 1.0, GMIN: float = 0.0, TW: float = 1.0, At: float = 1.2, Dturb: float = 0.0, qNL: float = 0.08,
    nref: float = 0.04, base: Bases = PER_UNIT,
) -> PHDAE:  # fmt: skip
    """HYGOV, a hydro turbine with its governor.

        e = (nref - dw - R c)/(1 + s Tf),    c = (1 + s Tr)/(r Tr s) e,   |c'| <= VELM,   GMIN <= c <= GMAX without wind-up
        g = c/(1 + s Tg),   TW q' = 1 - h,   h = (q/g)^2,   Pm = At h (q - qNL) - Dturb g dw,    dw = w/w_base - 1

    H:  0: its states have no energy, and it does no work
    Signal inputs:   w [rad/s];  signal outputs: torque [N.m], Pm [1]
    States:          error, c (desired gate), g (gate), q (flow of the water) [1]
    Parameters:      nref, R, r, VELM [1/s], GMAX, GMIN, At, Dturb, qNL [1], Tr, Tf, Tg, TW [s], w_base [rad/s], T_base [N.m]
    Modes:           c_at, speed_at
    Source: Siemens PTI, PSS/E model library, HYGOV; IEEE Working Group, Hydraulic turbine models, IEEE TPWRS 7 (1992).
    """
    d = Diagram("hygov")
    given = {"R": R, "r": r, "Tr": Tr, "Tf": Tf, "Tg": Tg, "VELM": VELM, "GMAX": GMAX, "GMIN": GMIN, "TW": TW, "At": At,
             "Dturb": Dturb, "qNL": qNL}  # fmt: skip
    for name in ("Tr", "Tf", "Tg", "TW", "r", "At"):
        if not given[name] > 0:
            raise ValueError(f"hygov: {name} = {given[name]:g} must be positive")
    p = d.data(given, ("Tr", "Tf", "Tg", "TW"), {"VELM": "1/s"})
    dw, start = _deviation(d, base), nref / R if R else 0.8
    e, c = d.state("error"), d.state("c", start, "desired gate")
    g, q = d.state("g", start, "gate"), d.state("q", start, "flow of the water")
    rate = (d.parameter("nref", nref, "reference of the speed") - dw - p["R"] * c.sx - e.sx) / p["Tf"]
    d.drive(e, rate)
    speed = d.clip("speed", (e.sx + p["Tr"] * rate) / (p["r"] * p["Tr"]), -p["VELM"], p["VELM"], VELM, unit="1/s")
    d.drive(c, speed, (p["GMIN"], p["GMAX"]), 1.0 / VELM)
    d.drive(g, (c.sx - g.sx) / p["Tg"])
    h = (q.sx / g.sx) ** 2
    d.drive(q, (1.0 - h) / p["TW"])
    Pm = p["At"] * h * (q.sx - p["qNL"]) - p["Dturb"] * g.sx * dw
    return _turbine(d, Pm, base, "hydro turbine and governor HYGOV")


def gast(
    *, R: float = 0.05, T1: float = 0.4, T2: float = 0.1, T3: float = 3.0, AT: float = 1.0, KT: float = 2.0,
    VMAX: float = 1.0, VMIN: float = 0.0, Dturb: float = 0.0, Pref: float = 0.8, base: Bases = PER_UNIT,
) -> PHDAE:  # fmt: skip
    """GAST, a gas turbine with its governor.

        valve = min(Pref - dw/R, AT + KT (AT - heat))/(1 + s T1),    VMIN <= valve <= VMAX without wind-up
        power = valve/(1 + s T2),   heat = power/(1 + s T3),   Pm = power - Dturb dw,    dw = w/w_base - 1

    H:  0: its states have no energy, and it does no work
    Signal inputs:   w [rad/s];  signal outputs: torque [N.m], Pm [1]
    States:          valve, power, heat [1];  parameters: Pref, R, AT, KT, VMAX, VMIN, Dturb [1], T1, T2, T3 [s],
                     w_base [rad/s], T_base [N.m]
    Modes:           valve_at, load_second (1 while the temperature limits the load)
    Source: Siemens PTI, PSS/E model library, GAST.
    """
    d = Diagram("gast")
    given = {"R": R, "T1": T1, "T2": T2, "T3": T3, "AT": AT, "KT": KT, "VMAX": VMAX, "VMIN": VMIN, "Dturb": Dturb}
    if not T3 > 0:
        raise ValueError(f"gast: T3 = {T3:g} s must be positive")
    p = d.data(given, ("T1", "T2", "T3"))
    dw, heat = _deviation(d, base), d.state("heat", Pref, "temperature of the exhaust")
    wanted = d.parameter("Pref", Pref, "reference of the power") - dw / p["R"]
    load = d.lesser("load", wanted, p["AT"] + p["KT"] * (p["AT"] - heat.sx))
    valve = d.lag("valve", load, "T1", 1.0, (p["VMIN"], p["VMAX"]), Pref)
    power = d.lag("power", valve, "T2", start=Pref)
    d.drive(heat, (power - heat.sx) / p["T3"])
    return _turbine(d, power - p["Dturb"] * dw, base, "gas turbine and governor GAST")


def _deviation(d: Diagram, base: Bases) -> ca.SX:
    """w/w_base - 1."""
    rated = d.parameter("w_base", base.speed, "rated speed", unit="rad/s", positive=True)
    return d.input("w", base.speed, "speed of the shaft", unit="rad/s") / rated - 1.0


def _turbine(d: Diagram, Pm: ca.SX, base: Bases, description: str) -> PHDAE:
    size = d.parameter("T_base", base.torque, "torque of one per unit", unit="N.m", positive=True)
    outputs = (
        signal_output("torque", size * Pm, unit="N.m", description="torque on the shaft"),
        signal_output("Pm", Pm, description="mechanical power in per unit"),
    )
    return d.declaration(outputs, description)
