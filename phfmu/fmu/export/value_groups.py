"""Value groups of a unit beside the quantities of its model.

Inputs of external ports at the nodes of a step and the outputs conjugate to them; impulses at its ends, what they change,
and the energy of each pair, of ports that take some (names and order are those of `engine/impulses.py`); what is constant in H.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from phfmu.declare.expressions.units import parse_unit, unit_text
from phfmu.declare.observable import observable
from phfmu.discretise.constant_energy import Constants
from phfmu.discretise.model import Model, build_model
from phfmu.engine.impulses import PortKernels, port_kernels
from phfmu.fmu.export.variables import FMUError
from phfmu.signals import CONSTANT, Quantity, entries, ordered_ports, pair_energies, total


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


#: local variables with S = L^T H'' L
JUMP = "impulse.jump"


def kernels_of(model: Model) -> PortKernels | None:
    """The impulses of a model's ports; None if its scheme or its ports take none."""
    if not model.scheme.impulses or model.step.nu == 0:
        return None
    found = port_kernels(model.declaration)
    return found if found.n else None


def require_kernels(model: Model) -> PortKernels:
    """The same; FMUError says of each port why it takes none."""
    found = kernels_of(model)
    if found is None:
        ports = port_kernels(model.declaration).forms.ports
        why = "; ".join(f"{p.port}: {p.reason}" for p in ports if p.reason) or f"scheme {model.scheme.name}"
        raise FMUError(f"{model.name}: no port takes impulses ({why}); leave out --impulses")
    return found


def impulse_values(model: Model) -> Iterator[Quantity]:
    """Inputs (start and end of the coming step), the lower triangle of S, energies of all external pairs in the last step."""
    kernels = require_kernels(model)
    n = kernels.n
    order = {pair: i for i, pair in enumerate(kernels.forms.pairs)}
    inputs, outputs = [""] * n, [""] * n
    free = [(p, first) for p, first in ordered_ports(model.declaration) if p.external and not p.signal]
    for port, first in free:
        for j, names in enumerate(port.impulse_names()):
            if (place := order.get(first + j)) is None:
                continue
            inputs[place], outputs[place] = port.input_unit, port.output_unit
            for end, name in enumerate(names):
                about = f"impulse of {port.input_names()[j]} at the {('start', 'end')[end]} of the coming step"
                unit = _times_second(port.input_unit)
                yield Quantity(name, "input", "impulse", end * n + place, 1, 0.0, unit, description=about)
    for i in range(n):
        for j in range(i + 1):
            yield Quantity(
                f"{JUMP}[{i + 1},{j + 1}]", "local", "jump", i * n + j, 1, None, _per_impulse(outputs[i], inputs[j]),
                description=f"change of output {i + 1} of those with impulses by impulse {j + 1}, at the present time",
            )  # fmt: skip
    for port, first in free:
        for j, name in enumerate(pair_energies(port)):
            about = f"energy through {port.input_names()[j]} in the last step, impulses included"
            yield Quantity(name, "local", "row_pairs", first + j, 1, None, "J", description=about)


def _times_second(unit: str) -> str:
    """V -> V.s;  what stands behind a stroke divides: m/s -> s.m/s."""
    return f"s.{unit}" if "/" in unit else f"{unit}.s"


def _per_impulse(output: str, given: str) -> str:
    if "/" not in given:
        return f"{output}/({given}.s)"
    y, s = parse_unit(output), parse_unit(_times_second(given))
    exponents = [a - b for a, b in zip(y.without_angle(), s.without_angle(), strict=True)]
    return unit_text(exponents, y.factor / s.factor)


def telling_constant(model: Model) -> Model:
    """The model, with `energy.constant` among its observables where parameters can make such an energy, for a unit to tell."""
    expression = Constants(model).expression
    if expression.is_zero():
        return model
    told = observable(total(CONSTANT), expression, unit="J", description="stored energy that no state enters")
    declaration = model.declaration
    return build_model(replace(declaration, observables=(*declaration.observables, told)), model.scheme)
