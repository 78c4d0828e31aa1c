"""Feedthrough of components: resistors, networks of them, and what the check says of it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from phfmu import (
    ELECTRICAL,
    PHDAE,
    Collocated,
    Network,
    Options,
    Port,
    PythonInstance,
    Scene,
    block,
    build_model,
    check,
    damping,
    energy,
    run,
    state,
)
from phfmu.components.electrical import resistor, rl_line, rlc_load, transformer
from phfmu.network.couplings.coupled import Coupled
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.network.members.engine_member import EngineMember
from tests.engines import ENGINES
from tests.wide import wide


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(("given", "out"), [("effort", 3.0), ("flow", 12.0)])
def test_resistor(engine, given, out):
    d = resistor(2.0, size=3, given=given).with_starts({f"terminal.{'v' if given == 'effort' else 'i'}": 6.0})
    assert check(d) == []
    instance = engine(build_model(d))
    assert instance.signal("y_end") == pytest.approx([out] * 3)
    instance.do_step(0.0, 0.5)
    assert instance.output() == pytest.approx([out] * 3)
    row = instance.ledger()
    assert row["dissipated"] == pytest.approx([0.5 * 3 * 6.0 * out]) and row["supplied"] == pytest.approx(
        row["dissipated"]
    )
    assert instance.sensitivity() == pytest.approx(np.eye(3) * out / 6.0)


def test_resistors_that_would_generate_are_refused():
    with pytest.raises(ValueError, match="R = -1"):
        resistor(-1.0)


def ladder(kind: str) -> Network:
    """An R-L-C load whose resistor is a member of its own, behind an ideal transformer or beside it."""
    net = Network(f"ladder_{kind}")
    net.add("tank", rlc_load(L=0.5, C=0.2, v=(1.0, 0.0, -0.5)))
    if kind == "direct":
        net.add("load", resistor(2.0, size=3))
        net.connect("tank.terminal", "load.terminal", name="bus")
    else:
        net.add("load", resistor(2.0 * 9.0, size=3))
        net.add("turns", transformer(3.0, size=3))
        net.connect("tank.terminal", "turns.a", name="low")
        net.connect("turns.b", "load.terminal", name="high")
    return net


def tank_truth(t):
    """charge and flux of one phase with the start (C v, 0), from the matrix exponential."""
    rate = np.array([[-1 / 2.0 / 0.2, -1 / 0.5], [1 / 0.2, 0.0]])
    return expm(rate * t) @ np.array([0.2, 0.0])


@pytest.mark.parametrize("kind", wide(["direct", "transformer"], "transformer"))
@pytest.mark.parametrize("coupling", ["monolithic", "newton"])
def test_networks_of_feedthrough(kind, coupling):
    """A ratio of 3 makes 18 ohm look like 2 ohm; the composed and the coupled network lose what the resistor takes."""
    net = ladder(kind)
    if coupling == "monolithic":
        model = build_model(net.compose(), Collocated(3))
        stepper = Monolithic(model, PythonInstance(model))
        h, tolerance = 0.02, 1e-9
    else:
        models = {n: build_model(d, Collocated(1)) for n, d in net.members.items()}
        stepper = Coupled(net, [EngineMember(n, m, PythonInstance(m)) for n, m in models.items()])
        h, tolerance = 0.005, 5e-5
    result = run(stepper, Options(stop=0.4, step=h))
    assert result.column("tank.charge[1]")[-1] == pytest.approx(tank_truth(0.4)[0], abs=tolerance)
    assert result.column("tank.flux[1]")[-1] == pytest.approx(tank_truth(0.4)[1], abs=tolerance)
    summary = result.ledger.summary()
    assert max(c.worst_relative for c in summary.components) <= 1e-13
    lost = next(c for c in summary.components if c.component == "load")
    assert lost.dissipated > 0.02


def test_a_line_between_resistors():
    """Bound ports with feedthrough at both ends of an inductor: index 1 although its node has no capacitor."""
    net = Network("line")
    net.add("line", rl_line(0.1, 0.5, i=(1.0, 0.0, 0.0)))
    for side in "ab":
        net.add(f"end_{side}", resistor(2.0, size=3, given="effort"))
        net.junction(f"bus_{side}", [f"line.{side}", f"end_{side}.terminal"], kind="0")
    model = build_model(net.compose(), Collocated(2))
    assert not model.checks
    instance = PythonInstance(model)
    for k in range(20):
        instance.do_step(0.01 * k, 0.01)
    assert instance.x[0] == pytest.approx(0.5 * np.exp(-4.1 / 0.5 * 0.2), rel=1e-6)


# -- check --------------------------------------------------------------------------------------------------------


def problems(**fields):
    x = state("x", start=1.0)
    port = Port("port", ELECTRICAL, "effort", {x: 1.0})
    made = {k: v(x, port) for k, v in fields.items()}
    return check(PHDAE("odd", states=(x,), energies=(energy(x**2 / 2),), ports=(port,), **made))


def test_check_accepts_the_passive_form():
    w = np.array([[1.0, 0.5], [0.5, 0.3]])
    assert problems(dissipation=lambda x, p: (block([x, p], w),)) == []


def test_check_names_what_breaks_passivity():
    """[R, P; P^T, S] = [1, 0.6; 0.6, 0.3] has determinant -0.06 although R and S are positive."""
    (found,) = problems(dissipation=lambda x, p: (block([x, p], np.array([[1.0, 0.6], [0.6, 0.3]])),))
    assert found.rule == "passivity" and "x, port.v" in found.reason and "R block on x, port" in found.entry
    assert "eigenvalue -0.04" in found.reason
    (found,) = problems(dissipation=lambda x, p: (damping(x, 1.0), damping(p, -0.1)))
    assert found.rule == "passivity" and "port" in found.entry


def test_check_names_feedthrough_that_is_not_skew():
    (found,) = problems(structure=lambda x, p: (block([p], np.array([[0.5]])),))
    assert found.rule == "skew" and "port.v" in found.reason


def test_check_names_ports_of_other_models():
    stranger = Port("stranger", ELECTRICAL, "effort", {})
    found = problems(dissipation=lambda x, p: (damping(stranger, 1.0),))
    assert any("stranger" in str(p) for p in found)


def test_scene_of_feedthrough_runs_with_changed_parameters():
    d = resistor(2.0).with_starts({"R": 4.0, "terminal.v": 8.0})
    scene = Scene("lone", d, stop=1.0, step=0.1)
    model = build_model(scene.declaration())
    result = run(Monolithic(model, PythonInstance(model)), Options(stop=1.0, step=0.1))
    assert result.column("terminal.energy")[-1] == pytest.approx(16.0)
