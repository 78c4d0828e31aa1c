"""A grid-following inverter beside an independent integration in the rotating frame; steady states, limits, books, units."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from phfmu import (
    Collocated,
    Monolithic,
    NativeInstance,
    Network,
    Options,
    PythonInstance,
    Scene,
    build_model,
    check,
    run,
)
from phfmu.components.electrical import grid_following_inverter, infinite_bus, load
from phfmu.components.scenes.electrical.network_events import weak_grid
from phfmu.operating import PQ, operating_point

V, S, W = 20e3, 10e6, 100.0 * np.pi
P, R, FAULT = 8e6, 5.0, (0.1, 0.2)
#: of `grid_following_inverter`
KP, KI, TI, TV, MOST, LEAST = 60.0, 1400.0, 1e-3, 20e-3, 1.1, 0.3


def rates(y: np.ndarray, G: float, ratio: float) -> np.ndarray:
    """In the frame that turns with the grid, V rms, line to line: line, capacitor, loop, measured voltage, currents."""
    i, u, iv = y[0] + 1j * y[1], y[2] + 1j * y[3], y[7] + 1j * y[8]
    delta, x, measured = y[4:7]
    Z, C = V**2 / S / ratio, 0.1 * S / V**2 / W
    seen, m = u * np.exp(-1j * delta), max(measured, LEAST * V)
    wanted = P / m
    wanted *= min(1.0, MOST * S / V / abs(wanted))
    di = (V - u - (0.1 + 1j) * Z * i) / (Z / W)
    du = (i + iv * np.exp(1j * delta) - G * u - 1j * W * C * u) / C
    dv = (wanted - iv) / TI
    loop = KP * seen.imag / V + x, KI * seen.imag / V, (seen.real - measured) / TV
    return np.array([*_pair(di), *_pair(du), *loop, *_pair(dv)])


def steady(ratio: float) -> np.ndarray:
    """The voltage that meets i = conj(P/u) in the capacitor and the line, by fixed-point iteration."""
    Z, y = (0.1 + 1j) * V**2 / S / ratio, 0.1j * S / V**2
    u = V + 0j
    for _ in range(200):
        u = (V / Z + P / np.conj(u)) / (1 / Z + y)
    return np.array([*_pair((V - u) / Z), *_pair(u), np.angle(u), 0.0, abs(u), P / abs(u), 0.0])


def _pair(z: complex) -> tuple[float, float]:
    return z.real, z.imag


def exact(ratio: float, stop: float, resistance: float = R) -> np.ndarray:
    y, t = steady(ratio), 0.0
    for end, G in ((FAULT[0], 0.0), (min(FAULT[1], stop), 1 / resistance), (stop, 0.0)):
        if end > t:
            found = solve_ivp(lambda _, y, G=G: rates(y, G, ratio), (t, end), y, method="DOP853", rtol=1e-12, atol=1e-9)
            y, t = found.y[:, -1], end
    return y


def of_run(scene: Scene, k: int, h: float, stop: float, engine: type = NativeInstance) -> np.ndarray:
    model = build_model(scene.declaration(), Collocated(k))
    r = run(Monolithic(model, engine(model)), Options(stop=stop, step=h, events=scene.events))
    assert r.ledger.summary().closed
    names = ("inverter.theta", "inverter.x", "inverter.U", "inverter.Id", "inverter.Iq")
    found = np.array([r.column(n)[-1] for n in names])
    return found - [W * stop, 0.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize("ratio", [3.0, 5.0])
def test_operating_point_is_that_of_the_phasors(ratio: float) -> None:
    """No initialiser: the angle of the loop is found with all else."""
    scene, known = weak_grid(ratio), steady(ratio)
    model = scene.declaration()
    start = {n: s for v in model.states for n, s in zip(v.names(), v.start, strict=True)}
    found = [start[f"inverter.{n}"] for n in ("theta", "x", "U", "Id", "Iq")]
    np.testing.assert_allclose(found, known[4:], rtol=1e-9, atol=1e-7)


def errors_at(stop: float, k: int, steps: tuple[float, ...], resistance: float = R) -> list[float]:
    known, size = exact(3.0, stop, resistance)[4:], np.array([1.0, 10.0, V, S / V, S / V])
    scene = weak_grid(R=resistance)
    return [float(np.max(np.abs(of_run(scene, k, h, stop) - known) / size)) for h in steps]


@pytest.mark.parametrize(
    ("k", "steps", "largest"), [(1, (1e-4, 5e-5), 1e-4), (2, (2e-4, 1e-4), 1e-7), (3, (5e-4, 2.5e-4), 1e-7)]
)
def test_orders_in_a_fault_beside_an_independent_integration(k: int, steps: tuple[float, ...], largest: float) -> None:
    """5 ms of one of 60 ohm, which leaves the current below its limit and discharges the capacitor in 0.5 ms."""
    errors = errors_at(0.105, k, steps, 60.0)
    assert errors[1] < largest and np.log2(errors[0] / errors[1]) == pytest.approx(2 * k, abs=0.3), errors


@pytest.mark.parametrize(("stop", "largest"), [(0.12, 1e-6), (0.3, 1e-4)])
def test_a_limit_within_a_step_costs_little(stop: float, largest: float) -> None:
    """The rates have a kink there: at its limit and after it, at order 4 in steps of 100 us."""
    (error,) = errors_at(stop, 2, (1e-4,))
    assert error < largest


def test_current_is_at_the_limit_and_the_source_gives_all_energy() -> None:
    scene = weak_grid()
    model = build_model(scene.declaration(), Collocated(1))
    r = run(Monolithic(model, NativeInstance(model)), Options(stop=0.5, step=1e-4, events=scene.events))
    amount = np.hypot(r.column("inverter.Id"), r.column("inverter.Iq"))
    assert amount.max() <= MOST * S / V * (1 + 1e-6) and amount[1800:1990] == pytest.approx(MOST * S / V, rel=1e-6)
    t = r.time <= 0.1
    work = r.column("inverter.source.energy")[t][-1]
    assert work == pytest.approx(P * 0.1, rel=1e-3)  # of order 2: means of steps
    assert abs(r.column("inverter.control.energy")).max() == 0.0


def test_engines_and_members_apart_agree() -> None:
    scene = weak_grid()
    native, python = (of_run(scene, 2, 1e-4, 0.12, engine) for engine in (NativeInstance, PythonInstance))
    np.testing.assert_allclose(native, python, rtol=1e-9, atol=1e-8)


def test_references_are_freed_for_powers() -> None:
    net = Network("fed")
    net.add("grid", infinite_bus(V * np.sqrt(2 / 3), 50.0, i=300.0))
    net.add("load", load(1e6, V=V))
    net.add("inverter", grid_following_inverter(1e6, V=V, S=S))
    net.junction("bus", ["grid.terminal", "load.terminal", "inverter.terminal"])
    point = operating_point(net, [PQ("inverter.terminal", ("inverter.P", "inverter.Q"), P=3e6, Q=-2e6)], 50.0)
    assert point.parameters["inverter.P"] == pytest.approx(3e6) and point.parameters["inverter.Q"] == pytest.approx(
        -2e6
    )
    assert point.states["inverter.Iq"] == pytest.approx(2e6 / V)


def test_told_what_is_wrong() -> None:
    with pytest.raises(ValueError, match="TV = 0, most = -1|most = -1, TV = 0"):
        grid_following_inverter(V=V, S=S, TV=0.0, most=-1.0)
    assert not check(grid_following_inverter(1e6, V=V, S=S))
