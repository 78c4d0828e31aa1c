"""Measurements at three-phase ports, each through a lag, for controllers."""

from __future__ import annotations

from math import cos, pi, sqrt

import casadi as ca
import numpy as np

from phfmu import ELECTRICAL, PHDAE, Port, Variable, algebraic, driven, parameter, signal_output, skew, state
from phfmu.components.electrical.phase_locked_loop import phase_locked_loop
from phfmu.components.electrical.phases import ALPHA, PHASES


def meter(
    Vn: float, Sn: float = 1e6, fn: float = 60.0, *, TR: float = 0.02, through: bool = False, frequency: bool = True,
    kp: float = 60.0, ki: float = 1400.0, angle: float = 0.0,
) -> PHDAE:  # fmt: skip
    """A meter at a bus, or `through` which a current flows from a to b: it takes no power, and its signals lag by TR > 0.

        TR V' = |v|/Vn - V,    TR P' = v.i/Sn - P,   TR Q' = (G^T v).i/Sn - Q
        theta' = 2 pi fn + kp e + x,   x' = ki e,   e = sin(angle of v - theta),   TR f' = theta'/(2 pi) - f

    |v| is the norm of the three voltages, which is rms line to line; G turns phases ahead by a quarter of a period.
    `bus` takes the voltage of a bus without capacitor too, which is no state: as a signal it is a state of the meter.

    H:  0: its states have no energy;  J: J[v, i] (skew)
    Algebraic:       v [V], i [A] of the phases
    Ports:           a (voltage given); with `through` also b (current given): v_b = v_a, i_b = -i_a
    Signal outputs:  voltage [1], frequency [Hz] unless `frequency` is False; with `through` active, reactive [1] from a to b
    Vn [V rms, line to line], Sn [VA], fn [Hz]: rated;  kp [1/s], ki [1/s2]: of the loop that follows the angle;
    `angle` [rad]: of phase a at the start.  ValueError for TR that is not positive.
    """
    if not TR > 0:
        raise ValueError(
            f"meter: TR = {TR:g} s must be positive; a signal without lag would be a voltage that no state holds"
        )
    peak, rated = sqrt(2.0 / 3.0) * Vn, sqrt(2.0 / 3.0) * Sn / Vn
    i = algebraic("i", 3, unit="A", nominal=rated, elements=PHASES, description="current from a to b")
    begun = [peak * cos(angle - a) for a in ALPHA]
    v = algebraic("v", 3, unit="V", start=begun, nominal=peak, elements=PHASES, description="voltage of the phases")
    lag, rated_v = (parameter(n, x, unit=u, positive=True) for n, x, u in (("TR", TR, "s"), ("Vn", Vn, "V")))
    size = ca.sqrt(ca.sumsqr(v.sx) + (1e-6 * rated_v) ** 2)
    V = state("V", start=1.0, description="voltage in per unit")
    rates: dict[Variable, ca.SX] = {V: (size / rated_v - V) / lag}
    outputs = [signal_output("voltage", V.sx, description="voltage in per unit")]
    own: list[Variable] = [lag, rated_v]
    if frequency:
        loop = phase_locked_loop(v, size, fn, kp, ki, angle)
        f = state("f", unit="1/s", start=fn, nominal=fn, description="frequency")
        rates |= loop.rates | {f: (loop.speed / (2.0 * pi) - f) / lag}
        own += loop.parameters
        outputs.append(signal_output("frequency", f.sx, unit="1/s", description="frequency"))
    ports = [Port("a", ELECTRICAL, "effort", {i: 1.0}, size=3, nominal=peak, elements=PHASES, description="the bus")]
    if through:
        power = parameter("Sn", Sn, unit="W", positive=True)
        P, Q = (state(n, description=t) for n, t in (("P", "active power"), ("Q", "reactive power")))
        turn = np.array([[0.0, -1.0, 1.0], [1.0, 0.0, -1.0], [-1.0, 1.0, 0.0]]) / sqrt(3.0)
        rates |= {
            P: (ca.dot(v.sx, i.sx) / power - P) / lag,
            Q: (ca.dot(ca.mtimes(turn.T, v.sx), i.sx) / power - Q) / lag,
        }
        outputs += [signal_output("active", P.sx, description="active power from a to b in per unit"),
                    signal_output("reactive", Q.sx, description="reactive power from a to b in per unit")]  # fmt: skip
        ports.append(
            Port("b", ELECTRICAL, "flow", {v: 1.0}, size=3, nominal=rated, elements=PHASES, description="away")
        )
        own.append(power)
    return PHDAE(
        "meter",
        states=tuple(rates),
        algebraics=(i, v),
        parameters=tuple(own),
        structure=(skew(v, i, 1.0),),
        ports=(*ports, driven("own", rates, description="the rates of what is measured; no work")),
        observables=tuple(outputs),
        description="meter of voltage, frequency and powers",
    )
