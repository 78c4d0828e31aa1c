"""Signals between members: composed, stepped apart and in units; what cannot be wired is refused."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import expm

from phfmu import (
    PHDAE,
    ROTATIONAL,
    Collocated,
    Coupled,
    EngineMember,
    FMUInstance,
    FMUMember,
    Monolithic,
    NativeInstance,
    Network,
    Options,
    Port,
    PythonInstance,
    build_model,
    check,
    damping,
    driven,
    energy,
    export,
    run,
    signal_input,
    signal_output,
    state,
    time,
)
from phfmu.components.control.pi_controller import pi_controller
from phfmu.components.scenes.mechanical.speed_control import speed_control
from phfmu.network.junction import ConnectionError

STOP = 0.5


def exact(t: float) -> float:
    """Speed of the loaded rotor by the matrix exponential of J w' = -d w + kp e + ki x - 5, x' = e = 100 - w."""
    J, d, kp, ki = 0.05, 0.01, 0.8, 8.0
    A = np.array([[-(d + kp) / J, ki / J], [-1.0, 0.0]])
    rest = -np.linalg.solve(A, [(kp * 100.0 - 5.0) / J, 100.0])
    return float((rest + expm(A * (t - 0.1)) @ ([100.0, d * 100.0 / ki] - rest))[0])


@cache
def composed(k: int, h: float, engine: Any = PythonInstance) -> Any:
    scene = speed_control()
    model = build_model(scene.declaration(), Collocated(k))
    return run(Monolithic(model, engine(model)), Options(stop=STOP, step=h, events=scene.events))


@cache
def apart(k: int, h: float, engine: Any = PythonInstance, folder: Any = None, version: str = "3.0") -> Any:
    scene = speed_control()
    assert isinstance(scene.system, Network)
    members = []
    for name, part in scene.system.members.items():
        model = build_model(replace(part, name=name), Collocated(k))
        if folder is None:
            members.append(EngineMember(name, model, engine(model)))
        else:
            (path,) = export(model, folder, (version,), step=h)
            members.append(FMUMember(name, FMUInstance(path)))
    return run(Coupled(scene.system, members), Options(stop=STOP, step=h, events=scene.events))


def scaled(factor: float, offset: float) -> Network:
    """The loop with a controller in other units: command = factor * its command + offset, and the gains that undo it."""
    whole = speed_control(0.8 / factor, 8.0 / factor).system
    assert isinstance(whole, Network)
    net = Network("scaled", members=dict(whole.members), junctions=list(whole.junctions))
    d, speed = 0.01, 100.0
    x = (d * speed - offset) / 8.0
    net.members["controller"] = net.members["controller"].with_starts({"x": x})
    net.signal("rotor.w", "controller.measured")
    net.signal("controller.command", "actuator.torque", factor=factor, offset=offset)
    return net


def test_signals_are_scaled_and_shifted_composed_and_apart() -> None:
    events = speed_control().events
    options = Options(stop=STOP, step=5e-3, events=events)
    net = scaled(-2.0, 0.3)
    one = build_model(net.compose())
    whole = run(Monolithic(one, PythonInstance(one)), options)
    np.testing.assert_allclose(whole.column("rotor.w"), composed(1, 5e-3).column("rotor.w"), rtol=1e-12)
    members = []
    for name, part in net.declared.items():
        model = build_model(replace(part, name=name))
        members.append(EngineMember(name, model, PythonInstance(model)))
    parts = run(Coupled(net, members), options)
    np.testing.assert_allclose(parts.column("rotor.w"), apart(1, 5e-3).column("rotor.w"), rtol=1e-12)
    assert "(times -2) (plus 0.3)" in str(net.wires[1])


def test_a_composed_loop_has_the_order_of_its_scheme() -> None:
    for k, ratio in ((1, 4.0), (2, 16.0)):
        coarse, fine = (composed(k, h).column("rotor.w")[-1] - exact(STOP) for h in (1e-2, 5e-3))
        assert coarse / fine == pytest.approx(ratio, rel=0.05)
        assert abs(coarse) < 1e-2


def test_members_apart_hold_signals_at_order_2_and_close_their_books() -> None:
    coarse, fine = (apart(1, h) for h in (1e-2, 5e-3))
    errors = [r.column("rotor.w")[-1] - exact(STOP) for r in (coarse, fine)]
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.05)
    assert abs(errors[0]) < 2e-2
    summary = fine.ledger.summary()
    assert summary.closed
    # signals carry no power: there is a row for the actuator's work and none for a signal
    assert {(p.component, p.port) for p in summary.ports} == {
        *(("rotor", p) for p in "ab"), ("actuator", "shaft"), ("actuator", "source"), ("controller", "integrator"),
    }  # fmt: skip
    work = {(p.component, p.port): p.supplied for p in summary.ports}
    assert work["controller", "integrator"] == 0.0


@pytest.mark.slow
def test_columns_show_the_signals_of_the_present_time() -> None:
    """Apart, too: the command is kp e + ki x of its own row, not of the held input."""
    r = apart(1, 5e-3)
    e = 100.0 - r.column("rotor.w")
    np.testing.assert_allclose(r.column("controller.error"), e, atol=1e-12)
    np.testing.assert_allclose(r.column("controller.command"), 0.8 * e + 8.0 * r.column("controller.x"), atol=1e-12)
    together = composed(1, 5e-3)
    np.testing.assert_allclose(r.column("controller.command"), together.column("controller.command"), atol=0.05)


@pytest.mark.slow
def test_engines_and_units_agree(tmp_path: Any) -> None:
    np.testing.assert_allclose(composed(1, 1e-2, NativeInstance).values, composed(1, 1e-2).values, rtol=1e-9, atol=1e-9)
    plain = apart(1, 1e-2)
    for other in (
        apart(1, 1e-2, NativeInstance),
        apart(1, 1e-2, folder=tmp_path),
        apart(1, 1e-2, folder=tmp_path, version="2.0"),
    ):
        for name in ("rotor.w", "controller.command", "controller.x"):
            np.testing.assert_allclose(other.column(name), plain.column(name), rtol=1e-9, atol=1e-9)


def test_a_unit_has_signals_as_plain_inputs_and_outputs(tmp_path: Any) -> None:
    """Any importer sets the input and reads the output; there is no port, and a command answers at once."""
    for path in export(build_model(pi_controller(2.0, 3.0)), tmp_path, step=1e-2, ledger_outputs=False):
        with FMUInstance(path) as unit:
            about = unit.interface.variables
            assert [n for n, v in about.items() if v.causality == "input"] == ["reference", "measured"]
            assert [n for n, v in about.items() if v.causality == "output"] == ["command", "error"]
            assert unit.ports == () and "energy.events" not in about
            unit.set({"reference": 5.0})
            assert unit.get(["command"])[0] == 10.0
            for i in range(10):
                unit.do_step(i * 1e-2, 1e-2)
            assert unit.get(["command"])[0] == pytest.approx(10.0 + 3.0 * 5.0 * 0.1, rel=1e-12)


def lag(name: str, direct: bool) -> PHDAE:
    """x' = u - x; the output is x, or x + u."""
    u, x = signal_input("u"), state("x", unit="s")
    out = x + u if direct else x.sx
    return PHDAE(
        name, (x,), parameters=(u,), ports=(driven("right", {x: u - x}),), observables=(signal_output("out", out),)
    )


def test_a_loop_of_outputs_that_answer_at_once_is_named() -> None:
    net = Network("loop")
    for name in ("a", "b", "c"):
        net.add(name, lag(name, True))
    net.signal("a.out", "b.u")
    net.signal("b.out", "c.u")
    with pytest.raises(ConnectionError, match="loop without delay") as error:
        net.signal("c.out", "a.u")
    for wire in ("a.out -> b.u", "b.out -> c.u", "c.out -> a.u"):
        assert wire in str(error.value)
    assert len(net.wires) == 2  # as it was
    net = Network("delayed")
    for name in ("a", "b", "c"):
        net.add(name, lag(name, name != "b"))
    for pair in (("a.out", "b.u"), ("b.out", "c.u"), ("c.out", "a.u")):
        net.signal(*pair)
    assert [str(w) for w in net.wires] == ["b.out -> c.u", "c.out -> a.u", "a.out -> b.u"]


def test_a_chain_of_direct_outputs_is_composed_through() -> None:
    """The order of wiring does not matter; all of a chain answers at one instant."""
    net = Network("chain")
    for name in ("a", "b", "c"):
        net.add(name, lag(name, True))
    net.signal("b.out", "c.u")
    net.signal("a.out", "b.u")
    d = net.compose()
    assert [v.name for v in d.parameters] == ["a.u"] and check(d) == []
    out = next(o.expr for o in d.observables if o.name == "c.out")
    f = ca.Function("f", [d.x, d.parameters[0].sx], [out])
    assert float(f([1.0, 10.0, 100.0], 1000.0)) == 1111.0


def test_what_does_not_fit_is_refused() -> None:
    def ends(source: PHDAE, target: PHDAE, a: str = "a.out", b: str = "b.u") -> None:
        net = Network("n")
        net.add("a", source)
        net.add("b", target)
        net.signal(a, b)

    u, x = signal_input("u", unit="rad/s"), state("x", unit="s")
    wants = PHDAE("w", (x,), parameters=(u,), ports=(driven("r", {x: u / 100.0}),))
    with pytest.raises(ConnectionError, match="a.out is in 1, b.u in rad/s"):
        ends(lag("a", True), wants)
    with pytest.raises(ConnectionError, match="no signal input 'v'; .*u"):
        ends(lag("a", True), lag("b", True), b="b.v")
    with pytest.raises(ConnectionError, match="no observable, state or port output.*'z'"):
        ends(lag("a", True), lag("b", True), a="a.z")
    s = signal_input("u")
    stores = PHDAE(
        "s", (x := state("x"),), parameters=(s,), energies=(energy(s * x**2 / 2),), dissipation=(damping(x, 1.0),)
    )
    with pytest.raises(ConnectionError, match="b.u stands in H"):
        ends(lag("a", True), stores)
    net = Network("twice")
    for name in ("a", "b", "c"):
        net.add(name, lag(name, True))
    net.signal("a.out", "c.u")
    with pytest.raises(ConnectionError, match=r"c.u is fed by a.out already"):
        net.signal("b.out", "c.u")


def test_an_input_that_a_wire_feeds_cannot_be_set() -> None:
    scene = speed_control()
    assert isinstance(scene.system, Network)
    members: list[Any] = [
        EngineMember(n, m, PythonInstance(m))
        for n, m in ((n, build_model(replace(d, name=n))) for n, d in scene.system.members.items())
    ]
    coupled = Coupled(scene.system, members)
    with pytest.raises(KeyError, match="fed by a signal"):
        coupled.set_value("actuator.torque", 1.0)
    assert coupled.set_value("controller.reference", 90.0) == "input"


def test_a_held_signal_stays_within_the_limits_of_its_input() -> None:
    """A conductance that falls to zero is not foretold to be negative: a resistance stays passive."""
    g = signal_input("g", 1.0, unit="N.m.s/rad", min=0.0)
    w = state("w", unit="rad/s", start=1.0)
    brake = PHDAE("brake", (w,), parameters=(g,), energies=(energy(w**2 / 2),), dissipation=(damping(w, g),),
                  ports=(Port("shaft", ROTATIONAL, "effort", {w: 1.0}),))  # fmt: skip
    x = state("x", unit="s")
    ramp = signal_output("g", ca.fmax(0.0, 1.0 - 10.0 * time), unit="N.m.s/rad")
    source = PHDAE("source", (x,), ports=(driven("right", {x: 1.0}),), observables=(ramp,))
    net = Network("released")
    net.add("brake", brake)
    net.add("source", source)
    net.signal("source.g", "brake.g")
    members: list[Any] = [
        EngineMember(n, m, PythonInstance(m))
        for n, m in ((n, build_model(replace(d, name=n))) for n, d in net.members.items())
    ]
    result = run(Coupled(net, members), Options(stop=0.3, step=0.03))
    assert result.ledger.summary().closed
    after = result.column("brake.w")[result.time > 0.14]
    assert np.ptp(after) < 1e-12
