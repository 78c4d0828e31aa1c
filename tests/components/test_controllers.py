"""Controllers against analytic step responses and an integration that switches by itself; limits, signals, set points."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import TransferFunction, step

from phfmu import (
    PHDAE,
    Collocated,
    Event,
    FMUInstance,
    Monolithic,
    NativeInstance,
    Network,
    Options,
    build_model,
    default_scheme,
    driven,
    export,
    limited,
    parameter,
    run,
    signal_input,
    state,
)
from phfmu.components.control import bases, exac1, gast, hygov, ieeest, ieeex1, meter, pss1a, sexs, st1a, tgov1
from phfmu.components.electrical import infinite_bus, machine_set, rl_line, synchronous_machine
from phfmu.components.scenes.electrical.island import island, smib_exciter
from phfmu.network.junction import ConnectionError
from phfmu.operating import PV, NoOperatingPoint, operating_point
from tests.network.governed import apart
from tests.wide import wide


def polynomial(*factors: Any) -> Any:
    out = np.ones(1)
    for f in factors:
        out = np.polymul(out, f)
    return out


def ran(model: PHDAE, order: int, stop: float, h: float, events: tuple[Event, ...]) -> Any:
    m = build_model(model, default_scheme(model, order))
    return run(Monolithic(m, NativeInstance(m)), Options(stop=stop, step=h, events=events))


#: name -> model without limits in reach, input, height of the step, output, numerator, denominator
LINEAR: dict[str, tuple[Callable[[], PHDAE], str, float, str, Any, Any]] = {
    "sexs": (
        lambda: sexs(TA=1.0, TB=8.0, K=50.0, TE=0.1, EMAX=99.0, EMIN=-99.0, Vref=1.0), "Vref", 0.02, "Efd_pu",
        50.0 * np.array([1.0, 1.0]), polynomial((8.0, 1.0), (0.1, 1.0)),
    ),
    "tgov1": (
        lambda: tgov1(R=0.05, T1=0.3, T2=2.0, T3=6.0, Pref=0.0, VMIN=-9.0), "Pref", 0.1, "Pm",
        0.1 / 0.1 * np.array([2.0, 1.0]), polynomial((0.3, 1.0), (6.0, 1.0)),
    ),
    "pss1a": (
        lambda: pss1a(T6=0.02, VSTMAX=9.0, VSTMIN=-9.0), "u", 0.01, "Vs",
        5.0 * polynomial((10.0, 0.0), (0.3, 1.0), (0.3, 1.0)),
        polynomial((0.02, 1.0), (10.0, 1.0), (0.0017, 0.061, 1.0), (0.03, 1.0), (0.03, 1.0)),
    ),
    "ieeest": (
        lambda: ieeest(A1=0.05, A2=0.01, A3=0.3, A4=0.02, A5=0.1, A6=0.03, T5=2.0, T6=1.5, LSMAX=9.0, LSMIN=-9.0), "u", 0.01,
        "Vs",
        5.0 * polynomial((0.03, 0.1, 1.0), (0.3, 1.0), (0.3, 1.0), (2.0, 0.0)),
        polynomial((0.01, 0.05, 1.0), (0.02, 0.3, 1.0), (0.03, 1.0), (0.03, 1.0), (1.5, 1.0)),
    ),
    "st1a": (
        lambda: st1a(TR=0.02, TC1=0.2, TB1=0.4, TA=0.05, KA=20.0, KC=0.0, VRMAX=99.0, VRMIN=-99.0, Vref=1.05), "Vref", 0.02,
        "Efd_pu", 20.0 * polynomial((1.0, 1.0), (0.2, 1.0)), polynomial((10.0, 1.0), (0.4, 1.0), (0.05, 1.0)),
    ),
    "gast": (
        lambda: gast(Pref=0.5), "Pref", 0.05, "Pm", np.array([1.0]), polynomial((0.4, 1.0), (0.1, 1.0)),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", list(LINEAR))
def test_step_responses_are_those_of_the_transfer_function(name):
    """Order 4 at 4 ms; and the order of the scheme is seen where the steps are twice as long."""
    build, given, height, told, num, den = LINEAR[name]
    model = rested(build())
    before = next(v.start[0] for v in model.parameters if v.name == given)
    errors = []
    for h in (4e-3, 8e-3):
        found = ran(model, 4, 2.0, h, (Event(0.0, given, before + height),))
        t, y = found.time, found.column(told)
        exact = step(TransferFunction(num, den), T=t)[1] * height
        errors.append(np.abs(y[1:] - y[0] - (exact[1:] - exact[0])).max() / max(np.abs(exact).max(), 1e-9))
    assert errors[0] < 1e-5 and errors[0] < errors[1] / 8.0


def rested(model: PHDAE) -> PHDAE:
    """The model after its states have come to rest with the inputs that it begins with."""
    x, f, p = [v.sx for v in model.states], None, [v.sx for v in model.parameters]
    import casadi as ca

    (own,) = (q for q in model.ports if q.name == "own")
    f = ca.Function("f", [ca.vertcat(*x), ca.vertcat(*p)], [ca.vertcat(*(ca.SX(own.on[v]) for v in model.states))])
    g = ca.Function(
        "J", [ca.vertcat(*x), ca.vertcat(*p)], [ca.jacobian(f(ca.vertcat(*x), ca.vertcat(*p)), ca.vertcat(*x))]
    )
    at, values = np.array([v.start[0] for v in model.states]), [v.start[0] for v in model.parameters]
    for _ in range(20):
        at = at - np.linalg.solve(g(at, values).full(), f(at, values).full().ravel())
    return model.with_starts(dict(zip([v.name for v in model.states], at.tolist(), strict=True)))


def limited_lag(lo: float, hi: float) -> PHDAE:
    x, u, T = state("x"), signal_input("u"), parameter("T", 0.2, unit="s")
    limit = limited(x, (u - x) / T, lo, hi, seconds=0.2)
    return PHDAE("lag", states=(x,), parameters=(u, T, limit.mode), ports=(driven("own", {x: limit.expr}),),
                 state_events=limit.events)  # fmt: skip


@pytest.mark.parametrize("order", [2, 4, 6])
def test_a_limit_is_met_exactly_and_left_when_the_rate_turns(order):
    """u = 2 to t = 0.5, then 0: x = 2 (1 - exp(-t/T)) to 1 at T ln 2, 1 until 0.5, then exp(-(t - 0.5)/T)."""
    found = ran(limited_lag(-1.0, 1.0), order, 1.0, 0.01, (Event(0.0, "u", 2.0), Event(0.5, "u", 0.0)))
    t, x = found.time, found.column("x")
    exact = np.where(
        t < 0.2 * np.log(2.0), 2.0 * (1.0 - np.exp(-t / 0.2)), np.where(t <= 0.5, 1.0, np.exp(-(t - 0.5) / 0.2))
    )
    assert x.max() == pytest.approx(1.0, abs=1e-14)
    assert np.abs(x - exact).max() < {2: 1e-3, 4: 1e-6, 6: 1e-9}[order]
    kept = (t > 0.2 * np.log(2.0)) & (t <= 0.5)
    assert np.ptp(x[kept]) == 0.0


def clamped(rates: Callable[[float, Any], Any], limits: dict[int, tuple[float, float]], x0: Any, stop: float) -> Any:
    """The motion with non-windup limits by projection of the rates, in small steps that end at changes: no modes, no guards."""

    def f(t: float, x: Any) -> Any:
        r = np.array(rates(t, x), float)
        for i, (lo, hi) in limits.items():
            if (x[i] >= hi and r[i] > 0) or (x[i] <= lo and r[i] < 0):
                r[i] = 0.0
        return r

    return solve_ivp(f, (0.0, stop), x0, method="RK45", max_step=2e-4, rtol=1e-8, atol=1e-10, dense_output=True).sol


def test_hygov_with_limits_of_gate_and_its_speed_agrees_with_another_integration():
    """A fall of the speed by 3 % opens the gate at its largest speed to its largest value; both limits are met."""
    found = ran(hygov(nref=0.03, VELM=0.1, GMAX=0.7), 4, 8.0, 0.01, (Event(0.0, "w", 0.97),))
    R, r, Tr, Tf, Tg, TW, VELM = 0.05, 0.3, 5.0, 0.05, 0.5, 1.0, 0.1

    def rates(t, x):
        e, c, g, q = x
        slope = (0.03 + 0.03 - R * c - e) / Tf
        return [slope, np.clip((e + Tr * slope) / (r * Tr), -VELM, VELM), (c - g) / Tg, (1.0 - (q / g) ** 2) / TW]

    exact = clamped(rates, {1: (0.0, 0.7)}, [0.0, 0.6, 0.6, 0.6], 8.0)
    t = found.time
    for k, name in enumerate(("error", "c", "g", "q")):
        assert np.abs(found.column(name) - exact(t)[k]).max() < 1e-4
    assert found.column("c").max() == pytest.approx(0.7, abs=1e-14)
    assert np.diff(found.column("c")).max() == pytest.approx(VELM * 0.01, rel=1e-9)


def test_gast_gives_way_to_the_temperature():
    """Pref = 1.3 against AT = 1: the valve follows the temperature's limit to AT, below VMAX."""
    found = ran(gast(Pref=0.8, VMAX=1.5), 4, 60.0, 0.02, (Event(0.0, "Pref", 1.3),))
    R = found.column("mode.load_second") if "mode.load_second" in found.names else found.column("load_second")
    assert R[-1] == 1.0 and found.column("Pm")[-1] == pytest.approx(1.0, abs=1e-6)


def test_exac1_rests_where_its_equations_say():
    """Efd of a rectifier with IN between sqrt(3)/4 and 3/4, from rest: VE and FEX by hand."""
    model = rested(exac1(Vref=1.012, SE1=0.0, KC=0.7, KD=0.3))
    starts = {v.name: v.start[0] for v in model.states}
    VE = starts["VE"]
    assert starts["VR"] == pytest.approx(VE + 0.3) and starts["VR"] == pytest.approx(400.0 * 0.012)
    found = ran(model, 2, 0.01, 1e-3, ())
    IN = 0.7 / VE
    assert IN < 3.0**0.5 / 4.0
    assert found.column("Efd_pu")[-1] == pytest.approx(VE * (1.0 - IN / 3.0**0.5), rel=1e-9)


def test_ieeex1_saturates_as_its_points_say():
    model = rested(ieeex1(Vref=1.08))
    starts = {v.name: v.start[0] for v in model.states}
    E = starts["Efd"]
    B = np.log(0.1 / 0.03)
    assert starts["VR"] == pytest.approx(40.0 * 0.08) and starts["VR"] == pytest.approx(
        E * (1.0 + 0.03 * np.exp(B * (E - 3.0)))
    )


WRONG: tuple[Callable[[], PHDAE], ...] = (
    *(lambda: sexs(TB=0.0), lambda: sexs(TE=-1.0), lambda: st1a(TA=0.0, KF=0.1), lambda: hygov(TW=0.0)),
    *(lambda: exac1(SE2=0.0), lambda: ieeest(A6=1.0), lambda: meter(1e3, TR=0.0)),
)


@pytest.mark.parametrize("wrong", WRONG)
def test_data_that_no_diagram_has_are_refused(wrong):
    with pytest.raises(ValueError, match=r"[A-Z]\w* ?=" r"|numerator|saturation"):
        wrong()


# -- in networks -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_an_exported_exciter_meets_and_leaves_its_limit_as_the_model_does(tmp_path, version):
    """Vref rises for 0.3 s, in the unit V falls as much: Efd stops at 3 in both, and the same values after the limit."""
    model = rested(sexs(Vref=1.01, EMAX=3.0))
    events = (Event(0.05, "Vref", 1.2), Event(0.35, "Vref", 1.0))
    found = ran(model, 2, 0.8, 0.01, events)
    made = export(build_model(model), tmp_path, step=0.01, ledger_outputs=False, versions=(version,))
    with FMUInstance(made[0]) as unit:
        at = []
        for k in range(80):
            if k in (5, 35):
                unit.set({"V": 1.0 - (0.19 if k == 5 else -0.01)})
            unit.do_step(k * 0.01, 0.01)
            at.append(unit.get(["Efd_pu"])[0])
    t, Efd = found.time, found.column("Efd_pu")
    exact = [Efd[np.abs(t - 0.01 * (k + 1)).argmin()] for k in range(80)]
    inside = [k for k in range(80) if k not in (4, 34)]
    np.testing.assert_allclose(np.array(at)[inside], np.array(exact)[inside], rtol=1e-9)
    assert max(at) == pytest.approx(3.0, abs=1e-14)


@pytest.mark.parametrize("order", wide([2, 4, 6], 4))
def test_the_exciter_stops_at_exactly_its_limit_during_a_fault_and_leaves_it(order):
    scene = smib_exciter(stop=0.6)
    found = ran(scene.declaration(), order, 0.6, scene.step, scene.events)
    t, Efd, at = found.time, found.column("avr.Efd"), found.column("avr.Efd_at")
    assert Efd.max() == pytest.approx(3.0, abs=1e-12) and (at == 1.0).any()
    assert np.abs(Efd[(at == 1.0) & (t > 0.11)] - 3.0).max() < 1e-12
    assert Efd[-1] < 2.9 and at[0] == 0.0
    assert max(c.worst_relative for c in found.ledger.summary().components) < 5e-14


def test_the_island_stays_at_rest_and_then_keeps_the_droop_of_its_governor():
    scene = island(t_step=0.1, stop=20.0)
    d = scene.declaration()
    still = ran(d, 4, 0.1, scene.step, ())
    assert np.abs(still.column("avr.Efd") / still.column("avr.Efd")[0] - 1.0).max() < 1e-6
    assert np.abs(still.column("meter.f") - 60.0).max() < 1e-6
    found = ran(d, 2, 20.0, 5e-4, scene.events)
    rise = found.column("gov.valve")[-1] - found.column("gov.valve")[0]
    assert 0.05 < rise < 0.11
    assert found.column("meter.f")[-1] == pytest.approx(60.0 * (1.0 - 0.05 * rise), abs=2e-3)


def plant() -> Network:
    data = machine_set("kundur555_1q")
    base, Z, v = bases(data), data.Vn_rms_ll**2 / data.Sn, data.Vn_rms_ll * (2.0 / 3.0) ** 0.5
    net = Network("plant")
    net.add("gen", synchronous_machine(data))
    net.add("meter", meter(data.Vn_rms_ll, data.Sn, data.fn, through=True))
    net.add("line", rl_line(0.02 * Z, 0.3 * Z / data.omega, v=v, rated=19e3))
    net.add("grid", infinite_bus(v, data.fn, i=19e3))
    net.add("avr", sexs(EMAX=4.0, base=base))
    net.add("gov", tgov1(base=base))
    net.junction("bus1", ["gen.terminal", "meter.a"])
    net.junction("bus3", ["meter.b", "line.a"])
    net.junction("bus2", ["line.b", "grid.terminal"])
    net.signal("meter.voltage", "avr.V")
    net.signal("avr.field", "gen.field.v")
    net.signal("gen.shaft.speed", "gov.w")
    net.signal("gov.torque", "gen.shaft.torque")
    return net


def test_set_points_give_the_network_what_it_asks_for():
    """By hand: Efd = field voltage over Ebase = K (Vref - V); Pm = Pref = torque over T_base; the meter tells P and Q."""
    net, data = plant(), machine_set("kundur555_1q")
    P = 0.7 * data.Sn
    point = operating_point(
        net, [PV("gen.terminal", P=P, V=1.03 * data.Vn_rms_ll, free=("avr.Vref", "gov.Pref"))], 60.0
    )
    Efd = point.states["avr.Efd"]
    assert point.parameters["avr.Vref"] == pytest.approx(1.03 + Efd / 100.0, rel=1e-12)
    assert point.states["gov.valve"] == pytest.approx(point.parameters["gov.Pref"], rel=1e-12)
    assert point.states["meter.P"] == pytest.approx(0.7, rel=1e-10)
    assert point.states["meter.Q"] == pytest.approx(-point.power("gen.terminal").imag / data.Sn, rel=1e-9)
    field = point.parameters["gen.field.v"]
    assert field == pytest.approx(Efd * bases(data).Ebase, rel=1e-12)
    torque = point.parameters["gen.shaft.torque"]
    losses = torque * data.omega - P
    assert 0.0 < losses < 0.02 * P  # copper and friction
    assert point.residual < 1e-10


def test_a_point_beyond_a_limit_is_refused_by_name():
    net, data = plant(), machine_set("kundur555_1q")
    ask = PV("gen.terminal", P=0.7 * data.Sn, V=1.03 * data.Vn_rms_ll, free=("avr.Vref", "gov.Pref"))
    net.members["avr"] = net.declared["avr"].with_starts({"EMAX": 1.5})
    net.members["gov"] = net.declared["gov"].with_starts({"VMAX": 0.5})
    with pytest.raises(NoOperatingPoint, match=r"avr\.Efd_hits_max by .*gov\.valve_hits_max by 0\.20"):
        operating_point(net, [ask], 60.0)


def test_signals_from_junctions_and_into_free_ports():
    net = plant()
    with pytest.raises(ConnectionError, match="no port at the junction has it as its output.*meter"):
        net.signal("bus1.v[1]", "avr.V")
    with pytest.raises(ConnectionError, match="has no 'i'"):
        net.signal("bus1.i", "avr.V")
    with pytest.raises(ConnectionError, match="is joined at 'bus1'"):
        net.signal("avr.field", "gen.terminal.v[1]")
    with pytest.raises(ConnectionError, match="is fed by avr.field already"):
        net.signal("avr.field", "gen.field.v")


@pytest.mark.parametrize("name", ["island", "smib_exciter"])
def test_members_apart_do_what_the_composed_network_does(name):
    scene = {"island": island, "smib_exciter": smib_exciter}[name]()
    net = scene.system
    assert isinstance(net, Network)
    options = Options(stop=0.01, step=scene.step, events=(Event(0.0, "avr.Vref", 1.2),))
    whole = run(Monolithic(m := build_model(net.compose(), Collocated(1)), NativeInstance(m)), options)
    split = run(apart(net, 1, NativeInstance), options)
    for told in ("avr.Efd", "gen.p", "gov.valve", "meter.V"):
        np.testing.assert_allclose(split.column(told)[-1], whole.column(told)[-1], rtol=1e-5)
    assert whole.column("avr.Efd")[-1] > 1.05 * whole.column("avr.Efd")[0]
