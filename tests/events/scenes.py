"""Scenes of several files: an oscillator that hits a wall, a rectifier bridge, a mass that is lifted off its floor."""

from __future__ import annotations

from math import cos, pi, sin, sqrt

import casadi as ca
import numpy as np
from scipy.optimize import brentq

from phfmu import (
    ELECTRICAL,
    PHDAE,
    TRANSLATIONAL,
    Guard,
    Jump,
    Port,
    StateEvent,
    Switch,
    algebraic,
    damping,
    energy,
    parameter,
    skew,
    state,
    time,
)

# -- an oscillator and a wall; it runs until WALL_STOP -----------------------------------------------------------

MASS, K, D, REBOUND = 1.3, 7.0, 0.4, 0.8
OMEGA = sqrt(K / MASS)
WALL_STOP = 6.0


def wall(e: float = REBOUND) -> PHDAE:
    """An oscillator that hits a wall at q = 0; its spring is free at q = -D."""
    q, p = state("q", unit="m", start=0.7), state("p", unit="kg.m/s", start=0.3)
    return PHDAE(
        "wall",
        states=(q, p),
        energies=(energy(p**2 / (2 * MASS)), energy(K / 2 * (q + D) ** 2)),
        structure=(skew(q, p, 1.0),),
        state_events=(StateEvent(Guard("wall", q, -1, unit="m"), jump=Jump({p: 1.0}, e)),),
    )


def exact() -> tuple[list[float], float, float]:
    """Times of the impacts, q and p at the stop."""
    t, x, v, times = 0.0, 0.7 + D, 0.3 / MASS, []

    def gap(s: float) -> float:
        return x * cos(OMEGA * s) + v / OMEGA * sin(OMEGA * s) - D

    while True:
        grid = np.linspace(1e-9, 2 * pi / OMEGA, 2001)
        falls = [i for i in range(2000) if gap(grid[i]) > 0 >= gap(grid[i + 1])]
        s = brentq(gap, grid[falls[0]], grid[falls[0] + 1], xtol=1e-15, rtol=9e-16) if falls else np.inf
        if t + s > WALL_STOP:
            s = WALL_STOP - t
            return times, gap(s), MASS * (v * cos(OMEGA * s) - x * OMEGA * sin(OMEGA * s))
        x, v = D, -REBOUND * (v * cos(OMEGA * s) - x * OMEGA * sin(OMEGA * s))
        t += s
        times.append(t)


# -- switches; the bridge runs until BRIDGE_STOP ---------------------------------------------------------------------

LA, RA, LD, RD, V, W, PHI, I0 = 2e-3, 0.05, 20e-3, 5.0, 100.0, 2 * pi * 50, 0.4, 8.0
BRIDGE_STOP = 0.05


def bridge() -> PHDAE:
    """A rectifier bridge between an AC and a DC inductor; on: one pair of its diodes blocks, off: it conducts."""
    a, d = state("fa", unit="Wb", nominal=0.05), state("fd", unit="Wb", nominal=0.3, start=LD * I0)
    mu, s = algebraic("mu", 2, unit="V", nominal=100.0), parameter("s", 0.0, 2)
    pairs = tuple(
        Switch(f"pair{j + 1}", mu.part(j, 1), {a: sign, d: 1.0}, s.part(j, 1), nominal=10.0, unit="A")
        for j, sign in enumerate((-1.0, 1.0))
    )
    return PHDAE(
        "bridge",
        states=(a, d),
        algebraics=(mu,),
        parameters=(s,),
        energies=(energy(a**2 / (2 * LA)), energy(d**2 / (2 * LD))),
        dissipation=(damping(a, RA), damping(d, RD)),
        ports=(Port("source", ELECTRICAL, "effort", {a: 1.0}, source=V * ca.cos(W * time + PHI), nominal=V),),
        switches=pairs,
    )


def lifted(force: ca.SX, weight: float = 0.0) -> PHDAE:
    """A mass of 1 kg on a floor, lifted by a force of time."""
    q, p = state("q", unit="m"), state("p", unit="kg.m/s")
    floor, rests = algebraic("N", unit="N", nominal=10.0), parameter("rests", 1.0)
    return PHDAE(
        "lifted",
        states=(q, p),
        algebraics=(floor,),
        parameters=(rests,),
        energies=(energy(p**2 / 2), energy(weight * q.sx)),
        structure=(skew(q, p, 1.0),),
        ports=(Port("lift", TRANSLATIONAL, "effort", {p: 1.0}, source=force),),
        switches=(Switch("floor", floor, {p: 1.0}, rests, gap=q, unit="m"),),
    )
