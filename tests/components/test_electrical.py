"""Electrical components against independent solutions; power goes through every port, from nonzero starts."""

from __future__ import annotations

from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
import reference_tools
from machine_reference import MachineReference
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from phfmu import Collocated, PythonInstance, time
from phfmu.components.electrical import (
    MachineDataError,
    current_source,
    fault_resistor,
    infinite_bus,
    machine_names,
    machine_set,
    operating_point,
    rl_line,
    rlc_load,
    steady_state,
    synchronous_machine,
    voltage_source,
)
from phfmu.discretise.model import build_model
from tests.wide import wide

SCENES = reference_tools.load("scenes")
COORDINATES = ("dq-flux", "abc-flux", "current")
OMEGA = 120.0 * np.pi


def steps(model, k, h, n, inputs):
    """A Python instance after n steps with `inputs` at the k nodes, and the worst ledger gap of a step."""
    plan = build_model(model, Collocated(k))
    instance, worst = PythonInstance(plan), 0.0
    for i in range(n):
        instance.set_node_inputs(np.array([inputs(h * (i + c)) for c in plan.nodes]))
        instance.do_step(h * i, h)
        row = instance.ledger()
        gap = abs(float(np.sum(row["stored"] + row["dissipated"] - row["supplied"])))
        size = sum(float(np.sum(np.abs(row[r]))) for r in ("stored", "dissipated", "supplied", "pairs"))
        worst = max(worst, gap / (abs(float(np.sum(instance.signals()["H"]))) + size or 1.0))
    instance.set_node_inputs(np.array([inputs(h * n)] * k))
    return instance, worst


def orders(errors):
    return [float(np.log2(a / b)) for a, b in pairwise(errors)]


# -- data and initialisation -----------------------------------------------------------------------------


def scene_machines():
    smib, hydro, two = SCENES["smib"], SCENES["smib_hydro"], SCENES["two_machine"]
    yield "smib", (smib["machine"], smib, 0.8, 0.2, None, 0.0, ("I", "p", "theta"), ("Vf", "tau0"))
    yield "hydro", (hydro["machine"], hydro, 0.8, 0.2, None, 0.0, ("I", "p", "theta"), ("Vf", "tau0"))
    P, Q = 240e6 / 325e6, 60e6 / 325e6
    yield "second", (two["machine2"], two, P, Q, 24e3, 0.0, ("I2", "p2", "theta2"), ("Vf2", "tau2"))


@pytest.mark.parametrize("case", [pytest.param(c, id=n) for n, c in scene_machines()])
def test_steady_state_equals_the_reference_data(case):
    source, scene, P, Q, V, angle, states, inputs = case
    data = machine_set(source, d=scene.get("d", 50.0))
    point = steady_state(data, P * data.Sn, Q * data.Sn, V, angle)
    current, p, theta = (scene["initial"][s] for s in states)
    assert np.allclose(point.I, current, rtol=1e-9, atol=1e-9 * np.max(np.abs(current)))
    values = (point.p, point.theta, point.Vf, point.tau)
    assert values == pytest.approx((p, theta, *(scene["inputs"][u] for u in inputs)), rel=1e-9)


def test_steady_state_of_the_first_of_two_machines_at_its_bus_voltage():
    two, data = SCENES["two_machine"], machine_set(SCENES["two_machine"]["machine1"])
    v, i = np.array(two["initial"]["v1"]), np.array(two["initial"]["I1"][:3])
    turn = np.exp(1j * np.array([0.0, 2.0, -2.0]) * np.pi / 3.0)
    voltage, current = 2.0 / 3.0 * v @ turn, 2.0 / 3.0 * i @ turn
    S = -1.5 * voltage * np.conj(current)
    point = steady_state(data, S.real, S.imag, abs(voltage) * np.sqrt(1.5), np.angle(voltage))
    assert np.allclose(point.I, two["initial"]["I1"], rtol=0, atol=1e-9 * np.max(np.abs(i)))
    assert (point.theta, point.Vf, point.tau) == pytest.approx(
        (two["initial"]["theta1"], two["inputs"]["Vf1"], two["inputs"]["tau1"]), rel=1e-9
    )
    assert np.allclose(point.v, v, rtol=1e-9)


@pytest.mark.parametrize("coordinates", COORDINATES)
@pytest.mark.parametrize("name", ["kundur555_1q", "krause_hydro325"])
def test_steady_state_has_no_rates(name, coordinates):
    """The first step from the steady state moves dq quantities by no more than the method error."""
    data = machine_set(name, d=50.0)
    point = steady_state(data)
    model = synchronous_machine(data, coordinates=coordinates, start=point)
    V = np.sqrt(2.0 / 3.0) * data.Vn_rms_ll

    def inputs(t):
        return [*(V * np.cos(data.omega * t - np.array([0, 2, -2]) * np.pi / 3)), point.Vf, point.tau]

    instance, worst = steps(model, 1, 1e-5, 100, inputs)
    p, theta = instance.x[-2:]
    assert worst < 1e-12
    assert p == pytest.approx(point.p, rel=1e-8)
    assert theta - point.theta == pytest.approx(1e-3 * data.omega, rel=1e-7)
    instance.reset()
    assert instance.signals()["y_end"] == pytest.approx([*point.I[:4], data.omega / data.pole_pairs], rel=1e-12)
    assert model.port("shaft").start == point.tau and model.port("field").start == point.Vf


def test_built_in_names_and_the_two_ways_to_give_stator_inductances():
    assert machine_names() == ["krause_hydro325", "kundur555_1q"]
    raw = {k: v for k, v in SCENES["two_machine"]["machine2"].items() if k not in ("Ld", "Lq", "L0", "pu", "H")}
    a, b = machine_set(raw), machine_set(SCENES["two_machine"]["machine2"])
    assert (a.Ld, a.Lq, a.L0) == pytest.approx((b.Ld, b.Lq, b.L0), rel=1e-12)
    assert machine_set(a) == a and machine_set(a, J=1.0).J == 1.0


BOOK = {"Laa0": 3.2758e-3, "Laa2": 4.58e-5, "Lab0": 1.6379e-3}
BAD = {
    "singular": (BOOK, ["L0 = 0 H", "Lab0 = Laa0/2", "leakage"]),
    "coupling": ({"M_stator_rotor": [0.06, 0.003, 0.003]}, ["d-axis block", "Ld, f, kd", "M_stator_rotor"]),
    "q coupling": ({"M_stator_rotor": [0.04, 0.003, 0.03]}, ["q-axis block", "Lq, kq"]),
    "inertia": ({"J": 0.0}, ["J = 0.0 must be positive"]),
    "friction": ({"d": -1.0}, ["d = -1.0 must not be negative"]),
    "stator resistance": ({"Ra": -1.0}, ["Ra = -1.0"]),
    "rotor resistance": ({"R_rotor": [0.07, -0.02, 0.01]}, ["R_rotor[2] = -0.02"]),
    "rotor sizes": ({"R_rotor": [0.07]}, ["R_rotor has 1 entries for 3 rotor windings"]),
    "matrix size": ({"L_rotor": [[1.0]]}, ["L_rotor", "expected 3 x 3"]),
    "axis": ({"axis": ["d", "x", "q"]}, ["'d' or on 'q'"]),
    "field": ({"axis": ["q", "d", "q"]}, ["field winding"]),
    "asymmetric": ({"L_rotor": [[0.58, 0.04, 0], [0.05, 0.0034, 0], [0, 0, 0.0032]]}, ["not symmetric"]),
    "across": ({"L_rotor": [[0.58, 0.04, 0.1], [0.04, 0.0034, 0], [0.1, 0, 0.0032]]}, ["L_rotor[1,3]"]),
    "pole pairs": ({"pole_pairs": 0}, ["pole_pairs = 0"]),
    "unknown entry": ({"Rb": 1.0}, ["unknown entry 'Rb'"]),
    "two at once": ({"J": -1.0, "Ra": -1.0}, ["J = -1.0", "Ra = -1.0"]),
    "not finite": ({"Ld": float("nan")}, ["not finite"]),
}


@pytest.mark.parametrize("changes, words", BAD.values(), ids=BAD.keys())
def test_impossible_data_is_refused_with_the_name_of_the_entry(changes, words):
    with pytest.raises(MachineDataError) as error:
        machine_set("kundur555_1q", **changes)
    assert all(w in str(error.value) for w in words), str(error.value)


def test_unknown_names_are_refused_with_the_names_there_are():
    with pytest.raises(MachineDataError, match=r"did you mean kundur555_1q\?"):
        machine_set("kundur")
    with pytest.raises(MachineDataError, match="krause_hydro325, kundur555_1q"):
        machine_set("?")
    with pytest.raises(MachineDataError, match="missing: .*Ra.* Ld"):
        machine_set({"name": "mine", "Sn": 1.0})
    with pytest.raises(ValueError, match="abc-flux"):
        synchronous_machine(coordinates="dq")  # type: ignore[arg-type]
    data = machine_set("kundur555_1q")
    with pytest.raises(MachineDataError, match="6 windings, I has 3"):
        operating_point(data, [0.0] * 3, 0.0, 0.0)
    with pytest.raises(MachineDataError, match="not > 0"):
        steady_state(data, V=0.0)


# -- the machine against an independent solution in flux coordinates --------------------------------------


def machine_inputs(data, point):
    """Two tones on each of the five inputs; unbalanced and with zero sequence at the terminal."""
    V = np.sqrt(2.0 / 3.0) * data.Vn_rms_ll
    scale, shift = np.array([1.0, 0.7, 1.2]), np.array([0.0, 2.0, -2.0]) * np.pi / 3.0

    def inputs(t):
        v = V * (scale * np.cos(data.omega * t - shift + 0.2) + 0.15 * np.sin(500.0 * t + shift) + 0.05)
        field = point.Vf * (1.0 + 20.0 * np.sin(300.0 * t) + 10.0 * np.cos(170.0 * t))
        torque = point.tau * (0.5 + 2.0 * np.sin(200.0 * t) - 1.5 * np.cos(90.0 * t))
        return [*v, field, torque]

    return inputs


def start_of(data):
    """Far from steady: currents in every winding with a zero sequence, three quarters of rated speed."""
    rated = steady_state(data)
    base = np.array([1.0, -0.4, 0.3]) * np.max(np.abs(rated.I[:3]))
    rotor = np.array([0.8, -0.3, 0.25, 0.15])[: data.n - 3] * rated.I[3]
    I = [*base, *rotor]
    return operating_point(data, I, 0.75 * rated.p, 0.4, v=rated.v, Vf=rated.Vf, tau=rated.tau)


def reference(data, point, inputs, end):
    """(I, p, theta, energy dissipated) at `end` by DOP853 on fluxes, momentum and angle."""
    raw = {name: getattr(data, name) for name in ("Ra", "R_rotor", "axis", "M_stator_rotor", "L_rotor")}
    mean, raw["Laa2"] = (data.Ld + data.Lq) / 2, (data.Ld - data.Lq) / 3
    raw["Lab0"] = (mean - data.L0) / 3
    raw["Laa0"] = mean - raw["Lab0"]
    machine = MachineReference(raw | {"J": data.J_electrical}, d=data.d_electrical)
    scale = np.array([*machine.fluxes(np.abs(point.I), 0.0), point.p, 1.0, 1e6])

    def rhs(t, y):
        x = y * scale
        *v, field, torque = inputs(t)
        psi_dot, p_dot, omega, I = machine.rhs(x[: data.n], x[-3], x[-2], v, field, torque / data.pole_pairs)
        loss = machine.R @ I**2 + data.d_electrical * omega**2
        return np.array([*psi_dot, p_dot, omega, loss]) / scale

    x0 = np.array([*machine.fluxes(point.I, point.theta), point.p, point.theta, 0.0])
    x = solve_ivp(rhs, (0.0, end), x0 / scale, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1] * scale
    return np.array([*machine.currents(x[: data.n], x[-2]), *x[-3:]])


def reached(model, instance, data, point):
    """(I, p, theta, dissipated) of an instance, in whatever coordinates, scaled for comparison."""
    signals = instance.signals()
    names = dict(zip(instance.model.observable_names, signals["observables"], strict=True))
    names |= dict(zip([n for v in model.states for n in v.names()], signals["x"], strict=True))
    values = [names[f"I[{j + 1}]"] for j in range(data.n)] + [names["p"], names["theta"]]
    # what is taken out at the ports is what the outputs at the end say
    assert signals["y_end"][:4] == pytest.approx(values[:4], rel=1e-9)
    assert signals["y_end"][4] == pytest.approx(values[-2] / data.J_electrical / data.pole_pairs, rel=1e-12)
    return np.array([*values, float(signals["dissipated"][0])])


FOUR_WINDINGS = {
    "axis": ["d", "d", "q", "q"],
    "R_rotor": [0.0715614370, 0.0196497297, 0.016384, 0.00428],
    "M_stator_rotor": [0.0400, 3.0465984e-3, 2.9548334e-3, 2.9548334e-3],
    "L_rotor": [
        [0.5773771, 0.0400, 0.0, 0.0],
        [0.0400, 3.36099e-3, 0.0, 0.0],
        [0.0, 0.0, 3.18425e-3, 2.9548334e-3],
        [0.0, 0.0, 2.9548334e-3, 4.2858e-3],
    ],
}
MACHINES = {
    "turbo": ("kundur555_1q", {"d": 5e3}),
    "hydro": ("krause_hydro325", {"d": 5e3}),
    "pole pairs": ("krause_hydro325", {"d": 5e5, "pole_pairs": 4, "J": 34301.4423789164 * 16}),
    "model 2.2": ("kundur555_1q", {"d": 5e3, **FOUR_WINDINGS}),
}
CASES = [
    ("turbo", "dq-flux", 1), ("turbo", "dq-flux", 2), ("turbo", "abc-flux", 1), ("turbo", "abc-flux", 2),
    ("turbo", "current", 1), ("hydro", "dq-flux", 2), ("hydro", "abc-flux", 2), ("hydro", "current", 1),
    ("pole pairs", "dq-flux", 1), ("pole pairs", "current", 1), ("model 2.2", "dq-flux", 2),
    ("model 2.2", "abc-flux", 1), ("model 2.2", "current", 1),
]  # fmt: skip
#: each data set, each choice of coordinates, both orders
TELLING = [("turbo", "dq-flux", 2), ("hydro", "abc-flux", 2), ("pole pairs", "dq-flux", 1), ("model 2.2", "current", 1)]


@pytest.mark.parametrize("name, coordinates, k", wide(CASES, *TELLING))
def test_driven_machine_converges_to_the_reference(name, coordinates, k):
    source, changes = MACHINES[name]
    data = machine_set(source, **changes)
    point, end = start_of(data), 0.016
    inputs = machine_inputs(data, point)
    expected = reference(data, point, inputs, end)
    size = np.array([*np.full(3, np.max(np.abs(expected[:3]))), *np.abs(expected[3:])])
    size[3 : data.n] = np.maximum(size[3 : data.n], 0.05 * size[3])
    model = synchronous_machine(data, coordinates=coordinates, start=point)
    errors = []
    for n in (80, 160) if k == 1 else (32, 64):
        instance, worst = steps(model, k, end / n, n, inputs)
        assert worst <= 1e-12
        errors.append(np.abs(reached(model, instance, data, point) - expected) / size)
    assert np.max(errors[-1]) < (3e-3 if k == 1 else 1e-5)
    seen = orders([float(np.linalg.norm(e)) for e in errors])[0]
    assert 2 * k - 0.3 < seen < 2 * k + 0.5, (seen, errors)


@pytest.mark.parametrize("coordinates", wide(["abc-flux", "current"], "current"))
@pytest.mark.parametrize("name", machine_names())
def test_without_losses_and_voltages_energy_and_fluxes_stay(name, coordinates):
    from phfmu.engine.native import NativeInstance

    data = machine_set(name, Ra=0.0, R_rotor=[0.0] * 3)
    point = start_of(data)
    model = synchronous_machine(data, coordinates=coordinates, start=point)
    instance = NativeInstance(build_model(model, Collocated(1)))
    instance.set_input(np.zeros(5))

    def conserved():
        signals = instance.signals()
        names = dict(zip(instance.model.observable_names, signals["observables"], strict=True))
        return np.array([*(names[f"flux[{j + 1}]"] for j in range(6)), *signals["H"]]), names["Te"]

    before, torque = conserved()
    assert np.allclose(before[:6], point.psi, rtol=1e-12)
    for i in range(10_000):
        instance.do_step(i * 1e-4, 1e-4)
    after, torque_after = conserved()
    assert abs(torque - torque_after) > 1e-3 * abs(torque)  # the rotor really moves through the field
    size = np.maximum(np.abs(before), 1e-3 * np.max(np.abs(before[:3])))
    assert np.max(np.abs(after - before) / size) < 1e-11


@pytest.mark.parametrize("coordinates", COORDINATES)
def test_ports_do_not_see_the_turns_of_the_dampers(coordinates):
    """Damper currents scaled by k: M/k, R/k^2, L/k^2, mutual L/k is the same machine (gauge)."""
    data = machine_set("kundur555_1q", d=50.0)
    k = np.array([1.0, 3.7, 0.21])
    other = machine_set(
        data,
        M_stator_rotor=list(np.array(data.M_stator_rotor) / k),
        R_rotor=list(np.array(data.R_rotor) / k**2),
        L_rotor=(np.array(data.L_rotor) / np.outer(k, k)).tolist(),
    )
    seen = []
    for machine, turns in ((data, np.ones(3)), (other, k)):
        point = start_of(data)
        I = [*point.I[:3], *(np.array(point.I[3:]) * turns)]
        start = operating_point(machine, I, point.p, point.theta, v=point.v, Vf=point.Vf, tau=point.tau)
        model = synchronous_machine(machine, coordinates=coordinates, start=start)
        instance, _ = steps(model, 1, 2e-4, 50, machine_inputs(data, point))
        seen.append(instance.signals())
    for block in ("y_end", "y_step", "energy", "H", "dissipated"):
        assert seen[0][block] == pytest.approx(seen[1][block], rel=1e-10)


# -- lines, loads, sources, switches ----------------------------------------------------------------------


class TwoTones:
    """u_j(t) = offset + a_j sin(w1 t + p_j) + b_j cos(w2 t) and its exact response of x' = A x + B u."""

    def __init__(self, n, size, seed=3):
        rng = np.random.default_rng(seed)
        self.w = np.array([OMEGA, 1.9 * OMEGA])
        self.C = size * rng.uniform(-1, 1, (n, 5))

    def basis(self, t):
        a = self.w * t
        return np.array([1.0, *np.sin(a), *np.cos(a)])

    def __call__(self, t):
        return self.C @ self.basis(t)

    def response(self, A, B, x0, t):
        """x(t), by the exponential of the system together with its oscillators."""
        generator = np.zeros((5, 5))
        generator[1:3, 3:5], generator[3:5, 1:3] = np.diag(self.w), -np.diag(self.w)
        n = len(x0)
        M = np.zeros((n + 5, n + 5))
        M[:n, :n], M[:n, n:], M[n:, n:] = A, B @ self.C, generator
        return (expm(M * t) @ np.array([*x0, *self.basis(0.0)]))[:n]


def check_linear(model, A, B, x0, size, outputs, end=0.02):
    """Orders 2 and 4 of the state against the exponential; outputs(x, u) at the end; closed ledger."""
    u = TwoTones(B.shape[1], size)
    exact = u.response(A, B, x0, end)
    scale = np.abs(exact).max()
    for k, counts in ((1, (80, 160)), (2, (20, 40))):
        errors = []
        for n in counts:
            instance, worst = steps(model, k, end / n, n, u)
            assert worst < 1e-13
            errors.append(float(np.linalg.norm(instance.x - exact)) / scale)
            y = instance.signals()["y_end"]
            assert y == pytest.approx(outputs(instance.x, u(end)), rel=1e-10, abs=1e-10 * np.abs(y).max())
        assert errors[-1] < 2e-3
        assert 2 * k - 0.2 < orders(errors)[0] < 2 * k + 0.4, errors


def test_rl_line():
    R, L, i0 = 0.3, 2e-3, [30.0, -10.0, 5.0]
    A, B = -R / L * np.eye(3), np.hstack([np.eye(3), -np.eye(3)])
    model = rl_line(R, L, i=i0, v=100.0)
    check_linear(model, A, B, L * np.array(i0), 100.0, lambda x, u: [*(x / L), *(-x / L)])


def test_rlc_load_with_capacitor():
    R, L, C, v0, i0 = 5.0, 0.02, 4e-4, [100.0, 20.0, -80.0], [3.0, -4.0, 6.0]
    E = np.eye(3)
    A = np.block([[0 * E, E / C], [-E / L, -E / (R * C)]])
    model = rlc_load(R, L, C, v=v0, i=i0, nominal=100.0)
    x0 = np.array([*(L * np.array(i0)), *(C * np.array(v0))])
    check_linear(model, A, np.vstack([0 * E, E]), x0, 20.0, lambda x, u: x[3:] / C)


def test_rl_load_takes_the_voltage_and_gives_both_currents():
    R, L, i0 = 5.0, 0.02, [3.0, -4.0, 6.0]
    model = rlc_load(R, L, i=i0, nominal=100.0)
    x0 = L * np.array(i0)
    check_linear(model, np.zeros((3, 3)), np.eye(3), x0, 100.0, lambda x, u: u / R + x / L)


def test_single_element_loads_have_only_what_they_need():
    assert not rlc_load(L=1.0).algebraics and not rlc_load(C=1.0).dissipation and not rlc_load(R=1.0).states
    assert [p.name for p in rlc_load(C=1.0).parameters] == ["C"]
    start, A, B, size = np.array([1.0, 2.0, 3.0]), np.zeros((3, 3)), np.eye(3), 0.01
    for load in (rlc_load(C=size, v=start.tolist()), rlc_load(L=size, i=start.tolist())):
        check_linear(load, A, B, size * start, 20.0, lambda x, u: x / size)


@pytest.mark.parametrize("build, words", [
    (lambda: rlc_load(), "at least one"), (lambda: rlc_load(R=0.0), "R = 0.0 must be positive"),
    (lambda: rlc_load(C=-1.0), "C = -1.0"), (lambda: rl_line(1.0, 0.0), "L = 0.0"),
    (lambda: rl_line(-1.0, 1.0), "R = -1.0"), (lambda: fault_resistor(-1.0), "G = -1.0"),
])  # fmt: skip
def test_impossible_parameters_are_refused(build, words):
    with pytest.raises(ValueError, match=words):
        build()


@pytest.mark.parametrize("G", [0.0, 20.0, (0.0, 20.0, 1e5)])
def test_fault_resistor(G):
    """i = G v at every node; its heat is the integral of G v^2."""
    values = np.broadcast_to(np.asarray(G, float), 3)
    model = fault_resistor(nominal=100.0).with_starts({f"G[{j + 1}]": g for j, g in enumerate(values)})
    u, h, n = TwoTones(3, 100.0), 1e-4, 50
    instance, worst = steps(model, 2, h, n, u)
    assert worst < 1e-13
    assert instance.signals()["y_end"] == pytest.approx(values * u(h * n), rel=1e-12, abs=1e-12)
    t, w = np.polynomial.legendre.leggauss(40)
    heat = sum(wi * h * n / 2 * float(values @ u(h * n * (ti + 1) / 2) ** 2) for ti, wi in zip(t, w, strict=True))
    assert float(instance.signals()["dissipated"][0]) == pytest.approx(heat, rel=1e-6, abs=1e-12)


def test_infinite_bus_holds_its_voltage_and_passes_the_power_to_its_source():
    amplitude, frequency, phase = 100.0, 50.0, 0.3
    model = infinite_bus(amplitude, frequency, phase, i=30.0)
    u, h, n = TwoTones(3, 30.0), 1e-4, 60
    instance, worst = steps(model, 2, h, n, u)
    end, signals = h * n, instance.signals()

    def voltage(t):
        return amplitude * np.cos(2 * np.pi * frequency * t + phase - np.array([0, 2, -2]) * np.pi / 3)

    assert worst < 1e-13
    assert signals["y_end"][:3] == pytest.approx(voltage(end), rel=1e-12)
    t, w = np.polynomial.legendre.leggauss(40)
    at = end * (t + 1) / 2
    work = np.array([sum(w[j] * end / 2 * voltage(at[j])[x] * u(at[j])[x] for j in range(40)) for x in range(3)])
    assert signals["energy"][:3] == pytest.approx(work, rel=1e-6)
    assert signals["energy"][:3] == pytest.approx(-signals["energy"][3:], rel=1e-12)
    assert model.port("source").external is False and model.port("terminal").given == "flow"


def test_scalar_sources():
    u, h, n = TwoTones(1, 10.0), 1e-3, 20
    wave = 3.0 * ca.sin(40.0 * time) + 1.0
    for model, sign in ((voltage_source(wave), 1.0), (current_source(wave), -1.0)):
        instance, worst = steps(model, 1, h, n, u)
        signals = instance.signals()
        assert worst < 1e-13
        assert signals["y_end"][0] == pytest.approx(sign * (3.0 * np.sin(40.0 * h * n) + 1.0), rel=1e-12)
        assert signals["energy"][0] == pytest.approx(-signals["energy"][1], rel=1e-12)
        assert abs(signals["energy"][0]) > 0.01


def test_entries_of_a_machine_that_would_be_ignored_are_refused() -> None:
    """A misspelt entry of a mapping left its default in place without a word."""
    from dataclasses import asdict

    whole = asdict(machine_set("kundur555_1q"))
    assert machine_set(whole) == machine_set("kundur555_1q")
    for changed, said in (
        ({"pole_pair": 2}, "unknown entry 'pole_pair'; did you mean pole_pairs"),
        ({"H": 7.0}, "H = 7 s, but J gives 3.525 s"),
        ({"Laa0": 1e-3}, "Laa0 without Laa2, Lab0"),
        ({"Laa0": 2e-3, "Laa2": 0.0, "Lab0": 5e-4}, "Laa0, Laa2, Lab0 give 0.0025 H; leave one of them out"),
    ):
        with pytest.raises(ValueError, match=said):
            machine_set(whole | changed)
    with pytest.raises(ValueError, match="no machine set 'kundur555'; did you mean kundur555_1q?"):
        machine_set("kundur555")
    moved = machine_set("kundur555_1q", Laa0=3.5e-3, Laa2=0.0, Lab0=1.5e-3)  # instead of the set's own
    assert moved.Ld == pytest.approx(5e-3)
