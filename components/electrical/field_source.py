"""A voltage that a signal sets."""

from __future__ import annotations

from phfmu import ELECTRICAL, PHDAE, Port, algebraic, signal_input, skew


def field_source(voltage: float = 0.0, *, nominal: float = 1.0, i: float = 1.0, size: int | None = None) -> PHDAE:
    """A voltage source that follows a signal, such as that of an exciter at a field winding.

        0 = -v + voltage,   0 = -i + terminal.i

    H:  0;  J: J[i, v] = 1 (skew);  R: 0
    Algebraic:     i [A], current into the source; v [V], its voltage
    Ports:         terminal (current INTO the source given, voltage out); source: fed from inside, the work of the source
    Signal input:  voltage [V];  `nominal` [V], `i` [A]: typical magnitudes;  `size`: number of phases
    """
    command = signal_input("voltage", voltage, size, unit="V", description="voltage of the source")
    current = algebraic("i", size, unit="A", nominal=i, description="current into the source")
    volt = algebraic("v", size, unit="V", nominal=nominal, description="voltage of the source")
    return PHDAE(
        "field_source",
        algebraics=(current, volt),
        parameters=(command,),
        structure=(skew(current, volt, 1.0),),
        ports=(
            Port("terminal", ELECTRICAL, "flow", {volt: 1.0}, size=size, nominal=i,
                 description="current into the source"),
            Port("source", ELECTRICAL, "effort", {current: -1.0}, size=size, source=command.sx, nominal=nominal,
                 description="voltage of the source; its energy is the work"),
        ),
        description="voltage set by a signal",
    )  # fmt: skip
