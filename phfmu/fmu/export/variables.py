"""The variables of an exported unit: one table from which descriptions, terminals and C text are written."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace

from phfmu.declare.entries.parameter_limits import ParameterLimit, limits
from phfmu.discretise.model import Model
from phfmu.fmu.words import plain
from phfmu.signals import MODE, Quantity, quantities

#: one part of a structured name of the standard: letters, digits and _, then indices
_PART = r"[A-Za-z_][A-Za-z_0-9]*(\[[0-9]+(,[0-9]+)*\])?"
_NAME = re.compile(rf"{_PART}(\.{_PART})*")


class FMUError(RuntimeError):
    """A unit cannot be written, read or stepped; the message names the numbers and the remedy."""


@dataclass(frozen=True)
class FMUVariable(Quantity):
    """One scalar of type Real (2.0) or Float64 (3.0).

    `block` is a `ph_block` of phfmu.h or a place of fmu.h by its name there.  Unit "1", nominal None and limits that are not
    there are not written.  `sign`: -1 where the unit tells the negative of what is in the block.
    """

    limit: ParameterLimit | None = None
    sign: int = 1

    @property
    def variability(self) -> str:
        if self.block in ("FMU_MODE", "FMU_HAPPENED"):
            return "discrete"
        if self.causality != "parameter":
            return "continuous"
        return "tunable" if self.block == "FMU_TUNABLE" else "fixed"

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


#: places of fmu.h; the others are blocks of phfmu.h
_OF_UNITS = (
    *("parameter", "tunable", "input", "node_input", "node_output", "impulse", "jump", "gap", "jumped"),
    *("mode", "happened", "joined"),
    *("row_stored", "row_supplied", "row_dissipated", "row_moved", "row_pairs"),
)
#: energies, which no input changes before the next step
_OF_STATE = (
    "PH_ENERGY",
    "PH_H",
    "PH_SUPPLIED",
    "PH_DISSIPATED",
    "PH_RESIDUAL",
    "FMU_GAP",
    "FMU_JUMPED",
    "FMU_HAPPENED",
)
#: where outputs of the ledger and residuals of constraints come from: to be looked at, not to be connected
_BOOKS = (*_OF_STATE, "PH_OBSERVABLES")


#: what a unit has beside the quantities of its model, e.g. `node_values`
Group = Callable[[Model], Iterable[Quantity]]


def variables(
    model: Model, groups: Sequence[Group] = (), ledger_outputs: bool = True, tunable: Collection[str] = ()
) -> tuple[FMUVariable, ...]:
    """All variables; the place is the value reference.  FMUError lists illegal and repeated names.

    `groups` come last, so that the references of the others stay.  `ledger_outputs`: energies and residuals of
    constraints are outputs, else local variables.  `tunable`: scalar names of parameters that may change between steps.
    """
    limit, modes = limits(model.declaration), {*model.declaration.modes}
    told = (*(q for q in quantities(model) if q.name not in modes), *(q for group in groups for q in group(model)))
    pairs = [
        (q, limit.get(q.name.removeprefix(MODE)) if q.block in ("parameter", "tunable", "mode") else None) for q in told
    ]
    signals = {n for o in model.declaration.observables if o.signal for n in o.names()}
    return listed(model.name, pairs, ledger_outputs, tunable, signals)


def listed(
    name: str,
    told: Iterable[tuple[Quantity, ParameterLimit | None]],
    ledger_outputs: bool,
    tunable: Collection[str],
    signals: Collection[str],
) -> tuple[FMUVariable, ...]:
    """The variables of the unit `name` with their limits; `signals`: outputs that stay such.  FMUError as of `variables`."""
    table = tuple(
        _written(replace(q, block="tunable") if q.name in tunable and q.block == "parameter" else q, limit)
        for q, limit in told
    )
    if not ledger_outputs:
        table = tuple(
            replace(v, causality="local")
            if v.causality == "output" and v.block in _BOOKS and v.name not in signals
            else v
            for v in table
        )
    problems = _problems(table)
    if problems:
        raise FMUError(f"{name}: " + "; ".join(problems))
    return table


def value_name(model: Model, name: str) -> str:
    """The variable of a parameter: those that state events set are no parameters of a unit, which are fixed or tunable."""
    return MODE + name if name in model.declaration.modes else name


def _written(q: Quantity, limit: ParameterLimit | None) -> FMUVariable:
    """A quantity as a unit tells it."""
    block = f"FMU_{q.block.upper()}" if q.block in _OF_UNITS else f"PH_{q.block.upper()}"
    return FMUVariable(
        q.name, q.causality, block, q.first, q.count, q.start, q.unit, q.nominal, plain(q.description), limit
    )


def writable_name(name: str) -> bool:
    """Whether it is a structured name of the standard, which a unit can have."""
    return bool(_NAME.fullmatch(name))


def _problems(table: tuple[FMUVariable, ...]) -> list[str]:
    found = [f"'{v.name}' is no structured name (write e.g. gen.I[1])" for v in table if not writable_name(v.name)]
    seen: set[str] = set()
    for v in table:
        if v.name in seen:
            found.append(f"two variables are called '{v.name}'")
        seen.add(v.name)
    return found
