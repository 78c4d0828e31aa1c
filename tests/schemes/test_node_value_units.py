"""Units with port values at the nodes of a step."""

from __future__ import annotations

import numpy as np
import pytest
from fmpy.validation import validate_fmu

from phfmu import (
    FMUInstance,
    NativeInstance,
    export,
)
from phfmu.cli import main
from phfmu.fmu.export.variables import FMUError
from phfmu.fmu.importer.values import Derivative
from phfmu.fmu.version import FMI3
from phfmu.gradients.quadrature import nodes
from tests.schemes.body_and_spring import END, driven_exact, force, plan, slope
from tests.wide import wide


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
