"""Parts of three-phase networks against phasors of their steady state and exact solutions."""

from __future__ import annotations

import numpy as np
import pytest

from phfmu import Network
from phfmu.components.electrical import (
    capacitor_bank,
    coupled_line,
    infinite_bus,
    line_per_unit,
    load,
    pi_line,
    rlc_branch,
    series_compensated_line,
    shunt,
    two_winding_transformer,
)
from phfmu.operating import operating_point
from tests.components.orders import steps
from tests.components.test_lines_and_loads import check_linear

F = 50.0
W = 2.0 * np.pi * F
ALPHA = np.array([0.0, 2.0, -2.0]) * np.pi / 3.0


def phasor(values) -> complex:
    """The peak phasor of phase a of balanced values."""
    return complex(2.0 / 3.0 * np.asarray(values) @ np.exp(1j * ALPHA))


def of_sequence(positive, zero):
    return positive * np.eye(3) + (zero - positive) / 3.0


def state(point, name):
    """The entries of the state `name` of an operating point, as a phasor."""
    return phasor([point.states[f"{name}[{k}]"] for k in (1, 2, 3)])


# -- lines: transients against the exponential, zero sequence included ------------------------------------------------------

SERIES = {"R": 0.3, "L": 2e-3, "R0": 0.9, "L0": 7e-3}
R_ABC, L_ABC = of_sequence(0.3, 0.9), of_sequence(2e-3, 7e-3)
E, O = np.eye(3), np.zeros((3, 3))
K = np.linalg.inv(L_ABC)


def test_coupled_line_follows_the_coupled_equations():
    model = coupled_line(**SERIES, v=100.0, rated=30.0)
    check_linear(model, -R_ABC @ K, np.hstack([E, -E]), np.zeros(3), 100.0, lambda x, u: [*(K @ x), *(-K @ x)])


def test_series_compensated_line_follows_its_equations():
    C = 5e-3
    A = np.block([[-R_ABC @ K, -E / C], [K, O]])
    model = series_compensated_line(**SERIES, C=C, v=100.0, rated=30.0)
    B = np.vstack([np.hstack([E, -E]), np.zeros((3, 6))])
    check_linear(model, A, B, np.zeros(6), 100.0, lambda x, u: [*(K @ x[:3]), *(-K @ x[:3])])


def test_pi_line_follows_its_equations():
    S = 2.0 * np.linalg.inv(of_sequence(1e-3, 6e-4))
    A = np.block([[-R_ABC @ K, S, -S], [-K, O, O], [K, O, O]])
    B = np.vstack([np.zeros((3, 6)), np.hstack([E, O]), np.hstack([O, E])])
    model = pi_line(**SERIES, C=1e-3, C0=6e-4, v=100.0, rated=20.0)
    check_linear(model, A, B, np.zeros(9), 20.0, lambda x, u: [*(S @ x[3:6]), *(S @ x[6:])], end=0.01)


def test_line_per_unit_gives_the_reactances_back():
    data = line_per_unit(0.01, 0.085, 0.176, S=100e6, V=230e3, f=60.0, x0=0.255)
    Z, w = 230e3**2 / 100e6, 120.0 * np.pi
    assert data["L"] * w / Z == pytest.approx(0.085) and data["C"] * w * Z == pytest.approx(0.176)
    assert data["L0"] * w / Z == pytest.approx(0.255) and data["R0"] == data["R"] == pytest.approx(0.01 * Z)
    assert "C" not in line_per_unit(0.01, 0.1, S=1e8, V=1e5, f=50.0)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: coupled_line(0.1, 1e-3, L0=-1e-3),
        lambda: coupled_line(-0.1, 1e-3),
        lambda: pi_line(0.1, 1e-3, 1e-6, C0=0.0),
        lambda: line_per_unit(0.01, 0.1, S=100.0, V=230.0, f=50.0),
        lambda: load(-1.0, V=400.0),
        lambda: load(0.0, 0.0, V=400.0),
        lambda: load(1.0, V=0.0),
        lambda: capacitor_bank(1e4, V=400.0, detuning=1.0),
        lambda: capacitor_bank(-1e4, V=400.0),
        lambda: rlc_branch(0.0, C=1e-3),
        lambda: two_winding_transformer(1e6, 20e3, 400.0, group="Dyn0"),
        lambda: two_winding_transformer(1e6, 20e3, 400.0, x=0.0),
        lambda: two_winding_transformer(1e6, 20e3, 400.0, p0=0.01),
        lambda: two_winding_transformer(1e6, 20e3, 400.0, i0=0.01, p0=0.02),
    ],
)
def test_contradictory_data_are_refused_with_numbers(wrong):
    with pytest.raises(ValueError, match=r"\d"):
        wrong()


# -- steady states, found by the operating point and known as phasors ---------------------------------------------------------

V = 400.0
PEAK = V * np.sqrt(2.0 / 3.0)
LOADS = [
    ("parallel", 1e5, 3e4),
    ("parallel", 1e5, -3e4),
    ("parallel", 1e5, 0.0),
    ("parallel", 0.0, 3e4),
    ("series", 1e5, 3e4),
    ("series", 1e5, -3e4),
    ("series", 1e5, 0.0),
    ("series", 0.0, 3e4),
]


def fed(part, port="terminal", r=1e-9, x=1e-8):
    """The operating point of a part at a stiff grid behind a line of nearly no impedance; current and voltage at the part."""
    net = Network("fed")
    net.add("grid", infinite_bus(PEAK, F, 0.3, i=100.0))
    net.add("line", coupled_line(r, x / W, v=PEAK, rated=100.0))
    net.add("part", part)
    net.junction("bus", ["grid.terminal", "line.a"])
    net.junction("feeder", ["line.b", f"part.{port}"])
    point = operating_point(net, [], F)
    i = state(point, "line.flux") / (x / W)
    return point, PEAK * np.exp(0.3j) - (r + 1j * x) * i, i


@pytest.mark.parametrize(("kind", "P", "Q"), LOADS)
def test_a_load_takes_exactly_its_power_at_nominal_voltage(kind, P, Q):
    part = load(P, Q, V=V, f=F, kind=kind)
    _, v, i = fed(part, r=0.01, x=0.1)
    S = 1.5 * v * np.conj(i) * (PEAK / abs(v)) ** 2
    assert abs(S - (P + 1j * Q)) < 1e-9 * abs(P + 1j * Q)


def test_banks_and_shunts_take_their_reactive_power():
    for part, Q in ((shunt(2e4, V=V, f=F), 2e4), (shunt(-2e4, V=V, f=F), -2e4), (capacitor_bank(2e4, V=V, f=F), -2e4)):
        _, v, i = fed(part, r=0.01, x=0.1)
        assert 1.5 * v * np.conj(i) * (PEAK / abs(v)) ** 2 == pytest.approx(1j * Q, abs=1e-6)
    _, v, i = fed(capacitor_bank(2e4, V=V, f=F, detuning=0.07, quality=1e9), r=0.01, x=0.1)
    assert 1.5 * v * np.conj(i) * (PEAK / abs(v)) ** 2 == pytest.approx(-2e4j, abs=1e-2)


def test_a_load_begins_in_its_steady_state():
    """At nominal voltage the start is the operating point, to the last digits of a stiff feeder."""
    part = load(1e5, 3e4, V=V, f=F, kind="series", angle=0.3)
    point, *_ = fed(part, r=0.0, x=1e-9)
    assert state(point, "part.flux") == pytest.approx(phasor(part.states[0].start), rel=1e-7)


HOURS = {
    "YNyn0": 0, "Yyn0": 0, "Yy6": 6, "YNyn6": 6, "Dd0": 0, "Dd6": 6, "Dyn1": 1, "Dy5": 5, "Dyn7": 7, "Dyn11": 11,
    "YNd1": 1, "Yd5": 5, "YNd7": 7, "YNd11": 11,
}  # fmt: skip


@pytest.mark.parametrize("group", HOURS)
def test_transformer_turns_by_its_hour_and_drops_over_its_leakage(group):
    """v_b = (v_a e^(-j hour 30 deg)/(tap n) - z i_b) and the powers of both sides differ by that of z."""
    Sn, Va, tap, r, x = 2e5, V, 1.05, 0.02, 0.08
    Vb = 100.0
    Z = (r + 1j * x) * Vb**2 / Sn
    net = Network("fed")
    net.add("grid", infinite_bus(PEAK, F, 0.3, i=100.0))
    net.add("unit", two_winding_transformer(Sn, Va, Vb, f=F, r=r, x=x, group=group, tap=tap))
    net.add("load", load(1e5, 3e4, V=Vb, f=F))
    net.junction("high", ["grid.terminal", "unit.a"])
    net.junction("low", ["unit.b", "load.terminal"])
    point = operating_point(net, [], F)
    Y = (1e5 - 3e4j) / Vb**2
    behind = PEAK * np.exp(0.3j) * np.exp(-1j * HOURS[group] * np.pi / 6.0) * Vb / Va / tap
    v_b = behind / (1.0 + Z * Y)
    assert state(point, "load.flux") == pytest.approx(v_b / (1j * W), rel=1e-9)
    into = phasor([point.algebraics[f"grid.i[{k}]"] for k in (1, 2, 3)])
    i_b = v_b * Y
    expected = 1.5 * (abs(v_b) ** 2 * np.conj(Y) + Z * abs(i_b) ** 2)
    assert -1.5 * PEAK * np.exp(0.3j) * np.conj(into) == pytest.approx(expected, rel=1e-9)


def test_the_core_takes_the_no_load_current_and_loss():
    Sn, i0, p0 = 2e5, 0.03, 0.01
    part = two_winding_transformer(Sn, V, 100.0, f=F, r=0.0, x=0.05, group="Dyn11", i0=i0, p0=p0)
    net = Network("open")
    net.add("grid", infinite_bus(PEAK, F, i=10.0))
    net.add("unit", part)
    net.add("load", load(1e-3, V=100.0, f=F))
    net.junction("high", ["grid.terminal", "unit.a"])
    net.junction("low", ["unit.b", "load.terminal"])
    point = operating_point(net, [], F)
    into = -phasor([point.algebraics[f"grid.i[{k}]"] for k in (1, 2, 3)])
    S = 1.5 * PEAK * np.conj(into)
    assert abs(S) == pytest.approx(i0 * Sn, rel=1e-6) and S.real == pytest.approx(p0 * Sn, rel=1e-6)


@pytest.mark.parametrize(("group", "grounded"), [("YNyn0", True), ("Yyn0", False), ("Dyn11", True), ("YNd1", False)])
def test_zero_sequence_passes_only_where_neutral_and_delta_let_it(group, grounded):
    """Side b under a common voltage of all phases, side a held at zero: leakage to ground, or no current."""
    part = two_winding_transformer(1e5, V, 100.0, f=F, x=0.1, group=group)
    L, h, n = 0.1 * 0.1 / W, 1e-4, 20
    unit, _ = steps(part, 1, h, n, lambda t: np.array([0.0, 0.0, 0.0, 50.0, 50.0, 50.0]))
    i = -50.0 * n * h / L if grounded else 0.0
    assert unit.x / L == pytest.approx([i] * 3, rel=1e-9, abs=1e-6)
