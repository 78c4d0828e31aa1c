"""Operating points against power flows, phasor circuits and the motion itself, and what is told where there is none."""

from __future__ import annotations

import json
from dataclasses import replace
from importlib import import_module
from math import pi, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phfmu import Collocated, NativeInstance, Network, build_model
from phfmu.cli import main
from phfmu.components.control import pi_controller
from phfmu.components.electrical import (
    induction_machine,
    infinite_bus,
    rl_line,
    rlc_load,
    steady_state,
    synchronous_machine,
)
from phfmu.components.mechanical.torque_source import torque_source
from phfmu.components.scenes.electrical.smib import circuit, smib
from phfmu.derivatives.steady_steps import steady_steps
from phfmu.operating import PQ, PV, Load, NoOperatingPoint, Slack, operating_point
from phfmu.operating.rotation import MemberEquations
from phfmu.results.file import open_result

W = 120 * pi
wscc9: Any = import_module("phfmu.components.scenes.electrical.wscc9")  # the module, not the function of that name
FLOW = json.loads((Path(__file__).parent / "wscc9_power_flow.json").read_text())


# -- the rotation of a member -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("coordinates", ["dq-flux", "abc-flux"])
def test_the_rotation_of_a_machine_turns_what_stands_in_the_stator(coordinates):
    e = MemberEquations(synchronous_machine(coordinates=coordinates))
    assert e.asymmetry < 1e-12
    assert e.c == pytest.approx([0.0] * 7 + [1.0], abs=1e-12)  # theta
    stands = coordinates == "dq-flux"
    assert (np.abs(e.S).max() < 1e-12) == stands
    x = np.array([1.0, -0.5, -0.5, *[0.3] * 3, 2.0, 0.1])
    turned = e.turned(x, 2 * pi / 3)
    assert turned[:3] == pytest.approx(x[:3] if stands else [-0.5, 1.0, -0.5])
    assert turned[3:] == pytest.approx([*x[3:7], 0.1 + 2 * pi / 3])


@pytest.mark.parametrize("coordinates", ["dq-flux", "abc-flux"])
def test_turns_by_many_angles_at_once_are_exponentials(coordinates):
    """Beside exponentials of 40 digits."""
    from mpmath import expm, matrix, workdps

    e = MemberEquations(synchronous_machine(coordinates=coordinates))
    n = len(e.c)
    generator = np.block([[e.S, e.c[:, None]], [np.zeros((1, n + 1))]])
    for angles in ([0.0, 1e-9, 0.3, -2.0], [-377.0, 50.0], []):
        A, b = e.turns(angles)
        assert A.shape == (len(angles), n, n) and b.shape == (len(angles), n)
        for angle, a, moved in zip(angles, A, b, strict=True):
            with workdps(40):
                exact = np.array(expm(matrix(generator.tolist()) * angle).tolist(), float)
            assert np.abs(a - exact[:n, :n]).max() <= 1e-15 * max(1.0, abs(angle))
            assert np.abs(moved - exact[:n, n]).max() <= 1e-15 * max(1.0, abs(angle))


def test_unequal_phases_have_no_rotation():
    """A line whose resistance differs by phase, made by unequal values in one matrix."""
    import casadi as ca

    from phfmu import ELECTRICAL, PHDAE, Port, block, energy, state

    flux = state("flux", 3, unit="Wb")
    ports = tuple(Port(n, ELECTRICAL, "effort", {flux: s}, size=3) for n, s in (("a", 1.0), ("b", -1.0)))
    line = PHDAE("uneven", states=(flux,), energies=(energy(ca.sumsqr(flux.sx)),),
                 dissipation=(block([flux], ca.diag(ca.DM([1.0, 2.0, 1.0]))),), ports=ports)  # fmt: skip
    assert MemberEquations(line).asymmetry > 1e-3
    net = Network("n")
    net.add("bus", infinite_bus(100.0))
    net.add("line", line)
    net.add("far", infinite_bus(90.0))
    net.connect("bus.terminal", "line.a")
    net.connect("far.terminal", "line.b")
    with pytest.raises(NoOperatingPoint, match="line: not symmetric under rotation of the phases"):
        operating_point(net, [])


# -- known circuits ---------------------------------------------------------------------------------------------------


def test_smib_from_a_start_far_from_it_is_the_start_that_its_formulas_give():
    data, start, *_ = circuit("kundur555_1q")
    net = smib().system
    assert isinstance(net, Network)
    other = steady_state(data, 0.5 * data.Sn, 0.0)
    moved = dict(net.members) | {
        "gen": synchronous_machine(data, start=other),
        "line": net.members["line"].with_starts({"flux": 0.0}),
    }
    point = operating_point(replace(net, members=moved), [PV("gen.terminal", P=0.8 * data.Sn, V=data.Vn_rms_ll)])
    assert point.states["gen.theta"] == pytest.approx(start.theta, rel=1e-11)
    assert point.states["gen.psi[4]"] == pytest.approx(start.dq[3], rel=1e-11)
    assert (point.inputs["gen.field.v"], point.inputs["gen.shaft.torque"]) == pytest.approx(
        (start.Vf, start.tau), rel=1e-11
    )
    assert point.power("gen.terminal") == pytest.approx(-complex(0.8, 0.2) * data.Sn, rel=1e-10)
    assert point.residual < 1e-12
    started = point.started()
    assert started.members["gen"].port("field").start == pytest.approx((start.Vf,))


def test_nine_buses_from_flat_voltages_are_the_published_power_flow():
    point = wscc9._point("dq-flux")
    assert point.iterations <= 8 and point.residual < 1e-12
    for bus, (V, angle, *_) in FLOW.items():
        base = wscc9.PLANTS[bus][2] if bus in wscc9.PLANTS else wscc9.VOLTAGE
        assert point.magnitude(f"bus{bus}") / base == pytest.approx(V, abs=1e-10)
        assert np.degrees(point.angle(f"bus{bus}")) == pytest.approx(angle, abs=1e-9)
    for k in "123":
        P, Q = FLOW[k][2:]
        assert -point.power(f"gen{k}.terminal") == pytest.approx(complex(P, Q) * 1e6, rel=1e-10)
    assert point.power("shunt5.terminal").real == pytest.approx(125e6, rel=1e-12)


@pytest.mark.parametrize(("k", "h", "drift"), [(1, 5e-5, 1e-3), (2, 5e-5, 1e-8), (3, 1e-4, 1e-10)])
@pytest.mark.parametrize("coordinates", ["dq-flux", "abc-flux"])
def test_nine_buses_stay_in_their_steady_state(coordinates, k, h, drift):
    """States of 1 s later, turned back, relative to their amplitude."""
    scene, point = wscc9.wscc9_steady(coordinates=coordinates), wscc9._point(coordinates)
    model = scene.declaration()
    unit = NativeInstance(build_model(model, Collocated(k)))
    unit.run(0.0, h, round(1.0 / h), record=())
    now = dict(zip((n for v in model.states for n in v.names()), np.array(unit.x), strict=True))
    back = point.turned_back(now, 1.0)
    for v in model.states:
        size = max(np.abs(v.start).max(), 1e-3 * np.max(np.abs(v.nominal)))
        for name, start in zip(v.names(), v.start, strict=True):
            assert abs(back[name] - start) <= drift * size, name


def drift(point: Any, scheme: Any, h: float, stop: float) -> float:
    """Largest difference of a state at `stop`, turned back, relative to its amplitude."""
    model = point.started().compose()
    unit = NativeInstance(build_model(model, scheme))
    unit.run(0.0, h, round(stop / h), record=())
    now = dict(zip((n for v in model.states for n in v.names()), np.array(unit.x), strict=True))
    return max(point.drift(now, stop).values())


@pytest.mark.parametrize(("k", "h", "before"), [(1, 1e-4, 1e-4), (2, 1e-4, 1e-8), (3, 2e-4, 1e-10)])
def test_steps_stay_in_their_own_steady_state(k: int, h: float, before: float) -> None:
    """Rounding of angles, 377 rad in 1 s; from the operating point of the equations it is a power of the step."""
    point = wscc9._point("dq-flux")
    found = steady_steps(point, Collocated(k), h)
    assert drift(found, Collocated(k), h, 1.0) <= 3e-10
    assert drift(point, Collocated(k), h, 1.0) > before
    assert abs(found.omega / point.omega - 1.0) <= 0.1 * (W * h) ** (
        2 * k
    )  # a frequency of their own: torques are given


def test_a_source_sets_the_frequency_of_the_steps() -> None:
    """Ten cycles at a stiff grid, with 2 % of slip in a motor."""
    net = Network("motor")
    net.add("grid", infinite_bus(375.6, 60.0))
    net.add("motor", induction_machine(speed=185.0).with_starts({"shaft.torque": -198.0}))
    net.connect("grid.terminal", "motor.terminal", name="bus")
    point = operating_point(net, [])
    h = 1.0 / 6000.0
    found = steady_steps(point, Collocated(1), h)
    assert found.omega == point.omega
    assert drift(found, Collocated(1), h, 1.0 / 6.0) <= 1e-10 < 1e-5 < drift(point, Collocated(1), h, 1.0 / 6.0)


def test_a_run_says_that_it_begins_where_its_steps_stay(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    words = ["run", "wscc9_steady", "--stop", "0.01", "--audit", "none"]
    assert main([*words, "-o", str(tmp_path / "a.csv")]) == 0
    assert "begins in the steady state of steps of 5e-05 s, at 59.998" in capsys.readouterr().out
    assert main([*words, "--set", "gen1.J=3e5"]) == 0
    assert "steady state of steps" not in capsys.readouterr().out
    assert main([*words, "--scheme", "gradient-pair"]) == 0
    assert "begins in the operating point of the equations: wscc9: scheme gradient-pair" in capsys.readouterr().out
    speed = open_result(tmp_path / "a.csv").column("gen2.shaft.speed")
    assert np.ptp(speed) <= 1e-11 * speed[0]


def test_an_induction_motor_under_load_is_its_equivalent_circuit():
    """No specification: the slip follows from the torque."""
    net = Network("motor")
    net.add("grid", infinite_bus(375.6, 60.0))
    net.add("motor", induction_machine(speed=185.0).with_starts({"shaft.torque": -198.0}))
    net.connect("grid.terminal", "motor.terminal", name="bus")
    point = operating_point(net, [])
    s = 1 - 2 * point.states["motor.p"] / 1.662 / W
    Zr, Zm = 0.228 / s + 0.8e-3j * W, 34.7e-3j * W
    i = 375.6 / (0.087 + 0.8e-3j * W + Zr * Zm / (Zr + Zm))
    assert 3 * abs(i * Zm / (Zr + Zm)) ** 2 * 0.228 / (s * W) == pytest.approx(198.0, rel=1e-10)
    S = 1.5 * 375.6 * np.conj(i)
    assert -point.power("grid.terminal") == pytest.approx(S, rel=1e-10)


def test_a_load_on_a_line():
    """The voltage of two buses in closed form, from the quadratic of the power over a reactance."""
    P, Q, V1, X = 3e6, 1e6, 10e3, 10.0
    net = Network("two")
    net.add("grid", infinite_bus(V1 * sqrt(2 / 3), 60.0))
    net.add("line", rl_line(0.0, X / W, v=8e3, rated=300.0))
    net.add("load", rlc_load(V1**2 / P, V1**2 / Q / W, nominal=8e3))
    net.connect("grid.terminal", "line.a", name="bus1")
    net.junction("bus2", ["line.b", "load.terminal"])
    u = V1**2 / 2 - Q * X
    V2 = sqrt(u + sqrt(u * u - X * X * (P * P + Q * Q)))
    point = operating_point(net, [Load("load.terminal", P=P, Q=Q)])
    assert point.magnitude("bus2") == pytest.approx(V2, rel=1e-11)
    assert point.power("load.terminal") == pytest.approx(complex(P, Q), rel=1e-11)
    assert (point.parameters["load.R"], point.parameters["load.L"]) == pytest.approx(
        (V2**2 / P, V2**2 / Q / W), rel=1e-11
    )


def test_a_generator_with_active_and_reactive_power():
    data, start, *_ = circuit("kundur555_1q")
    net = smib().system
    assert isinstance(net, Network)
    point = operating_point(net, [PQ("gen.terminal", P=0.8 * data.Sn, Q=0.2 * data.Sn)])
    assert point.magnitude("bus1") == pytest.approx(data.Vn_rms_ll, rel=1e-11)
    assert (point.inputs["gen.field.v"], point.inputs["gen.shaft.torque"]) == pytest.approx(
        (start.Vf, start.tau), rel=1e-10
    )


def test_controllers_come_along_and_a_set_point_is_found():
    """The torque comes from a PI controller of the speed: its set point is found as the speed, its state as the torque."""
    data, start, *_ = circuit("kundur555_1q")
    old = smib().system
    assert isinstance(old, Network)
    net = replace(old, members=dict(old.members), junctions=list(old.junctions), wires=[])
    net.add("governor", pi_controller(1e5, 2e5, reference=300.0, unit="rad/s", command="N.m"))
    net.add("turbine", torque_source(nominal=1e6))
    net.connect("gen.shaft", "turbine.shaft", name="shaft")
    net.signal("gen.shaft.speed", "governor.measured")
    net.signal("governor.command", "turbine.torque")
    wanted = PV("gen.terminal", P=0.8 * data.Sn, V=data.Vn_rms_ll, free=("gen.field.v", "governor.reference"))
    point = operating_point(net, [wanted])
    assert point.parameters["governor.reference"] == pytest.approx(data.omega, rel=1e-12)
    assert point.states["governor.x"] == pytest.approx(start.tau / 2e5, rel=1e-11)
    assert point.parameters["turbine.torque"] == pytest.approx(start.tau, rel=1e-11)
    assert point.inputs["gen.field.v"] == pytest.approx(start.Vf, rel=1e-11)


# -- what is told -----------------------------------------------------------------------------------------------------


def two(**line):
    net = Network("two")
    net.add("grid", infinite_bus(8e3, 60.0))
    net.add("line", rl_line(0.1, 0.01, v=8e3))
    net.add("load", rlc_load(50.0, 0.5, nominal=8e3))
    net.connect("grid.terminal", "line.a", name="bus1")
    net.junction("bus2", ["line.b", "load.terminal"])
    return net


@pytest.mark.parametrize(
    ("specifications", "frequency", "error", "words"),
    [
        ([Load("load.terminl", P=1e6)], 60.0, KeyError, "did you mean load.terminal"),
        ([PQ("load.terminal", P=-1e6, Q=0.0)], 60.0, NoOperatingPoint, "say which values are found"),
        (
            [PQ("load.terminal", P=-1e6, Q=0.0, free=("load.R",))],
            60.0,
            NoOperatingPoint,
            "each equation frees one value",
        ),
        (
            [PQ("load.terminal", P=-1e6, Q=0.0, free=("load.R", "load.X"))],
            60.0,
            KeyError,
            "load has no input or parameter 'X'",
        ),
        (
            [PQ("load.terminal", P=-1e6, Q=0.0, free=("load.R", "load.R"))],
            60.0,
            NoOperatingPoint,
            "load.R is freed twice",
        ),
        ([], 50.0, NoOperatingPoint, "grid: its source source does not turn with 50 Hz"),
        ([Load("load.terminal", P=90e6, Q=1e6)], 60.0, NoOperatingPoint, "two: "),
    ],
)
def test_what_cannot_be_is_told_by_name(specifications, frequency, error, words):
    with pytest.raises(error) as failed:
        operating_point(two(), specifications, frequency)
    assert words in str(failed.value)


def test_a_negative_load_is_refused_with_the_other_specification():
    with pytest.raises(ValueError, match="must not be negative; use PQ"):
        Load("load.terminal", P=-1.0)


def test_without_a_slack_the_angle_is_not_determined():
    net, specifications = wscc9._flat("dq-flux")
    first = PV("gen1.terminal", P=71.641e6, V=17160.0)
    with pytest.raises(NoOperatingPoint):
        operating_point(net, [first, *specifications[1:]])


def test_slack_with_an_angle_turns_the_whole_network():
    net, (slack, *others) = wscc9._flat("dq-flux")
    assert isinstance(slack, Slack)
    point, turned = (operating_point(net, [replace(slack, angle=a), *others]) for a in (0.0, 0.3))
    assert turned.states["gen2.theta"] - point.states["gen2.theta"] == pytest.approx(0.3, abs=1e-11)
    assert turned.inputs["gen2.field.v"] == pytest.approx(point.inputs["gen2.field.v"], rel=1e-12)
