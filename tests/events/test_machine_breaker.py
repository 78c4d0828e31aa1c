"""A machine whose line is opened: at current zeros of order 2k, forced with the loss of its formula; no angle moves."""

from __future__ import annotations

from functools import cache
from math import pi, sqrt

import numpy as np
import pytest

from phfmu import (
    PHDAE,
    Collocated,
    Event,
    Monolithic,
    NativeInstance,
    Network,
    Options,
    build_model,
    run,
)
from phfmu.components.electrical.breaker import breaker
from phfmu.components.electrical.machines.machine_data import machine_set
from phfmu.components.electrical.machines.synchronous_machine import synchronous_machine
from phfmu.components.library import build
from phfmu.components.scenes.electrical.smib import circuit
from phfmu.runs.result import Result

OPEN = 0.005


@cache
def declaration() -> PHDAE:
    """`smib` with a breaker in the line, joined to the machine at a node without capacitor."""
    data, start, R, L, grid = circuit("kundur555_1q")
    net = Network("machine_breaker")
    net.add("gen", synchronous_machine(data, start=start))
    i, v = [-x for x in start.I[:3]], data.Vn_rms_ll * sqrt(2 / 3)
    net.add("line", breaker(R, L, i=max(map(abs, i)), v=v, start=i))
    net.add("grid", grid)
    net.junction("bus1", ["gen.terminal", "line.a"])
    net.junction("bus2", ["line.b", "grid.terminal"])
    return net.compose()


@cache
def model(k: int):
    return build_model(declaration(), Collocated(k))


def opened(k: int, h: float, stop: float, command: float) -> Result:
    m = model(k)
    return run(
        Monolithic(m, NativeInstance(m)), Options(stop=stop, step=h, events=(Event(OPEN, "line.command", command),))
    )


def jumps(result: Result) -> list[tuple[np.ndarray, np.ndarray]]:
    """Rows before and after each state event."""
    return [(result.values[i], result.values[i + 1]) for i in np.flatnonzero(np.diff(result.time) == 0)]


def inductances(theta: float) -> np.ndarray:
    """L(theta) of the phases and the rotor windings, from the data and Park's matrix."""
    data = machine_set("kundur555_1q", d=50.0)
    n = data.n
    L = np.zeros((n, n))
    L[:3, :3] = np.diag([data.Ld, data.Lq, data.L0])
    L[3:, 3:] = data.L_rotor
    for j, (axis, m) in enumerate(zip(data.axis, data.M_stator_rotor, strict=True)):
        at = 0 if axis == "d" else 1
        L[at, 3 + j] = L[3 + j, at] = sqrt(3 / 2) * m
    T = np.eye(n)
    angles = theta - np.array([0, 2, -2]) * pi / 3
    T[:3, :3] = sqrt(2 / 3) * np.array([np.cos(angles), -np.sin(angles), [sqrt(1 / 2)] * 3])
    return T.T @ L @ T


def test_three_poles_open_at_their_zeros():
    result = opened(2, 2e-4, 0.02, 0.0)
    assert result.ledger.summary().closed
    times = result.time[np.flatnonzero(np.diff(result.time) == 0)]
    assert times == pytest.approx([7.594e-3, 10.161e-3, 13.005e-3], abs=1e-6)
    for part in result.ledger.summary().components:
        assert abs(part.jumps or 0.0) <= 1e-8  # J, of 2e9 in the rotor
    assert max(result.worst.values()) <= 1e-9  # A
    for phase in (1, 2, 3):  # nothing flows through an open pole, nor through the machine
        gone = result.column(f"line.closed[{phase}]") == 0
        assert np.abs(result.column(f"gen.I[{phase}]")[gone]).max() <= 1e-9


def test_forced_opening_loses_what_both_branches_store():
    """All poles at once: 1/2 L i^2 in the line, and in the machine 1/2 i S^-1 i, S the inverse inductance of its phases."""
    result = opened(2, 2e-4, 0.006, 2.0)
    ((before, after),) = jumps(result)
    names = result.names
    i = np.array([before[names.index(f"line.i[{j}]")] for j in (1, 2, 3)])
    theta = before[names.index("gen.theta")]
    S = np.linalg.inv(inductances(theta))[:3, :3]
    machine = i @ np.linalg.solve(S, i) / 2
    line = circuit("kundur555_1q")[3] * i @ i / 2
    summary = result.ledger.summary()
    assert summary.closed
    gen, of_line = summary.components[:2]
    assert gen.jumps == pytest.approx(-machine, rel=1e-12)
    assert of_line.jumps == pytest.approx(-line, rel=1e-12)
    for name in ("gen.theta", "gen.p"):  # an impulse of a voltage turns no angle and gives no momentum
        assert after[names.index(name)] == before[names.index(name)]
    assert max(abs(after[names.index(f"gen.I[{j}]")]) for j in (1, 2, 3)) <= 1e-9


def slopes(errors: list[float]) -> np.ndarray:
    return np.log2(np.array(errors[:-1]) / np.array(errors[1:]))


@pytest.mark.slow
@pytest.mark.parametrize(("k", "steps"), [(1, (4e-4, 2e-4, 1e-4)), (2, (4e-4, 2e-4, 1e-4)), (3, (8e-4, 4e-4, 2e-4))])
def test_fluxes_and_zeros_are_of_order_2k(k, steps):
    exact = opened(3, 2.5e-5, 0.03, 0.0)
    fluxes = [n for n in exact.names if n.startswith("gen.psi[") and not n.endswith("_end")]
    errors, late = [], []
    for h in steps:
        found = opened(k, h, 0.03, 0.0)
        errors.append(max(abs(found.column(n)[-1] - exact.column(n)[-1]) for n in fluxes))
        late.append(max(abs(a - b) for a, b in zip(zeros(found), zeros(exact), strict=True)))
    assert slopes(errors)[-1] == pytest.approx(2 * k, abs=0.2)
    assert late[-1] <= {1: 1e-5, 2: 1e-8, 3: 1e-12}[k]


def zeros(result: Result) -> list[float]:
    return [float(t) for t in result.time[np.flatnonzero(np.diff(result.time) == 0)]]


def test_a_fault_on_one_of_two_lines_is_cleared():
    """`smib_breaker`: six poles open one by one at their zeros; nodes of inductors hold through all of it."""
    scene = build("smib_breaker")
    m = build_model(scene.declaration(), Collocated(2))
    result = run(Monolithic(m, NativeInstance(m)), Options(stop=0.1, step=scene.step, events=scene.events))
    summary = result.ledger.summary()
    assert summary.closed and summary.events["state"] == 7  # the fault comes at once
    assert max(result.worst.values()) <= 1e-8  # A
    assert max(abs(c.jumps or 0.0) for c in summary.components) <= 1e-7  # J
    for who in ("breaker", "fault"):
        for phase in (1, 2, 3):
            assert result.column(f"{who}.closed[{phase}]")[-1] == 0
            assert abs(result.column(f"{who}.i[{phase}]")[-1]) <= 1e-9
            assert np.abs(result.column(f"{who}.i[{phase}]")).max() > 2e4 if who == "fault" else True
    assert result.column("rest.i[1]")[-1] == pytest.approx(0, abs=1e-8)  # nothing is left at the fault
    assert np.abs(result.column("line.i[1]")).max() > 1e4


def test_chopped_currents_lose_their_formula():
    """Poles open below 2 kA: 1/2 L i^2 of the line, and 1/2 c S^-1 c of the machine; the others stay."""
    data, start, R, L, grid = circuit("kundur555_1q")
    net = Network("chopped")
    net.add("gen", synchronous_machine(data, start=start))
    i, v = [-x for x in start.I[:3]], data.Vn_rms_ll * sqrt(2 / 3)
    net.add("line", breaker(R, L, chop=2e3, i=max(map(abs, i)), v=v, start=i))
    net.add("grid", grid)
    net.junction("bus1", ["gen.terminal", "line.a"])
    net.junction("bus2", ["line.b", "grid.terminal"])
    m = build_model(net.compose(), Collocated(2))
    result = run(
        Monolithic(m, NativeInstance(m)), Options(stop=0.009, step=2e-4, events=(Event(OPEN, "line.command", 0.0),))
    )
    before, after = jumps(result)[0]
    names = result.names
    i = np.array([before[names.index(f"line.i[{j}]")] for j in (1, 2, 3)])
    S_machine = np.linalg.inv(inductances(before[names.index("gen.theta")]))[:3, :3]
    chopped = np.abs(i) <= 2e3
    assert chopped.sum() == 1  # phase a carries 1.1 kA when it is told to open
    S = S_machine + np.diag(np.where(chopped, 0.0, 1 / L))  # the other phases stay joined with their lines
    c = np.where(chopped, i, 0.0)
    lost = c @ np.linalg.solve(S, c) / 2 + L * c @ c / 2
    assert float(result.notes[0].split()[-2]) == pytest.approx(lost, rel=1e-8)  # nine digits are told
    assert after[names.index("gen.theta")] == before[names.index("gen.theta")]
    assert result.ledger.summary().closed
