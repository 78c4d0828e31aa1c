"""The synchronous machine: data and starts, and its motion against an independent solution in flux coordinates."""

from __future__ import annotations

import numpy as np
import pytest
import reference_tools
from machine_reference import MachineReference
from scipy.integrate import solve_ivp

from phfmu import Collocated
from phfmu.components.electrical import (
    MachineDataError,
    machine_names,
    machine_set,
    operating_point,
    steady_state,
    synchronous_machine,
)
from phfmu.discretise.model import build_model
from tests.components.orders import orders, steps
from tests.wide import wide

SCENES = reference_tools.load("scenes")
COORDINATES = ("dq-flux", "abc-flux", "current")


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
    from phfmu.engine.native.native import NativeInstance

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
