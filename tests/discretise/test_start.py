"""Consistent starts by projection, and the energy that changed parameters bring."""

from __future__ import annotations

import numpy as np
import pytest

from phfmu import (
    DeclarationError,
    Event,
    Monolithic,
    Network,
    Options,
    PythonInstance,
    build_model,
    project_start,
    run,
)
from phfmu.components.electrical.machines.machine_data import machine_set
from phfmu.components.mechanical.four_particle import four_particle
from phfmu.components.mechanical.translational import mass
from phfmu.components.scenes.electrical.smib import smib
from phfmu.components.scenes.electrical.two_machine import two_machine
from phfmu.components.scenes.mechanical.oscillator import oscillator


def joined(v1: float, v2: float, m1: float = 1.0, m2: float = 2.0):
    net = Network("rigid")
    net.add("m1", mass(m1, k=10.0, v=v1))
    net.add("m2", mass(m2, v=v2))
    net.junction("link", ["m1.flange", "m2.flange"])
    return build_model(net.compose())


def test_rigid_joint_loses_the_energy_of_an_inelastic_impact() -> None:
    """Momentum is kept and 1/2 m1 m2/(m1 + m2) dv^2 is lost: 1/3 J for 1 kg at 1 m/s on 2 kg at rest."""
    found = project_start(joined(1.0, 0.0))
    assert found.energy == pytest.approx(-1.0 / 3.0, abs=1e-14)
    assert dict((n, b) for n, _, b in found.moved) == pytest.approx({"m1.v": 1 / 3, "m2.v": 1 / 3})


def test_positions_then_velocities() -> None:
    model = build_model(four_particle().with_starts({"q[4]": 1.1, "v[4]": 1.0}))
    found = project_start(model)
    q, v = found.x[:12].reshape(4, 3), found.x[12:].reshape(4, 3)
    bar = q[1] - q[0]
    assert bar @ bar == pytest.approx(1.0, abs=1e-14) and abs(bar @ (v[1] - v[0])) <= 1e-14
    assert np.array([1.0, 3.0]) @ v[:2, 0] == pytest.approx(3.0)  # momentum of the bar
    assert found.energy < 0.0 and "q[4]: 1.1 -> 1.05" in found.report()


def test_kept_states_stay() -> None:
    model = build_model(four_particle().with_starts({"q[4]": 1.1}))
    found = project_start(model, keep=["q[4]"])
    assert found.x[3] == 1.1 and found.x[0] == pytest.approx(0.1)
    with pytest.raises(DeclarationError, match=r"lambda\[1\] \(position\) residual 0.105 .*Keep fewer of q\[1\]"):
        project_start(model, keep=["q"])
    with pytest.raises(DeclarationError, match="no state q\\[99\\]"):
        project_start(model, keep=["q[99]"])


def test_command_line_projects_and_reports(capsys) -> None:
    """The joined masses of the first test, as a target of the command line."""
    from phfmu.cli import main

    common = ["run", "four_particle", "--set", "q[4]=1.1", "--set", "v[4]=1", "--stop", "0.02", "--engine", "python"]
    assert main(common) == 2
    assert "--project" in capsys.readouterr().err
    assert main([*common, "--keep", "q[4]"]) == 2
    assert main([*common, "--project", "--keep", "q[4]", "--keep", "v"]) == 2
    assert "no consistent start" in capsys.readouterr().err
    assert main([*common, "--project", "--keep", "q[4]"]) == 0
    text = capsys.readouterr().out
    for line in ("start projected: 4 hidden constraints, 2 off", "lambda[1] (position): 0.105 -> ", "q[1]: 0 -> 0.1",
                 "lambda[1] (velocity): "):  # fmt: skip
        assert line in text
    assert "q[4]:" not in text


def test_currents_of_a_bare_node_sum_to_zero() -> None:
    scene = smib()
    model = build_model(scene.declaration())
    x = model.x0.copy()
    x[8] *= 1.01  # line flux of phase a
    found = project_start(model, x)
    assert max(abs(v) for v in found.before.values()) > 100.0
    assert max(abs(v) for v in found.after.values()) <= 1e-8 and found.energy < 0.0


def test_run_projects_on_request_and_books_the_jump() -> None:
    model = joined(1.0, 0.0)
    with pytest.raises(ValueError, match="inconsistent start.*--project"):
        run(Monolithic(model, PythonInstance(model)), Options(stop=0.1, step=0.01))
    result = run(Monolithic(model, PythonInstance(model)), Options(stop=0.1, step=0.01, project=True))
    assert np.max(np.abs(result.column("m1.v") - result.column("m2.v"))) <= 1e-14
    assert result.column("m1.energy.stored")[0] == pytest.approx(1 / 18)


def test_changed_parameter_books_the_energy_it_brings() -> None:
    """k1 from 4 pi^2 to 60 N/m at 0.5 s changes H of mass1 by (60 - 4 pi^2) q1^2 / 2."""
    model = build_model(oscillator().declaration())
    result = run(
        Monolithic(model, PythonInstance(model)), Options(stop=1.0, step=0.01, events=[Event(0.5, "mass1.k", 60.0)])
    )
    q = result.column("mass1.q")[int(np.argmin(np.abs(result.time - 0.5)))]
    component = {c.component: c for c in result.ledger.summary().components}["mass1"]
    assert component.jumps == pytest.approx(0.5 * (60.0 - 4 * np.pi**2) * q**2, rel=1e-12)
    assert abs(component.gap) <= 1e-13


# -- an electrical inconsistency moves fluxes and nothing else ---------------------------------------------------


@pytest.mark.parametrize("coordinates", ["dq-flux", "abc-flux", "current"])
def test_a_voltage_impulse_moves_fluxes_and_no_rotor(coordinates) -> None:
    """Both branches of the bus get the voltage impulse s = -(B^T M^-1 B)^-1 sum of currents; the angle stays to the bit."""
    data, alpha = machine_set("kundur555_1q"), 2 * np.pi / 3 * np.arange(3)
    model = build_model(smib(coordinates=coordinates).declaration())
    at = {n: i for i, n in enumerate(n for v in model.declaration.states for n in v.names())}
    x = model.x0.copy()
    line = [at[f"line.flux[{j}]"] for j in (1, 2, 3)]
    x[line] *= np.array([1.3, 0.9, 1.1])
    found = project_start(model, x)
    theta = x[at["gen.theta"]]
    T = np.eye(data.n)
    T[:3, :3] = np.sqrt(2 / 3) * np.array([np.cos(theta - alpha), -np.sin(theta - alpha), np.full(3, 0.5**0.5)])
    L, L_line = T.T @ data.constant_inductance() @ T, 0.3 * data.Vn_rms_ll**2 / data.Sn / data.omega
    own = "I" if coordinates == "current" else "psi"
    gen = [at[f"gen.{own}[{j + 1}]"] for j in range(data.n)]

    def flux(state):  # of the phases and rotor windings
        raw = state[gen]
        return L @ raw if own == "I" else T.T @ raw if coordinates == "dq-flux" else raw

    M = np.block([[L, np.zeros((data.n, 3))], [np.zeros((3, data.n)), L_line * np.eye(3)]])
    B = np.vstack([np.eye(data.n)[:, :3], np.eye(3)])
    before = np.concatenate([flux(x), x[line]])
    s = -np.linalg.solve(B.T @ np.linalg.solve(M, B), B.T @ np.linalg.solve(M, before))
    after = np.concatenate([flux(found.x), found.x[line]])
    assert after - before == pytest.approx(B @ s, rel=1e-9, abs=1e-12 * np.abs(before).max())
    assert found.energy == pytest.approx(s @ B.T @ np.linalg.solve(M, before) / 2, rel=1e-9)
    still = [at["gen.theta"], at["gen.p"], *(gen[3:] if own == "psi" else ())]
    assert (found.x[still] == x[still]).all()
    moving = {n for n, i in at.items() if found.x[i] != x[i]}
    assert {n for n, *_ in found.moved} == moving and not moving & {"gen.theta", "gen.p"}


def two_pairs(still: float):
    """Two rigid pairs that share nothing; the second holds to rounding."""
    net = Network("pairs")
    for n, v in (("a1", 1.0), ("a2", 0.0), ("b1", still), ("b2", still * (1 + 2e-14))):
        net.add(n, mass(1.0, k=10.0, v=v))
    net.junction("a", ["a1.flange", "a2.flange"])
    net.junction("b", ["b1.flange", "b2.flange"])
    return build_model(net.compose())


def test_what_a_violated_row_does_not_touch_keeps_its_bits() -> None:
    model = two_pairs(1 / 3)
    found = project_start(model)
    names = [n for v in model.declaration.states for n in v.names()]
    assert {n for n, *_ in found.moved} == {"a1.v", "a2.v"}
    still = [i for i, n in enumerate(names) if n not in ("a1.v", "a2.v")]
    assert (found.x[still] == model.x0[still]).all()


def test_small_states_that_move_are_reported() -> None:
    """1 nm/s becomes 1/3 nm/s: both velocities are listed with digits that tell them apart."""
    net = Network("small")
    net.add("m1", mass(1.0, v=1e-16))
    net.add("m2", mass(2.0))
    net.junction("link", ["m1.flange", "m2.flange"])
    model = build_model(net.compose())
    model.check_scale[:] = 1e-16
    found = project_start(model)
    assert [n for n, *_ in found.moved] == ["m1.v", "m2.v"] and "m1.v: 1e-16 -> 3.33333333e-17" in found.report()


def test_a_velocity_without_mass_gives_way_for_nothing() -> None:
    """Masses of 1 and 2 kg held together by a massless piece: their momentum is kept, the piece takes their speed."""
    net = Network("light")
    for n, m, v in (("m1", 1.0, 1.0), ("piece", 0.0, 5.0), ("m2", 2.0, 0.0)):
        net.add(n, mass(m, v=v))
    net.junction("link", ["m1.flange", "piece.flange", "m2.flange"])
    found = project_start(build_model(net.compose()))
    assert dict((n, b) for n, _, b in found.moved) == pytest.approx({"m1.v": 1 / 3, "piece.v": 1 / 3, "m2.v": 1 / 3})
    assert found.energy == pytest.approx(-1 / 3)


def test_a_projection_after_an_event_turns_no_rotor_and_is_told() -> None:
    """A tenfold line inductance breaks the sum of currents at bus1; the fluxes jump, angle and momentum keep their bits."""
    scene = smib()
    model = build_model(scene.declaration())
    stepper = Monolithic(model, PythonInstance(model))
    result = run(stepper, Options(stop=0.003, step=1e-3, events=[Event(0.002, "line.L", 8e-3)]))
    assert len(result.notes) == 1 and "at t = 0.002 s" in result.notes[0] and "line.flux[1]: " in result.notes[0]
    assert "gen.theta" not in result.notes[0] and "gen.p:" not in result.notes[0]


@pytest.mark.parametrize("build", [smib, two_machine])
def test_what_an_impulse_loses_is_formed_from_it(build) -> None:
    """1/2 c S^-1 c beside rotors that store 1e10 times as much, so that no difference of H shows it; no angle moves."""
    model = build_model(build().declaration())
    names = [n for v in model.declaration.states for n in v.names()]
    p = model.p0.copy()
    parameters = [n for v in model.declaration.parameters for n in v.names()]
    p[parameters.index("line.L")] *= 1 + 1e-3
    found = project_start(model, p=p)
    c = np.array([v for n, v in found.before.items() if n.startswith("bus1")])
    data, line_L = machine_set("kundur555_1q"), p[parameters.index("line.L")]
    owner = "gen" if build is smib else "m1"
    theta, alpha = model.x0[names.index(f"{owner}.theta")], 2 * np.pi / 3 * np.arange(3)
    T = np.sqrt(2 / 3) * np.array([np.cos(theta - alpha), -np.sin(theta - alpha), np.full(3, 0.5**0.5)])
    S = T.T @ np.linalg.inv(data.constant_inductance())[:3, :3] @ T + np.eye(3) / line_L
    lost = c @ np.linalg.solve(S, c) / 2
    assert 1e-3 < lost < 1.0
    assert found.lost == pytest.approx(lost, rel=1e-9)  # H - H is off by 1e-5 of it
    assert found.energy == -found.lost and sum(found.changes) == pytest.approx(found.energy, rel=1e-12)
    moved = {n for n, _, _ in found.moved}
    assert moved and not any("theta" in n or n.endswith(".p") for n in moved)
    assert max(abs(v) for v in found.after.values()) <= 1e-10


def test_the_loss_of_a_changed_inductance_is_booked_with_it() -> None:
    """The event rows of the impulse add up to nothing with what was lost, which belongs to the line."""
    model = build_model(smib().declaration())
    sink = EventRows()
    run(
        Monolithic(model, PythonInstance(model)),
        Options(stop=0.003, step=1e-3, sink=sink, events=[Event(0.002, "line.L", 8e-3)]),
    )
    rows = [e for e in sink.events if e.kind == "reprojection"]
    lost = sum(e.lost or 0.0 for e in rows)
    assert lost > 0 and [e.component for e in rows if e.lost] == ["line"]
    assert sum(e.energy_jump for e in rows) == pytest.approx(-lost, rel=1e-12)


class EventRows:
    """A sink that keeps the event rows."""

    def __init__(self) -> None:
        self.events = []

    def write_event(self, row) -> None:
        self.events.append(row)

    def __getattr__(self, name: str):
        return lambda *args, **kwargs: None
