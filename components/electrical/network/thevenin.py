"""Thevenin source of three phases or one: a grid known by its voltage and its short-circuit power."""

from __future__ import annotations

from math import hypot, pi

import casadi as ca

from phfmu import ELECTRICAL, PHDAE, Port, block, observable, parameter, state, time
from phfmu.components.electrical.network.lines import require_sequences
from phfmu.components.electrical.phases import Phases


def thevenin_source(
    V: float,
    S_sc: float,
    *,
    f: float = 50.0,
    x_r: float = 10.0,
    zero: float | None = None,
    angle: float = 0.0,
    rated: float | None = None,
    phases: int = 3,
) -> PHDAE:
    """Stiff balanced voltage behind an impedance:  flux' = terminal.v - e(t) - R_abc i,  flux = L_abc i.

    e_x = E cos(w t + angle - alpha_x),  E = V sqrt(2/phases),  w L = Z sin(atan x_r),  R = Z cos(atan x_r),  Z = V^2/S_sc
    R_abc, L_abc: symmetric matrices of these values and `zero` times these

    H:  i^T L_abc i/2;  J: 0;  R: R_abc
    states:      flux (3) [Wb]
    ports:       terminal: voltages given, currents INTO the source out;  source: fed from inside, its energy is the work of e
    parameters:  amplitude E [V] (peak, phase to ground), omega [rad/s], phase [rad]
                 R, R0 [ohm], L, L0 [H]: positive and zero sequence
    observables: i (3), the current into the source
    V [V], rms, line to line; S_sc [VA], three-phase short-circuit power; f [Hz]; `x_r` [1]: X/R; `zero` [1]: Z0/Z (1);
    `phases`: 3, or 1: V to ground, S_sc of one phase, no zero sequence, scalars for (3);  `angle` [rad] of phase a;
    `rated`: current [A]
    ValueError for values that are not positive.
    Source: IEC 60909-0 (short-circuit power of a network feeder).
    """
    if not (V > 0 and S_sc > 0 and f > 0 and x_r > 0):
        raise ValueError(
            f"thevenin_source: V = {V:g} V, S_sc = {S_sc:g} VA, f = {f:g} Hz and x_r = {x_r:g} must be positive"
        )
    p, w, Z = Phases.of("thevenin_source", phases), 2.0 * pi * f, V**2 / S_sc
    p.no_zero_sequence("thevenin_source", zero=zero)
    zero = 1.0 if zero is None else zero
    R, L = Z / hypot(1.0, x_r), Z * x_r / hypot(1.0, x_r) / w
    require_sequences("thevenin_source", "L", "H", L, zero * L)
    e = V * p.peak
    r = parameter("R", R, unit="ohm", min=0.0, description="positive-sequence resistance")
    l = parameter("L", L, unit="H", positive=True, description="positive-sequence inductance")
    r0 = parameter("R0", zero * R, unit="ohm", min=0.0, description="zero-sequence resistance")
    l0 = parameter("L0", zero * L, unit="H", positive=True, description="zero-sequence inductance")
    amplitude = parameter("amplitude", e, unit="V", description="peak phase voltage")
    omega = parameter("omega", w, unit="rad/s", description="angular frequency")
    phi = parameter("phase", angle, unit="rad", description="angle of phase a at t = 0")
    typical = rated or 0.1 * e / Z
    flux = state("flux", unit="Wb", nominal=L * typical, description="flux per phase", **p.each)
    turn = omega * time + phi.sx
    inner = ca.vertcat(*(amplitude * ca.cos(turn - a) for a in p.angles))
    return PHDAE(
        "thevenin_source",
        states=(flux,),
        parameters=(r, l, *((r0, l0) if p.count == 3 else ()), amplitude, omega, phi),
        energies=(p.energy(flux, l.sx, l0.sx),),
        dissipation=(block((flux,), p.matrix(r.sx, r0.sx)),),
        ports=(
            Port("terminal", ELECTRICAL, "effort", {flux: 1}, nominal=e, description="into the source", **p.each),
            Port("source", ELECTRICAL, "effort", {flux: -1}, source=inner, nominal=e,
                 description="inner voltage; its energy is the work of the source", **p.each),
        ),
        observables=(observable("i", flux.z, unit="A", description="current into the source", elements=p.elements),),
        description=f"{p.word} voltage behind an impedance",
    )  # fmt: skip
