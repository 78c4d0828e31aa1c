"""Resistors and ideal transformers: ports without states, y = D u."""

from __future__ import annotations

from phfmu import ELECTRICAL, PHDAE, Given, Port, damping, parameter, skew


def resistor(R: float = 1.0, *, size: int | None = None, given: Given = "effort", nominal: float = 1.0) -> PHDAE:
    """A resistor from its terminal to ground, in each of `size` phases: feedthrough only, no unknown.

    given="effort":  i = v/R;   given="flow":  v = R i

    H:  0;  R: 1/R or R on the port
    ports:       terminal: voltage given, current INTO the resistor out, or the reverse
    parameters:  R [ohm]
    `nominal`: typical input, [V] or [A].  ValueError for R that is not positive.
    """
    if not R > 0:
        raise ValueError(f"resistor: R = {R} ohm must be positive")
    resistance = parameter("R", R, unit="ohm", description="resistance")
    terminal = Port("terminal", ELECTRICAL, given, {}, size=size, nominal=nominal, description="to ground")
    return PHDAE(
        "resistor",
        parameters=(resistance,),
        dissipation=(damping(terminal, 1 / resistance if given == "effort" else resistance.sx),),
        ports=(terminal,),
        description="resistor to ground",
    )


def transformer(n: float = 1.0, *, size: int | None = None, v: float = 1.0, i: float = 1.0) -> PHDAE:
    """Ideal transformer of ratio n = v_b / v_a: the skew part of the feedthrough, neither stores nor loses.

    v_b = n v_a,   i_a = -n i_b

    H:  0;  J: Gamma[a, b] = n (skew)
    ports:       a: voltage given, current INTO the transformer out; b: current INTO it given, voltage out
    parameters:  n [1]
    `v` [V], `i` [A]: typical voltage of a and current of b.
    """
    ratio = parameter("n", n, unit="1", description="ratio v_b / v_a")
    a = Port("a", ELECTRICAL, "effort", {}, size=size, nominal=v, description="side a to ground")
    b = Port("b", ELECTRICAL, "flow", {}, size=size, nominal=i, description="side b to ground")
    return PHDAE(
        "transformer",
        parameters=(ratio,),
        structure=(skew(a, b, ratio.sx),),
        ports=(a, b),
        description="ideal transformer",
    )
