"""Breakers and diodes in series with an inductance."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf

import casadi as ca

from phfmu import ELECTRICAL, PHDAE, Guard, Jump, Port, StateEvent, damping, energy, observable, parameter, state

#: currents that opening at a zero leaves, as a part of the typical current: rounding
LANDED = 1e-6


def breaker(
    R: float,
    L: float,
    *,
    chop: float = 0.0,
    phases: int = 3,
    i: float = 1.0,
    v: float = 1.0,
    start: Sequence[float] = (),
) -> PHDAE:
    """Line between `a` and `b` with a breaker in each phase: flux' = s (v_a - v_b) - R i,  i = flux/L.

    H:  |flux|^2 / (2 L);  J: 0;  R: R on each phase;  ports: a.i = s i, b.i = -s i
    states:      flux (phases) [Wb], nothing flows where s = 0
    ports:       a, b: voltages given, currents INTO the line out
    parameters:  R [ohm], L [H] per phase; command: 1 close, 0 open each pole at its current zero, 2 open at once
    modes:       closed (phases): s, 1 or 0
    observables: i (phases), the current from a to b; u (phases), the voltage over the poles
    `chop`: poles open below this |current| [A] already and lose L i^2/2, booked as an event; with command 2 they lose that of
    any current.  `i`, `v`: typical current and voltage; `start` (phases): currents at the start [A], none by default.
    Source: switches that modulate the interconnection, Escobar, van der Schaft, Ortega, Automatica 35 (1999).
    """
    inductance = parameter("L", L, unit="H", positive=True, description="inductance per phase")
    resistance = parameter("R", R, unit="ohm", description="resistance per phase")
    command = parameter("command", 1.0, min=0.0, max=2.0, description="1 close, 0 open at zeros, 2 open at once")
    closed = parameter("closed", 1.0, phases, min=0.0, max=1.0, description="poles: 1 closed, 0 open")
    fluxes = [L * x for x in start] or 0.0
    flux = state("flux", phases, unit="Wb", start=fluxes, nominal=L * i, description="flux per phase, a to b")
    a = Port("a", ELECTRICAL, "effort", {flux: ca.diag(closed.sx)}, size=phases, nominal=v, description="end a")
    b = Port("b", ELECTRICAL, "effort", {flux: -ca.diag(closed.sx)}, size=phases, nominal=v, description="end b")
    events = []
    for j in range(phases):
        pole, column, name = f"closed[{j + 1}]", ca.SX.eye(phases)[:, j], f"pole{j + 1}"
        current = flux.z[j]
        zero = Guard(f"{name}.zero", current, 0, i, "A")
        if chop > 0.0:
            zero = Guard(f"{name}.chop", ca.fabs(current) - chop, -1, i, "A")
        opens, closes = {pole: 0.0}, {pole: 1.0}
        below = Jump({flux: column}, most=chop * (1 + LANDED) + LANDED * i)
        at_once = Guard(f"{name}.force", command, 1)  # beyond zero when it is armed
        events += [
            StateEvent(zero, when={"command": 0.0, **closes}, sets=opens, jump=below),
            StateEvent(at_once, when={"command": 2.0, **closes}, sets=opens, jump=Jump({flux: column}, most=inf)),
            StateEvent(Guard(f"{name}.close", command, 1), when={"command": 1.0, **opens}, sets=closes),
        ]
    return PHDAE(
        "breaker",
        states=(flux,),
        parameters=(resistance, inductance, command, closed),
        energies=(energy(ca.sumsqr(flux.sx) / (2 * inductance)),),
        dissipation=(damping(flux, resistance),),
        ports=(a, b),
        observables=(
            observable("i", flux.z, unit="A", description="current from a to b"),
            observable("u", (1 - closed.sx) * (a.u - b.u), unit="V", description="voltage over the poles"),
        ),
        state_events=tuple(events),
        description="series R-L line with a breaker in each phase",
    )


def ideal_diode(R: float, L: float, *, conducts: bool = False, i: float = 1.0, v: float = 1.0) -> PHDAE:
    """Branch from `a` to `b` with an ideal diode in series with R and L: flux' = s (v_a - v_b) - R i,  i = flux/L >= 0.

    It blocks (s = 0) where its current falls to zero and conducts (s = 1) where v_a - v_b rises above zero.

    H:  flux^2 / (2 L);  J: 0;  R: R;  ports: a.i = s i, b.i = -s i
    states:      flux [Wb]
    ports:       a, b: voltages given, currents INTO the branch out
    parameters:  R [ohm], L [H]
    modes:       conducts: s
    observables: i, the current from a to b
    `conducts`: at the start;  `i`, `v`: typical current and voltage.
    """
    inductance = parameter("L", L, unit="H", positive=True, description="inductance")
    resistance = parameter("R", R, unit="ohm", description="resistance")
    mode = parameter("conducts", float(conducts), min=0.0, max=1.0, description="1 conducts, 0 blocks")
    flux = state("flux", unit="Wb", nominal=L * i, description="flux, a to b")
    a = Port("a", ELECTRICAL, "effort", {flux: mode.sx}, nominal=v, description="anode")
    b = Port("b", ELECTRICAL, "effort", {flux: -mode.sx}, nominal=v, description="cathode")
    on, off = {"conducts": 1.0}, {"conducts": 0.0}
    return PHDAE(
        "ideal_diode",
        states=(flux,),
        parameters=(resistance, inductance, mode),
        energies=(energy(flux**2 / (2 * inductance)),),
        dissipation=(damping(flux, resistance),),
        ports=(a, b),
        observables=(observable("i", flux.z, unit="A", description="current from a to b"),),
        state_events=(
            StateEvent(Guard("blocks", flux.z, -1, i, "A"), when=on, sets=off, jump=Jump({flux: 1.0}, most=LANDED * i)),
            StateEvent(Guard("conducts_on", a.u - b.u, 1, v, "V"), when=off, sets=on),
        ),
        description="ideal diode in series with R and L",
    )
