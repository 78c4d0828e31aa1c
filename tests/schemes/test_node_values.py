"""Port values at the nodes of a step: order 2k where means give order 2, in the engines, in FMUs, between members."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from phfmu import (
    FMUInstance,
    NativeInstance,
    export,
)
from phfmu.cli import main
from phfmu.fmu.export.variables import FMUError
from phfmu.gradients.quadrature import nodes
from tests.engines import ENGINES
from tests.schemes.body_and_spring import END, K2, START, D, K, M, driven_exact, force, plan, slope
from tests.wide import wide


@cache
def joined_exact():
    def rate(_, x):
        q, v, s = x
        return [v, (-K2 * (s + s**3) - K * (q + q**3) - D * v) / M, v]

    return solve_ivp(rate, (0.0, END), START, "DOP853", rtol=3e-14, atol=1e-15).y[:, -1]


# -- one component --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("k", wide([1, 2, 3], 2))
@pytest.mark.parametrize("parts", [1, 3])
def test_node_values_carry_the_energy_of_the_step(engine, k, parts):
    """h sum b_i u_i y_i = supplied; sum b_i y_i = the mean; for any number of internal steps."""
    model, h = plan("body", k), 0.2
    instance, rng = engine(model), np.random.default_rng(k)
    assert instance.node_output() == pytest.approx(np.full((k, 1), START[1]), rel=1e-15)
    for s in range(5):
        u = rng.uniform(-3, 3, (k, 1))
        instance.set_node_inputs(u)
        instance.do_step(s * h, h, parts=parts)
        y = instance.node_output()
        supplied = float(instance.ledger()["supplied"].sum())
        assert h * (nodes(k).b @ (u * y)).item() == pytest.approx(supplied, rel=1e-13, abs=1e-15)
        assert nodes(k).b @ y == pytest.approx(instance.output(), rel=1e-13)


@pytest.mark.parametrize(("k", "parts"), [(2, 1), (3, 1), (2, 4)])
def test_engines_have_the_same_node_outputs_and_save_them(k, parts):
    model, h = plan("body", k), 0.2
    python, native = (e(model) for e in ENGINES)
    for s in range(5):
        for instance in (python, native):
            instance.set_node_inputs(force(h * (s + model.nodes))[:, None])
            instance.do_step(s * h, h, parts=parts)
        assert python.node_output() == pytest.approx(native.node_output(), rel=1e-12)
    for instance in (python, native):
        saved, seen = instance.get_state(), instance.node_output()
        instance.do_step(1.0, h)
        assert (instance.node_output() != seen).all()
        instance.set_state(saved)
        assert (instance.node_output() == seen).all()


@pytest.mark.parametrize("k", [1, 2, 3])
def test_driven_by_means_the_order_is_two_by_node_values_2k(k):
    model, counts = plan("body", k), (12, 18, 27)
    steps, errors = [END / n for n in counts], {"nodes": [], "means": []}
    for n, h in zip(counts, steps, strict=True):
        for kind in errors:
            instance = NativeInstance(model)
            for s in range(n):
                u = force(h * (s + model.nodes))[:, None]
                instance.set_node_inputs(u if kind == "nodes" else np.tile(model.step.weights @ u, (k, 1)))
                instance.do_step(s * h, h)
            errors[kind].append(np.max(abs(instance.x - driven_exact())))
    assert slope(steps, errors["nodes"]) == pytest.approx(2 * k, abs=0.25)
    assert slope(steps, errors["means"]) == pytest.approx(2.0, abs=0.25)


# -- two components -------------------------------------------------------------------------------------------


def converge(first, second, t, h, k, weights, exchanged):
    """Exchange port values over [t, t + h] until they stay; the two instances keep the step.  Returns the created work.

    `exchanged`: "nodes" or "means".  The mass takes the force of the spring, the spring the velocity of the mass.
    """
    saved = first.get_state(), second.get_state()
    velocity = first.node_output()
    for _ in range(60):
        for instance, state_ in zip((first, second), saved, strict=True):
            instance.set_state(state_)
        if exchanged == "means":
            velocity = np.tile(weights @ velocity, (k, 1))
        second.set_node_inputs(velocity)
        second.do_step(t, h)
        pull = -second.node_output()
        if exchanged == "means":
            pull = np.tile(weights @ pull, (k, 1))
        first.set_node_inputs(pull)
        first.do_step(t, h)
        before, velocity = velocity, first.node_output()
        change = weights @ (velocity - before) if exchanged == "means" else velocity - before
        if np.max(abs(change)) <= 1e-14:
            break
    else:
        raise AssertionError("the exchange did not converge")
    return float(np.sum(first.ledger()["pairs"] + second.ledger()["pairs"]))


def joined(first, second, n, k, exchanged):
    """End state and largest created work of n steps."""
    h, created = END / n, 0.0
    for s in range(n):
        created = max(created, abs(converge(first, second, s * h, h, k, nodes(k).b, exchanged)))
    return created


@pytest.mark.parametrize(
    ("exchanged", "k", "order"), [("nodes", 2, 4), ("nodes", 3, 6), ("means", 2, 2), ("means", 3, 2)]
)
def test_two_components_keep_order_2k_only_if_they_exchange_node_values(exchanged, k, order):
    counts = (10, 15, 22)
    errors = []
    for n in counts:
        one, two = NativeInstance(plan("body", k)), NativeInstance(plan("spring", k))
        assert joined(one, two, n, k, exchanged) <= 1e-13
        errors.append(np.max(abs(np.append(one.x, two.x) - joined_exact())))
    assert slope([END / n for n in counts], errors) == pytest.approx(order, abs=0.3)


def test_two_units_keep_order_four(units):
    counts, errors = (15, 22, 30), []
    with FMUInstance(units("body", 2, "3.0")) as one, FMUInstance(units("spring", 2, "2.0")) as two:
        for n in counts:
            one.reset()
            two.reset()
            assert joined(one, two, n, 2, "nodes") <= 1e-13
            errors.append(np.max(abs(np.append(one.get(["q", "v"]), two.get(["x"])) - joined_exact())))
    assert slope([END / n for n in counts], errors) == pytest.approx(4.0, abs=0.3)


def test_node_inputs_need_more_than_one_node(tmp_path, capsys):
    with pytest.raises(FMUError, match="body: a step of order 2 has one node.*order 4 or 6"):
        export(plan("body", 1), tmp_path, step=0.1, node_inputs=True)
    assert main(["export", "mass", "--node-inputs", "--step", "0.1", "-o", str(tmp_path)]) == 2
    assert "order 4 or 6" in capsys.readouterr().err
