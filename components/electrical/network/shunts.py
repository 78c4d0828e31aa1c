"""Faults, surge arresters and loads of constant power: what stands at a bus without a state."""

from __future__ import annotations

from math import sqrt

import casadi as ca
import numpy as np

from phfmu import ELECTRICAL, PHDAE, Event, Port, block, damping, parameter
from phfmu.components.electrical.phases import PHASES, Phases

#: turns balanced voltages forwards by 90 degrees
QUARTER = np.array([[0.0, -1.0, 1.0], [1.0, 0.0, -1.0], [-1.0, 1.0, 0.0]]) / sqrt(3.0)


def fault(kind: str | None = None, R: float = 0.05, *, Rg: float = 0.0, nominal: float = 1.0, phases: int = 3) -> PHDAE:
    """Fault of any kind, of resistances that an event switches:  i = on Y v,  Y = D - D 1 1^T D/(1^T D 1 + 1/Rg).

    D has 1/R of the faulted phases on its diagonal: each has R to the point of the fault, which has Rg to ground with `g` in
    the kind, and no path to it without.  A bus of inductances only has no voltage before the fault: it needs a capacitor or a
    resistor beside it, such as the charging of a line.

    H:  0;  R: on Y on the port (feedthrough)
    ports:       terminal: voltages given, currents INTO the fault out
    parameters:  on: 0 no fault, 1 the fault;  R, Rg [ohm], Rg where it is given
    `kind`: faulted phases, and g: abcg (the default), abc, ab, bc, ca, abg, bcg, cag, ag, bg, cg, with one phase ag;
    R, Rg [ohm];  `nominal`: voltage [V];  `phases`: 3, or 1 with scalars.
    ValueError for another kind, R <= 0, Rg < 0, an Rg without g.
    """
    p = Phases.of("fault", phases)
    kind = kind or ("abcg" if p.count == 3 else "ag")
    if p.count == 1 and kind != "ag":
        raise ValueError(f"fault: kind '{kind}' with one phase, whose only fault is that to ground, ag")
    hit, ground = kind.removesuffix("g"), kind.endswith("g")
    kinds = ("a", "b", "c", "ab", "bc", "ca", "abc")
    if hit not in kinds or (len(hit) == 1 and not ground):
        raise ValueError(
            f"fault: no kind '{kind}'; give abc, ab, bc or ca, or with ground abcg, abg, bcg, cag, ag, bg or cg"
        )
    if not (R > 0 and Rg >= 0) or (Rg and not ground):
        raise ValueError(
            f"fault: kind = {kind}, R = {R:g} ohm must be positive and Rg = {Rg:g} ohm not negative, with g in the kind"
        )
    resistance = parameter(
        "R", R, unit="ohm", positive=True, description="from each faulted phase to the point of the fault"
    )
    to_ground = (
        parameter("Rg", Rg, unit="ohm", positive=True, description="from the point of the fault to ground")
        if Rg
        else None
    )
    on = parameter("on", 0.0, min=0.0, max=1.0, description="0 no fault, 1 the fault")
    g = ca.DM([phase in hit for phase in "abc"[: p.count]]) / resistance.sx
    Y = ca.diag(g)
    if to_ground is not None or not ground:
        Y = Y - g @ g.T / (ca.sum1(g) + (0 if to_ground is None else 1 / to_ground))
    terminal = Port("terminal", ELECTRICAL, "effort", {}, nominal=nominal, description="into the fault", **p.each)
    return PHDAE(
        "fault",
        parameters=(on, resistance, *(() if to_ground is None else (to_ground,))),
        dissipation=(block((terminal,), on.sx * Y),),
        ports=(terminal,),
        description=f"fault {kind}, switched by events",
    )


def fault_events(member: str, begins: float, clears: float | None = None) -> tuple[Event, ...]:
    """Events of a `fault` named `member` that begins at `begins` [s] and is gone at `clears` [s], where that is given."""
    if clears is not None and not clears > begins:
        raise ValueError(
            f"fault_events: {member} begins at {begins:g} s and clears at {clears:g} s, which must be later"
        )
    there = (Event(begins, f"{member}.on", 1.0),)
    return there if clears is None else (*there, Event(clears, f"{member}.on", 0.0))


def surge_arrester(V: float, I: float = 1e3, alpha: float = 25.0, *, size: int | None = None) -> PHDAE:
    """Metal-oxide arrester to ground, a monotone resistance:  i = I |v/V|^alpha sign(v).

    H:  0;  R: (I/V) |v/V|^(alpha - 1) on the port (feedthrough)
    ports:       terminal: voltage given, current INTO the arrester out
    parameters:  V [V] and I [A], a point of the characteristic (phase to ground, peak);  alpha [1]
    `size`: phases.  ValueError for values that are not positive and alpha < 1, which does not rise.
    Source: Dommel, EMTP Theory Book, 1986, section 12.3.
    """
    if not (V > 0 and I > 0 and alpha >= 1):
        raise ValueError(f"surge_arrester: V = {V:g} V and I = {I:g} A must be positive, alpha = {alpha:g} at least 1")
    volt = parameter("V", V, unit="V", positive=True, description="voltage at the current I")
    current = parameter("I", I, unit="A", positive=True, description="current at the voltage V")
    exponent = parameter("alpha", alpha, unit="1", positive=True, description="exponent of the characteristic")
    terminal = Port("terminal", ELECTRICAL, "effort", {}, size=size, nominal=V, description="into the arrester")
    conductance = current / volt * ca.fabs(terminal.u / volt) ** (exponent - 1)
    return PHDAE(
        "surge_arrester",
        parameters=(volt, current, exponent),
        dissipation=(damping(terminal, conductance),),
        ports=(terminal,),
        description="metal-oxide arrester to ground",
    )


def constant_power_load(P: float, Q: float = 0.0, *, V: float, least: float = 0.7) -> PHDAE:
    """Load that takes P and Q at any voltage above `least` V, below that the impedance it has there.

    i = (P v - Q G v)/s,   s = max(|v|^2, (least V)^2),   G turns balanced voltages forwards by 90 degrees

    H:  0;  R: P/s on the port (feedthrough);  J: -Q G/s (skew, feedthrough: reactive power does no work)
    ports:       terminal: voltages given, currents INTO the load out
    parameters:  P [W], Q [var] of all three phases;  V [V], rms, line to line, least [1]
    Not incrementally passive: a drop of the voltage raises the current, which can make a network unstable.
    ValueError for P < 0, V or least that is not positive.
    """
    if not (P >= 0 and V > 0 and 0 < least):
        raise ValueError(
            f"constant_power_load: P = {P:g} W must not be negative, V = {V:g} V and least = {least:g} positive"
        )
    p = parameter("P", P, unit="W", min=0.0, description="active power taken")
    q = parameter("Q", Q, unit="W", description="reactive power taken, in var")
    nominal = parameter("V", V, unit="V", positive=True, description="nominal voltage, rms, line to line")
    part = parameter("least", least, unit="1", positive=True, description="of V, below which it is an impedance")
    terminal = Port(
        "terminal", ELECTRICAL, "effort", {}, size=3, nominal=V * sqrt(2.0 / 3.0), description="into the load",
        elements=PHASES,
    )  # fmt: skip
    s = ca.fmax(ca.sumsqr(terminal.u), (part * nominal) ** 2)
    return PHDAE(
        "constant_power_load",
        parameters=(p, q, nominal, part),
        structure=(block((terminal,), q / s * ca.DM(QUARTER)),),
        dissipation=(damping(terminal, p / s),),
        ports=(terminal,),
        description="three-phase load of constant power",
    )
