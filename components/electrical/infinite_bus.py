"""Infinite bus: a stiff balanced three-phase voltage."""

from __future__ import annotations

import warnings
from dataclasses import replace
from math import pi

import casadi as ca

from phfmu import PHDAE, parameter, time
from phfmu.components.electrical.phases import PHASES
from phfmu.components.electrical.sources import voltage_source

#: frequencies of grids in Hz, of which rad/s are 2 pi times as many; how near such a number is one of them
GRIDS, NEAR = (50.0, 60.0), 1e-3


def infinite_bus(amplitude: float, frequency: float = 60.0, phase: float = 0.0, *, i: float = 1.0) -> PHDAE:
    """Stiff balanced grid: v_x = amplitude cos(omega t + phase - alpha_x),  omega = 2 pi frequency.

    0 = v - e(t),  0 = -i + terminal.i,  alpha = (0, 2 pi/3, -2 pi/3)

    H:  0;  J: J[i, v] = 1 (skew);  R: 0
    algebraic:   i (3) [A], current into the bus; v (3) [V]
    ports:       terminal: currents INTO the bus given, voltages out; source: fed from inside, source.energy
                 is the work that the grid puts in (negative if it takes power)
    parameters:  amplitude [V] (peak, phase to ground), omega [rad/s], phase [rad]
    frequency [Hz]: 50 or 60, not 314 or 377; the parameter omega that a run may set is in rad/s.  `i`: typical current [A].
    Warns (UserWarning) where the frequency is 2 pi times 50 or 60: most likely rad/s were given.
    """
    for hertz in GRIDS:
        if abs(frequency - 2.0 * pi * hertz) <= NEAR * frequency:
            remedy = f"most likely rad/s; it is in Hz, give frequency={hertz:g}"
            warnings.warn(f"infinite_bus: frequency = {frequency:g} is 2 pi {hertz:g}, {remedy}", stacklevel=2)
    a = parameter("amplitude", amplitude, unit="V", description="peak phase voltage")
    w = parameter("omega", 2.0 * pi * frequency, unit="rad/s", description="angular frequency")
    phi = parameter("phase", phase, unit="rad", description="phase of v_a at t = 0")
    angle = w * time + phi.sx
    e = ca.vertcat(*(a * ca.cos(angle - alpha) for alpha in (0.0, 2.0 * pi / 3.0, -2.0 * pi / 3.0)))
    bus = voltage_source(e, size=3, parameters=(a, w, phi), v=abs(amplitude) or 1.0, i=i, elements=PHASES)
    return replace(bus, name="infinite_bus", description="stiff balanced three-phase voltage")
