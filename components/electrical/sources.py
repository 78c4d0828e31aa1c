"""Ideal sources whose work is booked at a port of their own."""

from __future__ import annotations

from typing import Any

import casadi as ca

from phfmu import ELECTRICAL, PHDAE, Port, Variable, algebraic, skew


def voltage_source(
    voltage: Any,
    *,
    size: int | None = None,
    parameters: tuple[Variable, ...] = (),
    v: float = 1.0,
    i: float = 1.0,
    elements: tuple[str, ...] = (),
) -> PHDAE:
    """Ideal voltage source: `voltage` is an expression of `time` and `parameters` (size x 1).

    0 = v - voltage(t),  0 = -i + terminal.i

    H:  0;  J: J[i, v] = 1 (skew);  R: 0
    algebraic:   i [A], current into the source; v [V], its voltage
    ports:       terminal: current INTO the source given, voltage out; source: fed from inside, its energy is
                 the work of the source, source.i = -i
    `v` [V], `i` [A]: typical magnitudes;  `elements`: names of the entries, such as phases.
    Source: Guenther, Bartel, Jacob, Reis 2020 (independent source as a port).
    """
    current = algebraic("i", size, unit="A", nominal=i, elements=elements, description="current into the source")
    volt = algebraic("v", size, unit="V", nominal=v, elements=elements, description="voltage of the source")
    return PHDAE(
        "voltage_source",
        algebraics=(current, volt),
        parameters=parameters,
        structure=(skew(current, volt, 1),),
        ports=(
            Port("terminal", ELECTRICAL, "flow", {volt: 1}, size=size, nominal=i, elements=elements,
                 description="current into the source"),
            Port("source", ELECTRICAL, "effort", {current: -1}, size=size, source=ca.SX(voltage), nominal=v, elements=elements,
                 description="inner voltage; its energy is the work of the source"),
        ),
        description="ideal voltage source",
    )  # fmt: skip


def current_source(
    current: Any,
    *,
    size: int | None = None,
    parameters: tuple[Variable, ...] = (),
    v: float = 1.0,
    i: float = 1.0,
    elements: tuple[str, ...] = (),
) -> PHDAE:
    """Ideal current source: delivers `current`, an expression of `time` and `parameters` (size x 1).

    0 = -v + terminal.v,  0 = i + current(t)

    H:  0;  J: J[i, v] = -1 (skew);  R: 0
    algebraic:   i [A], current into the source; v [V], its voltage
    ports:       terminal: voltage given, current INTO the source out (= -current); source: fed from inside
    `v` [V], `i` [A]: typical magnitudes;  `elements`: names of the entries, e.g. those of the phases.
    """
    into = algebraic("i", size, unit="A", nominal=i, elements=elements, description="current into the source")
    volt = algebraic("v", size, unit="V", nominal=v, elements=elements, description="voltage of the source")
    return PHDAE(
        "current_source",
        algebraics=(into, volt),
        parameters=parameters,
        structure=(skew(into, volt, -1),),
        ports=(
            Port("terminal", ELECTRICAL, "effort", {into: 1}, size=size, nominal=v, elements=elements,
                 description="current into the source"),
            Port("source", ELECTRICAL, "flow", {volt: 1}, size=size, source=ca.SX(current), nominal=i, elements=elements,
                 description="inner current; its energy is the work of the source"),
        ),
        description="ideal current source",
    )  # fmt: skip
