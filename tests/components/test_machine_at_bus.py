"""The machine with its line folded in: full order in all states, exact phase fluxes, the same physics as with the line."""

from __future__ import annotations

import numpy as np
import pytest
from reference_tools import read

from phfmu import Collocated, NativeInstance, Options, build_model, check, run
from phfmu.components.electrical import machine_at_bus, machine_names, machine_set, steady_state, synchronous_machine
from phfmu.components.scenes.electrical.smib import smib_folded
from phfmu.network.couplings.monolithic import Monolithic
from tests.wide import wide

LINE = {"R": 0.03, "L": 4e-4}


def errors(coordinates: str, k: int, h: float, until: float) -> dict[str, float]:
    """Errors against the reference (DOP853 in abc flux, checked in the rotor frame) on the rows that h meets."""
    scene, ref = smib_folded(coordinates=coordinates), read("smib")  # type: ignore[arg-type]
    model = build_model(scene.declaration(), Collocated(k))
    r = run(Monolithic(model, NativeInstance(model)), Options(stop=until, step=h, events=scene.events))
    assert max(c.worst_relative for c in r.ledger.summary().components) <= 1e-14
    assert not [n for n in r.names if n.startswith("constraint.")]  # no bare node, nothing hidden
    t = ref["time"]
    on = (t <= until + 1e-9) & (np.abs(t / h - np.round(t / h)) < 1e-6)
    rows = [int(np.argmin(np.abs(r.time - s))) for s in t[on]]
    out = {}
    for name, columns in (("stator", (1, 2, 3)), ("field", (4,)), ("dampers", (5, 6))):
        gap = [np.max(np.abs(r.column(f"gen.I[{j}]")[rows] - ref[f"I[{j}]"][on])) for j in columns]
        out[name] = float(max(gap) / max(np.max(np.abs(ref[f"I[{j}]"])) for j in columns))
    out["theta"] = float(np.max(np.abs(r.column("gen.theta")[rows] - ref["theta"][on])))
    return out


CASES = {
    ("dq-flux", 1): ((1e-3, 5e-4, 2.5e-4), 1.0, 2e-6),
    ("dq-flux", 2): ((2.5e-3, 1.25e-3, 6.25e-4), 1.0, 3e-8),
    ("dq-flux", 3): ((5e-3, 3.125e-3, 2.5e-3), 1.0, 1e-8),
    ("abc-flux", 1): ((2e-4, 1e-4, 5e-5), 0.1, 1e-3),
    ("abc-flux", 2): ((1e-3, 5e-4, 2.5e-4), 0.2, 2e-5),
    ("abc-flux", 3): ((2.5e-3, 1.25e-3, 6.25e-4), 0.2, 1e-5),
}


@pytest.mark.parametrize(("coordinates", "k"), wide(CASES, ("dq-flux", 1)))
def test_folded_line_gives_order_2k_in_all_currents_and_the_angle(coordinates, k):
    steps, until, first = CASES[coordinates, k]
    found = [errors(coordinates, k, h, until) for h in steps]
    assert found[0]["stator"] <= first
    for name in found[0]:
        e = np.array([f[name] for f in found])
        if name == "theta" and coordinates == "dq-flux" and k == 3:
            assert e[-1] <= 1e-12  # already at the accuracy of the reference
            continue
        seen = np.polyfit(np.log(steps), np.log(e), 1)[0]
        assert seen == pytest.approx(2 * k, abs=0.1 if k == 1 else 0.2 if k == 2 else 0.3), (name, e)


def test_ten_millisecond_steps_of_balanced_quantities_are_accurate():
    """Balanced 60 Hz currents are constant in dq coordinates: more than half a period in one step."""
    assert errors("dq-flux", 2, 1e-2, 1.0)["stator"] <= 3e-6
    assert errors("dq-flux", 3, 1e-2, 1.0)["stator"] <= 5e-7


@pytest.mark.parametrize("k", wide([1, 2, 3], 1))
@pytest.mark.parametrize("name", machine_names())
def test_phase_fluxes_stay_to_the_last_bit_without_resistance_and_voltage(name, k):
    """psi' = 0 in abc flux coordinates, while the rotor turns through the field and torque flows; 1e4 steps."""
    data = machine_set(name, Ra=0.0, R_rotor=[0.0] * 3)
    model = build_model(machine_at_bus(data, 0.0, LINE["L"], coordinates="abc-flux"), Collocated(k))
    instance = NativeInstance(model)
    x = model.x0.copy()
    x[-2] *= 0.6  # out of step: psi does not turn, the rotor does
    instance.set_x(0.0, x)
    instance.set_input(np.zeros(5))
    instance.initialise()
    H = instance.signals()["H"].sum()
    rows = instance.run(0.0, 1e-4, 10_000, ("x", "stored"))
    assert (rows["x"][:, :6] == x[:6]).all()
    assert np.ptp(rows["x"][:, -2]) > 1e-3 * abs(x[-2])
    assert abs(instance.signals()["H"].sum() - H) <= 1e-12 * H


@pytest.mark.parametrize("coordinates", wide(["dq-flux", "abc-flux", "current"], "dq-flux"))
def test_a_line_is_a_larger_leakage_and_resistance_of_the_stator(coordinates):
    """Driven by unbalanced voltages with zero sequence: the folded machine = the machine with these data."""
    data = machine_set("kundur555_1q", d=50.0)
    start = steady_state(data)
    folded = machine_at_bus(data, **LINE, coordinates=coordinates, start=start)
    longer = {n: getattr(data, n) + LINE["L"] for n in ("Ld", "Lq", "L0")}
    other = synchronous_machine(machine_set(data, Ra=data.Ra + LINE["R"], **longer), coordinates=coordinates)
    one, two = (NativeInstance(build_model(m)) for m in (folded, other))
    two.set_x(0.0, one.x)
    two.initialise()
    t = 1e-4 * np.arange(200)[:, None]
    u = 2e4 * np.cos(377 * t + np.array([0.2, 2.5, 1.0])) * [1.0, 0.6, 1.1] + 500.0
    u = np.column_stack([u, np.full(200, start.Vf), start.tau * (1 + np.sin(200 * t))])
    ends = [i.run(0.0, 1e-4, 200, ("x", "y_step"), inputs=u) for i in (one, two)]
    for block in ("x", "y_step"):
        size = np.max(np.abs(ends[1][block]), axis=0)
        assert np.max(np.abs(ends[0][block] - ends[1][block]) / size) <= 1e-11


def test_the_start_is_steady_at_the_far_end():
    data = machine_set("kundur555_1q", d=50.0)
    start = steady_state(data)
    model = machine_at_bus(data, **LINE)
    assert check(model) == []
    i = -(complex(0.8, 0.2) * data.Sn / (1.5 * data.Vn_rms_ll * (2 / 3) ** 0.5)).conjugate()
    far = data.Vn_rms_ll * (2 / 3) ** 0.5 + (LINE["R"] + 1j * data.omega * LINE["L"]) * i
    expected = [(far * np.exp(-1j * a)).real for a in (0.0, 2 * np.pi / 3, -2 * np.pi / 3)]
    assert model.port("terminal").start == pytest.approx(expected, rel=1e-12)
    plan = build_model(machine_at_bus(data, **LINE, start=start), Collocated(2))
    instance, h = NativeInstance(plan), 1e-3
    for s in range(200):
        t = h * (s + plan.nodes)[:, None]
        v = (far * np.exp(1j * (data.omega * t - np.array([0.0, 2 * np.pi / 3, -2 * np.pi / 3])))).real
        instance.set_node_inputs(np.column_stack([v, np.full((2, 1), start.Vf), np.full((2, 1), start.tau)]))
        instance.do_step(s * h, h)
    assert instance.x[-2] == pytest.approx(start.p, rel=1e-10)
    assert instance.x[:2] == pytest.approx(plan.x0[:2], rel=1e-8)


def test_negative_lines_are_refused():
    with pytest.raises(ValueError, match="R = -1.0 ohm and L = 0.001 H"):
        machine_at_bus(R=-1.0, L=1e-3)
