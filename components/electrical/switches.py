"""Ideal switches between two nodes: no resistance, no inductance, no time constant made up."""

from __future__ import annotations

from math import inf

from phfmu import ELECTRICAL, PHDAE, Port, Switch, Variable, algebraic, observable, parameter
from phfmu.declare.switch import Law


def _between(name: str, law: Law, on: bool, i: float, v: float, what: str, *more: Variable, most: float = 0.0) -> PHDAE:
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
    `conducts`: at the start;  `i`, `v`: typical current and voltage.
    Source: Camlibel, Heemels, van der Schaft, Schumacher, IEEE TCAS-I 50 (2003).
    """
    return _between("diode", "unilateral", conducts, i, v, "ideal diode")


def thyristor(*, conducts: bool = False, gate: float = 0.0, i: float = 1.0, v: float = 1.0) -> PHDAE:
    """Ideal thyristor from `a` to `b`: blocks both ways until `gate` = 1 and v_a > v_b, then conducts until i falls to zero.

    As `diode`, with the parameter `gate` (1 or 0), which events set.
    """
    fired = parameter("gate", gate, min=0.0, max=1.0, description="1: may begin to conduct")
    return _between("thyristor", "unilateral", conducts, i, v, "ideal thyristor", fired)


def ideal_switch(*, conducts: bool = True, force: bool = False, i: float = 1.0, v: float = 1.0) -> PHDAE:
    """Ideal switch between `a` and `b`, closed and opened by setting `conducts`.

    0 = v_a - v_b while it conducts, 0 = i while it does not

    Closing it between capacitors loses C1 C2/(2 (C1 + C2)) dv^2, booked.  Opening it where its current has nowhere to go is
    refused, with `force` it loses L i^2/2, booked.  Ports and modes as of `diode`.
    """
    return _between("switch", "free", conducts, i, v, "ideal switch", most=inf if force else 0.0)
