"""Ideal sources whose work is booked at a port of their own."""

from __future__ import annotations

from dataclasses import replace
from math import pi
from typing import Any

import casadi as ca

from phfmu import ELECTRICAL, PHDAE, Port, Variable, algebraic, parameter, skew, time
from phfmu.components.electrical.phases import PHASES


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


def balanced_current_source(phasor: complex, frequency: float = 60.0, *, v: float = 1.0, i: float = 1.0) -> PHDAE:
    """Plant that delivers the balanced current Re(phasor exp(j (omega t - alpha))), whatever its voltage is.

    alpha = (0, 2 pi/3, -2 pi/3),  omega = 2 pi frequency; the rest as in `current_source`.

    parameters:  phasor (2) [A] (peak): real and imaginary part, omega [rad/s]
    frequency [Hz];  `v` [V], `i` [A]: typical magnitudes.
    """
    z = complex(phasor)
    parts = parameter("phasor", [z.real, z.imag], 2, unit="A", description="current of phase a that it delivers")
    w = parameter("omega", 2.0 * pi * frequency, unit="rad/s", description="angular frequency")
    angles = [w * time - alpha for alpha in (0.0, 2.0 * pi / 3.0, -2.0 * pi / 3.0)]
    current = ca.vertcat(*(parts[0] * ca.cos(x) - parts[1] * ca.sin(x) for x in angles))
    source = current_source(current, size=3, parameters=(parts, w), v=v, i=i, elements=PHASES)
    return replace(source, name="balanced_current_source", description="constant balanced three-phase current")
