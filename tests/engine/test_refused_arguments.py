"""Arguments that instances refuse: values that are not finite, wrong shapes, steps without parts; both engines."""

from __future__ import annotations

import numpy as np
import pytest

from tests.engine.library_models import ERRORS, plan, start
from tests.engines import ENGINES

# -- refused arguments -----------------------------------------------------------------------------


def refused(instance, what, *words):
    """`what` raises an error with the model's name and the words, and changes nothing."""
    before = {n: v.tobytes() for n, v in instance.signals().items()}
    with pytest.raises(ERRORS) as error:
        what()
    for word in (instance.model.name, *words):
        assert word in str(error.value)
    assert before == {n: v.tobytes() for n, v in instance.signals().items()}


BAD_VALUES = {
    "input": lambda i, bad: i.set_input([1.0, bad]),
    "node input": lambda i, bad: i.set_node_inputs([[1.0, 0.0], [bad, 0.0]]),
    "parameter": lambda i, bad: i.set_parameters([bad, *i.parameters[1:]]),
    "state": lambda i, bad: i.set_x(0.0, [bad, 0.0]),
    "time": lambda i, bad: i.do_step(bad, 1e-4),
}
BAD_SHAPES = {
    "short input": lambda i: i.set_input([1.0]),
    "scalar input": lambda i: i.set_input(1.0),
    "table of inputs": lambda i: i.set_input([[1.0, 2.0]]),
    "one node": lambda i: i.set_node_inputs([[1.0, 2.0]]),
    "flat nodes": lambda i: i.set_node_inputs(np.zeros(4)),
    "wide nodes": lambda i: i.set_node_inputs(np.zeros((2, 3))),
    "parameters": lambda i: i.set_parameters([1.0]),
    "state": lambda i: i.set_x(0.0, [1.0]),
    "run": lambda i: i.run(0.0, 1e-4, 3, inputs=np.zeros((2, 2))),
}


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("what", BAD_VALUES)
def test_values_that_are_not_finite_are_refused(engine, what):
    instance = start(engine(plan("dc_motor", 2)))
    instance.do_step(0.0, 1e-4)
    for bad in (np.nan, np.inf, -np.inf):
        refused(instance, lambda bad=bad: BAD_VALUES[what](instance, bad))


@pytest.mark.parametrize("engine", ENGINES)
def test_a_run_refuses_an_input_that_is_not_finite(engine):
    instance = start(engine(plan("dc_motor", 2)))
    with pytest.raises(ERRORS, match="not finite"):
        instance.run(0.0, 1e-4, 3, ("x",), inputs=[[1.0, 0.0], [np.nan, 0.0], [1.0, 0.0]])
    assert instance.time == pytest.approx(1e-4)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("what", BAD_SHAPES)
def test_wrong_shapes_are_refused(engine, what):
    instance = start(engine(plan("dc_motor", 2)))
    refused(instance, lambda: BAD_SHAPES[what](instance))


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("h", [np.nan, np.inf, -np.inf])
def test_steps_that_are_not_finite_are_refused(engine, h):
    instance = start(engine(plan("dc_motor", 2)))
    instance.do_step(0.0, 1e-4)
    refused(instance, lambda: instance.do_step(1e-4, h), "step must be finite")
    refused(instance, lambda: instance.run(1e-4, h, 3), "step must be finite")
    instance.do_step(1e-4, 1e-4)
    assert instance.counts["steps"] == 2


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("parts", [0, -1])
def test_a_step_of_no_parts_is_refused(engine, parts):
    instance = start(engine(plan("dc_motor", 2)))
    refused(instance, lambda: instance.do_step(0.0, 1e-4, parts=parts))
