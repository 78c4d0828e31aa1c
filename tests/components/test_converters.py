"""Rectifiers, a step-down converter and a bead with ideal switches, against integrations of their own."""

from __future__ import annotations

from math import acos, pi

import casadi as ca
import numpy as np
import pytest
from event_reference import bridge
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import brentq
from scipy.special import ellipkinc

from phfmu import (
    Collocated,
    Event,
    Monolithic,
    NativeInstance,
    Network,
    Options,
    StepFailure,
    SwitchedInstance,
    build_model,
    check,
    run,
)
from phfmu.cli import main
from phfmu.components.electrical.sources import voltage_source
from phfmu.components.electrical.switches import ideal_switch
from phfmu.components.library import SWITCHED, build
from phfmu.components.scenes.electrical.buck import buck
from tests.wide import slow

RS, LS, RL, LL, E, W = 0.05, 2e-3, 5.0, 20e-3, 100.0, 2 * pi * 50


def simulated(scene, k: int, step: float, stop: float | None = None, model=None):
    model = model or build_model(scene.declaration(), Collocated(k))
    options = Options(stop=scene.stop if stop is None else stop, step=step, events=scene.events)
    return run(Monolithic(model, SwitchedInstance(model, NativeInstance)), options)


def switchings(result, name: str, n: int) -> list[float]:
    """Times at which modes change, in order."""
    modes = np.column_stack([result.column(f"{name}[{j + 1}]") for j in range(n)])
    return [float(result.time[k + 1]) for k in np.flatnonzero(np.abs(np.diff(modes, axis=0)).sum(axis=1))]


class ThreePhase:
    """The bridge by hand: upper diodes P, lower diodes N; y = currents of the phases into it, and of the load."""

    def __init__(self):
        self.P, self.N = set(), set()

    def rails(self, t, y):
        """Potentials of the rails from the sums of currents, and e - R i of each phase."""
        drive = -E * np.cos(W * t + 0.4 - np.arange(3) * 2 * pi / 3) - RS * y[:3]
        p, n, ratio = sum(drive[k] for k in self.P), sum(drive[k] for k in self.N), LS / LL
        # sum_P (drive - vp) = ratio (vp - vn - RL i), sum_N (drive - vn) = -ratio (vp - vn - RL i)
        A = [[len(self.P) + ratio, -ratio], [-ratio, len(self.N) + ratio]]
        return np.linalg.solve(A, [p + ratio * RL * y[3], n - ratio * RL * y[3]]), drive

    def rates(self, t, y):
        (vp, vn), drive = self.rails(t, y)
        slope = [
            (drive[k] - vp) / LS if k in self.P else (drive[k] - vn) / LS if k in self.N else 0.0 for k in range(3)
        ]
        return np.array([*slope, (vp - vn - RL * y[3]) / LL])

    def watched(self, t, y):
        """Per diode the current that it carries or the voltage that it blocks."""
        (vp, vn), drive = self.rails(t, y)
        v = [vp if k in self.P else vn if k in self.N else drive[k] for k in range(3)]
        upper = [y[k] if k in self.P else vp - v[k] for k in range(3)]
        return upper + [-y[k] if k in self.N else v[k] - vn for k in range(3)]

    def until(self, stop):
        """Times of all events, and y at the stop."""
        e = -E * np.cos(0.4 - np.arange(3) * 2 * pi / 3)
        self.P, self.N = {int(np.argmax(e))}, {int(np.argmin(e))}
        t, y, times, fresh = 0.0, np.zeros(4), [], set(range(6))
        while True:
            guards = []
            for j in range(6):
                start = self.watched(t, y)[j]

                def guard(s, z, j=j, t=t, sign=j in fresh, start=start):
                    # what has just changed is zero at the start: it is looked at a little later
                    return self.watched(s, z)[j] if not sign or s > t + 1e-5 else max(start, 1.0)

                guard.terminal, guard.direction = True, -1
                guards.append(guard)
            found = solve_ivp(
                self.rates, (t, stop), y, method="DOP853", rtol=1e-13, atol=1e-13, events=guards, max_step=2e-5
            )
            if found.status == 0:
                return times, found.y[:, -1]
            j = next(j for j in range(6) if len(found.t_events[j]))
            t, y = float(found.t_events[j][0]), found.y_events[j][0]
            times.append(t)
            side = (self.P, self.N)[j // 3]
            side.symmetric_difference_update({j % 3})
            if j % 3 not in self.P | self.N:
                y[j % 3] = 0.0
            fresh = {j}


@pytest.fixture(scope="module")
def three_phase():
    return ThreePhase().until(0.02)


@pytest.mark.parametrize(("k", "n", "time_error"), [(2, 160, 2e-8), slow((3, 160, 2e-10))])
def test_a_six_pulse_bridge_equals_an_integration_by_hand(three_phase, k, n, time_error):
    """From rest: the first diodes come from the laws at the start, 11 events, overlap of three diodes."""
    times, y = three_phase
    scene = build("six_pulse")
    model, errors = build_model(scene.declaration(), Collocated(k)), []
    for steps in (n // 2, n):
        result = simulated(scene, k, scene.stop / steps, model=model)
        assert result.ledger.summary().closed
        found = switchings(result, "bridge.conducts", 6)
        assert found[0] == 0.0 and len(found) == 1 + len(times) == 12
        currents = [-result.column(f"grid.current[{j + 1}]")[-1] for j in range(3)]
        errors.append(np.linalg.norm(np.array([*currents, -result.column("load.current")[-1]]) * [1, 1, 1, -1] - y))
    assert np.max(np.abs(np.array(found[1:]) - times)) <= time_error
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2 * k, abs=0.3)


@pytest.mark.slow
def test_the_single_phase_scene_is_the_bridge_of_the_tests_of_switches():
    result = simulated(build("rectifier"), 3, 2.5e-4)
    times, ia, idc = bridge(0.05)
    assert switchings(result, "bridge.blocks", 2) == pytest.approx(times, abs=1e-12)
    assert result.column("load.current")[-1] == pytest.approx(idc, abs=1e-8)
    assert result.column("grid.current")[-1] == pytest.approx(ia, abs=1e-8)
    assert result.ledger.summary().closed and max(abs(v) for v in result.column("bridge.energy.residual")) < 1e-12


def filter_step(x: np.ndarray, source: float, R: float, h: float) -> np.ndarray:
    """Coil current and output voltage after h at a constant voltage before the coil."""
    A = np.array([[-0.05 / 100e-6, -1 / 100e-6, source / 100e-6], [1 / 47e-6, -1 / (R * 47e-6), 0.0], [0.0, 0.0, 0.0]])
    return (expm(A * h) @ [*x, 1.0])[:2]


def buck_by_hand(duty: float, R: float, f: float, periods: int) -> tuple[np.ndarray, list[float]]:
    """Coil current and voltage after so many periods, and the times at which the diode stops."""
    x, stops = np.zeros(2), []
    for n in range(periods):
        x = filter_step(x, 24.0, R, duty / f)
        left = (1 - duty) / f

        def current(h, x=x):
            return filter_step(x, -0.1, R, h)[0]

        if current(left) > 0:
            x = filter_step(x, -0.1, R, left)
            continue
        h = brentq(current, 0.0, left, xtol=1e-18, rtol=9e-16)
        stops.append((n + duty) / f + h)
        v = filter_step(x, -0.1, R, h)[1]
        x = np.array([0.0, v * np.exp(-(left - h) / (R * 47e-6))])
    return x, stops


@pytest.mark.parametrize(("R", "periods"), [(4.0, 6), (400.0, 6)])
def test_a_buck_converter_equals_its_piecewise_solution(R, periods):
    """Continuous and discontinuous conduction."""
    scene = buck(0.4, R=R, later=None)
    result = simulated(scene, 3, 5e-6, stop=periods / 20e3)
    x, stops = buck_by_hand(0.4, R, 20e3, periods)
    assert result.column("coil.current")[-1] == pytest.approx(x[0], abs=1e-10)
    assert result.column("load.voltage")[-1] == pytest.approx(x[1], abs=1e-10)
    assert result.ledger.summary().closed
    gone = [float(n.split("t = ")[1].split(" s")[0]) for n in result.notes if "diode.opens" in n]
    assert gone == pytest.approx(stops, abs=1e-12) and (stops or R < 100)


def test_a_diode_with_much_current_stops_where_the_chopper_begins():
    """Both in a ring with the sources contradict each other, however large the coil's current that they could share."""
    scene, f, when = buck(0.4, later=None), 20e3, 6e-5
    model = build_model(scene.declaration(), Collocated(3))
    events = (Event(when, "chopper.duty", 0.6),)
    options = Options(stop=4 / f, step=5e-6, events=events)
    result = run(Monolithic(model, SwitchedInstance(model, NativeInstance)), options)
    x = np.zeros(2)
    for duty in (0.4, 0.6, 0.6, 0.6):
        x = filter_step(filter_step(x, 24.0, 4.0, duty / f), -0.1, 4.0, (1 - duty) / f)
    assert result.column("coil.current")[-1] == pytest.approx(x[0], abs=1e-10)
    assert result.column("load.voltage")[-1] == pytest.approx(x[1], abs=1e-10)
    assert result.ledger.summary().closed
    on = np.column_stack([result.column(f"{n}.conducts") for n in ("chopper", "diode")])
    assert (on.sum(axis=1)[1:] == 1).all()


def test_a_switch_between_sources_that_differ_is_not_closed():
    """24 V on one side, 23 V on the other: no mode, and one line says at which switch."""
    net = Network("short")
    for side, volts in (("a", 24.0), ("b", 23.0)):
        net.add(side, voltage_source(ca.SX(volts), v=24.0, i=3.0))
    net.add("switch", ideal_switch(conducts=False, i=3.0, v=24.0))
    for side in "ab":
        net.junction(f"at_{side}", [f"{side}.terminal", f"switch.{side}"])
    model = build_model(net.compose(), Collocated(2))
    events = (Event(0.5, "switch.conducts", 1.0),)
    with pytest.raises(StepFailure, match=r"after 'switch.switch' no mode of the switches obeys their laws"):
        run(Monolithic(model, SwitchedInstance(model, NativeInstance)), Options(stop=1.0, step=0.1, events=events))


def test_a_duty_signal_sets_the_mean_voltage():
    """The averaged model: v = (24 d - 0.1 (1 - d)) R/(R + 0.05), before and after the duty changes."""
    scene = buck(0.4, later=0.6)
    result = simulated(scene, 2, 1e-5)
    v, t = result.column("load.voltage"), result.time

    def mean(begin: float, end: float) -> float:
        inside = (t >= begin) & (t <= end)
        return float(np.trapezoid(v[inside], t[inside]) / (end - begin))

    for duty, begin, end in ((0.4, 1.25e-3, 1.5e-3), (0.6, 2.75e-3, 3e-3)):
        assert mean(begin, end) == pytest.approx((24 * duty - 0.1 * (1 - duty)) * 4 / 4.05, rel=0.02)
    assert result.ledger.summary().closed


@pytest.mark.parametrize(("k", "n", "error"), [slow((1, 80, 1e-4)), slow((2, 80, 1e-9)), (3, 40, 1e-12)])
def test_a_bead_leaves_its_cylinder(k, n, error):
    """At the height r (2/3 + v^2/(3 g r)), of the order of the steps; the radius stays, the energy too."""
    scene = build("bead")
    model = build_model(scene.declaration(), Collocated(k))
    height = 2 / 3 + 0.5**2 / (3 * 9.81)
    # the integral of 1/sqrt(v^2 + 4 g r sin^2(a/2)) over the angle
    leaves = 2 / 0.5 * ellipkinc(acos(height) / 2, -4 * 9.81 / 0.5**2)
    errors = []
    for steps in (n // 2, n):
        instance = SwitchedInstance(model, NativeInstance)
        before = instance.signal("H").sum()
        parts = list(instance.land(0.0, scene.stop / steps, steps, record=("x",)))
        (happened,) = (p.happened for p in parts if p.happened)
        errors.append(abs(happened.t - leaves))
        assert happened.switched == ("contact off",) and abs(instance.signal("H").sum() - before) < 1e-13
        radii = [np.hypot(*row[:2]) for p in parts if p.rows for row in p.rows["x"] if p.t[0] < happened.t]
        assert np.max(np.abs(np.array(radii) - 1)) < 1e-13
        assert happened.signals[1] == pytest.approx(height, abs=1e-12 if k > 1 else 1e-14)
    assert errors[1] <= error and np.log2(errors[0] / errors[1]) == pytest.approx(2 * k, abs=0.2)


@pytest.mark.parametrize("name", SWITCHED)
def test_what_is_switched_in_the_library_is_sound(name):
    found = build(name)
    declaration = found.declaration() if hasattr(found, "declaration") else found
    assert check(declaration, strict=True) == [] and declaration.switches


def test_info_tells_the_switches(capsys):
    assert main(["info", "rectifier"]) == 0
    told = "unilateral, bridge.blocks[1] = 0, bridge.u[1] on bridge.ac, bridge.dc"
    assert f"  {'bridge.pair1':<28} {told}" in capsys.readouterr().out


def test_a_saved_state_has_its_mode():
    """A state brings its mode back: the same bits follow."""
    scene = build("rectifier")
    instance = SwitchedInstance(build_model(scene.declaration(), Collocated(2)), NativeInstance)
    list(instance.land(0.0, 1e-3, 3))
    kept, mode = instance.get_state(), instance.mode
    list(instance.land(0.0, 1e-3, 3, first=3, changed=False))
    x, after = instance.x, instance.mode
    instance.set_state(kept)
    assert instance.mode == mode != after
    list(instance.land(0.0, 1e-3, 3, first=3, changed=False))
    assert (instance.x == x).all() and instance.mode == after


def test_a_rectifier_runs_from_the_command_line(capsys):
    assert main(["run", "rectifier", "--stop", "0.004"]) == 0
    said = capsys.readouterr()
    assert "bridge.pair2.opens, bridge.pair2 off" in said.out + said.err
