"""Loads, reactors and capacitor banks from powers at a nominal voltage."""

from __future__ import annotations

from math import pi
from typing import Literal, TypeAlias

import casadi as ca

from phfmu import ELECTRICAL, PHDAE, Port, algebraic, damping, energy, observable, parameter, skew, state
from phfmu.components.electrical.phases import Phases
from phfmu.components.electrical.rlc_load import rlc_load

Kind: TypeAlias = Literal["parallel", "series"]


def load(
    P: float,
    Q: float = 0.0,
    *,
    V: float,
    f: float = 50.0,
    kind: Kind = "parallel",
    angle: float = 0.0,
    phases: int = 3,
) -> PHDAE:
    """Constant impedance that takes P and Q at the nominal voltage, star-grounded; it begins in steady state there.

    parallel:  R = V^2/P,  L = V^2/(w Q),  or C = -Q/(w V^2) where Q < 0: an `rlc_load`, whose ports and parameters it has
    series:    R + j X = V^2 (P + j Q)/(P^2 + Q^2),  L = X/w,  or C = -1/(w X) where Q < 0: an `rlc_branch`

    P [W], Q [var]: of all phases, taken;  V [V], rms, line to line, or to ground of one phase;  f [Hz];  w = 2 pi f
    `angle` [rad]: of the voltage of phase a at the start;  `phases`: 3, or 1
    ValueError for P < 0 (a load does not deliver), for P = Q = 0, and for V or f that is not positive.
    """
    _require("load", V, f)
    if P < 0 or not (P or Q):
        raise ValueError(
            f"load: P = {P:g} W must not be negative, and one of P and Q = {Q:g} var not zero; what delivers is a source"
        )
    p, w = Phases.of("load", phases), 2.0 * pi * f
    peak = V * p.peak
    if kind == "parallel":
        L, C = (V**2 / (w * Q) if Q > 0 else None), (-Q / (w * V**2) if Q < 0 else None)
        i = 0.0 if L is None else p.values(peak / (1j * w * L), angle)
        return rlc_load(V**2 / P if P else None, L, C, v=p.values(peak, angle), i=i, nominal=peak, phases=phases)
    if kind != "series":
        raise ValueError(f"load: kind = '{kind}' is neither 'parallel' nor 'series'")
    R, X = (V**2 * S / (P**2 + Q**2) for S in (P, Q))
    L, C = (X / w if X > 0 else None), (-1.0 / (w * X) if X < 0 else None)
    return rlc_branch(R, L, C, f=f, v=peak, angle=angle, phases=phases)


def shunt(Q: float, *, V: float, f: float = 50.0, angle: float = 0.0, phases: int = 3) -> PHDAE:
    """Reactor (Q > 0) or capacitor (Q < 0) to ground that takes Q at the nominal voltage: a `load` without resistance.

    Q [var]: of all phases, taken;  V [V], rms, line to line, or to ground of one phase;  f [Hz];
    `angle` [rad] of phase a at the start;  `phases`: 3, or 1
    """
    return load(0.0, Q, V=V, f=f, angle=angle, phases=phases)


def capacitor_bank(
    Q: float,
    *,
    V: float,
    f: float = 50.0,
    detuning: float = 0.0,
    quality: float = 50.0,
    angle: float = 0.0,
    phases: int = 3,
) -> PHDAE:
    """Capacitor bank that delivers Q at the nominal voltage, with reactors in series where it is detuned.

    C = Q (1 - p)/(w V^2),  L = p/(w^2 C),  R = w L/quality,  p = detuning = X_L/X_C: an `rlc_branch`; p = 0: a `shunt`

    Q [var]: delivered, of all phases;  V [V], rms, line to line, or to ground of one phase;  f [Hz];  `detuning` [1];
    `quality` [1];  `angle` [rad] of phase a at the start;  `phases`: 3, or 1.  With p = 0.07 it resonates at f/sqrt(p) = 3.78 f.
    ValueError for Q that is not positive and p outside [0, 1).
    """
    _require("capacitor_bank", V, f)
    if not (Q > 0 and 0 <= detuning < 1 and quality > 0):
        raise ValueError(
            f"capacitor_bank: Q = {Q:g} var and quality = {quality:g} must be positive and detuning = {detuning:g} in [0, 1); "
            "for a reactor use shunt"
        )
    if not detuning:
        return shunt(-Q, V=V, f=f, angle=angle, phases=phases)
    w = 2.0 * pi * f
    C = Q * (1.0 - detuning) / (w * V**2)
    L = detuning / (w**2 * C)
    peak = V * Phases.of("capacitor_bank", phases).peak
    return rlc_branch(w * L / quality, L, C, f=f, v=peak, angle=angle, phases=phases)


def rlc_branch(
    R: float,
    L: float | None = None,
    C: float | None = None,
    *,
    f: float = 50.0,
    v: float = 1.0,
    angle: float = 0.0,
    phases: int = 3,
) -> PHDAE:
    """R, L and C in series from each phase to ground, L and C optional:  flux' = terminal.v - R i - charge/C,  charge' = i.

    with L:     i = flux/L;   without L:  0 = terminal.v - R i - charge/C with the algebraic i

    H:  |flux|^2/(2 L) + |charge|^2/(2 C);  J: J[charge, flux or i] = 1 (skew);  R: R on flux or i
    states:      flux (3) [Wb], charge (3) [C] of what is there;  algebraic: i (3) [A] without L
    ports:       terminal: voltage given, current INTO the branch out
    parameters:  R [ohm], L [H], C [F] per phase, of what is there
    observables: i (3), the current to ground;  v_C (3), the voltage over C
    `v`: peak phase voltage [V] of the steady state at `f` [Hz] in which it begins, `angle` [rad] that of phase a;
    `phases`: 3, or 1 with scalars for (3).
    ValueError for values that are not positive, and for R = 0 without L.
    """
    if not R >= 0 or not all(x is None or x > 0 for x in (L, C)) or not (R or L):
        raise ValueError(
            f"rlc_branch: R = {R:g} ohm must not be negative, L = {L} H and C = {C} F must be positive or left out, and "
            "R = 0 needs an L; a capacitor alone is rlc_load"
        )
    p, w = Phases.of("rlc_branch", phases), 2.0 * pi * f
    Z = R + 1j * w * (L or 0.0) + (1.0 / (1j * w * C) if C else 0.0)
    i = v / Z
    resistance = parameter("R", R, unit="ohm", description="resistance per phase")
    states, parameters, energies, told = [], [resistance], [], []
    if L is not None:
        inductance = parameter("L", L, unit="H", positive=True, description="inductance per phase")
        on = state("flux", unit="Wb", start=p.values(L * i, angle), nominal=L * abs(i), description="flux per phase",
                   **p.each)  # fmt: skip
        states.append(on)
        parameters.append(inductance)
        energies.append(energy(ca.sumsqr(on.sx) / (2 * inductance)))
        told.append(observable("i", on.z, unit="A", description="current to ground", elements=p.elements))
    else:
        on = algebraic("i", unit="A", nominal=abs(i), description="current to ground", **p.each)
    between = ()
    if C is not None:
        capacitance = parameter("C", C, unit="F", positive=True, description="capacitance per phase")
        charge = state("charge", unit="C", start=p.values(i / (1j * w), angle), nominal=abs(i) / w,
                       description="charge per phase", **p.each)  # fmt: skip
        states.append(charge)
        parameters.append(capacitance)
        energies.append(energy(ca.sumsqr(charge.sx) / (2 * capacitance)))
        told.append(observable("v_C", charge.z, unit="V", description="voltage over C", elements=p.elements))
        between = (skew(charge, on, 1),)
    return PHDAE(
        "rlc_branch",
        states=tuple(states),
        algebraics=() if L is not None else (on,),
        parameters=tuple(parameters),
        energies=tuple(energies),
        structure=between,
        dissipation=(damping(on, resistance),),
        ports=(
            Port(
                "terminal",
                ELECTRICAL,
                "effort",
                {on: 1},
                nominal=v,
                description="phases to ground; current into the branch",
                **p.each,
            ),
        ),
        observables=tuple(told),
        description=f"{p.word} series R-L-C to ground",
    )


def _require(part: str, V: float, f: float) -> None:
    if not (V > 0 and f > 0):
        raise ValueError(
            f"{part}: V = {V:g} V and f = {f:g} Hz must be positive; V is rms, line to line, and f not in rad/s"
        )
