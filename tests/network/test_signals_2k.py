"""Signals between members stepped apart at the nodes of their steps: the run is that of the composed model, of order 2k."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from phfmu import (
    PHDAE,
    Anderson,
    Collocated,
    Coupled,
    EngineMember,
    NativeInstance,
    Network,
    Options,
    PythonInstance,
    build_model,
    damping,
    driven,
    energy,
    run,
    signal_input,
    state,
)
from phfmu.components.scenes.mechanical.speed_control import speed_control
from phfmu.network.members.member import Member
from phfmu.network.scene import Event
from tests.network.governed import (
    LOOP,
    apart,
    apart_by,
    composed,
    governed,
    loop,
    ran,
    speed,
)
from tests.wide import slow, wide


def plain_members(net: Network, k: int) -> list[Member]:
    """Without ports for signals."""
    models = {n: build_model(replace(d, name=n), Collocated(k)) for n, d in net.declared.items()}
    return [EngineMember(n, m, PythonInstance(m)) for n, m in models.items()]


@pytest.mark.parametrize("k", [1, 2, 3])
def test_a_loop_apart_is_the_composed_one(k: int) -> None:
    """Through the event of its load: states, and what is told of them at the ends of steps."""
    scene = speed_control()
    whole = run(composed(loop(), k), Options(stop=0.2, step=1e-2, events=scene.events))
    parts, system = speed(k)
    assert system.coupling.order == 2 * k
    np.testing.assert_allclose(parts.column("rotor.w"), whole.column("rotor.w"), rtol=1e-13)
    for name in LOOP:
        size = np.abs(whole.column(name)).max()
        np.testing.assert_allclose(parts.column(name), whole.column(name), rtol=0, atol=1e-13 * size)
    command = 0.8 * parts.column("controller.error") + 8.0 * parts.column("controller.x")
    np.testing.assert_allclose(parts.column("controller.command"), command, rtol=1e-13)


@pytest.mark.parametrize(
    ("engine", "k"), wide([(PythonInstance, 2), *((NativeInstance, k) for k in (1, 2, 3))], (NativeInstance, 1))
)
def test_a_governed_and_excited_machine_apart_is_the_composed_one(engine: Any, k: int) -> None:
    """Beside a bare node with its impulses, with an output that is not linear in the states."""
    net, stop = governed(), 0.005
    system = apart(net, k, engine)
    parts, whole = ran(net, system, 1e-3, stop), ran(net, composed(net, k, engine), 1e-3, stop)
    assert np.ptp(whole.column("governor.x")) > 1e4 and np.ptp(whole.column("exciter.x")) > 10
    assert apart_by(parts, whole) < 1e-12
    assert parts.ledger.summary().closed
    if engine is NativeInstance:
        assert not system.master.calls


def end_errors(net: Network, system: Any, h: float, reference: Any) -> list[float]:
    result = ran(net, system, h)
    found = ((result.column(n)[-1], reference.column(n)[-1]) for n in ("gen.theta", "governor.x", "exciter.x"))
    return [abs(a / b - 1) for a, b in found]


@pytest.mark.slow
@pytest.mark.parametrize("parts", [None, {"gen": 2, "governor": 3, "line": 3}])
@pytest.mark.parametrize(("k", "h"), [(1, 1e-3), (2, 2e-3), (3, 4e-3)])
def test_its_order_is_2k_with_internal_steps_too(k: int, h: float, parts: dict[str, int] | None) -> None:
    """Against the circuit without a bare node, composed at order 8."""
    net, folded = governed(), governed(folded=True)
    reference = ran(folded, composed(folded, 4, NativeInstance), 1e-4)
    coarse, fine = (end_errors(net, apart(net, k, NativeInstance, parts), s, reference) for s in (h, h / 2))
    np.testing.assert_allclose(np.log2(np.divide(coarse, fine)), 2 * k, atol=0.15)


@pytest.mark.parametrize(("k", "h"), [slow((1, 1e-2)), (2, 2e-2), slow((3, 4e-2))])
def test_internal_steps_keep_the_order(k: int, h: float) -> None:
    scene = speed_control()
    names = ("rotor.w", "controller.x")
    assert isinstance(scene.system, Network)
    load = (Event(0.0, "rotor.b.torque", -5.0),)
    reference = run(composed(loop(), 4), Options(stop=0.2, step=1e-2, events=load))
    errors = []
    for step in (h, h / 2):
        system = apart(loop(), k, parts={"rotor": 3, "controller": 2})
        found = run(system, Options(stop=0.2, step=step, events=load))
        errors.append([abs(found.column(n)[-1] - reference.column(n)[-1]) for n in names])
    np.testing.assert_allclose(np.log2(np.divide(*errors)), 2 * k, atol=0.25)


def test_the_least_k_of_both_ends_is_exchanged() -> None:
    """A controller of order 2 in a loop of order 6: the whole has order 2."""
    scene = speed_control()
    members: list[Member] = []
    for name, part in loop().separate().items():
        model = build_model(part, Collocated(1 if name == "controller" else 3))
        members.append(EngineMember(name, model, PythonInstance(model)))
    system = Coupled(loop(), members)
    assert system.coupling.order == 2
    reference = run(composed(loop(), 1), Options(stop=0.2, step=1e-2, events=scene.events))
    found = run(system, Options(stop=0.2, step=1e-2, events=scene.events))
    np.testing.assert_allclose(found.column("rotor.w"), reference.column("rotor.w"), rtol=1e-4)


@pytest.mark.parametrize("k", [1, 2])
def test_the_compiled_loop_takes_signals_along(k: int) -> None:
    """With the numbers of members that are called back."""
    (fast, system), (plain, other) = speed(k, NativeInstance), speed(k, NativeInstance, called=True)
    assert other.master.calls and not system.master.calls
    for name in fast.names:
        size = max(np.abs(plain.column(name)).max(), 1.0)
        np.testing.assert_allclose(fast.column(name), plain.column(name), rtol=0, atol=1e-13 * size, err_msg=name)


def test_signals_have_no_row_in_the_books_and_no_column() -> None:
    plain = Coupled(loop(), plain_members(loop(), 2))
    result, system = speed(2)
    # the source of the actuator is fed, as in the composed model
    names = [n.replace("actuator.source.speed", "actuator.source.power") for n in plain.names]
    assert sorted(system.names) == sorted(names) and system.booking == plain.booking
    assert system.inputs().keys() == plain.inputs().keys() and set(system.settable()) <= set(plain.settable())
    assert result.ledger.summary().closed
    with pytest.raises(KeyError, match="fed by a signal"):
        system.set_value("actuator.torque", 1.0)
    with pytest.raises(KeyError):
        system.set_value("controller.command", 1.0)


def test_other_couplings_hold_them() -> None:
    """Members with signals at nodes under a coupling of held values: as if they had none."""
    scene = speed_control()
    options = Options(stop=0.2, step=1e-2, events=scene.events)
    values = []
    for parts in (loop().separate(), {n: replace(d, name=n) for n, d in loop().declared.items()}):
        models = {n: build_model(d) for n, d in parts.items()}
        members: list[Member] = [EngineMember(n, m, PythonInstance(m)) for n, m in models.items()]
        values.append(run(Coupled(loop(), members, Anderson()), options))
    for name in LOOP:
        np.testing.assert_allclose(values[0].column(name), values[1].column(name), rtol=1e-12, atol=1e-10)


def test_a_held_member_holds_its_signals() -> None:
    """Wires from and to a member that takes no values at nodes are held, the others are not."""
    scene = speed_control()
    parts = loop().separate({"rotor"})
    assert [p.name for p in parts["rotor"].ports] == ["a", "b"]
    assert "measured" in {v.name for v in parts["controller"].parameters}
    models = {n: build_model(d) for n, d in parts.items()}
    system = Coupled(loop(), [EngineMember(n, m, PythonInstance(m)) for n, m in models.items()])
    found = run(system, Options(stop=0.2, step=1e-2, events=scene.events))
    exact = run(composed(loop(), 1), Options(stop=0.2, step=1e-2, events=scene.events))
    gap = np.abs(found.column("rotor.w") - exact.column("rotor.w")).max()
    assert 1e-9 < gap < 0.1


def test_factors_and_offsets() -> None:
    """command = -2 (its command) + 0.3, with the gains that undo it."""
    whole = speed_control(-0.4, -4.0).system
    assert isinstance(whole, Network)
    net = Network("scaled", members=dict(whole.members), junctions=list(whole.junctions))
    net.members["controller"] = net.declared["controller"].with_starts({"x": (1.0 - 0.3) / 8.0})
    net.signal("rotor.w", "controller.measured")
    net.signal("controller.command", "actuator.torque", factor=-2.0, offset=0.3)
    options = Options(stop=0.2, step=1e-2, events=speed_control().events)
    one, other = run(apart(net, 2), options), run(composed(net, 2), options)
    np.testing.assert_allclose(one.column("rotor.w"), other.column("rotor.w"), rtol=1e-13)
    plain = speed(2)[0].column("rotor.w")
    np.testing.assert_allclose(one.column("rotor.w"), plain, rtol=1e-12)


def fed_by(name: str, damping_: float, start: float) -> PHDAE:
    """x' = -d x + u,  H = x^2 / 2: the signal u drives a source, whose work u x comes from outside."""
    u, x = signal_input("u"), state("x", start=start)
    return PHDAE(
        name, (x,), parameters=(u,), energies=(energy(x**2 / 2),), dissipation=(damping(x, damping_),),
        ports=(driven("source", {x: u}),),
    )  # fmt: skip


def toy() -> Network:
    """x1' = -2 x1 + x2, x2' = -x2 + x1, x(0) = (1, 5): each feeds the other without taking anything from it.

    Source: the example of energy-conservation-based co-simulation (Sadjina et al. 2017), as libcosim tests it.
    """
    net = Network("toy")
    net.add("one", fed_by("one", 2.0, 1.0))
    net.add("two", fed_by("two", 1.0, 5.0))
    net.signal("two.x", "one.u")
    net.signal("one.x", "two.u")
    return net


@pytest.mark.parametrize("k", [1, 2])
def test_what_signals_make_of_sources_is_booked_as_from_outside(k: int) -> None:
    """Each source has the energy of the integral of x1 x2, by the matrix exponential; nothing is left to junctions."""
    A, stop = np.array([[-2.0, 1.0], [1.0, -1.0]]), 1.0
    where, weights = np.polynomial.legendre.leggauss(20)
    x = np.array([expm(A * stop * (1 + s) / 2) @ [1.0, 5.0] for s in where])
    work = stop / 2 * float(weights @ (x[:, 0] * x[:, 1]))
    errors = []
    for h in (0.2, 0.1):
        result = run(apart(toy(), k), Options(stop=stop, step=h))
        s = result.ledger.summary()
        assert s.closed and not s.junctions and s.network is not None
        made = {p.component: p.supplied for p in s.ports}
        assert made["one"] == pytest.approx(made["two"], rel=1e-13) and len(s.ports) == 2
        assert s.network.external == pytest.approx(2 * made["one"], rel=1e-13)
        assert s.network.stored + (s.network.dissipated or 0.0) == pytest.approx(s.network.external, rel=1e-13)
        ends = [result.column(f"{n}.x")[-1] for n in ("one", "two")]
        errors.append([made["one"] - work, *(ends - expm(A * stop) @ [1.0, 5.0])])
    np.testing.assert_allclose(np.log2(np.abs(np.divide(*errors))), 2 * k, atol=0.15)
