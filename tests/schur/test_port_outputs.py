"""Ports of models that the Schur stepper takes: their outputs, their work and what else is read at the end of its steps.

A pendulum of 1 m, damped by a damper whose coefficient depends on its place, is driven through every kind of port.  The
reference is its equation in the angle, integrated by another method.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from phfmu import (
    PHDAE,
    ROTATIONAL,
    TRANSLATIONAL,
    Coupled,
    EngineMember,
    FMUInstance,
    FMUMember,
    Holonomic,
    Monolithic,
    NativeInstance,
    Network,
    Options,
    Port,
    PythonInstance,
    algebraic,
    block,
    build_model,
    damping,
    default_scheme,
    energy,
    export,
    observable,
    parameter,
    run,
    skew,
    state,
)
from phfmu.components.mechanical.rotational import flexible_shaft, rotational_inertia
from phfmu.discretise.model import Model
from phfmu.network.couplings.newton import newton
from tests.wide import slow

M, G, ARM, DRAG = 1.3, 9.81, 0.7, 0.4
#: angle and speed at the start
START = (0.3, 0.8)
Torque = Callable[[float, float, float], float]


@dataclass(frozen=True)
class Way:
    """A way to declare a port of the pendulum; `torque` and `power` (phi, w, t) are those of its inputs `given(t)`."""

    port: Callable[[Any, Any, Any], Any]
    given: Callable[[float], list[float]]
    torque: Torque
    power: Torque


def force(t: float) -> float:
    return 0.5 + 0.4 * np.cos(3.0 * t)


def turn(q: Any) -> Any:
    """The column of a torque about the support."""
    return ca.vertcat(-q.sx[1], q.sx[0])


def column(value: Callable[[Any, Any], Any], size: int | None = None) -> Callable[[Any, Any, Any], Any]:
    return lambda q, v, arm: (Port("p", ROTATIONAL, "effort", {v: value(q, arm)}, size), {})


def feedthrough(q: Any, v: Any, arm: Any) -> Any:
    """A damper between the pendulum and a shaft that turns at the given speed: R acts on velocity and port."""
    port, t = Port("p", ROTATIONAL, "flow", {}), turn(q)
    row = ca.horzcat(t.T, ca.SX(-1))
    return port, {"dissipation": (block((v, port), DRAG * ca.mtimes(row.T, row)),)}


def gyrating(q: Any, v: Any, arm: Any) -> Any:
    """J acts on velocity and port."""
    port = Port("p", ROTATIONAL, "effort", {})
    return port, {"structure": (skew(v, port, arm.sx * turn(q)),)}


def twice(q: Any, v: Any, arm: Any) -> Any:
    """A constant column and an entry of J that depends on the state, of one port; J between two entries of it."""
    port = Port("p", TRANSLATIONAL, "effort", {v: np.eye(2)}, 2)
    return port, {
        "structure": (skew(v, port, ca.horzcat(turn(q), ca.SX(2, 1))), block((port,), ca.SX([[0, 1], [-1, 0]])))
    }


def _one(t: float) -> list[float]:
    return [force(t)]


def _two(t: float) -> list[float]:
    return [force(t), -0.3]


def _along(phi: float, f: list[float]) -> float:
    """Moment about the support of a force at the end."""
    return -np.sin(phi) * f[0] + np.cos(phi) * f[1]


WAYS = {
    "constant": Way(
        column(lambda q, arm: np.eye(2), 2), _two,
        lambda phi, w, t: _along(phi, _two(t)), lambda phi, w, t: w * _along(phi, _two(t)),
    ),
    "parameter": Way(
        column(lambda q, arm: ca.vertcat(0, arm.sx)), _one,
        lambda phi, w, t: ARM * np.cos(phi) * force(t), lambda phi, w, t: ARM * np.cos(phi) * w * force(t),
    ),
    "state": Way(column(lambda q, arm: turn(q)), _one, lambda phi, w, t: force(t), lambda phi, w, t: w * force(t)),
    "state and parameter": Way(
        column(lambda q, arm: arm.sx * turn(q)), _one, lambda phi, w, t: ARM * force(t), lambda phi, w, t: ARM * w * force(t)
    ),
    "state beside constant": Way(
        column(lambda q, arm: ca.horzcat(turn(q), ca.SX([1, 0])), 2), _two,
        lambda phi, w, t: force(t) + 0.3 * np.sin(phi), lambda phi, w, t: w * (force(t) + 0.3 * np.sin(phi)),
    ),
    "block of J": Way(gyrating, _one, lambda phi, w, t: ARM * force(t), lambda phi, w, t: ARM * w * force(t)),
    "block of R": Way(
        feedthrough, _one, lambda phi, w, t: DRAG * (force(t) - w), lambda phi, w, t: DRAG * (force(t) - w) * force(t)
    ),
    "column and block of J": Way(
        twice, _two, lambda phi, w, t: _along(phi, _two(t)) + force(t), lambda phi, w, t: w * (_along(phi, _two(t)) + force(t))
    ),
}  # fmt: skip


def drag(s: Any) -> Any:
    """Coefficient of the damper to (2, 0) at the squared distance s from there."""
    return 0.05 + 0.02 * s


def pendulum(way: str, rods: int = 1) -> PHDAE:
    """q = (cos phi, sin phi), H = M |v|^2 / 2 + M G q[2]; all rods but one are redundant."""
    q, v = state("q", 2, unit="m", start=np.array([np.cos(START[0]), np.sin(START[0])])), state(
        "v", 2, unit="m/s", start=START[1] * np.array([-np.sin(START[0]), np.cos(START[0])])
    )  # fmt: skip
    lam, arm = algebraic("lambda", rods, unit="N/m"), parameter("arm", ARM, unit="m")
    port, more = WAYS[way].port(q, v, arm)
    distance = ca.sumsqr(q.sx - ca.DM([2.0, 0.0]))
    return PHDAE(
        "pendulum",
        states=(q, v),
        algebraics=(lam,),
        parameters=(arm,),
        energies=(energy(0.5 * M * ca.sumsqr(v.sx)), energy(M * G * q[1])),
        E={v: M},
        structure=(skew(q, v, 1.0), *more.get("structure", ())),
        dissipation=(damping(v, drag(distance)), *more.get("dissipation", ())),
        constraints=(Holonomic(lam, ca.repmat(0.5 * (ca.sumsqr(q.sx) - 1.0), rods)),),
        ports=(port,),
        observables=(observable("spin", q[0] * v[1] - q[1] * v[0], unit="rad/s"), observable("tension", lam.sx)),
    )


@cache
def model(way: str, order: int) -> Model:
    declaration = pendulum(way)
    return build_model(declaration, default_scheme(declaration, order))


def plain(m: Model) -> Model:
    """The same model without the Schur stepper."""
    return replace(m, step=replace(m.step, schur=None))


def reference(way: str, stop: float) -> np.ndarray:
    """phi, w, energy supplied at the port, energy lost in the damper to (2, 0)."""
    port = WAYS[way]

    def rate(t: float, s: Any) -> list[float]:
        phi, w = s[:2]
        c = drag(np.sum((np.array([np.cos(phi), np.sin(phi)]) - [2.0, 0.0]) ** 2))
        return [w, (port.torque(phi, w, t) - c * w) / M - G * np.cos(phi), port.power(phi, w, t), c * w * w]

    return solve_ivp(rate, (0.0, stop), [*START, 0.0, 0.0], method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]


def pushed(unit: Any, way: str, h: float, n: int, k: int) -> tuple[float, float]:
    """Steps with the inputs at the nodes; what was supplied and lost."""
    c, supplied, lost = unit.model.step.nodes, 0.0, 0.0
    for i in range(n):
        given = np.array([WAYS[way].given(h * (i + c[j])) for j in range(k)])
        unit.set_node_inputs(given)
        unit.do_step(i * h, h)
        book = unit.ledger()
        work = h * float(np.sum(unit.model.step.weights[:, None] * given * unit.node_output()))
        assert work == pytest.approx(float(book["supplied"].sum()), abs=1e-14)
        assert abs(book["stored"] + book["dissipated"] - book["supplied"]).max() <= 1e-13
        supplied, lost = supplied + float(book["supplied"].sum()), lost + float(book["dissipated"].sum())
    return supplied, lost


@pytest.mark.parametrize("order", [slow(2), 6])
@pytest.mark.parametrize("way", WAYS)
def test_all_that_is_read_after_a_step_is_that_of_newton(way: str, order: int, compiler: None) -> None:
    """With the Schur stepper, without it and in Python; signals, ledgers, node outputs, derivatives; other parameters midway."""
    m, k = model(way, order), order // 2
    assert m.step.schur is not None
    units: list[Any] = [NativeInstance(m), NativeInstance(plain(m)), PythonInstance(m)]
    for i in range(12):
        if i == 6:
            for unit in units:
                unit.set_parameters([1.4 * ARM])
        given = np.array([WAYS[way].given(0.02 * (i + j / k)) for j in range(k)])
        for unit in units:
            unit.set_node_inputs(given)
            unit.do_step(0.02 * i, 0.02)
        fast, *others = units
        for other in others:
            for name, values in other.signals().items():
                assert fast.signal(name) == pytest.approx(values, rel=1e-11, abs=1e-11), (name, i)
            for name, values in other.ledger().items():
                assert fast.ledger()[name] == pytest.approx(values, rel=1e-11, abs=1e-13), (name, i)
            assert fast.node_output() == pytest.approx(other.node_output(), rel=1e-11, abs=1e-12)
            assert fast.sensitivity() == pytest.approx(other.sensitivity(), rel=1e-9, abs=1e-12)
    assert units[0].counts["schur"] == 12 and units[1].counts["schur"] == 0
    assert abs(units[0].signal("energy")).min() > 1e-3


@pytest.mark.parametrize("order", [slow(2), 6])
def test_a_redundant_rod_at_rest_changes_no_work(order: int, compiler: None) -> None:
    declaration, found = pendulum("state", 2), []
    twice = build_model(declaration, default_scheme(declaration, order))
    for m in (model("state", order), twice):
        unit = NativeInstance(m)
        found.append(pushed(unit, "state", 0.02, 20, order // 2))
        assert unit.counts["schur"] == 20
    assert found[1] == pytest.approx(found[0], rel=1e-11)


@pytest.mark.parametrize(("order", "h", "error"), [slow((2, 0.002, 3e-5)), (6, 0.02, 3e-10)])
@pytest.mark.parametrize("way", WAYS)
def test_the_work_of_a_port_is_that_of_another_method(
    way: str, order: int, h: float, error: float, compiler: None
) -> None:
    """Through each way of declaring it, with inputs at the nodes of steps."""
    unit, stop = NativeInstance(model(way, order)), 0.8
    n = round(stop / h)
    supplied, lost = pushed(unit, way, h, n, order // 2)
    assert unit.counts["schur"] == n
    phi, w, given, spent = reference(way, stop)
    if way == "block of R":
        spent += _lost_in_feedthrough(stop)
    assert abs(given) > 0.05
    assert unit.x[:2] == pytest.approx([np.cos(phi), np.sin(phi)], abs=error)
    assert unit.signal("observables")[0] == pytest.approx(w, abs=10 * error)
    assert supplied == pytest.approx(given, abs=10 * error)
    assert lost == pytest.approx(spent, abs=10 * error)


def _lost_in_feedthrough(stop: float) -> float:
    """Energy lost in the damper between pendulum and shaft."""
    way = WAYS["block of R"]

    def rate(t: float, s: Any) -> list[float]:
        phi, w = s[:2]
        c = drag(np.sum((np.array([np.cos(phi), np.sin(phi)]) - [2.0, 0.0]) ** 2))
        return [w, (way.torque(phi, w, t) - c * w) / M - G * np.cos(phi), DRAG * (force(t) - w) ** 2]

    return solve_ivp(rate, (0.0, stop), [*START, 0.0], method="DOP853", rtol=1e-13, atol=1e-14).y[-1, -1]


@pytest.mark.parametrize(("way", "order", "version"), [
    ("state", 6, "3.0"),
    *(slow((way, order, version)) for way in WAYS for order in (2, 6) for version in ("2.0", "3.0")
      if (way, order, version) != ("state", 6, "3.0")),
])  # fmt: skip
def test_a_unit_is_the_engine(way: str, order: int, version: str, tmp_path: Path, compiler: None) -> None:
    m = model(way, order)
    (path,) = export(m, tmp_path, (version,), step=0.02, node_inputs=order > 2)
    unit, engine = FMUInstance(path), NativeInstance(m)
    for i in range(10):
        u = WAYS[way].given(0.02 * i)
        for one in (unit, engine):
            one.set_input(u)
            one.do_step(0.02 * i, 0.02)
        assert np.array_equal(unit.output(), engine.output()) and abs(unit.output()).min() > 1e-3
        assert unit.ledger()["supplied"] == engine.ledger()["supplied"]


J = 0.4  # kg.m2, of the load


def loaded(kind: str) -> Network:
    """The pendulum's torque port on a rotor, rigidly or through a spring."""
    net = Network("driven")
    net.add("arm", pendulum("state"))
    net.add("load", rotational_inertia(J, speed=START[1]))
    if kind == "rigid":
        net.junction("hub", ["arm.p", "load.a"], kind="1")
    else:
        net.add("shaft", flexible_shaft(30.0, twist=0.05))
        net.connect("arm.p", "shaft.a", name="near")
        net.connect("shaft.b", "load.a", name="far")
    return net


def loaded_reference(kind: str, stop: float) -> np.ndarray:
    """phi and w of the pendulum, speed of the load."""

    def rate(_: float, s: Any) -> list[float]:
        phi, w, speed, twist = s
        c = drag(np.sum((np.array([np.cos(phi), np.sin(phi)]) - [2.0, 0.0]) ** 2))
        torque = -M * G * np.cos(phi) - c * w
        if kind == "rigid":
            return [w, torque / (M + J), torque / (M + J), 0.0]
        return [w, (torque + 30.0 * twist) / M, -30.0 * twist / J, speed - w]

    return solve_ivp(rate, (0.0, stop), [*START, START[1], 0.05], method="DOP853", rtol=1e-13, atol=1e-14).y[:3, -1]


@pytest.mark.parametrize(("kind", "order", "engine"), [
    ("rigid", 6, "native"),
    *(slow((kind, order, engine)) for kind in ("rigid", "spring") for order in (2, 6)
      for engine in ("python", "native", "2.0", "3.0") if (kind, order, engine) != ("rigid", 6, "native")),
])  # fmt: skip
def test_members_apart_are_the_composed_model(
    kind: str, order: int, engine: str, tmp_path: Path, compiler: None
) -> None:
    """A motor on its load: node values and Newton's method at the junction, by each engine, and by units."""
    net, stop, h = loaded(kind), 0.6, 0.02
    own: list[Any] = []
    for name, part in net.declared.items():
        m = build_model(part, default_scheme(part, order))
        assert (m.step.schur is not None) == (name == "arm")
        if engine in ("2.0", "3.0"):
            (path,) = export(m, tmp_path, (engine,), step=h, node_inputs=order > 2)
            own.append(FMUMember(name, FMUInstance(path)))
        else:
            own.append(EngineMember(name, m, {"python": PythonInstance, "native": NativeInstance}[engine](m)))
    options = Options(stop=stop, step=h)
    apart = run(Coupled(net, own, newton), options)
    composed = net.compose()
    m = build_model(composed, default_scheme(composed, order))
    one = run(Monolithic(m, NativeInstance(m)), options)
    for name in ("arm.q[1]", "arm.q[2]", "arm.v[1]", "arm.v[2]", "load.w"):
        assert apart.column(name) == pytest.approx(one.column(name), rel=1e-10, abs=1e-10), name
    assert apart.ledger.summary().closed and one.ledger.summary().closed
    phi, w, speed = loaded_reference(kind, stop)
    error = {2: 5e-3, 6: 1e-8}[order]
    assert apart.column("load.w")[-1] == pytest.approx(speed, abs=error) and abs(speed) > 1.0
    assert apart.column("arm.q[2]")[-1] == pytest.approx(np.sin(phi), abs=error)
    assert kind == "spring" or speed == pytest.approx(w, abs=1e-10)
