"""Breakers, faults that clear and diodes in series with an inductance."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import inf

import casadi as ca

from phfmu import (
    ELECTRICAL,
    PHDAE,
    Guard,
    Jump,
    Port,
    StateEvent,
    Variable,
    damping,
    energy,
    observable,
    parameter,
    state,
)
from phfmu.components.electrical.phases import PHASES

#: currents that opening at a zero leaves, as a part of the typical current: rounding
LANDED = 1e-6


def breaker(
    R: float,
    L: float,
    *,
    chop: float = 0.0,
    arc: float = 0.0,
    withstand: float | None = None,
    phases: int = 3,
    i: float = 1.0,
    v: float = 1.0,
    start: Sequence[float] = (),
) -> PHDAE:
    """Line between `a` and `b` with a breaker in each phase: flux' = s (v_a - v_b) - R i - g V_arc,  i = flux/L.

    H:  |flux|^2 / (2 L);  J: 0;  R: R on each phase;  ports: a.i = s i, b.i = -s i
    states:      flux (phases) [Wb], nothing flows where s = 0
    ports:       a, b: voltages given, currents INTO the line out; with an arc: arc, inside, what leaves there heats it
    parameters:  R [ohm], L [H] per phase; command: 1 close, 0 open each pole at its current zero, 2 open at once;
                 with an arc: V_arc [V], V_withstand [V]
    modes:       closed (phases): s, 1 or 0; with an arc: arcing (phases): g, the sign of its current, 0 without
    observables: i (phases), the current from a to b; u (phases), the voltage over the poles
    `chop`: poles open below this |current| [A] already and lose L i^2/2, booked as an event; with command 2 they lose that of
    any current.
    `arc`: voltage [V] against the current of a pole that is told to open, until a zero; the pole is open where it carries no
    current, and conducts again, over its arc, where |v_a - v_b| exceeds `withstand` [V] (at least `arc`).
    `i`: typical current [A];  `v`: typical voltage [V]; `start` (phases): currents at the start [A], none by default.
    ValueError for an arc with `chop`, and for a `withstand` below `arc`.
    Source: switches that modulate the interconnection, Escobar, van der Schaft, Ortega, Automatica 35 (1999).
    """
    poles = _Poles(R, L, phases, i, v, start)
    if arc:
        return _with_arc(poles, arc, withstand, chop)
    return replace(
        poles.declaration("breaker", "series R-L line with a breaker in each phase"),
        state_events=tuple(e for j in range(phases) for e in (*poles.opening(j, chop), poles.closing(j))),
    )


def clearing_fault(
    R: float, L: float, *, there: bool = False, phases: int = 3, i: float = 1.0, v: float = 1.0
) -> PHDAE:
    """Fault to ground that clears at the zeros of its currents: flux' = s v_a - R i,  i = flux/L.

    H:  |flux|^2 / (2 L);  J: 0;  R: R on each phase;  port: a.i = s i
    states:      flux (phases) [Wb]
    ports:       a: voltages given, currents INTO the fault out
    parameters:  R [ohm], L [H] per phase; command: 1 the fault comes, 0 each phase clears at its current zero, 2 at once
    modes:       closed (phases): s, 1 or 0
    observables: i (phases); u (phases), the voltage where a phase is clear
    `there`: at the start;  `i`: typical current [A];  `v`: typical voltage [V].
    """
    poles = _Poles(R, L, phases, i, v, (), grounded=True, told=float(there))
    return replace(
        poles.declaration("clearing_fault", "fault to ground that clears at the zeros of its currents"),
        state_events=tuple(e for j in range(phases) for e in (*poles.opening(j, 0.0), poles.closing(j))),
    )


class _Poles:
    """Base of breakers and faults: branches in series with R and L whose poles events open and close."""

    def __init__(
        self,
        R: float,
        L: float,
        phases: int,
        i: float,
        v: float,
        start: Sequence[float],
        *,
        grounded: bool = False,
        told: float = 1.0,
    ):
        self.phases, self.i, self.v = phases, i, v
        self.L = parameter("L", L, unit="H", positive=True, description="inductance per phase")
        self.R = parameter("R", R, unit="ohm", description="resistance per phase")
        words = "1 comes, 0 clears at zeros, 2 at once" if grounded else "1 close, 0 open at zeros, 2 open at once"
        self.command = parameter("command", told, min=0.0, max=2.0, description=words)
        self.called = called = PHASES if phases == len(PHASES) else ()
        self.closed = parameter(
            "closed", told, phases, min=0.0, max=1.0, description="poles: 1 closed, 0 open", elements=called
        )
        fluxes = [L * x for x in start] or 0.0
        where = "a to ground" if grounded else "a to b"
        self.flux = state(
            "flux",
            phases,
            unit="Wb",
            start=fluxes,
            nominal=L * i,
            description=f"flux per phase, {where}",
            elements=called,
        )
        s = ca.diag(self.closed.sx)
        a = Port(
            "a", ELECTRICAL, "effort", {self.flux: s}, size=phases, nominal=v, description="end a", elements=called
        )
        b = Port(
            "b", ELECTRICAL, "effort", {self.flux: -s}, size=phases, nominal=v, description="end b", elements=called
        )
        self.ports = (a,) if grounded else (a, b)
        self.over = a.u if grounded else a.u - b.u

    def pole(self, j: int) -> str:
        """The mode of pole j."""
        return f"closed[{j + 1}]"

    def jump(self, j: int, most: float = 0.0) -> Jump:
        """The current of pole j becomes 0; from at most `most` [A] and rounding."""
        return Jump({self.flux: ca.SX.eye(self.phases)[:, j]}, most=most * (1 + LANDED) + LANDED * self.i)

    def opening(self, j: int, chop: float) -> Iterator[StateEvent]:
        """At a zero, or below a current `chop`; at once."""
        current, name, closed = self.flux.z[j], f"pole{j + 1}", {self.pole(j): 1.0}
        zero = Guard(f"{name}.zero", current, 0, self.i, "A")
        if chop > 0.0:
            zero = Guard(f"{name}.chop", ca.fabs(current) - chop, -1, self.i, "A")
        opens = {self.pole(j): 0.0}
        yield StateEvent(zero, when={"command": 0.0, **closed}, sets=opens, jump=self.jump(j, chop))
        at_once = Guard(f"{name}.force", self.command, 1)  # beyond zero when it is armed
        yield StateEvent(at_once, when={"command": 2.0, **closed}, sets=opens, jump=self.jump(j, inf))

    def closing(self, j: int) -> StateEvent:
        """At once."""
        at_once = Guard(f"pole{j + 1}.close", self.command, 1)
        return StateEvent(at_once, when={"command": 1.0, self.pole(j): 0.0}, sets={self.pole(j): 1.0})

    def declaration(self, name: str, description: str) -> PHDAE:
        """Without events."""
        of = "through the fault" if len(self.ports) == 1 else "from a to b"
        return PHDAE(
            name,
            states=(self.flux,),
            parameters=(self.R, self.L, self.command, self.closed),
            energies=(energy(ca.sumsqr(self.flux.sx) / (2 * self.L)),),
            dissipation=(damping(self.flux, self.R),),
            ports=self.ports,
            observables=(
                observable("i", self.flux.z, unit="A", description=f"current {of}", elements=self.called),
                observable(
                    "u",
                    (1 - self.closed.sx) * self.over,
                    unit="V",
                    description="voltage over the poles",
                    elements=self.called,
                ),
            ),
            description=description,
        )


def _with_arc(poles: _Poles, arc: float, withstand: float | None, chop: float) -> PHDAE:
    """A breaker whose poles arc between the command to open and a zero that stays one."""
    least = arc if withstand is None else withstand
    if chop or not 0 < arc <= least:
        raise ValueError(
            f"breaker: arc = {arc} V, withstand = {least} V, chop = {chop} A; an arc needs 0 < arc <= withstand and no chop"
        )
    n = poles.phases
    V = parameter("V_arc", arc, unit="V", positive=True, description="voltage of an arc")
    holds = parameter(
        "V_withstand", least, unit="V", positive=True, description="voltage over an open pole that it withstands"
    )
    arcing = parameter("arcing", 0.0, n, min=-1.0, max=1.0, description="sign of the arc's current, 0 without")
    inside = Port(
        "arc", ELECTRICAL, "effort", {poles.flux: -ca.diag(arcing.sx)}, size=n, nominal=poles.v,
        source=ca.repmat(V.sx, n, 1), description="the arcs; energy leaves there",
    )  # fmt: skip
    plain = poles.declaration("breaker", "series R-L line with a breaker in each phase that arcs")
    events = (e for j in range(n) for e in (*_arcing(poles, j, f"arcing[{j + 1}]", holds), poles.closing(j)))
    return replace(
        plain,
        parameters=(*plain.parameters, V, holds, arcing),
        ports=(*plain.ports, inside),
        state_events=tuple(events),
    )


def _arcing(poles: _Poles, j: int, g: str, holds: Variable) -> Iterator[StateEvent]:
    """Pole j: strikes when it is told to open, goes out at each zero, reignites beyond what it withstands; opens at once."""
    current, s, name = poles.flux.z[j], poles.pole(j), f"pole{j + 1}"
    told, over = {"command": 0.0}, poles.over[j]
    for sign, word in ((1.0, "positive"), (-1.0, "negative")):
        side = int(sign)
        strike = Guard(f"{name}.strike_{word}", current, side, poles.i, "A")
        yield StateEvent(strike, when={**told, s: 1.0, g: 0.0}, sets={g: sign})
        zero = Guard(f"{name}.zero_{word}", current, -side, poles.i, "A")
        yield StateEvent(zero, when={**told, s: 1.0, g: sign}, sets={s: 0.0, g: 0.0}, jump=poles.jump(j))
        again = Guard(f"{name}.reignite_{word}", over - sign * holds, side, poles.v, "V")
        yield StateEvent(again, when={**told, s: 0.0}, sets={s: 1.0, g: sign})
        cold = Guard(f"{name}.close_{word}", poles.command, 1)
        yield StateEvent(cold, when={"command": 1.0, s: 1.0, g: sign}, sets={g: 0.0})
        forced = Guard(f"{name}.force_{word}", poles.command, 1)
        yield StateEvent(forced, when={"command": 2.0, s: 1.0, g: sign}, sets={s: 0.0, g: 0.0}, jump=poles.jump(j, inf))
    forced = Guard(f"{name}.force", poles.command, 1)
    yield StateEvent(forced, when={"command": 2.0, s: 1.0, g: 0.0}, sets={s: 0.0}, jump=poles.jump(j, inf))


def ideal_diode(R: float, L: float, *, conducts: bool = False, i: float = 1.0, v: float = 1.0) -> PHDAE:
    """Branch from `a` to `b` with an ideal diode in series with R and L: flux' = s (v_a - v_b) - R i,  i = flux/L >= 0.

    It blocks (s = 0) where its current falls to zero and conducts (s = 1) where v_a - v_b rises above zero.

    H:  flux^2 / (2 L);  J: 0;  R: R;  ports: a.i = s i, b.i = -s i
    states:      flux [Wb]
    ports:       a, b: voltages given, currents INTO the branch out
    parameters:  R [ohm], L [H]
    modes:       conducts: s
    observables: i, the current from a to b
    `conducts`: at the start;  `i`: typical current [A];  `v`: typical voltage [V].
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
