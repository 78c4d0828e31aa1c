"""Ideal switches between two nodes: no resistance, no inductance, no time constant made up."""

from __future__ import annotations

from dataclasses import replace
from math import inf, pi
from typing import Literal, TypeAlias

import casadi as ca

from phfmu import (
    ELECTRICAL,
    PHDAE,
    Guard,
    Port,
    StateEvent,
    Switch,
    Variable,
    algebraic,
    observable,
    parameter,
    signal_input,
    time,
)

Law: TypeAlias = Literal["free", "unilateral"]


def _between(
    name: str,
    law: Law,
    on: bool,
    i: float,
    v: float,
    what: str,
    *more: Variable,
    most: float = 0.0,
) -> PHDAE:
    """One switch from `a` to `b`: 0 = v_a - v_b while it conducts, 0 = i while it does not."""
    current = algebraic("i", unit="A", nominal=i, description="current from a to b")
    mode = parameter("conducts", float(on), min=0.0, max=1.0, description="1 conducts, 0 blocks")
    a = Port("a", ELECTRICAL, "effort", {}, nominal=v, description="current into the switch")
    b = Port("b", ELECTRICAL, "effort", {}, nominal=v, description="current into the switch")
    when = {p.name: 1.0 for p in more}
    switch = Switch(name, current, {a: -1.0, b: 1.0}, mode, law, when, most=most, nominal=v, unit="V")
    u = observable("u", a.u - b.u, unit="V", description="voltage from a to b")
    return PHDAE(
        name,
        algebraics=(current,),
        parameters=(mode, *more),
        ports=(a, b),
        switches=(switch,),
        observables=(u,),
        description=what,
    )


def diode(*, conducts: bool = False, i: float = 1.0, v: float = 1.0) -> PHDAE:
    """Ideal diode from `a` to `b`:  0 <= i,  0 <= v_b - v_a,  i (v_b - v_a) = 0.

    0 = v_a - v_b while it conducts, 0 = i while it blocks

    H:  0;  algebraic: i [A], from a to b
    ports:       a, b: voltages given, currents INTO the diode out
    modes:       conducts: 1 or 0
    observables: u, the voltage from a to b [V]
    `conducts`: at the start;  `i`: typical current [A];  `v`: typical voltage [V].
    Source: Camlibel, Heemels, van der Schaft, Schumacher, IEEE TCAS-I 50 (2003).
    """
    return _between("diode", "unilateral", conducts, i, v, "ideal diode")


def thyristor(*, conducts: bool = False, gate: float = 0.0, i: float = 1.0, v: float = 1.0) -> PHDAE:
    """Ideal thyristor from `a` to `b`: blocks both ways until `gate` = 1 and v_a > v_b, then conducts until i falls to zero.

    As `diode`, with the parameter `gate` (1 or 0), which events set.  `v` [V]: typical voltage.
    """
    fired = parameter("gate", gate, min=0.0, max=1.0, description="1: may begin to conduct")
    return _between("thyristor", "unilateral", conducts, i, v, "ideal thyristor", fired)


def ideal_switch(*, conducts: bool = True, force: bool = False, i: float = 1.0, v: float = 1.0) -> PHDAE:
    """Ideal switch between `a` and `b`, closed and opened by setting `conducts`.

    0 = v_a - v_b while it conducts, 0 = i while it does not

    Closing it between capacitors loses C1 C2/(2 (C1 + C2)) dv^2, booked.  Opening it where its current has nowhere to go is
    refused, with `force` it loses L i^2/2, booked.  Ports and modes as of `diode`.  `v` [V]: typical voltage.
    """
    return _between("switch", "free", conducts, i, v, "ideal switch", most=inf if force else 0.0)


def chopper(f: float, *, duty: float = 0.5, i: float = 1.0, v: float = 1.0) -> PHDAE:
    """Ideal switch between `a` and `b` that conducts for the first `duty` of every period 1/f.

        conducts while h < 0,   h = cos(pi d) - cos(2 pi f t - pi d),   which is zero at f t = n and f t = n + d

    As `ideal_switch`; signal input: duty d (0 to 1, beyond as at these), which may change at any time;  parameters: f [Hz];
    `v` [V]: typical voltage
    """
    base = ideal_switch(conducts=False, i=i, v=v)
    frequency = parameter("f", f, unit="Hz", positive=True, description="switching frequency")
    d = signal_input("duty", duty, description="part of the period in which it conducts")
    within = ca.fmax(0.0, ca.fmin(1.0, d.sx))
    h = ca.cos(pi * within) - ca.cos(2 * pi * frequency.sx * time - pi * within)
    on, off = {"conducts": 1.0}, {"conducts": 0.0}
    events = (
        StateEvent(Guard("begins", h, -1), when=off, sets=on),
        StateEvent(Guard("ends", h, 1), when=on, sets=off),
    )
    return replace(
        base,
        name="chopper",
        parameters=(*base.parameters, frequency, d),
        state_events=events,
        description="ideal switch, pulse-width modulated",
    )
