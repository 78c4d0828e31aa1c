"""Three-phase star-grounded parallel R-L-C load; any of the three may be absent."""

from __future__ import annotations

from collections.abc import Sequence

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

Phases = Sequence[float]


def rlc_load(
    R: float | None = None,
    L: float | None = None,
    C: float | None = None,
    *,
    v: Phases = (0.0, 0.0, 0.0),
    i: Phases = (0.0, 0.0, 0.0),
    nominal: float = 1.0,
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
    `v`: start voltages of C; `i`: start currents of L; `nominal`: typical voltage [V].
    """
    if R is None and L is None and C is None:
        raise ValueError("rlc_load: give at least one of R, L, C")
    for name, value in (("R", R), ("L", L), ("C", C)):
        if value is not None and not value > 0:
            raise ValueError(f"rlc_load: {name} = {value} must be positive; leave it out (None) for an open branch")
    resistance = None if R is None else parameter("R", R, unit="ohm", description="resistance per phase")
    inductance = None if L is None else parameter("L", L, unit="H", description="inductance per phase")
    capacitance = None if C is None else parameter("C", C, unit="F", description="capacitance per phase")
    parameters = tuple(p for p in (resistance, inductance, capacitance) if p is not None)
    states: list[Variable] = []
    algebraics: list[Variable] = []
    energies: list[Energy] = []
    structure: list[Block] = []
    dissipation: list[Block] = []
    observables: list[Observable] = []
    on: dict[Variable, float] = {}
    flux = None
    if inductance is not None and L is not None:
        start = [L * k for k in i]
        flux = state("flux", 3, unit="Wb", start=start, nominal=max([nominal / 377.0, *map(abs, start)]),
                     description="flux of the inductor per phase")  # fmt: skip
        states.append(flux)
        energies.append(energy(sum(flux[k] ** 2 for k in range(3)) / (2 * inductance)))
        observables.append(observable("i_L", flux.z, unit="A", description="current of the inductor"))
    if capacitance is not None and C is not None:
        charge = state("charge", 3, unit="C", start=[C * k for k in v], nominal=C * nominal,
                       description="charge of the capacitor per phase")  # fmt: skip
        states.append(charge)
        energies.append(energy(sum(charge[k] ** 2 for k in range(3)) / (2 * capacitance)))
        observables.append(observable("v", charge.z, unit="V", description="voltage to ground"))
        on[charge] = 1
        if flux is not None:
            structure.append(skew(flux, charge, 1))
        if resistance is not None:
            dissipation.append(damping(charge, 1 / resistance))
            observables.append(
                observable("i_R", charge.z / resistance.sx, unit="A", description="current of the resistor")
            )
    else:
        if flux is not None:
            on[flux] = 1
        if resistance is not None:
            current, volt, blocks = conductance_pair(1 / resistance, nominal)
            algebraics += [current, volt]
            structure.append(blocks[0])
            dissipation.append(blocks[1])
            on[current] = 1
            observables.append(observable("i_R", current.sx, unit="A", description="current of the resistor"))
    given = "effort" if capacitance is None else "flow"
    port = Port("terminal", ELECTRICAL, given, on, size=3, nominal=nominal if given == "effort" else 1.0,
                description="phases a, b, c to ground; current into the load")  # fmt: skip
    return PHDAE(
        "rlc_load",
        states=tuple(states),
        algebraics=tuple(algebraics),
        parameters=parameters,
        energies=tuple(energies),
        structure=tuple(structure),
        dissipation=tuple(dissipation),
        ports=(port,),
        observables=tuple(observables),
        description="three-phase parallel R-L-C to ground",
    )


def conductance_pair(G, nominal: float) -> tuple[Variable, Variable, tuple[Block, Block]]:
    """Algebraic (i, v) of a three-phase conductance G with 0 = -v + u, 0 = i - G v; blocks of J and R."""
    current = algebraic("i", 3, unit="A", description="current into the conductance")
    volt = algebraic("v", 3, unit="V", nominal=nominal, description="voltage across the conductance")
    return current, volt, (skew(volt, current, 1), damping(volt, G))
