"""Port values at the nodes of a step: order 2k where means give order 2, in the engines, in FMUs, between members."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from fmpy.validation import validate_fmu
from scipy.integrate import solve_ivp

from phfmu import (
    PHDAE,
    TRANSLATIONAL,
    Collocated,
    FMUInstance,
    NativeInstance,
    Port,
    build_model,
    damping,
    energy,
    export,
    parameter,
    skew,
    state,
)
from phfmu.cli import main
from phfmu.fmu.values import Derivative
from phfmu.fmu.variables import FMUError
from phfmu.fmu.version import FMI3
from phfmu.gradients.quadrature import nodes
from tests.engines import ENGINES
from tests.wide import wide

M, K, D, K2, END = 1.3, 4.0, 0.2, 2.5, 1.5
START = (0.4, -0.3, 0.2)


def body(size: int | None = None) -> PHDAE:
    """A mass on a hardening spring with a force port (vector or scalar)."""
    q, v = state("q", size, unit="m", start=START[0]), state("v", size, unit="m/s", start=START[1])
    m = parameter("m", M, unit="kg")
    n = q.n
    return PHDAE(
        "body",
        states=(q, v),
        parameters=(m,),
        energies=tuple(energy(K * (q[i] ** 2 / 2 + q[i] ** 4 / 4)) for i in range(n))
        + tuple(energy(m * v[i] ** 2 / 2) for i in range(n)),
        E={v: m},
        structure=(skew(q, v, 1.0),),
        dissipation=(damping(v, D),),
        ports=(Port("flange", TRANSLATIONAL, "effort", {v: 1.0}, size=size),),
    )


def spring() -> PHDAE:
    """x' = velocity, force K2 (x + x^3) on the joint."""
    x = state("x", unit="m", start=START[2])
    return PHDAE(
        "spring",
        states=(x,),
        energies=(energy(K2 * (x**2 / 2 + x**4 / 4)),),
        ports=(Port("end", TRANSLATIONAL, "flow", {x: 1.0}),),
    )


def force(t):
    return 3.0 * np.sin(4.0 * t) + np.exp(-t)


@cache
def driven_exact():
    rate = lambda t, x: [x[1], (force(t) - K * (x[0] + x[0] ** 3) - D * x[1]) / M]  # noqa: E731
    return solve_ivp(rate, (0.0, END), START[:2], "DOP853", rtol=3e-14, atol=1e-15).y[:, -1]


@cache
def joined_exact():
    def rate(_, x):
        q, v, s = x
        return [v, (-K2 * (s + s**3) - K * (q + q**3) - D * v) / M, v]

    return solve_ivp(rate, (0.0, END), START, "DOP853", rtol=3e-14, atol=1e-15).y[:, -1]


def slope(steps, errors):
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])


@cache
def plan(name: str, k: int, size: int | None = None):
    return build_model(body(size) if name == "body" else spring(), Collocated(k))


@pytest.fixture(scope="module")
def units(tmp_path_factory):
    """(name, k, version) -> path of a unit with node inputs, step 0.1 s."""
    made: dict[tuple[str, int, int | None], dict[str, Path]] = {}

    def get(name: str, k: int, version: str, size: int | None = None) -> Path:
        if (name, k, size) not in made:
            model, folder = plan(name, k, size), tmp_path_factory.mktemp(name)
            paths = export(model, folder, step=0.1, node_inputs=True)
            made[name, k, size] = dict(zip(("2.0", "3.0"), paths, strict=True))
        return made[name, k, size][version]

    return get


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


# -- units ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize("k", wide([2, 3], 2))
def test_a_unit_driven_by_node_values_equals_the_native_engine(units, version, k):
    model, h, n = plan("body", k, 2), 0.1, 20
    path = units("body", k, version, 2)
    assert validate_fmu(str(path)) == []
    native = NativeInstance(model)
    with FMUInstance(path) as unit:
        assert unit.nodes == pytest.approx(model.nodes, rel=1e-15)
        for s in range(n):
            u = np.column_stack([force(h * (s + model.nodes)), -(force(h * (s + model.nodes)) ** 2)])
            for instance in (unit, native):
                instance.set_node_inputs(u)
                instance.do_step(s * h, h)
            x = unit.get([f"{v}[{i}]" for v in "qv" for i in (1, 2)])
            assert x == pytest.approx(native.x, rel=1e-11)
            assert unit.node_output() == pytest.approx(native.node_output(), rel=1e-11)
            assert unit.ledger()["pairs"] == pytest.approx(native.ledger()["pairs"], rel=1e-11)
            assert unit.get(["flange.force_node[2,1]"])[0] == u[0, 1]
            assert unit.get(["flange.force[2]"])[0] == pytest.approx(model.step.weights @ u[:, 1], rel=1e-15)
        residual, moved = unit.get(["energy.residual", "energy.supplied"])
        assert abs(residual) <= 1e-13 * (1 + abs(moved))


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_a_unit_driven_by_node_values_has_order_four(units, version):
    """Internal steps of at most 0.1 s see the polynomial through the node values of the communication step."""
    counts, errors = (15, 22, 30), []
    c = nodes(2).c
    with FMUInstance(units("body", 2, version)) as unit:
        for n in counts:
            unit.reset()
            for s in range(n):
                unit.set_node_inputs(force(END / n * (s + c))[:, None])
                unit.do_step(s * END / n, END / n)
            errors.append(np.max(abs(unit.get(["q", "v"]) - driven_exact())))
    assert slope([END / n for n in counts], errors) == pytest.approx(4.0, abs=0.2)


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_inputs_that_are_never_set_at_nodes_are_held_and_what_is_set_last_counts(units, version):
    model, h = plan("body", 2), 0.1
    native = NativeInstance(model)
    with FMUInstance(units("body", 2, version)) as unit:
        for s, held in enumerate((True, True, False, False, True)):
            for instance in (unit, native):
                if held:
                    instance.set_input([1.0 + s])
                elif s == 2:  # stays for the next step
                    instance.set_node_inputs([[0.5], [2.0]])
                instance.do_step(s * h, h)
            assert unit.get(["q", "v"]) == pytest.approx(native.x, rel=1e-15)
            if held:
                assert (unit.output() == native.output()).all()
                assert unit.sensitivity() == pytest.approx(native.sensitivity(), rel=1e-12)
        saved = unit.get_state()
        unit.set_node_inputs([[0.5], [2.0]])
        unit.do_step(0.5, h)
        twice = unit.get_state()
        pairs, nodes_y = unit.ledger()["pairs"], unit.node_output()
        unit.set_state(saved)
        unit.do_step(0.5, h)
        assert abs(unit.ledger()["pairs"] - pairs) > 1e-6
        unit.set_state(twice)
        assert (unit.node_output() == nodes_y).all() and (unit.ledger()["pairs"] == pairs).all()


def test_units_without_node_inputs_have_no_trace_of_them(tmp_path):
    model = plan("body", 2)
    (path,) = export(model, tmp_path, ("3.0",), step=0.1)
    with FMUInstance(path) as unit:
        assert not [n for n in unit.interface.variables if "_node" in n] and unit.nodes.size == 0
        with pytest.raises(FMUError, match="export it with --node-inputs"):
            unit.set_node_inputs([[0.0], [0.0]])


def test_node_inputs_need_more_than_one_node(tmp_path, capsys):
    with pytest.raises(FMUError, match="body: a step of order 2 has one node.*order 4 or 6"):
        export(plan("body", 1), tmp_path, step=0.1, node_inputs=True)
    assert main(["export", "mass", "--node-inputs", "--step", "0.1", "-o", str(tmp_path)]) == 2
    assert "order 4 or 6" in capsys.readouterr().err


def test_wrong_node_inputs_are_refused(units):
    with FMUInstance(units("body", 2, "3.0")) as unit:
        for bad in ([[1.0]], [1.0, 2.0], [[1.0], [np.nan]]):
            with pytest.raises(ValueError, match="2 x 1 finite inputs"):
                unit.set_node_inputs(bad)
        unit.do_step(0.0, 0.1)
        with pytest.raises(
            FMUError, match="'flange.velocity_step' is neither an output at a node nor one at the present"
        ):
            means = unit._slave.references(unit.interface.scalars(["flange.velocity_step"], "variable"))
            unit._slave.derivative(Derivative(means, unit.variable("flange.force_node[1]"), FMI3))


def test_export_from_the_command_line(tmp_path, capsys):
    arguments = ["export", "rlc_load", "--node-inputs", "--order", "4", "--step", "1e-4", "--fmi", "3"]
    assert main([*arguments, "-o", str(tmp_path)]) == 0
    with FMUInstance(capsys.readouterr().out.strip()) as unit:
        assert {"terminal.i_node[3,2]", "terminal.v_node[3,2]"} <= set(unit.interface.variables)
        assert unit.nodes == pytest.approx([0.5 - 3**0.5 / 6, 0.5 + 3**0.5 / 6], rel=1e-15)
