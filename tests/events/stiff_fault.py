"""A source whose exciter runs into its limit while a fault discharges the capacitor of the bus in 2 us.

    L i' = E sin(w t) - R i - v,   C v' = i - v (1/R_b + G),   E' = k s (V - sqrt(v^2 + 1)),   s: 1 below the limit of E

At steps of 50 us the time constant C/G of the fault is shorter than a step by 25: Gauss nodes multiply what is left of v by
(1 - 12.5)/(1 + 12.5) = -0.85 in each.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from phfmu import (
    ELECTRICAL,
    PHDAE,
    Event,
    Guard,
    Network,
    Port,
    StateEvent,
    damping,
    driven,
    energy,
    observable,
    parameter,
    signal_input,
    signal_output,
    state,
    time,
)

R, L, C, BUS, W = 0.4, 5e-3, 2e-6, 400.0, 2 * np.pi * 50
GAIN, WANTED, LIMIT, START = 60.0, 6000.0, 10500.0, 9000.0
#: C/G = 2 us
FAULT = 1.0
T_FAULT, STOP, STEP = 5e-3, 0.02, 5e-5
EVENTS = (Event(T_FAULT, "bus.G", FAULT),)


def source() -> PHDAE:
    """Voltage behind R and L, its amplitude a signal."""
    flux = state("flux", unit="Wb", start=0.0, nominal=10.0)
    field = signal_input("field", START, unit="V")
    return PHDAE(
        "source",
        states=(flux,),
        parameters=(field,),
        energies=(energy(flux**2 / (2 * L)),),
        dissipation=(damping(flux, R),),
        ports=(
            Port("terminal", ELECTRICAL, "effort", {flux: -1.0}, nominal=1e4),
            Port("inner", ELECTRICAL, "effort", {flux: 1.0}, source=field.sx * ca.sin(W * time), nominal=1e4),
        ),
        observables=(observable("i", flux.z, unit="A"),),
    )


def bus() -> PHDAE:
    """A capacitor with a load and a fault to ground."""
    q, g = state("q", unit="C", start=0.0, nominal=C * 1e4), parameter("G", 0.0, unit="S")
    return PHDAE(
        "bus",
        states=(q,),
        parameters=(g,),
        energies=(energy(q**2 / (2 * C)),),
        dissipation=(damping(q, g + 1 / BUS),),
        ports=(Port("terminal", ELECTRICAL, "flow", {q: 1.0}, nominal=1e3),),
        observables=(
            signal_output("v", q.z, unit="V"),
            observable("i_fault", g * q.z, unit="A"),
        ),
    )


def exciter() -> PHDAE:
    """Integrates what the bus lacks until its output is at the limit, where it stays."""
    e, s, v = state("E", unit="V", start=START, nominal=1e4), parameter("free", 1.0), signal_input("v", 0.0, unit="V")
    gain = parameter("k", GAIN, unit="1/s")
    lack = s * gain * (WANTED - ca.sqrt(v.sx**2 + 1.0))
    return PHDAE(
        "exciter",
        states=(e,),
        parameters=(s, v, gain),
        ports=(driven("integrator", {e: lack}),),
        observables=(signal_output("field", e, unit="V"),),
        state_events=(StateEvent(Guard("limit", e - LIMIT, 1, 1e4, "V"), when={"free": 1.0}, sets={"free": 0.0}),),
    )


def network() -> Network:
    net = Network("stiff_fault")
    net.add("source", source())
    net.add("bus", bus())
    net.add("exciter", exciter())
    net.connect("source.terminal", "bus.terminal", name="node")
    net.signal("exciter.field", "source.field")
    net.signal("bus.v", "exciter.v")
    return net


def exact(times: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """(i, v, E) at the times, by another method, and when the exciter is at its limit."""
    found, at, x, free = np.zeros((len(times), 3)), np.inf, np.array([0.0, 0.0, START]), 1.0

    def rates(t: float, y: NDArray[np.float64], g: float) -> list[float]:
        i, v, e = y
        return [
            (e * np.sin(W * t) - R * i - v) / L,
            (i - v * (g + 1 / BUS)) / C,
            free * GAIN * (WANTED - np.sqrt(v**2 + 1.0)),
        ]

    def limit(t: float, y: NDArray[np.float64], g: float) -> float:
        return y[2] - LIMIT

    limit.terminal, limit.direction = True, 1  # type: ignore[attr-defined]
    t, ends = 0.0, [(T_FAULT, 0.0), (STOP, FAULT)]
    while ends:
        end, g = ends[0]
        s = solve_ivp(
            rates,
            (t, end),
            x,
            "Radau",
            args=(g,),
            events=limit if free else None,
            rtol=1e-10,
            atol=1e-7,
            dense_output=True,
        )
        here = (times >= t) & (times <= s.t[-1])
        if here.any():
            found[here] = s.sol(times[here]).T
        t, x = float(s.t[-1]), s.y[:, -1]
        if s.status == 1:
            at, free = t, 0.0
        else:
            ends.pop(0)
    return found, at
