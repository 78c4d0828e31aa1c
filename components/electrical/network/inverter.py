"""A grid-following inverter: a controlled current source that finds the angle of its voltage by a phase-locked loop."""

from __future__ import annotations

from math import cos, pi, sqrt

import casadi as ca

from phfmu import ELECTRICAL, PHDAE, Port, algebraic, driven, parameter, signal_input, signal_output, skew, state
from phfmu.components.electrical.phase_locked_loop import phase_locked_loop
from phfmu.components.electrical.phases import ALPHA, PHASES

#: entries of a voltage along and across an angle, and back, as power needs them: P = vd Id + vq Iq
_SCALE = sqrt(2.0 / 3.0)


def grid_following_inverter(
    P: float = 0.0,
    Q: float = 0.0,
    *,
    V: float,
    S: float,
    fn: float = 50.0,
    most: float = 1.1,
    least: float = 0.3,
    Ti: float = 1e-3,
    TV: float = 20e-3,
    kp: float = 60.0,
    ki: float = 1400.0,
    angle: float = 0.0,
) -> PHDAE:
    """Inverter that delivers P and Q into a voltage that others make; its inner loops are a lag, its switches are averaged.

        vd + j vq = sqrt(2/3) sum_k v_k exp(-j (theta - alpha_k)),   i_k = sqrt(2/3) Re((Id + j Iq) exp(j (theta - alpha_k)))
        theta' = 2 pi fn + kp vq/V + x,   x' = ki vq/V                          phase-locked loop
        TV U' = vd - U,   Ti Id' = s P/m - Id,   Ti Iq' = -s Q/m - Iq,   m = max(U, least V)
        s = min(1, most S/V/|(P + jQ)/m|)                                       limit of the current, P and Q in proportion

    so that P = vd Id + vq Iq is delivered, vd in V rms, line to line.  The work of the inverter is the energy of its port
    `source`, where its direct-current side would be: no energy is stored and none is lost.

    H:  0: its states have no energy;  J: J[i, v] = -1 (skew);  R: 0
    states:       theta [rad], x [rad/s] of the loop, U [V], voltage, Id, Iq [A] rms, delivered
    algebraic:    i [A], current into the inverter; v [V], its voltage
    ports:        terminal: voltages given, currents INTO the inverter out; source: fed from inside
    signals:      P [W], Q [var] in; frequency [Hz] of the loop, voltage [1], active [W], reactive [var] as commanded, out
    P [W], Q [var]: delivered;  V [V], rms, line to line, S [VA], fn [Hz]: rated;  most [1]: current, of S/V;  least [1]: voltage,
    of V, below which power falls with it;  Ti, TV [s];  kp [1/s], ki [1/s2];  angle [rad] of phase a at the start.
    Not passive: in a weak grid its loop and its constant power make oscillations grow, sooner with a short TV.
    ValueError for ratings, times and limits that are not positive.
    """
    wrong = {
        n: x
        for n, x in {"V": V, "S": S, "fn": fn, "most": most, "least": least, "Ti": Ti, "TV": TV}.items()
        if not x > 0
    }
    if wrong:
        raise ValueError(
            f"grid_following_inverter: {', '.join(f'{n} = {x:g}' for n, x in wrong.items())} must be positive"
        )
    active = signal_input("P", P, unit="W", description="active power to deliver")
    reactive = signal_input("Q", Q, unit="W", description="reactive power to deliver, in var")
    rated = parameter("V", V, unit="V", positive=True, description="rated voltage, rms, line to line")
    limit = parameter("most", most * S / V, unit="A", positive=True, description="largest current, of Id + j Iq")
    floor = parameter(
        "least", least, unit="1", positive=True, description="of V, below which power falls with the voltage"
    )
    lag = parameter("Ti", Ti, unit="s", positive=True, description="lag of the current")
    filtered = parameter("TV", TV, unit="s", positive=True, description="lag of the measured voltage")

    peak, current = _SCALE * V, _SCALE * S / V
    U = state("U", start=V, unit="V", nominal=V, description="measured voltage, rms, line to line")
    along = state("Id", start=P / V, unit="A", nominal=S / V, description="delivered current along the voltage")
    across = state("Iq", start=-Q / V, unit="A", nominal=S / V, description="delivered current ahead of the voltage")
    i = algebraic("i", 3, unit="A", nominal=current, elements=PHASES, description="current into the inverter")
    v = algebraic("v", 3, unit="V", start=[peak * cos(angle - a) for a in ALPHA], nominal=peak, elements=PHASES,
                  description="voltage of the phases")  # fmt: skip

    loop = phase_locked_loop(v, rated.sx, fn, kp, ki, angle)
    cosines, sines = (ca.vertcat(*(f(loop.theta.sx - a) for a in ALPHA)) for f in (ca.cos, ca.sin))
    vd = _SCALE * ca.dot(cosines, v.sx)
    delivered = _SCALE * (along.sx * cosines - across.sx * sines)
    m = ca.fmax(U.sx, floor.sx * rated.sx)
    wanted = ca.sqrt(active.sx**2 + reactive.sx**2 + (1e-9 * rated.sx * limit.sx) ** 2) / m
    part = ca.fmin(1.0, limit.sx / wanted)
    rates = loop.rates | {
        U: (vd - U.sx) / filtered.sx,
        along: (part * active.sx / m - along.sx) / lag.sx,
        across: (-part * reactive.sx / m - across.sx) / lag.sx,
    }
    return PHDAE(
        "grid_following_inverter",
        states=tuple(rates),
        algebraics=(i, v),
        parameters=(active, reactive, rated, limit, floor, lag, filtered, *loop.parameters),
        structure=(skew(i, v, -1.0),),
        ports=(
            Port("terminal", ELECTRICAL, "effort", {i: 1.0}, size=3, nominal=peak, elements=PHASES,
                 description="current into the inverter"),
            driven("source", {v: delivered}, description="the delivered current; its energy is the work of the inverter"),
            driven("control", rates, description="the rates of the control; no work"),
        ),
        observables=(
            signal_output("frequency", loop.parameters[0] + loop.x / (2.0 * pi), unit="1/s", description="of the loop"),
            signal_output("voltage", U.sx / rated.sx, description="measured voltage in per unit"),
            signal_output("active", U.sx * along.sx, unit="W", description="active power at the measured voltage"),
            signal_output("reactive", -U.sx * across.sx, unit="W", description="reactive power at the measured voltage, in var"),
        ),
        description="grid-following inverter: current source with a phase-locked loop",
    )  # fmt: skip
