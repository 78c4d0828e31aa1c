"""Signals: named inputs and outputs without power (a duty, a valve, a set point, a measured speed).

A signal input is a parameter that others feed: it may stand in J, R, B, in sources and observables.  It is held over a step,
and does no work by itself.  A signal output is an observable that others may read.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import casadi as ca

from phfmu.declare.observable import Observable, observable
from phfmu.declare.phdae import PHDAE
from phfmu.declare.port import DRIVE, Port
from phfmu.declare.variable import Number, Variable, parameter


def signal_input(
    name: str,
    start: Number = 0.0,
    size: int | None = None,
    *,
    unit: str = "1",
    min: Number | None = None,
    max: Number | None = None,
    description: str = "",
) -> Variable:
    """An input without power, listed among the `parameters`; `start`: its value before anyone sets it; limits as there."""
    return replace(parameter(name, start, size, unit=unit, min=min, max=max, description=description), signal=True)


def signal_output(name: str, expr: Any, *, unit: str = "1", description: str = "") -> Observable:
    """An observable that networks connect to signal inputs; an output of units."""
    return replace(observable(name, expr, unit=unit, description=description), signal=True)


def signal_inputs(model: PHDAE) -> dict[str, str]:
    """Scalar name -> unit of all signal inputs."""
    return {n: v.unit for v in model.parameters if v.signal for n in v.names()}


def driven(name: str, on: dict[Variable, Any], *, description: str = "", owner: str = "") -> Port:
    """A port that puts the expressions `on` (variable -> right-hand side) on the rows of variables, and books their work.

    E x' = .. + f(x, z, p, t), y = f^T z, its power in W; 0 on a state without energy, such as that of a controller.
    """
    return Port(name, DRIVE, "flow", on, source=1.0, description=description, owner=owner)


def read_by(expr: ca.SX, inputs: Sequence[ca.SX]) -> list[int]:
    """The scalar symbols among `inputs` that an expression depends on as it stands (feedthrough)."""
    there = {s.element_hash() for s in ca.symvar(expr)}
    return [i for i, s in enumerate(inputs) if s.element_hash() in there]
