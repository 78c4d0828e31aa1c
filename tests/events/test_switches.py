"""Ideal switches: a structure a mode, complementarity, jumps where they close; against analytic piecewise solutions."""

from __future__ import annotations

from cmath import exp as cexp
from dataclasses import replace
from math import asin, atan, cos, exp, pi, sin

import casadi as ca
import numpy as np
import pytest
from event_reference import bridge as bridge_by_hand
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
    SwitchedInstance,
    algebraic,
    build_model,
    check,
    damping,
    energy,
    parameter,
    run,
    state,
    time,
)
from phfmu.components.electrical.sources import voltage_source
from phfmu.components.electrical.switches import diode, ideal_switch, thyristor
from phfmu.engine.build.kernels import Kernels
from phfmu.engine.model import kernels
from phfmu.engine.native.native_model import native_model
from phfmu.outcome.status import EventRefused
from tests.events.scenes import BRIDGE_STOP, LA, LD, bridge, lifted
from tests.wide import slow, wide

W = 2 * pi * 50


def stepped(model, n: int):
    """Currents, times of events, closure over H, modes taken."""
    instance = SwitchedInstance(model, NativeInstance)
    before, total, happened, modes = instance.signal("H").sum(), 0.0, [], []
    sides = dict(zip(("pair1", "pair2"), instance.mode, strict=True))
    for part in instance.land(0.0, BRIDGE_STOP / n, n, record=("dissipated", "supplied")):
        if part.rows:
            total += part.rows["dissipated"].sum() - part.rows["supplied"].sum()
        if part.happened is not None:
            happened.append(part.happened)
            sides |= {word.split()[0]: int(word.endswith(" on")) for word in part.happened.switched}
            modes.append(tuple(sides.values()))
            total += part.happened.lost.sum()
            assert abs(part.happened.lost.sum()) <= 1e-12 and part.happened.energy.sum() == -part.happened.lost.sum()
    assert instance.mode == modes[-1]
    change = instance.signal("H").sum() - before
    return instance.x / [LA, LD], [h.t for h in happened], (change + total) / before, modes


@pytest.fixture(scope="module")
def bridges() -> dict:
    return {k: build_model(bridge(), Collocated(k)) for k in (1, 2, 3)}


CASES = [slow((1, 200, 1e-6)), slow((2, 100, 1e-9)), (3, 100, 1e-12)]


@pytest.mark.parametrize(("k", "n", "time_error"), CASES)
def test_a_bridge_commutates_with_order_2k(bridges, k, n, time_error):
    """11 events; overlap, not all off, between the pairs."""
    times, ia, idc = bridge_by_hand(BRIDGE_STOP)
    assert len(times) == 11
    errors = []
    for steps in (n // 2, n):
        i, found, closure, modes = stepped(bridges[k], steps)
        errors.append(np.hypot(*(i - [ia, idc])))
        assert len(found) == 11 and abs(closure) <= 1e-14
        assert modes[1::2] == [(0, 0)] * 5 and set(modes) == {(0, 0), (0, 1), (1, 0)}
    assert np.max(np.abs(np.array(found) - times)) <= time_error
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2 * k, abs=0.2)


def test_compiled_code_changes_modes_without_returning(bridges, monkeypatch):
    """11 changes of modes in one call, once the modes are known."""
    stepped(bridges[3], 50)
    instance, calls = SwitchedInstance(bridges[3], NativeInstance), []
    land = instance.native._mode_code.lib.ph_modes_land
    monkeypatch.setattr(instance.native._mode_code.lib, "ph_modes_land", lambda *a: calls.append(1) or land(*a))
    parts = list(instance.land(0.0, BRIDGE_STOP / 50, 50))
    assert len(calls) == 1 and sum(bool(part.happened and part.happened.switched) for part in parts) == 11


def test_modes_share_their_kernels(bridges):
    """A mode is other tables for the same library."""
    model = bridges[2]
    instance = SwitchedInstance(model, NativeInstance)
    list(instance.land(0.0, BRIDGE_STOP / 50, 50))
    known = [model.modes[mode] for mode in model.modes.known]
    assert len(known) == 3  # all diodes off never comes up
    assert len({(m.step.nx, m.step.na, m.step.nw) for m in known}) == 1
    assert len({native_model(m, "compiled").code.build.path for m in known if m.checks}) == 1
    assert len({Kernels(kernels(m)).token for m in known if m.checks}) == 1


def capacitor(C: float, v: float = 0.0, R: float | None = None) -> PHDAE:
    """A capacitor to ground with a resistor beside it."""
    q = state("q", unit="C", start=C * v, nominal=C * 10)
    loss = () if R is None else (damping(q, 1 / R),)
    port = Port("terminal", ELECTRICAL, "flow", {q: 1.0}, nominal=1.0)
    return PHDAE("capacitor", states=(q,), energies=(energy(q**2 / (2 * C)),), dissipation=loss, ports=(port,))


def inductor(L: float, i: float, R: float = 0.0) -> PHDAE:
    """An inductor from a node to ground."""
    f = state("flux", unit="Wb", start=L * i, nominal=L)
    port = Port("terminal", ELECTRICAL, "effort", {f: 1.0}, nominal=1.0)
    return PHDAE(
        "inductor", states=(f,), energies=(energy(f**2 / (2 * L)),), dissipation=(damping(f, R),), ports=(port,)
    )


def test_a_half_wave_rectifier_in_a_network():
    """Ideal source, diode and capacitor, with nothing between them: the current stops at tan(w t) = -w R C.

    Collocation holds the source and the capacitor together at its nodes: order 2 for k = 1 and 2.
    """
    R, C, V = 10.0, 1e-3, 10.0
    net = Network("half_wave")
    net.add("source", voltage_source(V * ca.sin(W * time), v=V, i=1.0))
    net.add("diode", diode(i=1.0, v=V))
    net.add("load", capacitor(C, R=R))
    net.junction("ac", ["source.terminal", "diode.a"])
    net.junction("dc", ["diode.b", "load.terminal"])
    declaration = net.compose()
    (warned,) = check(declaration, strict=True)
    assert warned.rule == "order" and "'load.q' is tied to a source" in warned.reason
    model = build_model(declaration, Collocated(2))
    result = run(Monolithic(model, SwitchedInstance(model, NativeInstance)), Options(stop=0.05, step=5e-5))
    assert result.ledger.summary().closed
    stops = (pi - atan(W * R * C)) / W
    v = V * sin(W * stops)
    again = brentq(lambda t: V * sin(W * t) - v * exp(-(t - stops) / (R * C)), 0.0205, 0.0225, xtol=1e-17, rtol=9e-16)
    found = [result.time[j] for j in np.flatnonzero(np.diff(result.column("diode.conducts"))) + 1]
    wanted = [0.0, stops, again, stops + 0.02, again + 0.02, stops + 0.04, again + 0.04][: len(found)]
    assert len(found) == 6 and found == pytest.approx(wanted, abs=1e-7)
    assert result.column("diode.i_end").min() >= -1e-9


def pair_of_capacitors() -> Network:
    net = Network("joined")
    net.add("one", capacitor(2e-6, 100.0, 1e3))
    net.add("two", capacitor(5e-6, 20.0, 1e3))
    net.add("switch", ideal_switch(conducts=False, i=1.0, v=100.0))
    net.junction("left", ["one.terminal", "switch.a"])
    net.junction("right", ["switch.b", "two.terminal"])
    return net


def test_joined_capacitors_lose_what_the_formula_says():
    model = build_model(pair_of_capacitors().compose(), Collocated(2))
    instance = SwitchedInstance(model, NativeInstance)
    p = instance.parameters
    p[[n for v in model.declaration.parameters for n in v.names()].index("switch.conducts")] = 1.0
    instance.set_parameters(p)
    (happened,) = (part.happened for part in instance.land(0.0, 1e-5, 3) if part.happened)
    C1, C2, dv = 2e-6, 5e-6, 80.0
    assert happened.lost.sum() == pytest.approx(C1 * C2 / (2 * (C1 + C2)) * dv**2, rel=1e-12)
    assert happened.switched == ("switch.switch on",)
    assert happened.lost.sum() == -happened.energy.sum()


def cut(force: bool, beside: bool) -> PHDAE:
    """An inductor that a switch holds at ground, with a free-wheeling diode beside it or not."""
    net = Network("cut")
    net.add("L", inductor(0.1, 3.0, R=0.2))
    net.add("source", voltage_source(ca.SX(5.0), v=5.0, i=1.0))
    net.add("switch", ideal_switch(force=force, i=1.0, v=10.0))
    net.junction("up", ["source.terminal", "switch.a"])
    if beside:
        net.add("diode", diode(i=1.0, v=10.0))
        net.add("ground", voltage_source(ca.SX(-1.0), v=5.0, i=1.0))
        net.junction("zero", ["ground.terminal", "diode.a"])
        net.junction("node", ["switch.b", "L.terminal", "diode.b"])
    else:
        net.junction("node", ["switch.b", "L.terminal"])
    return net.compose()


def opened(declaration: PHDAE) -> object:
    model = build_model(declaration, Collocated(2))
    options = Options(stop=2e-3, step=2e-4, events=(Event(1e-3, "switch.conducts", 0.0),))
    return run(Monolithic(model, SwitchedInstance(model, NativeInstance)), options)


def test_opening_a_current_is_refused_booked_or_taken_over():
    def current(t):
        return 25.0 + (3.0 - 25.0) * exp(-t * 0.2 / 0.1)

    with pytest.raises(EventRefused, match="'switch.switch' would jump"):
        opened(cut(force=False, beside=False))
    forced = opened(cut(force=True, beside=False))
    assert forced.ledger.summary().closed
    assert f"lost {0.05 * current(1e-3) ** 2:.6g}"[:12] in forced.notes[0]
    assert abs(forced.column("L.flux")[-1]) < 1e-50
    taken = opened(cut(force=False, beside=True))
    assert taken.ledger.summary().closed and "diode.diode on" in taken.notes[0]
    assert taken.column("L.flux")[-1] / 0.1 == pytest.approx((current(1e-3) + 5.0) * exp(-1e-3 * 2.0) - 5.0, rel=1e-11)


def test_parallel_diodes_share_their_current():
    """Dependent contacts: the least norm."""
    net = Network("parallel")
    net.add("source", voltage_source(10 * ca.sin(W * time), v=10.0, i=1.0))
    net.add("load", capacitor(1e-3, 5.0, R=10.0))
    for name in ("d1", "d2"):
        net.add(name, diode(i=1.0, v=10.0))
    net.junction("ac", ["source.terminal", "d1.a", "d2.a"])
    net.junction("dc", ["load.terminal", "d1.b", "d2.b"])
    model = build_model(net.compose(), Collocated(2))
    result = run(Monolithic(model, SwitchedInstance(model, NativeInstance)), Options(stop=0.0199, step=5e-4))
    one, two = result.column("d1.i_end"), result.column("d2.i_end")
    assert one == pytest.approx(two, abs=1e-12) and one.max() > 0.5


def test_a_thyristor_waits_for_its_gate():
    net = Network("phase_control")
    net.add("source", voltage_source(10 * ca.sin(W * time), v=10.0, i=1.0))
    net.add("thyristor", thyristor(i=1.0, v=10.0))
    net.add("load", inductor(5e-3, 0.0, R=2.0))
    net.junction("ac", ["source.terminal", "thyristor.a"])
    net.junction("dc", ["load.terminal", "thyristor.b"])
    model = build_model(net.compose(), Collocated(3))
    events = (Event(0.004, "thyristor.gate", 1.0), Event(0.0045, "thyristor.gate", 0.0))
    options = Options(stop=0.0275, step=2.5e-4, events=events)
    result = run(Monolithic(model, SwitchedInstance(model, NativeInstance)), options)
    on = np.flatnonzero(result.column("thyristor.conducts") > 0)
    assert result.time[on[0]] == 0.004  # forward voltage from 0 on, and from 0.02 on without a gate
    phasor = 10 / (2 + 1j * W * 5e-3)

    def current(t):
        forced = (phasor * cexp(1j * (W * t - pi / 2))).real
        return forced - (phasor * cexp(1j * (W * 0.004 - pi / 2))).real * exp(-(t - 0.004) * 400)

    stops = brentq(current, 0.01, 0.014, xtol=1e-17, rtol=9e-16)
    assert result.time[on[-1] + 1] == pytest.approx(stops, abs=1e-11)
    assert abs(result.column("load.flux")[-1]) < 1e-50 and result.ledger.summary().closed


def one(**changes) -> PHDAE:
    base = diode()
    return replace(base, switches=(replace(base.switches[0], **changes),))


@pytest.mark.parametrize(
    ("declaration", "says"),
    [
        (one(law="unilatral"), "did you mean unilateral?"),
        (one(multiplier=algebraic("i")), "is algebraic of 1, not one algebraic of the model"),
        (one(mode=parameter("conduct", 0.0)), "there are: conducts"),
        (one(nominal=0.0), "nominal = 0"),
        (one(most=-1.0), "most = -1"),
        (one(on={}), "stands on no variable"),
        (one(on={state("x"): 1.0}), "which the model does not have"),
        (one(on={diode().ports[0]: [1.0, 1.0]}), "which the model does not have"),
        (one(when={"conduct": 1.0}), "did you mean conducts"),
        (replace(diode(), switches=diode().switches * 2), "is algebraic of 1"),
    ],
)
def test_what_a_switch_is_made_of_is_checked(declaration, says):
    assert says in "\n".join(map(str, check(declaration)))


def test_units_of_a_switch_are_checked():
    problems = check(one(unit="A"), strict=True)
    assert any("diode.closes" in p.entry and p.rule == "dimension" for p in problems)


def test_an_instance_of_one_mode_is_refused(bridges):
    with pytest.raises(ValueError, match=r"SwitchedInstance\(model, NativeInstance\)"):
        NativeInstance(bridges[1])


G, F0, OMEGA = 9.81, 15.0, 8.0
LIFT = asin(G / F0) / OMEGA


def flight(t: float) -> float:
    """Height of the mass after it was lifted."""
    s = t - LIFT
    return -F0 / OMEGA * ((sin(OMEGA * t) - sin(OMEGA * LIFT)) / OMEGA - cos(OMEGA * LIFT) * s) - G * s**2 / 2


@pytest.mark.parametrize(
    ("k", "n"),
    wide(((k, 40) for k in (1, 2, 3)), (2, 40), (3, 40)),
)
def test_a_mass_lifts_off_its_floor_and_lands(k, n):
    """Lift-off where the force falls to zero, landing with its whole speed lost; times of order 2k."""
    lands = brentq(flight, LIFT + 0.05, LIFT + 0.6, xtol=1e-16, rtol=9e-16)
    model, errors = build_model(lifted(F0 * ca.sin(OMEGA * time), G), Collocated(k)), []
    for steps in (n // 2, n):
        instance = SwitchedInstance(model, NativeInstance)
        parts = list(instance.land(0.0, (lands + 0.02) / steps, steps, record=("supplied",)))
        first, second = (part.happened for part in parts if part.happened)
        supplied = sum(part.rows["supplied"].sum() for part in parts if part.rows)
        assert first.switched == ("floor off",) and second.switched == ("floor on",)
        assert first.t == pytest.approx(LIFT, abs=1e-14)
        assert second.lost.sum() > 0.1 and instance.signal("H").sum() + second.lost.sum() == pytest.approx(
            supplied, abs=1e-13
        )
        assert abs(instance.x[0]) < 1e-14
        errors.append(abs(second.t - lands))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2 * k, abs=0.4)
