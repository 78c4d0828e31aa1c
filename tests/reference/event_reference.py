"""Closed forms of scenes with state events; independent of the package under test on purpose."""

from __future__ import annotations

from cmath import exp as cexp
from math import asin, atan2, cos, exp, log, pi, sin, sqrt

import numpy as np
from scipy.optimize import brentq

#: rectifier: inductances (H), resistances (ohm), source (V, rad/s, rad), start of the DC current (A)
LA, RA, LD, RD, E, W, PHI, I0 = 2e-3, 0.05, 20e-3, 5.0, 100.0, 2 * pi * 50, 0.4, 8.0
#: bouncing ball: gravity (m/s2), restitution; from 1 m
G, RESTITUTION = 9.81, 0.8


def ball(stop: float) -> list[float]:
    """Times of the impacts before `stop`, t_n = t_0 (1 + 2 e (1 - e^n)/(1 - e))."""
    e, fall, found = RESTITUTION, sqrt(2 / G), list[float]()
    while len(found) < 1000:
        t = fall * (1 + 2 * e * (1 - e ** len(found)) / (1 - e))
        if t > stop:
            break
        found.append(t)
    return found


def hard_stop(stop: float = 0.5) -> dict[str, float]:
    """Wagons of 2 and 1 kg, 200 N/m: impact after 0.1 m, motion together until the spring is at rest, then apart.

    hit, apart (s); speed of the first before the impact, of the second at the end (m/s); gap at the end (m)
    """
    w, k, m = sqrt(200.0 / 2.0), 200.0, 3.0
    before, hit = w * sqrt(0.15**2 - 0.05**2), (pi / 2 - asin(0.05 / 0.15)) / w
    v, slow = 2.0 * before / m, sqrt(k / m)
    apart = hit + atan2(0.05 * slow, v) / slow
    end, left = sqrt(v**2 + k * 0.05**2 / m), stop - apart
    gap = end * left - end / w * sin(w * left)
    return {"hit": hit, "apart": apart, "before": before, "speed": end, "gap": gap, "wagon": end * cos(w * left)}


def two_points(n: int, stop: float = 2.0) -> tuple[list[float], float]:
    """The first n switchings of a relay between 95 and 105 rad/s from 80 rad/s, 200 rad/s driven and 0 not; speed at the stop."""
    tau = 0.05 / 0.02
    up, down = tau * log((200 - 95) / (200 - 105)), tau * log(105 / 95)
    first = tau * log((200 - 80) / (200 - 105))
    times = [first + (i // 2) * (up + down) + (i % 2) * down for i in range(n)]
    fade = exp(-(stop - times[-1]) / tau)
    return times, 105 * fade if n % 2 else 200 + (95 - 200) * fade


def branch(L: float, R: float, sign: float, t0: float, i0: float):
    """The current of L i' + R i = sign E cos(W t + PHI), i(t0) = i0."""
    phasor = sign * E * cexp(1j * PHI) / (R + 1j * W * L)
    return lambda t: (
        (phasor * cexp(1j * W * t)).real + (i0 - (phasor * cexp(1j * W * t0)).real) * exp(-(t - t0) * R / L)
    )


def bridge(stop: float = 0.05) -> tuple[list[float], float, float]:
    """Times of the commutations and the currents at the stop: all four conduct, or one pair does and i_a = +-i_d."""
    t, ia, idc, sign, times = 0.0, 0.0, I0, 0, list[float]()
    while True:
        if sign == 0:
            fa, fd = branch(LA, RA, 1.0, t, ia), branch(LD, RD, 0.0, t, idc)
            ends = [lambda s, q=q, fa=fa, fd=fd: fd(s) - q * fa(s) for q in (1, -1)]
        else:
            both = branch(LA + LD, RA + RD, sign, t, idc)
            fa, fd = (lambda s, f=both, q=sign: q * f(s)), both
            # the pair takes current again where the voltage that blocks it, that of the DC side, falls to zero

            def blocked(s: float, f=both, q=sign) -> float:
                slope = (q * E * np.cos(W * s + PHI) - (RA + RD) * f(s)) / (LA + LD)
                return LD * slope + RD * f(s)

            ends = [blocked]
        found = []
        for j, g in enumerate(ends):
            grid = t + np.linspace(1e-9, 0.02, 4001)
            v = [g(s) for s in grid]
            k = next((k for k in range(4000) if v[k] > 0 >= v[k + 1]), None)
            if k is not None:
                found.append((brentq(g, grid[k], grid[k + 1], xtol=1e-17, rtol=9e-16), j))
        end, which = min(found)
        if end > stop:
            return times, fa(stop), fd(stop)
        t, ia, idc = end, fa(end), fd(end)
        sign = (1, -1)[which] if sign == 0 else 0
        times.append(t)
