"""Breakers and diodes in series with an inductance against exact piecewise linear solutions."""

from __future__ import annotations

from collections.abc import Callable
from math import cos, pi, sin

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq

from phfmu import (
    ELECTRICAL,
    PHDAE,
    Collocated,
    Event,
    Monolithic,
    NativeInstance,
    Network,
    Options,
    Port,
    build_model,
    damping,
    energy,
    run,
    state,
    time,
)
from phfmu.components.electrical.breaker import ideal_diode
from phfmu.components.scenes.electrical.breaker_opening import breaker_opening
from tests.wide import wide

E, W, PHI, R, L, C, LOAD = 325.0, 2 * pi * 50, 0.3, 0.5, 0.01, 50e-6, 40.0
STOP, OPEN = 0.04, 0.02
ALPHA = (0.0, 2 * pi / 3, -2 * pi / 3)


def rates(s: float) -> np.ndarray:
    """Of (flux, charge, cos, sin) with the switch closed (s = 1) or open."""
    m = np.zeros((4, 4))
    m[0] = [-R / L, -s / C, s * E, 0]
    m[1] = [s / L, -1 / (LOAD * C), 0, 0]
    m[2, 3], m[3, 2] = -W, W
    return m


def crossing(z: np.ndarray, s: float, g: Callable[[np.ndarray], float], stop: float, sign: int = 0) -> float:
    """The first time at which g crosses zero in the direction (0: any), inf if it does not until `stop`."""
    t = np.linspace(1e-7, stop, 4001)
    step, y, values = expm(rates(s) * (t[1] - t[0])), expm(rates(s) * t[0]) @ z, []
    for _ in t:
        values.append(g(y))
        y = step @ y
    for i in range(4000):
        if values[i] * values[i + 1] <= 0 and (sign == 0 or (values[i + 1] - values[i]) * sign > 0):
            return brentq(lambda x: g(expm(rates(s) * x) @ z), t[i], t[i + 1], xtol=1e-18, rtol=9e-16)
    return np.inf


def start(alpha: float) -> np.ndarray:
    return np.array([0.0, 0.0, cos(PHI - alpha), sin(PHI - alpha)])


def opened(alpha: float) -> tuple[float, float]:
    """When a pole opens, and the voltage of its load at the stop."""
    z = expm(rates(1.0) * OPEN) @ start(alpha)
    t = crossing(z, 1.0, lambda y: y[0], STOP - OPEN)
    z = expm(rates(1.0) * t) @ z
    z[0] = 0.0
    return OPEN + t, float((expm(rates(0.0) * (STOP - OPEN - t)) @ z)[1] / C)


def simulated(scene, k: int, step: float, more=()):
    model = build_model(scene.declaration(), Collocated(k))
    options = Options(stop=scene.stop, step=step, events=(*scene.events, *more))
    result = run(Monolithic(model, NativeInstance(model)), options)
    assert result.ledger.summary().closed
    return result


def switched(result, name: str) -> list[tuple[float, int]]:
    """(time, row before) of the changes of a mode."""
    return [(float(result.time[i]), int(i)) for i in np.flatnonzero(np.diff(result.column(name)))]


WAYS = wide((1, 2, 3), 2)


@pytest.mark.parametrize("k", WAYS)
def test_order_2k_through_an_opening(k):
    """Capacitor voltages after three current zeros of a grid, a breaker and an RC load."""
    exact = [opened(alpha) for alpha in ALPHA]
    errors = []
    for n in (160, 320):
        result = simulated(breaker_opening(), k, STOP / n)
        found = [result.column(f"load.v[{j + 1}]")[-1] for j in range(3)]
        errors.append(max(abs(v - w) for v, (_, w) in zip(found, exact, strict=True)))
        times = [switched(result, f"line.closed[{j + 1}]")[0][0] for j in range(3)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2 * k, abs=0.2)
    late = max(abs(t - u) for t, (u, _) in zip(times, exact, strict=True))
    assert late <= {1: 1e-5, 2: 1e-9, 3: 1e-12}[k]
    assert max(abs(result.column(f"line.i[{j + 1}]")[-1]) for j in range(3)) == 0.0
    lost = [row for row in result.notes if "lost" in row]
    assert len(lost) == 3 and all(float(note.split()[-2]) < 1e-24 for note in lost)


def test_a_chopped_current_loses_its_formula():
    result = simulated(breaker_opening(chop=0.8), 3, 2.5e-4)
    for j in range(3):
        ((_, i),) = switched(result, f"line.closed[{j + 1}]")
        flux = result.column(f"line.flux[{j + 1}]")
        assert abs(flux[i]) == pytest.approx(0.8 * L, rel=1e-12) and flux[i + 1] == 0.0
    jumps = {c.component: c.jumps for c in result.ledger.summary().components if c.jumps is not None}
    assert jumps == {"line": pytest.approx(-3 * L * 0.8**2 / 2, rel=1e-12)}


def test_poles_forced_open_lose_what_they_carried_and_close_again():
    again = Event(0.03, "line.command", 1.0)
    result = simulated(breaker_opening(forced=True), 2, 2.5e-4, more=(again,))
    carried = 0.0
    for j in range(3):
        (t, i), (closed, _) = switched(result, f"line.closed[{j + 1}]")
        assert (t, closed) == (0.02, 0.03)
        carried += result.column(f"line.flux[{j + 1}]")[i] ** 2 / (2 * L)
    jumps = {c.component: c.jumps for c in result.ledger.summary().components if c.jumps is not None}
    assert carried > 0.1 and jumps == {"line": pytest.approx(-carried, rel=1e-13)}
    assert result.ledger.summary().events == {"parameter": 2, "state": 2}


def half_wave() -> Network:
    """A source, a diode in series with R and L, and C with its load."""
    charge = state("charge", unit="C", nominal=0.01)
    load = PHDAE(
        "load", states=(charge,), energies=(energy(charge**2 / (2 * C)),), dissipation=(damping(charge, 1 / LOAD),),
        ports=(Port("terminal", ELECTRICAL, "flow", {charge: 1.0}),),
    )  # fmt: skip
    from phfmu.components.electrical.sources import voltage_source

    net = Network("half_wave")
    net.add("grid", voltage_source(E * ca.cos(W * time + PHI), v=E, i=10.0))
    net.add("diode", ideal_diode(R, L, i=10.0, v=E))
    net.add("load", load)
    net.connect("grid.terminal", "diode.a", name="ac")
    net.connect("diode.b", "load.terminal", name="dc")
    return net


def rectified() -> tuple[list[float], float]:
    """When the diode conducts and blocks, and the voltage of the load at the stop."""
    z, t, s, times = start(0.0), 0.0, 1.0, [0.0]
    while True:
        g, sign = ((lambda y: y[0]), -1) if s else ((lambda y: E * y[2] - y[1] / C), 1)
        at = crossing(z, s, g, STOP - t, sign)
        if t + at > STOP:
            return times, float((expm(rates(s) * (STOP - t)) @ z)[1] / C)
        z, t = expm(rates(s) * at) @ z, t + at
        z[0] = z[0] if not s else 0.0
        s = 1.0 - s
        times.append(t)


@pytest.mark.parametrize("k", WAYS)
def test_order_2k_through_a_diode(k):
    """A half-wave rectifier: the guard of the blocked diode is between voltages at nodes, which are solved for within steps."""
    times, voltage = rectified()
    assert len(times) >= 4
    model, errors = build_model(half_wave().compose(), Collocated(k)), []
    for n in (160, 320):
        result = run(Monolithic(model, NativeInstance(model)), Options(stop=STOP, step=STOP / n))
        assert result.ledger.summary().closed
        found = switched(result, "diode.conducts")
        errors.append(abs(result.column("load.charge")[-1] / C - voltage))
    starts = [] if result.column("diode.conducts")[0] == 0.0 else [0.0]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2 * k, abs=0.3)
    late = np.max(np.abs(np.array(starts + [t for t, _ in found]) - times))
    assert late <= {1: 1e-4, 2: 1e-8, 3: 1e-11}[k]
    assert result.column("diode.i").min() >= -1e-9
