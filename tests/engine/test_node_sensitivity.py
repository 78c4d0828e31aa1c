"""Derivatives of a step with respect to inputs at its nodes: against differences with rollback and a dense reference."""

from __future__ import annotations

from itertools import product

import casadi as ca
import numpy as np
import pytest

from phfmu import (
    PHDAE,
    TRANSLATIONAL,
    Collocated,
    Domain,
    NativeInstance,
    Port,
    PythonInstance,
    Status,
    StepFailure,
    block,
    build_model,
    energy,
    skew,
    state,
)
from phfmu.declare.variable import time
from tests.engines import ENGINES
from tests.wide import wide

#: order of the scheme -> length of a step of two internal ones, of which one has to be halved, see `growing`
LENGTH = {1: 0.8, 2: 0.95, 3: 0.97}
PUSH = Domain("push", "f", "N", "v", "m/s", "flow")


def growing() -> PHDAE:
    """x' = x^2 + u from 1 grows without bound in a second: longer and longer steps of it have to be halved."""
    x = state("x", start=1.0)
    push = Port("push", PUSH, "effort", {x: 1.0})
    return PHDAE("grows", (x,), energies=(energy(0.5 * x.sx**2),), dissipation=(block((x,), -x.sx),), ports=(push,))


def sprung() -> PHDAE:
    """A mass on a quartic spring with a damper, pushed; a second port with feedthrough through a resistor."""
    q, p = state("q", start=0.3), state("p", start=1.0)
    a = Port("a", TRANSLATIONAL, "effort", {p: 1.0})
    b = Port("b", TRANSLATIONAL, "effort", {p: 0.5})
    return PHDAE(
        "sprung",
        (q, p),
        energies=(energy(2.0 * q.sx**2 + q.sx**4), energy(0.25 * p.sx**2)),
        structure=(skew(q, p, 1.0),),
        dissipation=(block((p,), 0.3), block((b,), 0.7)),
        ports=(a, b),
    )


@pytest.fixture(scope="module")
def plan():
    made = {}

    def get(make, k):
        if (make, k) not in made:
            made[make, k] = build_model(make(), Collocated(k))
        return made[make, k]

    return get


def differences(values, U: np.ndarray, size: float) -> np.ndarray:
    """d values / d U, columns node by node; central differences, twice extrapolated."""
    columns = []
    for place in np.ndindex(U.shape):
        e = np.zeros(U.shape)
        e[place] = size
        a, b, c = ((values(U + s * e) - values(U - s * e)) / (2 * s * size) for s in (1.0, 0.5, 0.25))
        ab, bc = (4 * b - a) / 3, (4 * c - b) / 3
        columns.append((16 * bc - ab) / 15)
    return np.stack(columns, axis=-1)


def stacked(instance, end=True) -> np.ndarray:
    y_end = [instance.signal("y_end")[: instance.model.step.nu]] if end else []
    return np.concatenate([instance.node_output().ravel(), instance.x, *y_end])


def agree(found, expected, accuracy=1e-9):
    np.testing.assert_allclose(found, expected, rtol=0, atol=accuracy * np.abs(expected).max())


def compared(instance, t: float, h: float, parts: int, U: np.ndarray, size: float) -> None:
    start = instance.get_state()

    def values(inputs):
        instance.set_state(start)
        instance.set_node_inputs(inputs)
        instance.do_step(t, h, parts)
        return stacked(instance)

    expected = differences(values, U, size)
    values(U)
    S = instance.node_sensitivity(end=True)
    k, nu = U.shape
    agree(S.nodes.reshape(k * nu, -1), expected[: k * nu])
    agree(S.x, expected[k * nu : -nu])
    agree(S.end, expected[-nu:])
    merged = np.einsum("k,kinj->ij", instance.model.step.weights, S.nodes.reshape(k, nu, k, nu))
    agree(instance.sensitivity(), merged, 1e-12)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("k", wide([1, 2, 3], 2))
@pytest.mark.parametrize("parts", [1, 3])
def test_node_by_node_it_equals_differences(plan, engine, k, parts):
    """Outputs at the nodes, states and outputs at the end, with feedthrough; their means are `sensitivity`."""
    instance, rng = engine(plan(sprung, k)), np.random.default_rng(k)
    instance.do_step(0.0, 0.2)
    compared(instance, 0.2, 0.3, parts, rng.uniform(-1, 1, (k, 2)), 0.05)


@pytest.mark.parametrize("k", [1, 2, 3])
def test_both_engines_give_the_same(plan, k):
    U, found = np.random.default_rng(k).uniform(-1, 1, (k, 2)), []
    for instance in (e(plan(sprung, k)) for e in ENGINES):
        instance.set_node_inputs(U)
        instance.do_step(0.0, 0.3, 2)
        found.append(instance.node_sensitivity(end=True))
    for name in ("nodes", "x", "end"):
        agree(getattr(found[0], name), getattr(found[1], name), 1e-13)


@pytest.mark.parametrize("engine", ENGINES)
def test_columns_of_chosen_inputs(plan, engine):
    instance = engine(plan(sprung, 2))
    instance.do_step(0.0, 0.3, 2)
    every, one = instance.node_sensitivity(), instance.node_sensitivity([1])
    np.testing.assert_array_equal(one.nodes, every.nodes[..., [1, 3]])
    assert every.end is None and one.nodes.shape == (2, 2, 2)
    with pytest.raises(IndexError, match=r"inputs \[2\] of a model with 2"):
        instance.node_sensitivity([0, 2])


@pytest.mark.parametrize(
    ("engine", "k", "parts"),
    wide(product(ENGINES, (1, 2, 3), (1, 2)), *product((NativeInstance,), (1, 2), (1, 2)), (PythonInstance, 1, 1)),
)
def test_halved_steps_have_derivatives_of_their_parts(plan, engine, k, parts):
    """Of one internal step, and of two of which the second was halved."""
    instance, h = engine(plan(growing, k)), LENGTH[k] * parts / 2
    if parts == 1:
        instance.do_step(0.0, h)
    before = instance.counts["substeps"]
    compared(instance, LENGTH[k] - h, h, parts, np.linspace(-1e-4, 1e-4, k)[:, None], 1e-4)
    assert instance.counts["substeps"] > before


@pytest.mark.parametrize("engine", ENGINES)
def test_a_saved_state_keeps_which_parts_there_were(plan, engine):
    instance = engine(plan(growing, 1))
    instance.do_step(0.0, 0.8, 2)
    saved, S = instance.get_state(), instance.node_sensitivity()
    instance.reset()
    with pytest.raises(StepFailure) as failure:
        instance.node_sensitivity()
    assert failure.value.status is Status.NO_SENSITIVITY
    instance.do_step(0.0, 0.1)
    instance.set_state(saved)
    np.testing.assert_array_equal(instance.node_sensitivity().nodes, S.nodes)


def pulsed() -> PHDAE:
    """x' = p(t) (1 + x^2) - 3.5 x + u, p = 3 in the middle of each second: the midpoint rule has no solution over
    a second, as 3 m^2 - 5.5 m + 3 + 2 x = 0 has none for x >= 0, and one over half a second."""
    x = state("x")
    swing = Port("swing", PUSH, "effort", {x: 1.0 + x.sx**2}, source=3.0 * ca.sin(np.pi * time) ** 2)
    push = Port("push", PUSH, "effort", {x: 1.0})
    return PHDAE(
        "pulsed", (x,), energies=(energy(0.5 * x.sx**2),), dissipation=(block((x,), 3.5),), ports=(swing, push)
    )


@pytest.mark.parametrize("engine", wide(ENGINES, NativeInstance))
def test_as_many_halved_steps_as_are_remembered(plan, engine):
    instance = engine(plan(pulsed, 1))
    compared(instance, 0.0, 16.0, 16, np.array([[0.01]]), 1e-2)
    assert len(instance.node_sensitivity().x) == 1
    instance.reset()
    before = instance.counts["substeps"]
    instance.do_step(0.0, 17.0, 17)
    assert instance.counts["substeps"] - before == 17
    for asked in (instance.sensitivity, instance.node_sensitivity):
        with pytest.raises(StepFailure) as failure:
            asked()
        assert failure.value.status is Status.NO_SENSITIVITY


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("k", [1, 2, 3])
def test_halved_steps_carry_the_energy_through_their_node_values(plan, engine, k):
    """h sum b_i u_i y_i = supplied, with outputs brought back from substeps of unequal length by the adjoint."""
    instance, h = engine(plan(growing, k)), LENGTH[k]
    u = 1e-3 * np.random.default_rng(k).uniform(-1, 1, (k, 1))
    instance.set_node_inputs(u)
    instance.do_step(0.0, h, 2)
    assert instance.counts["substeps"] > 0
    supplied = instance.ledger()["supplied"].sum()
    assert h * plan(growing, k).step.weights @ (u * instance.node_output()) == pytest.approx(supplied, rel=1e-13)
