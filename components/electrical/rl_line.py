"""Three-phase series R-L line."""

from __future__ import annotations

from collections.abc import Sequence

from phfmu import ELECTRICAL, PHDAE, Port, damping, energy, observable, parameter, state
from phfmu.components.electrical.phases import PHASES


def rl_line(R: float, L: float, *, i: Sequence[float] = (0.0, 0.0, 0.0), v: float = 1.0, rated: float = 1.0) -> PHDAE:
    """Three-phase series line between `a` and `b`: flux' = v_a - v_b - R i,  i = flux/L.

    H:  |flux|^2 / (2 L);  J: 0;  R: R on each phase
    states:      flux (3) [Wb]
    ports:       a, b: voltages given, currents INTO the line out; a.i = i, b.i = -i
    parameters:  R [ohm], L [H] per phase
    observables: i (3), the current from a to b
    `i`: start currents [A]; `v`: typical voltage [V] of the ports; `rated`: typical current [A], at least that of the start.
    """
    if not L > 0 or not R >= 0:
        raise ValueError(f"rl_line: L = {L} H must be positive and R = {R} ohm not negative")
    inductance = parameter("L", L, unit="H", description="inductance per phase")
    resistance = parameter("R", R, unit="ohm", description="resistance per phase")
    size = L * max(rated, *map(abs, i))
    flux = state(
        "flux",
        3,
        unit="Wb",
        start=[L * k for k in i],
        nominal=size,
        description="flux per phase, a to b",
        elements=PHASES,
    )
    return PHDAE(
        "rl_line",
        states=(flux,),
        parameters=(resistance, inductance),
        energies=(energy(sum(flux[k] ** 2 for k in range(3)) / (2 * inductance)),),
        dissipation=(damping(flux, resistance),),
        ports=(
            Port(
                "a",
                ELECTRICAL,
                "effort",
                {flux: 1},
                size=3,
                nominal=v,
                description="end a; current into the line",
                elements=PHASES,
            ),
            Port(
                "b",
                ELECTRICAL,
                "effort",
                {flux: -1},
                size=3,
                nominal=v,
                description="end b; current into the line",
                elements=PHASES,
            ),
        ),
        observables=(observable("i", flux.z, unit="A", description="current from a to b", elements=PHASES),),
        description="three-phase series R-L line",
    )
