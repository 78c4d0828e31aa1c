"""Single-phase branches and nodes."""

from __future__ import annotations

from typing import Any

import casadi as ca

from phfmu import ELECTRICAL, PHDAE, Port, damping, energy, observable, parameter, state


def rl_branch(
    R: float, L: float, *, source: Any = None, size: int | None = None, i0: float = 0.0, i: float = 1.0, v: float = 1.0
) -> PHDAE:
    """Inductance and resistance in series, with a voltage source or not:  flux' = terminal.v - R i + source(t),  i = flux/L.

    H:  |flux|^2 / (2 L);  R: R
    states:      flux (size) [Wb]
    ports:       terminal: voltage given, current INTO the branch out;  source: fed from inside, its energy is the source's work
    parameters:  R [ohm], L [H]
    observables: current
    `source`: expression of `time`;  `size`: phases;  `i0`: start current [A];
    `i`: typical current [A];  `v`: typical voltage [V].
    """
    inductance = parameter("L", L, unit="H", positive=True, description="inductance")
    resistance = parameter("R", R, unit="ohm", description="resistance")
    flux = state("flux", size, unit="Wb", start=L * i0, nominal=L * i, description="flux")
    ports = [
        Port("terminal", ELECTRICAL, "effort", {flux: 1.0}, size=size, nominal=v, description="current into the branch")
    ]
    if source is not None:
        what = "inner voltage; its energy is the work of the source"
        ports.append(
            Port(
                "source",
                ELECTRICAL,
                "effort",
                {flux: 1.0},
                size=size,
                source=ca.SX(source),
                nominal=v,
                description=what,
            )
        )
    return PHDAE(
        "rl_branch",
        states=(flux,),
        parameters=(resistance, inductance),
        energies=(energy(ca.sumsqr(flux.sx) / (2 * inductance)),),
        dissipation=(damping(flux, resistance),),
        ports=tuple(ports),
        observables=(observable("current", flux.z, unit="A", description="current into the branch"),),
        description="inductance and resistance in series",
    )


def rl_link(R: float, L: float, *, i0: float = 0.0, i: float = 1.0, v: float = 1.0) -> PHDAE:
    """Inductance and resistance in series between `a` and `b`:  flux' = v_a - v_b - R i,  i = flux/L.

    H:  flux^2 / (2 L);  R: R;  states: flux [Wb];  ports: a, b: voltages given, currents INTO the branch out
    parameters:  R [ohm], L [H];  observables: current, from a to b
    `i0`: start current [A];  `i`: typical current [A];  `v`: typical voltage [V].
    """
    inductance = parameter("L", L, unit="H", positive=True, description="inductance")
    resistance = parameter("R", R, unit="ohm", description="resistance")
    flux = state("flux", unit="Wb", start=L * i0, nominal=L * i, description="flux")
    return PHDAE(
        "rl_link",
        states=(flux,),
        parameters=(resistance, inductance),
        energies=(energy(flux**2 / (2 * inductance)),),
        dissipation=(damping(flux, resistance),),
        ports=tuple(
            Port(end, ELECTRICAL, "effort", {flux: sign}, nominal=v, description="current into the branch")
            for end, sign in (("a", 1.0), ("b", -1.0))
        ),
        observables=(observable("current", flux.z, unit="A", description="current from a to b"),),
        description="inductance and resistance between two nodes",
    )


def rc_node(R: float, C: float, *, v0: float = 0.0, i: float = 1.0, v: float = 1.0) -> PHDAE:
    """Capacitor and resistor to ground:  charge' = terminal.i - v/R,  v = charge/C.

    H:  charge^2 / (2 C);  R: 1/R;  states: charge [C];  ports: terminal: current INTO the node given, voltage out
    parameters:  R [ohm], C [F];  observables: voltage
    `v0`: start voltage [V];  `i`: typical current [A];  `v`: typical voltage [V].
    """
    capacitance = parameter("C", C, unit="F", positive=True, description="capacitance")
    resistance = parameter("R", R, unit="ohm", positive=True, description="resistance")
    charge = state("charge", unit="C", start=C * v0, nominal=C * v, description="charge")
    return PHDAE(
        "rc_node",
        states=(charge,),
        parameters=(resistance, capacitance),
        energies=(energy(charge**2 / (2 * capacitance)),),
        dissipation=(damping(charge, 1 / resistance),),
        ports=(Port("terminal", ELECTRICAL, "flow", {charge: 1.0}, nominal=i, description="current into the node"),),
        observables=(observable("voltage", charge.z, unit="V", description="voltage of the capacitor"),),
        description="capacitor and resistor to ground",
    )
