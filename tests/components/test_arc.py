"""A breaker that arcs: strikes, zeros and reignitions against the closed form of an inductive circuit, pole by pole."""

from __future__ import annotations

from functools import cache
from math import cos, exp, pi

import numpy as np
import pytest
from scipy.optimize import brentq

from phfmu import (
    Collocated,
    Event,
    Monolithic,
    NativeInstance,
    Network,
    Options,
    build_model,
    check,
    run,
)
from phfmu.components.electrical.breaker import breaker
from phfmu.components.electrical.infinite_bus import infinite_bus
from phfmu.components.electrical.resistor import resistor
from phfmu.runs.result import Result
from tests.wide import slow

V, W, PHI, R, L, LOAD, ARC, HOLDS = 325.0, 2 * pi * 50, 0.3, 0.5, 0.01, 3.0, 40.0, 300.0
OPEN, BETTER, STOP = 0.02, 0.045, 0.06
ALPHA = (0.0, 2 * pi / 3, -2 * pi / 3)
ROOTS = {"xtol": 1e-16, "rtol": 1e-15}


@cache
def model(k: int):
    net = Network("arcing")
    net.add("grid", infinite_bus(V, 50.0, PHI, i=50.0))
    net.add("line", breaker(R, L, arc=ARC, withstand=HOLDS, i=50.0, v=V))
    net.add("load", resistor(LOAD, size=3, given="flow"))
    net.connect("grid.terminal", "line.a", name="bus")
    net.connect("line.b", "load.terminal", name="feeder")
    assert check(net.compose(), strict=True) == []
    return build_model(net.compose(), Collocated(k))


def arced(k: int, h: float) -> Result:
    events = (Event(OPEN, "line.command", 0.0), Event(BETTER, "line.V_withstand", 400.0))
    m = model(k)
    return run(Monolithic(m, NativeInstance(m)), Options(stop=STOP, step=h, events=events))


def pole(alpha: float) -> tuple[list[float], float]:
    """Times of the zeros and reignitions after the command, and the energy of the arcs: L i' + (R + LOAD) i = v - g ARC."""
    resistance, X = R + LOAD, W * L
    a, b = V * resistance / (resistance**2 + X**2), V * X / (resistance**2 + X**2)

    def v(t: float) -> float:
        return V * cos(W * t + PHI - alpha)

    def forced(t: float) -> float:
        return a * cos(W * t + PHI - alpha) + b * np.sin(W * t + PHI - alpha)

    def current(t: float, t0: float, i0: float, g: float) -> float:
        rest = -g * ARC / resistance
        return forced(t) + rest + (i0 - forced(t0) - rest) * exp(-resistance / L * (t - t0))

    t, i = OPEN, current(OPEN, 0.0, 0.0, 0.0)
    g, times, heat = np.sign(i), [], 0.0
    while True:
        grid = np.linspace(t + 1e-9, t + 0.02, 2001)
        values = [current(x, t, i, g) * g for x in grid]
        n = next(j for j in range(2000) if values[j] > 0 >= values[j + 1])
        zero = brentq(lambda x, t=t, i=i, g=g: current(x, t, i, g), grid[n], grid[n + 1], **ROOTS)
        points, weights = np.polynomial.legendre.leggauss(30)
        inside = [current(t + (1 + s) / 2 * (zero - t), t, i, g) for s in points]
        heat += ARC * abs(weights @ inside) * (zero - t) / 2
        times.append(zero)
        if zero > BETTER:
            return times, heat
        grid = np.linspace(zero, zero + 0.02, 2001)
        n = next(j for j in range(2000) if abs(v(grid[j])) < HOLDS <= abs(v(grid[j + 1])))
        t, i = brentq(lambda x: abs(v(x)) - HOLDS, grid[n], grid[n + 1], **ROOTS), 0.0
        if t > BETTER:
            return times, heat
        g = np.sign(v(t))
        times.append(t)


@pytest.mark.parametrize(("k", "h", "late"), [slow((2, 5e-4, 1e-8)), (3, 5e-4, 1e-11)])
def test_arcs_strike_go_out_and_reignite(k, h, late):
    result = arced(k, h)
    assert result.ledger.summary().closed
    truth = [pole(alpha) for alpha in ALPHA]
    for j, (times, _) in enumerate(truth):
        closed = result.column(f"line.closed[{j + 1}]")
        found = result.time[1:][np.diff(closed) != 0]
        assert found == pytest.approx(times, abs=late)
        assert np.abs(result.column(f"line.i[{j + 1}]")[closed == 0]).max() <= 1e-9
    assert result.column("line.arc.energy")[-1] == pytest.approx(
        -sum(heat for _, heat in truth), rel=1e-6 if k == 2 else 1e-10
    )


@pytest.mark.parametrize(("k", "steps"), [slow((1, (2.5e-4, 6.25e-5))), (2, (2.5e-4, 6.25e-5)), (3, (1e-3, 2.5e-4))])
def test_events_of_arcs_are_of_order_2k(k, steps):
    times = sorted(t for alpha in ALPHA for t in pole(alpha)[0])
    errors = []
    for h in steps:
        result = arced(k, h)
        found = [t for j in (1, 2, 3) for t in result.time[1:][np.diff(result.column(f"line.closed[{j}]")) != 0]]
        errors.append(np.linalg.norm(np.sort(found) - times))
    assert np.log2(errors[0] / errors[1]) / 2 == pytest.approx(2 * k, abs=0.2)


def test_arcs_that_nothing_holds_are_refused():
    for bad in ({"arc": 40.0, "withstand": 30.0}, {"arc": 40.0, "chop": 1.0}, {"arc": -1.0}):
        with pytest.raises(ValueError, match="an arc needs 0 < arc <= withstand and no chop"):
            breaker(R, L, **bad)
