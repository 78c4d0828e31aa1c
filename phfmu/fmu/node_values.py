"""A group of variables: inputs of external ports at the nodes of a step, and the outputs conjugate to them."""

from __future__ import annotations

from collections.abc import Iterator

from phfmu.discretise.model import Model
from phfmu.fmu.variables import FMUError
from phfmu.signals import Quantity, entries, ordered_ports


def require_nodes(model: Model) -> None:
    """FMUError if a step has one node only."""
    if model.step.k == 1:
        raise FMUError(
            f"{model.name}: a step of order {model.scheme.order} has one node, its inputs are the held ones; inputs at "
            "the nodes need order 4 or 6"
        )


def node_values(model: Model) -> Iterator[Quantity]:
    """Inputs of power ports and signals, then outputs, at the nodes."""
    plan = model.step
    free = [(p, first) for p, first in ordered_ports(model.declaration) if p.external]
    for port, first in free:
        if port.sends:
            continue
        nominal = entries(port.nominal, port.n)
        for j, names in enumerate(port.node_input_names(plan.k)):
            for i, name in enumerate(names):
                yield Quantity(
                    name, "input", "node_input", i * plan.nu + first + j, 1, float(model.u0[first + j]), port.input_unit,
                    abs(nominal[j]) or None, f"{port.input_names()[j]} at t + {model.nodes[i]:.9g} h of the next step",
                )  # fmt: skip
    ports = {n for port, _ in free if not port.signal for n in port.output_names()}
    for port, first in free:
        if port.signal and (not port.sends or {*port.output_names()} <= ports):  # outputs of ports are there already
            continue
        for j, names in enumerate(port.node_output_names(plan.k)):
            for i, name in enumerate(names):
                yield Quantity(
                    name, "output", "node_output", i * plan.nq + first + j, 1, None, port.output_unit,
                    description=f"{port.output_names()[j]} at t + {model.nodes[i]:.9g} h of the last step",
                )  # fmt: skip
