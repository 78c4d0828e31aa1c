"""Switched conductance to ground of three phases, or of one."""

from __future__ import annotations

from phfmu import ELECTRICAL, PHDAE, Port, parameter
from phfmu.components.electrical.phases import Phases
from phfmu.components.electrical.rlc_load import conductance_pair


def fault_resistor(G: float = 0.0, *, nominal: float = 1.0, phases: int = 3) -> PHDAE:
    """Shunt conductance to ground in each phase, i = G v; G = 0 is open; events on G close and clear it.

    0 = -v + terminal.v,  0 = i - G v

    H:  0;  J: J[v, i] = 1 (skew);  R: G on v
    algebraic:   i (3) [A], v (3) [V]
    ports:       terminal: voltages given, currents INTO the fault out
    parameters:  G (3) [S] per phase; setting `G` sets all three, `G[1]` only phase a
    `nominal`: typical voltage [V];  `phases`: 3, or 1 with scalars for (3).
    """
    p = Phases.of("fault_resistor", phases)
    if not G >= 0:
        raise ValueError(f"fault_resistor: G = {G} S must not be negative (0 = open)")
    conductance = parameter("G", G, unit="S", description="conductance to ground per phase, 0 = open", **p.each)
    current, volt, (structure, dissipation) = conductance_pair(conductance, nominal, p)
    return PHDAE(
        "fault_resistor",
        algebraics=(current, volt),
        parameters=(conductance,),
        structure=(structure,),
        dissipation=(dissipation,),
        ports=(Port("terminal", ELECTRICAL, "effort", {current: 1}, nominal=nominal,
                    description="phases a, b, c to ground; current into the fault", **p.each),),
        description=f"switched {p.word} conductance to ground",
    )  # fmt: skip
