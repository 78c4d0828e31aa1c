"""The variables of an exported unit: one table from which descriptions, terminals and C text are written."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from phfmu.declare.parameter_limits import Limit, limits
from phfmu.declare.phdae import PHDAE
from phfmu.declare.port import Port
from phfmu.declare.variable import Number, Variable
from phfmu.discretise.model import Model
from phfmu.fmu.words import plain

Causality = Literal["independent", "parameter", "input", "output", "local"]

#: one part of a structured name of the standard: letters, digits and _, then indices
_PART = r"[A-Za-z_][A-Za-z_0-9]*(\[[0-9]+(,[0-9]+)*\])?"
_NAME = re.compile(rf"{_PART}(\.{_PART})*")


class FMUError(RuntimeError):
    """A unit cannot be written, read or stepped; the message names the numbers and the remedy."""


@dataclass(frozen=True)
class FMUVariable:
    """One scalar of type Real (2.0) or Float64 (3.0).

    Its value is the sum of `count` entries of the runtime's `block` from `first` on: a `ph_block` of phfmu.h
    or a place of fmu.h.  `start` is None if calculated; `unit` "1", `nominal` None and limits that are not there are not
    written.
    """

    name: str
    causality: Causality
    block: str
    first: int
    count: int = 1
    start: float | None = None
    unit: str = "1"
    nominal: float | None = None
    description: str = ""
    limit: Limit | None = None

    @property
    def variability(self) -> str:
        return "fixed" if self.causality == "parameter" else "continuous"

    @property
    def initial(self) -> str | None:
        """exact: given by `start`; calculated: by the model; inputs and time have none."""
        if self.causality in ("input", "independent"):
            return None
        return "calculated" if self.start is None else "exact"

    @property
    def depends_on_inputs(self) -> bool:
        """False if a new input changes the value only after the next step."""
        return self.block not in _OF_STATE


#: energies, which no input changes before the next step
_OF_STATE = ("PH_ENERGY", "PH_H", "PH_SUPPLIED", "PH_DISSIPATED", "PH_RESIDUAL", "FMU_GAP")
#: where outputs of the ledger and residuals of constraints come from: to be looked at, not to be connected
_BOOKS = (*_OF_STATE, "PH_OBSERVABLES")


def variables(model: Model, node_inputs: bool = False, ledger_outputs: bool = True) -> tuple[FMUVariable, ...]:
    """All variables; the place is the value reference.  FMUError lists illegal and repeated names.

    `node_inputs`: port inputs and outputs at the k nodes of a step too; they come last.  `ledger_outputs`: energies and
    residuals of constraints are outputs, else local variables.
    """
    table = (
        FMUVariable("time", "independent", "PH_X", model.step.nx, unit="s", description="time"),
        *_parameters(model),
        *_ports(model),
        *_totals(model),
        *_starts(model.declaration.states, "local", "PH_X", list(model.x0)),
        *_algebraics(model),
        *_observables(model),
        *_checks(model),
        *(_nodes(model) if node_inputs else ()),
    )
    table = tuple(replace(v, description=plain(v.description)) for v in table)
    if not ledger_outputs:
        table = tuple(
            replace(v, causality="local") if v.causality == "output" and v.block in _BOOKS else v for v in table
        )
    problems = _problems(table)
    if problems:
        raise FMUError(f"{model.name}: " + "; ".join(problems))
    return table


def _problems(table: tuple[FMUVariable, ...]) -> list[str]:
    found = [f"'{v.name}' is no structured name (write e.g. gen.I[1])" for v in table if not _NAME.fullmatch(v.name)]
    seen: set[str] = set()
    for v in table:
        if v.name in seen:
            found.append(f"two variables are called '{v.name}'")
        seen.add(v.name)
    return found


def _scalars(declared: tuple[Variable, ...]) -> Iterator[tuple[int, str, str, Variable, int]]:
    """(place, name, description, variable, entry) of every scalar."""
    place = 0
    for v in declared:
        for i, name in enumerate(v.names()):
            text = v.description or f"{v.role} {v.name}"
            yield place, name, text if v.size is None else f"{text}, entry {i + 1}", v, i
            place += 1


def _starts(declared: tuple[Variable, ...], causality: Causality, block: str, start: list[float]) -> list[FMUVariable]:
    return [
        FMUVariable(name, causality, block, i, 1, float(start[i]), v.unit, _nominal(v, j), text)
        for i, name, text, v, j in _scalars(declared)
    ]


def _parameters(model: Model) -> list[FMUVariable]:
    limit = limits(model.declaration)
    made = _starts(model.declaration.parameters, "parameter", "FMU_PARAMETER", list(model.p0))
    return [replace(v, limit=limit.get(v.name)) for v in made]


def _nominal(v: Variable, entry: int) -> float | None:
    """Parameters have no nominal value of their own."""
    return None if v.role == "parameter" or not v.nominal[entry] else abs(v.nominal[entry])


def _algebraics(model: Model) -> Iterator[FMUVariable]:
    what = "carried on by the scheme" if model.step.carries else "mean of the last step"
    for i, name, text, v, j in _scalars(model.declaration.algebraics):
        yield FMUVariable(name, "local", "PH_A", i, 1, None, v.unit, _nominal(v, j), f"{text}, {what}")
    for i, name, text, v, j in _scalars(model.declaration.algebraics):
        yield FMUVariable(
            end_name(name),
            "local",
            "PH_A_END",
            i,
            1,
            None,
            v.unit,
            _nominal(v, j),
            f"{text}, at the present time",
        )


def end_name(name: str) -> str:
    """lambda[1] -> lambda_end[1]."""
    base, bracket, index = name.partition("[") if "[" in name.rsplit(".", 1)[-1] else (name, "", "")
    return f"{base}_end{bracket}{index}"


def ordered_ports(declaration: PHDAE) -> list[tuple[Port, int]]:
    """Ports with the place of their first scalar pair: external ones first, then those fed from inside."""
    result, place = [], 0
    for external in (True, False):
        for port in declaration.ports:
            if port.external == external:
                result.append((port, place))
                place += port.n
    return result


#: suffix, block and time of the outputs of a port
OUTPUTS = (("", "PH_Y_END", "at the present time"), ("_step", "PH_Y_STEP", "mean of the last step"))


def _ports(model: Model) -> Iterator[FMUVariable]:
    for port, first in ordered_ports(model.declaration):
        flow, effort = port.domain.flow, port.domain.effort
        given, found = (effort, flow) if port.given == "effort" else (flow, effort)
        text = f"of port {port.name}" + (f" ({port.description})" if port.description else "")
        causality: Causality = "output" if port.external else "local"
        if port.external:
            nominal = _entries(port.nominal, port.n)
            for i, name in enumerate(port.input_names()):
                yield FMUVariable(
                    name, "input", "FMU_INPUT", first + i, 1, float(model.u0[first + i]), port.input_unit,
                    abs(nominal[i]) or None, f"{given} {text}, held over a step",
                )  # fmt: skip
        for suffix, block, when in OUTPUTS:
            for i, name in enumerate(port.output_names(suffix)):
                about = f"{found} {text}, {when}"
                yield FMUVariable(name, causality, block, first + i, 1, None, port.output_unit, description=about)
        about = f"energy {text}, supplied since the start"
        yield FMUVariable(f"{port.name}.energy", causality, "PH_ENERGY", first, port.n, None, "J", description=about)


def _nodes(model: Model) -> Iterator[FMUVariable]:
    """Inputs of external ports at the nodes of a step, then the outputs conjugate to them."""
    plan = model.step
    if plan.k == 1:
        raise FMUError(
            f"{model.name}: a step of order {model.scheme.order} has one node, its inputs are the held ones; inputs at "
            "the nodes need order 4 or 6"
        )
    free = [(p, first) for p, first in ordered_ports(model.declaration) if p.external]
    for port, first in free:
        nominal = _entries(port.nominal, port.n)
        for j, names in enumerate(port.node_input_names(plan.k)):
            for i, name in enumerate(names):
                yield FMUVariable(
                    name, "input", "FMU_NODE_INPUT", i * plan.nu + first + j, 1, float(model.u0[first + j]), port.input_unit,
                    abs(nominal[j]) or None, f"{port.input_names()[j]} at t + {model.nodes[i]:.9g} h of the next step",
                )  # fmt: skip
    for port, first in free:
        for j, names in enumerate(port.node_output_names(plan.k)):
            for i, name in enumerate(names):
                yield FMUVariable(
                    name, "output", "FMU_NODE_OUTPUT", i * plan.nq + first + j, 1, None, port.output_unit,
                    description=f"{port.output_names()[j]} at t + {model.nodes[i]:.9g} h of the last step",
                )  # fmt: skip


def _entries(value: Number, n: int) -> list[float]:
    return np.broadcast_to(np.asarray(value, float), (n,)).tolist()


#: name, block and meaning of the entries of the energy ledger
LEDGER = (
    ("stored", "PH_H", "stored energy"),
    ("supplied", "PH_SUPPLIED", "energy supplied through ports since the start"),
    ("dissipated", "PH_DISSIPATED", "energy dissipated since the start"),
    (
        "residual",
        "PH_RESIDUAL",
        "change of stored + dissipated - supplied energy since the start",
    ),
    ("gap", "FMU_GAP", "change of stored energy since the start that the ledgers of the steps do not explain"),
)
#: the same of one communication step, free of the cancellation of differences
STEP_LEDGER = (
    ("stored_step", "FMU_ROW_STORED", "change of stored energy in the last step"),
    ("supplied_step", "FMU_ROW_SUPPLIED", "energy supplied through ports in the last step"),
    ("dissipated_step", "FMU_ROW_DISSIPATED", "energy dissipated in the last step"),
    ("moved_step", "FMU_ROW_MOVED", "sum over the energies of |change| in the last step"),
)


def _totals(model: Model) -> Iterator[FMUVariable]:
    n = model.step.ncomp
    for name, block, text in LEDGER:
        yield FMUVariable(f"energy.{name}", "output", block, 0, n, None, "J", description=text)
    for name, block, text in STEP_LEDGER:
        yield FMUVariable(f"energy.{name}", "local", block, 0, n, None, "J", description=text)
    if n == 1:
        return
    for i, member in enumerate(model.members):
        for name, block, text in LEDGER if member else ():
            yield FMUVariable(
                f"{member}.energy.{name}", "local", block, i, 1, None, "J", description=f"{member}: {text}"
            )


def _observables(model: Model) -> Iterator[FMUVariable]:
    place = 0
    for o in model.declaration.observables:
        for i in range(o.expr.numel()):
            name = model.observable_names[place]
            text = o.description or f"observable {o.name}"
            text = text if o.expr.numel() == 1 else f"{text}, entry {i + 1}"
            yield FMUVariable(name, "local", "PH_OBSERVABLES", place, 1, None, o.unit, description=text)
            place += 1


def _checks(model: Model) -> Iterator[FMUVariable]:
    first = len(model.observable_names)
    for i, (name, check) in enumerate(zip(check_names(model), model.checks, strict=True)):
        text = f"residual of the hidden constraint of {check.name}, {check.level} level"
        yield FMUVariable(name, "output", "PH_OBSERVABLES", first + i, description=text)


def check_names(model: Model) -> list[str]:
    """constraint.velocity.lambda[1], constraint.position.lambda[1], ... in the order of the checks."""
    return [f"constraint.{check.level}.{check.name}" for check in model.checks]
