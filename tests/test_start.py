"""Consistent starts by projection, and the energy that changed parameters bring."""

from __future__ import annotations

import numpy as np
import pytest

from phfmu import (
    DeclarationError,
    Event,
    Monolithic,
    Network,
    PythonInstance,
    build_model,
    project_start,
    run,
)
from phfmu.components.mechanical.four_particle import four_particle
from phfmu.components.mechanical.translational import mass
from phfmu.components.scenes.oscillator import oscillator
from phfmu.components.scenes.smib import smib


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
        run(Monolithic(model, PythonInstance(model)), stop=0.1, step=0.01)
    result = run(Monolithic(model, PythonInstance(model)), stop=0.1, step=0.01, project=True)
    assert np.max(np.abs(result.column("m1.v") - result.column("m2.v"))) <= 1e-14
    assert result.column("m1.energy.stored")[0] == pytest.approx(1 / 18)


def test_changed_parameter_books_the_energy_it_brings() -> None:
    """k1 from 4 pi^2 to 60 N/m at 0.5 s changes H of mass1 by (60 - 4 pi^2) q1^2 / 2."""
    model = build_model(oscillator().declaration())
    result = run(Monolithic(model, PythonInstance(model)), stop=1.0, step=0.01, events=[Event(0.5, "mass1.k", 60.0)])
    q = result.column("mass1.q")[int(np.argmin(np.abs(result.time - 0.5)))]
    component = {c.component: c for c in result.ledger.summary().components}["mass1"]
    assert component.jumps == pytest.approx(0.5 * (60.0 - 4 * np.pi**2) * q**2, rel=1e-12)
    assert abs(component.gap) <= 1e-13
