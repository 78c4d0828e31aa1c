"""What has no mode is refused by name: friction that sticks, sliding, contacts that share what no row tells."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import casadi as ca
import numpy as np
import pytest

from phfmu import (
    ELECTRICAL,
    PHDAE,
    TRANSLATIONAL,
    Block,
    Collocated,
    Guard,
    Monolithic,
    NativeInstance,
    Network,
    Options,
    Port,
    PythonInstance,
    Refusal,
    StateEvent,
    Switch,
    SwitchedInstance,
    algebraic,
    block,
    build_model,
    check,
    damping,
    energy,
    parameter,
    run,
    skew,
    state,
    time,
)
from phfmu.cli import main
from phfmu.components.electrical.sources import voltage_source
from phfmu.components.library import build
from phfmu.outcome.status import EventRefused

Q, P, P2 = state("q", unit="m"), state("p", unit="kg.m/s", start=1.0), state("p2", unit="kg.m/s", start=-1.0)
F, V0, MASS = 3.0, 0.01, 2.0


def body(*dissipation: Block, **more: Any) -> PHDAE:
    energies = (energy(P**2 / (2 * MASS)), energy(P2**2 / 2), energy(Q**2 / 2))
    return PHDAE(
        "body", states=(Q, P, P2), energies=energies, structure=(skew(Q, P, 1.0),), dissipation=dissipation, **more
    )


SLIP = P.z - P2.z
COULOMB: Mapping[str, Block] = {
    "of the velocity": damping(P, F / ca.fabs(P.z)),
    "of the momentum": damping(P, F / ca.fabs(P.sx)),
    "by a sign": damping(P, F * ca.sign(P.z) / P.z),
    "by cases": damping(P, ca.if_else(P.z > 0, F, -F) / P.z),
    "of a slip": block([P, P2], F / ca.fabs(SLIP) * ca.DM([[1, -1], [-1, 1]])),
    "in a plane": block([P, P2], F / ca.norm_2(ca.vertcat(P.z, P2.z)) * ca.SX.eye(2)),
}
SMOOTH: Mapping[str, Block] = {
    "rounded off": damping(P, F / ca.sqrt(P.z**2 + V0**2)),
    "tanh": damping(P, F * ca.tanh(P.z / V0) / P.z),
    "turbulent": damping(P, F * ca.fabs(P.z)),
    "viscous": damping(P, F),
    "two slopes": damping(P, ca.if_else(P.z > 0, F, 2 * F)),
    "of the place": damping(P, F / ca.fabs(Q.sx - 2)),
}


@pytest.mark.parametrize("name", COULOMB)
def test_coulomb_friction_is_told_by_name(name):
    found = [p for p in check(body(COULOMB[name])) if p.rule == "friction"]
    assert len(found) == 1 and "Coulomb friction" in found[0].reason and "sqrt(v^2 + v0^2)" in found[0].remedy


@pytest.mark.parametrize("name", SMOOTH)
def test_other_friction_is_none(name):
    assert not [p for p in check(body(SMOOTH[name])) if p.rule == "friction"]


def test_a_force_between_two_limits_is_no_law_of_a_switch():
    mu, s = algebraic("mu", unit="N"), parameter("s", 1.0)
    switch = Switch("brake", mu, {P: 1.0}, s, law="coulomb")  # pyright: ignore[reportArgumentType]
    (found,) = check(body(algebraics=(mu,), parameters=(s,), switches=(switch,)))
    assert "Coulomb friction" in found.remedy


def stick() -> PHDAE:
    """A force F against the velocity whose sign is a mode; the spring is too weak to pull the body loose again."""
    s = parameter("s", 1.0)
    events = (
        StateEvent(Guard("turns_back", P.z, -1), when={"s": 1.0}, sets={"s": -1.0}),
        StateEvent(Guard("turns_on", P.z, 1), when={"s": -1.0}, sets={"s": 1.0}),
    )
    friction = Port("friction", TRANSLATIONAL, "effort", {P: 1.0}, source=-F * s.sx)
    return body(ports=(friction,), parameters=(s,), state_events=events)


def test_sliding_is_refused_by_name_where_it_begins():
    """MASS q'' + q = -F from q = 0 with p = 1: rest where tan(w t) = p w / F, w^2 = 1 / MASS."""
    model = build_model(stick(), Collocated(3))
    instance = NativeInstance(model)
    with pytest.raises(EventRefused, match=r"100 events .* at one instant, the last 'turns_.*Coulomb friction.*tanh"):
        list(instance.land(0.0, 0.01, 100))
    w = np.sqrt(1 / MASS)
    assert instance.time == pytest.approx(np.arctan(w / F) / w, abs=1e-12)  # at its last accepted step


def table(x: ca.SX, y: ca.SX) -> PHDAE:
    """A table on four legs at (+-1, +-1) with a load of 10 N at (x, y): the forces of its legs have one null vector."""
    q, p = ([state(f"{name}{n}") for n in ("z", "a", "b")] for name in ("q", "p"))
    mu = [algebraic(f"N{i + 1}", unit="N", nominal=5.0) for i in range(4)]
    on = [parameter(f"on{i + 1}", 1.0) for i in range(4)]
    corners = ((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0))
    legs = tuple(
        Switch(f"leg{i + 1}", mu[i], {p[0]: 1.0, p[1]: a, p[2]: b}, on[i], gap=q[0].sx + a * q[1].sx + b * q[2].sx)
        for i, (a, b) in enumerate(corners)
    )
    load = Port("load", TRANSLATIONAL, "effort", {p[0]: -1.0, p[1]: -x, p[2]: -y}, source=10.0)
    return PHDAE(
        "table", states=(*q, *p), algebraics=tuple(mu), parameters=tuple(on), ports=(load,), switches=legs,
        energies=tuple(energy(v**2 / 2) for v in p), structure=tuple(skew(a, b, 1.0) for a, b in zip(q, p, strict=True)),
    )  # fmt: skip


def test_legs_that_share_a_load_are_refused_where_least_norm_would_lift_one():
    """Least norm: N_i = 10/4 (1 + x_i x + y_i y); leg 3 is lifted where x + y = 1, where it could bear as much as leg 2."""
    lever = ca.SX(0.7 * ca.sin(time))
    model = build_model(table(lever, lever), Collocated(2))
    instance = SwitchedInstance(model, NativeInstance)
    with pytest.raises(
        EventRefused, match="'leg3' opens where its share .* could hold up to 2.5: .* depend on each other"
    ):
        list(instance.land(0.0, 0.1, 20))
    assert instance.time == pytest.approx(np.arcsin(1 / 1.4), abs=1e-9)
    instance = SwitchedInstance(model, NativeInstance)
    list(instance.land(0.0, 0.1, 5))
    bears = 2.5 * (1 + np.array([2, 0, -2, 0]) * 0.7 * np.sin(0.5))
    np.testing.assert_allclose(instance.signal("a_end"), bears, rtol=1e-9)


def capacitor_at_a_source(resistance: float) -> PHDAE:
    q = state("q", unit="C")
    port = Port("terminal", ELECTRICAL, "flow", {q: 1.0})
    net = Network("held")
    net.add("source", voltage_source(ca.SX(ca.sin(time)), v=1.0, i=1.0))
    net.add("load", PHDAE("capacitor", states=(q,), energies=(energy(q**2 / 2),), ports=(port,)))
    if resistance:
        i, u = algebraic("i", unit="A"), {"a": ca.SX.sym("a"), "b": ca.SX.sym("b")}
        ends = tuple(Port(n, ELECTRICAL, "effort", {i: sign}, u=u[n]) for n, sign in (("a", 1.0), ("b", -1.0)))
        net.add("series", PHDAE("resistor", algebraics=(i,), dissipation=(damping(i, resistance),), ports=ends))
        net.junction("left", ["source.terminal", "series.a"])
        net.junction("right", ["series.b", "load.terminal"])
    else:
        net.junction("node", ["source.terminal", "load.terminal"])
    return net.compose()


def test_a_capacitor_on_an_ideal_source_is_told_by_name_with_the_order_it_has():
    """A warning; the orders it names are those of runs, 2, 2 and 4 for k = 1, 2, 3."""
    assert not [p for p in check(capacitor_at_a_source(0.1), strict=True) if p.rule == "order"]
    declaration = capacitor_at_a_source(0.0)
    (found,) = (p for p in check(declaration, strict=True) if p.rule == "order")
    assert "'load.q' is tied to a source" in found.reason and found.severity == "warning"
    for k, order in ((1, 2), (2, 2), (3, 4)):
        model = build_model(declaration, Collocated(k))
        errors = []
        for n in (8, 16):
            result = run(Monolithic(model, NativeInstance(model)), Options(stop=2.0, step=2.0 / n))
            errors.append(abs(result.column("load.q")[-1] - np.sin(2.0)))
        assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.3)


@pytest.mark.parametrize(("scene", "vary"), [("bouncing_ball", "e=0.5,0.9"), ("rectifier", "load.R=1,2")])
def test_the_python_engine_says_what_lands_on_guards(scene: str, vary: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Refused before the first step, of a run and of a sweep."""
    for words in (["run", scene], ["sweep", scene, "--vary", vary, "--measure", "last(time)"]):
        assert main([*words, "--engine", "python"]) == 2
        assert f"{scene}: the Python engine takes steps of a fixed grid and lands on no" in capsys.readouterr().err


def test_a_python_instance_looks_at_no_guard() -> None:
    instance = PythonInstance(build_model(build("bouncing_ball").declaration(), Collocated(2)))
    calls: tuple[Callable[[], Any], ...] = (
        lambda: instance.do_step(0.0, 0.1),
        lambda: instance.run(0.0, 0.1, 3),
        lambda: instance.land(0.0, 0.1, 3),
    )
    for call in calls:
        with pytest.raises(
            Refusal, match=r"lands on no state events \('floor'\); take --engine native \(NativeInstance\)"
        ):
            call()
    instance.step_exactly(0.0, 1.0)
    assert instance.x == pytest.approx([1.0 - 9.81 / 2, -9.81], rel=1e-14)  # as if there were no floor
    with pytest.raises(Refusal, match="lands on no switches"):
        SwitchedInstance(build_model(build("rectifier").declaration(), Collocated(2)), PythonInstance)
