"""Star-grounded parallel R-L-C load of three phases, or of one; any of the three may be absent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from phfmu import (
    ELECTRICAL,
    PHDAE,
    Block,
    Energy,
    Observable,
    Port,
    Variable,
    algebraic,
    damping,
    energy,
    observable,
    parameter,
    skew,
    state,
)
from phfmu.components.electrical.phases import Phases

#: one value for all phases, or one for each
Start = float | Sequence[float]


def rlc_load(
    R: float | None = None,
    L: float | None = None,
    C: float | None = None,
    *,
    v: Start = 0.0,
    i: Start = 0.0,
    nominal: float = 1.0,
    phases: int = 3,
) -> PHDAE:
    """Parallel R, L, C from each phase to ground, each optional: a load, a reactor or the shunt of a line.

    with C:     charge' = terminal.i - v/R - flux/L,  flux' = v = charge/C
    without C:  flux' = v = terminal.v,  terminal.i = i + flux/L,  0 = -v + terminal.v,  0 = i - v/R

    H:  |charge|^2/(2 C) + |flux|^2/(2 L);  J: J[flux, charge] = 1, without C J[v, i] = 1 (skew);
    R:  1/R on charge or v
    states:      charge (3) [C] and flux (3) [Wb] of what is there;  algebraic: i [A], v [V] of R without C
    ports:       terminal: with C the current INTO the load given, voltage out; without C the reverse
    parameters:  R [ohm], L [H], C [F] per phase, of what is there
    observables: v (with C), i_L (with L), i_R (with R)
    `v`: start voltages of C; `i`: start currents of L; `nominal`: typical voltage [V];
    `phases`: 3, or 1 with scalars for (3).
    """
    p = Phases.of("rlc_load", phases)
    if R is None and L is None and C is None:
        raise ValueError("rlc_load: give at least one of R, L, C")
    for name, value in (("R", R), ("L", L), ("C", C)):
        if value is not None and not value > 0:
            raise ValueError(f"rlc_load: {name} = {value} must be positive; leave it out (None) for an open branch")
    coil = None if L is None else _inductor(p, L, i, nominal)
    plate = None if C is None else _capacitor(p, C, v, nominal)
    resistor = None if R is None else _resistor(p, R, plate, nominal)
    parts = [b for b in (coil, plate, resistor) if b is not None]
    parameters = [b.parameter for b in (resistor, coil, plate) if b is not None]
    between = () if coil is None or plate is None else (skew(coil.on, plate.on, 1),)
    given = "effort" if plate is None else "flow"
    on = {b.on: 1 for b in parts} if plate is None else {plate.on: 1}
    port = Port("terminal", ELECTRICAL, given, on, nominal=nominal if given == "effort" else 1.0,
                description="phases a, b, c to ground; current into the load", **p.each)  # fmt: skip
    return PHDAE(
        "rlc_load",
        states=tuple(b.on for b in parts if b.energies),
        algebraics=tuple(v for b in parts for v in b.algebraics),
        parameters=tuple(parameters),
        energies=tuple(e for b in parts for e in b.energies),
        structure=(*between, *(s for b in parts for s in b.structure)),
        dissipation=tuple(d for b in parts for d in b.dissipation),
        ports=(port,),
        observables=tuple(b.observable for b in parts),
        description=f"{p.word} parallel R-L-C to ground",
    )


@dataclass(frozen=True)
class Branch:
    """One of R, L, C: its parameter, the variable that the terminal acts on (a state if it stores energy), what it adds."""

    parameter: Variable
    on: Variable
    observable: Observable
    energies: tuple[Energy, ...] = ()
    algebraics: tuple[Variable, ...] = ()
    structure: tuple[Block, ...] = ()
    dissipation: tuple[Block, ...] = ()


def _inductor(p: Phases, L: float, i: Start, nominal: float) -> Branch:
    inductance = parameter("L", L, unit="H", description="inductance per phase")
    start = p.start(L, i)
    most = max(map(abs, start)) if isinstance(start, list) else abs(start)
    flux = state("flux", unit="Wb", start=start, nominal=max(nominal / 377.0, most),
                 description="flux of the inductor per phase", **p.each)  # fmt: skip
    stored = energy(sum(x**2 for x in ca.vertsplit(flux.sx)) / (2 * inductance), kind="quadratic")
    told = observable("i_L", flux.z, unit="A", description="current of the inductor", elements=p.elements)
    return Branch(inductance, flux, told, energies=(stored,))


def _capacitor(p: Phases, C: float, v: Start, nominal: float) -> Branch:
    capacitance = parameter("C", C, unit="F", description="capacitance per phase")
    charge = state("charge", unit="C", start=p.start(C, v), nominal=C * nominal,
                   description="charge of the capacitor per phase", **p.each)  # fmt: skip
    stored = energy(sum(x**2 for x in ca.vertsplit(charge.sx)) / (2 * capacitance), kind="quadratic")
    return Branch(
        capacitance,
        charge,
        observable("v", charge.z, unit="V", description="voltage to ground", elements=p.elements),
        (stored,),
    )


def _resistor(p: Phases, R: float, plate: Branch | None, nominal: float) -> Branch:
    """Across the capacitor if there is one, else on algebraic variables of its own."""
    resistance = parameter("R", R, unit="ohm", description="resistance per phase")
    what = "current of the resistor"
    if plate is not None:
        told = observable("i_R", plate.on.z / resistance.sx, unit="A", description=what, elements=p.elements)
        return Branch(resistance, plate.on, told, dissipation=(damping(plate.on, 1 / resistance),))
    current, volt, (turned, lost) = conductance_pair(1 / resistance, nominal, p)
    told = observable("i_R", current.sx, unit="A", description=what, elements=p.elements)
    return Branch(resistance, current, told, (), (current, volt), (turned,), (lost,))


def conductance_pair(G, nominal: float, phases: Phases) -> tuple[Variable, Variable, tuple[Block, Block]]:
    """Algebraic (i, v) of a conductance G in each phase with 0 = -v + u, 0 = i - G v; blocks of J and R."""
    current = algebraic("i", unit="A", description="current into the conductance", **phases.each)
    volt = algebraic("v", unit="V", nominal=nominal, description="voltage across the conductance", **phases.each)
    return current, volt, (skew(volt, current, 1), damping(volt, G))
