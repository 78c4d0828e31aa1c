"""Faults, saturation, arresters, sources with impedance and loads of constant power against something independent."""

from __future__ import annotations

from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from phfmu import Collocated, NativeInstance, Network, PythonInstance, Scene, build_model
from phfmu.components.electrical import (
    MagnetisationCurve,
    constant_power_load,
    fault,
    fault_events,
    load,
    saturating_reactor,
    surge_arrester,
    thevenin_source,
    two_winding_transformer,
)
from phfmu.components.scenes.electrical.network_events import inrush, short_circuit
from phfmu.operating import operating_point
from tests.components.orders import orders, steps
from tests.components.test_network_parts import PEAK, F, V, W, phasor
from tests.components.test_scenes import closed, monolithic

POINTS = ((1.0, 0.1), (1.2, 1.0), (1.3, 4.0))


def rows_of(scene, k=1):
    """A run of a scene, its members composed, whose books close."""
    result = monolithic(scene, scene.step, scene.stop, k)
    assert closed(result, 1e-10)
    return result


def three(result, name):
    return np.column_stack([result.column(f"{name}[{k}]") for k in (1, 2, 3)])


def current(flux, points=POINTS, rounding=0.05):
    """The current of a magnetisation curve by the formula of its documentation, in NumPy."""
    f, i = np.array([(0.0, 0.0), *points]).T
    g, w = np.diff(i) / np.diff(f), rounding * np.diff(f).min()

    def s(x):
        return (x + np.hypot(x, w)) / 2.0

    return g[0] * flux + sum((b - a) * (s(flux - k) - s(-flux - k)) for a, b, k in zip(g, g[1:], f[1:], strict=False))


# -- saturation ----------------------------------------------------------------------------------------------------------


def test_the_curve_meets_its_points_and_rises_everywhere():
    curve = MagnetisationCurve(POINTS, 1e-4)
    for flux, i in POINTS:
        assert curve.current(flux) == pytest.approx(i, abs=1e-3)
        assert curve.current(-flux) == pytest.approx(-i, abs=1e-3)
    rough = MagnetisationCurve(POINTS)
    fluxes = np.linspace(-3.0, 3.0, 301)
    values = np.array([rough.current(f) for f in fluxes])
    assert values == pytest.approx(current(fluxes), abs=1e-12) and (np.diff(values) > 0).all()


@pytest.mark.parametrize("rounding", [0.05, 1.0])
def test_current_and_energy_of_a_curve_keep_their_digits_at_every_flux(rounding):
    """Against the formulas of the documentation with 40 digits, also where H is a square of what rounds."""
    mp = pytest.importorskip("mpmath")
    curve, every = MagnetisationCurve(POINTS, rounding), [(mp.mpf(0), mp.mpf(0)), *POINTS]
    f = [mp.mpf(x) for x, _ in every]
    with mp.workdps(40):
        g = [(mp.mpf(i1) - i) / (mp.mpf(f1) - f0) for (f0, i), (f1, i1) in pairwise(every)]
        w = rounding * min(mp.mpf(b) - a for (a, _), (b, _) in pairwise(every))
        s = lambda x: (x + mp.sqrt(x**2 + w**2)) / 2  # noqa: E731
        S = lambda x: (x**2 + x * mp.sqrt(x**2 + w**2) + w**2 * mp.asinh(x / w)) / 4  # noqa: E731
        for flux in (1e-9, -1e-3, 0.4, 1.0, 1.25, -3.0, 20.0):
            bends = list(zip(g, g[1:], f[1:], strict=False))
            i = g[0] * flux + sum((b - a) * (s(flux - c) - s(-flux - c)) for a, b, c in bends)
            H = g[0] * mp.mpf(flux) ** 2 / 2
            H += sum((b - a) * (S(flux - c) + S(-flux - c) - 2 * S(-c)) for a, b, c in bends)
            assert float(curve.current(flux)) == pytest.approx(float(i), rel=1e-13)
            assert float(ca.DM(curve.energy(flux))) == pytest.approx(float(H), rel=1e-13)


@pytest.mark.parametrize("points", [(), ((1.0, 0.1), (1.0, 0.2)), ((1.0, 0.3), (1.2, 0.2)), ((0.0, 0.1),)])
def test_points_that_do_not_rise_are_refused(points):
    with pytest.raises(ValueError, match=r"point|rise"):
        MagnetisationCurve(points)


@pytest.mark.parametrize(("k", "counts"), [(1, (80, 160)), (2, (40, 80)), (3, (20, 40))])
def test_a_saturating_reactor_converges_to_its_equation(k, counts):
    """flux' = v - R i(flux) by DOP853; deep in saturation."""
    R, v = 0.5, lambda t: 400.0 * np.sin(W * t)
    model = saturating_reactor(POINTS, R, rounding=0.8, v=400.0)

    def slope(t, x):
        return [v(t) - R * current(x[0], rounding=0.8)]

    exact = solve_ivp(slope, (0.0, 0.02), [0.0], method="DOP853", rtol=1e-13, atol=1e-13).y[0, -1]
    errors = []
    for n in counts:
        unit, worst = steps(model, k, 0.02 / n, n, lambda t: np.array([v(t)]))
        assert worst < 1e-13
        errors.append(abs(unit.x[0] - exact))
    assert 2 * k - 0.4 < orders(errors)[0], errors


def test_inrush_is_one_sided_and_many_times_the_rated_current():
    scene = inrush()
    rows = rows_of(scene, 1)
    i = three(rows, "unit.i_m")
    psi = three(rows, "unit.linkage")
    rated, peak = np.sqrt(2.0 / 3.0) * 1e6 / 400.0, 400.0 * np.sqrt(2.0 / 3.0) / W
    assert np.abs(i).max() > rated and np.abs(psi).max() > 1.4 * peak
    worst = i[:, np.unravel_index(np.abs(i).argmax(), i.shape)[1]]
    high, low = np.sort([worst.max(), -worst.min()])[::-1]
    assert high > 10.0 * low


# -- faults ----------------------------------------------------------------------------------------------------------------


A = np.exp(2j * np.pi / 3.0)


def sequence_currents(kind, E, Z1, Z0, R):
    """Phase phasors into the fault by sequence networks in series or parallel (Z2 = Z1)."""
    if kind == "abcg":
        return E / (Z1 + R) * np.array([1, A**2, A])
    if kind == "ag":
        return np.array([3.0 * E / (2.0 * Z1 + Z0 + 3.0 * R), 0, 0])
    if kind == "bc":
        i1 = E / (2.0 * (Z1 + R))
        return i1 * np.array([0, A**2 - A, A - A**2])
    z1, z0 = Z1 + R, Z0 + R
    i1 = E / (z1 + z1 * z0 / (z1 + z0))
    i2, i0 = -i1 * z0 / (z1 + z0), -i1 * z1 / (z1 + z0)
    return np.array([i0 + i1 + i2, i0 + A**2 * i1 + A * i2, i0 + A * i1 + A**2 * i2])


@pytest.mark.parametrize("kind", ["abcg", "ag", "bc", "bcg"])
def test_steady_short_circuit_currents_are_those_of_the_sequence_networks(kind):
    """One Thevenin source and the fault; the last cycle after ten of them."""
    R, zero, x_r = 0.02, 3.0, 1.0
    net = Network("sequence")
    net.add("grid", thevenin_source(V, 1e6, f=F, x_r=x_r, zero=zero))
    net.add("fault", fault(kind, R, nominal=PEAK))
    net.add("load", load(1.0, V=V, f=F))
    net.junction("bus", ["grid.terminal", "fault.terminal", "load.terminal"])
    n = 100
    scene = Scene("sequence", net, 0.2, 0.02 / n, fault_events("fault", 0.0))
    rows = rows_of(scene, 2)
    last = three(rows, "grid.i")[-n:]
    t = rows.time[-n:]
    found = -2.0 / n * np.exp(-1j * W * t) @ last
    Z = V**2 / 1e6 * (1 + 1j * x_r) / np.hypot(1, x_r)
    assert found == pytest.approx(sequence_currents(kind, PEAK, Z, zero * Z, R), abs=2e-3 * np.abs(found).max())


@pytest.mark.parametrize(
    "wrong", [("a", {}), ("xg", {}), ("ag", {"R": 0.0}), ("ab", {"Rg": 1.0}), ("ag", {"Rg": -1.0})]
)
def test_faults_that_are_none_are_refused(wrong):
    kind, values = wrong
    with pytest.raises(ValueError, match=kind):
        fault(kind, **values)
    with pytest.raises(ValueError, match="later"):
        fault_events("fault", 0.2, 0.1)


def test_ground_resistance_is_shared_by_the_faulted_phases():
    unit = PythonInstance(build_model(fault("abg", 2.0, Rg=3.0), Collocated(1)))
    unit.set_parameters([1.0, 2.0, 3.0])
    unit.set_input(np.array([8.0, 8.0, 5.0]))
    assert unit.signals()["y_end"] == pytest.approx([1.0, 1.0, 0.0])


@pytest.mark.parametrize("kind", ["ag", "bc", "abcg"])
def test_short_circuit_closes_its_books_and_is_steady_before(kind):
    scene = short_circuit(kind)
    rows = rows_of(scene, 2)  # order 2 has a steady state of its own, off by (w h)^2/12
    t, i = rows.time, three(rows, "line.i")
    before = i[t < 0.04]
    amplitude = np.abs([phasor(row) for row in before])
    assert amplitude == pytest.approx(amplitude[0], rel=1e-7)
    assert np.abs(i).max() > 2.0 * amplitude[0]


# -- arrester, constant power, Thevenin source -------------------------------------------------------------------------------


def test_an_arrester_passes_its_point_and_rises_by_its_power():
    unit = NativeInstance(build_model(surge_arrester(600.0, 1e3, 25.0), Collocated(1)))
    for v, i in ((600.0, 1e3), (-600.0, -1e3), (300.0, 1e3 / 2.0**25), (0.0, 0.0)):
        unit.set_input(np.array([v]))
        assert unit.signals()["y_end"] == pytest.approx([i], rel=1e-12)


def test_a_load_of_constant_power_takes_it_at_a_voltage_below_nominal():
    P, Q = 1e5, 3e4
    net = Network("weak")
    net.add("grid", thevenin_source(V, 1e6, f=F))
    net.add("load", constant_power_load(P, Q, V=V))
    net.junction("bus", ["grid.terminal", "load.terminal"])
    point = operating_point(net, [], F)
    Z = V**2 / 1e6 * (1 + 10j) / np.hypot(1, 10)
    i = -phasor([point.states[f"grid.flux[{k}]"] for k in (1, 2, 3)]) / (Z.imag / W)
    v = PEAK - Z * i
    assert 0.9 < abs(v) / PEAK < 0.97
    assert 1.5 * v * np.conj(i) == pytest.approx(P + 1j * Q, rel=1e-8)


def test_contradictory_values_are_refused():
    for wrong in (
        lambda: surge_arrester(-1.0),
        lambda: surge_arrester(1.0, alpha=0.5),
        lambda: constant_power_load(-1.0, V=V),
        lambda: thevenin_source(V, 0.0),
        lambda: thevenin_source(V, 1e6, zero=-1.0),
        lambda: saturating_reactor(POINTS, -1.0),
        lambda: two_winding_transformer(1e6, V, V, i0=0.1, curve=MagnetisationCurve(POINTS)),
    ):
        with pytest.raises(ValueError, match=r"\d"):
            wrong()
