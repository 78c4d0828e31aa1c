"""The common part of the descriptions of all versions: the unit, its units, names and dates, how to build it."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import ClassVar

import casadi as ca

from phfmu.declare.expressions.units import BASE, parse_unit
from phfmu.declare.phdae import PHDAE
from phfmu.discretise.model import Model, require_model
from phfmu.engine.impulses import PortKernels
from phfmu.fmu.export.outward import require_ports, turned
from phfmu.fmu.export.schedule import UnitEvent
from phfmu.fmu.export.value_groups import impulse_values, kernels_of, node_values, require_kernels, require_nodes
from phfmu.fmu.export.variables import FMUVariable, variables
from phfmu.fmu.words import plain
from phfmu.fmu.xml import Element, etree, number, text_of
from phfmu.signals import MEAN, check_names, jumps, state_events

#: category of messages -> its description
LOG_CATEGORIES = {
    "logStatusError": "calls that were refused, with the numbers and the next move",
    "logNonlinearSystems": "steps that had to be halved",
}


@dataclass(frozen=True)
class ArraySpan:
    """An array: its name and number of entries, which are consecutive variables."""

    name: str
    size: int


@dataclass(frozen=True, eq=False)
class ExportedUnit:
    """A model to be exported, with its declaration.  `step`: longest internal and suggested communication step, s; `stop`: s.

    `node_inputs`: ports also have inputs and outputs at the nodes of a step, and impulses where they take some; `impulses`: the
    same for steps with one node.  `ledger_outputs`: energies and residuals of
    constraints are outputs, else local variables.  `terminals`: ports are listed as terminals.  `arrays`: vector ports are arrays
    in FMI 3.0.  `left_out`: what the declaration's scene has and the unit has not, a line each.  `outward`: names of ports whose
    flow counts out of the unit (`outward.py`).  `tunable`: scalar names of parameters that may be set between steps.
    `events`: what the unit does itself, in order of time, to some of these.
    Errors: TypeError if `model` is none; FMUError for an outward port there is not.
    """

    model: Model
    step: float
    stop: float | None = None
    node_inputs: bool = False
    ledger_outputs: bool = True
    terminals: bool = True
    left_out: tuple[str, ...] = ()
    arrays: bool = False
    outward: tuple[str, ...] = ()
    tunable: frozenset[str] = frozenset()
    impulses: bool = False
    events: tuple[UnitEvent, ...] = ()

    #: whether it tells derivatives of its steps
    derives: ClassVar[bool] = True
    #: type and name of what is constant of its step map in C, and the function that tells the map
    about: ClassVar[tuple[str, str, str]] = ("ph_model", "ph_the_model", "ph_map_model")

    def __post_init__(self) -> None:
        require_model(self.model, "Unit")
        require_ports(self.declaration, self.outward)
        if self.impulses:
            require_kernels(self.model)
        elif self.node_inputs:
            require_nodes(self.model)

    @property
    def at_nodes(self) -> bool:
        """Whether it has inputs at the nodes of a step."""
        return self.node_inputs or self.impulses

    @cached_property
    def kernels(self) -> PortKernels | None:
        """Its impulses; None without."""
        return kernels_of(self.model) if self.at_nodes else None

    @property
    def headers(self) -> tuple[str, ...]:
        """C headers of what its equations and its landing are, where these are of no one model."""
        return ()

    @property
    def lands(self) -> bool:
        """Whether it has state events."""
        return self.model.events is not None

    @property
    def changes_modes(self) -> bool:
        """Whether it has ideal switches, or lands as what may have some."""
        return self.model.modes is not None

    @property
    def derives_by_states(self) -> bool:
        """Whether it tells derivatives of its steps by states and parameters, too."""
        return self.derives and self.model.step.nu > 0 and not self.lands and not self.model.step.carries

    def has_derivatives(self, v: FMUVariable) -> bool:
        """Whether a value has those by states and parameters: all but outputs of ports that are fed from inside."""
        return not v.block.startswith("PH_Y") or v.first < self.model.step.nu

    @property
    def landing(self) -> str:
        """C text that defines what lands on them, where that is no instance of one model."""
        return ""

    def texts(self) -> dict[str, str]:
        """C files that are generated for it where it is more than one model: name -> text."""
        return {}

    def resources(self, platforms: Sequence[str]) -> dict[str, bytes]:
        """Files that stand below resources/: name there -> content."""
        del platforms
        return {}

    @property
    def saves(self) -> bool:
        """Whether its state can be saved and restored."""
        return True

    @property
    def serialises(self) -> bool:
        """Whether its state can become bytes."""
        return True

    @property
    def varies(self) -> bool:
        """Whether its steps may differ in length."""
        return True

    def capabilities(self, every: Mapping[str, str], needs: Mapping[str, Sequence[str]]) -> dict[str, str]:
        """Attributes of its description: `every`, of which those that need what it has not are false.

        `needs`: derives, saves, serialises or varies -> attributes.
        """
        lacking = (n for what, names in needs.items() if not getattr(self, what) for n in names)
        return {**every, **dict.fromkeys(lacking, "false")}

    def drivers(self) -> dict[str, Path]:
        """Files of what drives the steps of its models, if it has such."""
        return {}

    @property
    def checks(self) -> list[tuple[str, float]]:
        """Names of the residuals of hidden constraints, and their sizes."""
        return list(zip(check_names(self.model), self.model.check_scale, strict=True))

    @property
    def equations(self) -> list[tuple[str, Sequence[str], Sequence[str]]]:
        """Per part of its step map a name, and the names of its equations: in a step, and at an instant."""
        return [("", self.model.row_names, self.model.instant_names)]

    @property
    def declaration(self) -> PHDAE:
        return self.model.declaration

    @property
    def name(self) -> str:
        """On one line, without control characters."""
        return plain(self.declaration.name)

    @cached_property
    def identifier(self) -> str:
        """The name as a C identifier: file names of libraries, and `modelIdentifier`."""
        text = re.sub(r"\W", "_", self.name, flags=re.ASCII)
        return text if text and not text[0].isdigit() else f"m_{text}"

    @cached_property
    def variables(self) -> tuple[FMUVariable, ...]:
        """The table; the place of a variable is its value reference."""
        happen = self.model.events is not None
        groups = [node_values] * self.at_nodes + [impulse_values] * (self.kernels is not None)
        groups += [jumps] * (self.jumps or happen) + [state_events] * happen
        table = variables(self.model, groups, self.ledger_outputs, self.tunable)
        return turned(table, [p for p in self.declaration.ports if p.name in self.outward])

    @cached_property
    def jumps(self) -> bool:
        """Whether stored energy depends on what may be set between steps."""
        d = self.declaration
        free = [s for v in d.parameters for s, n in zip(ca.vertsplit(v.sx), v.names(), strict=True)
                if v.signal or n in self.tunable]  # fmt: skip
        return bool(free) and bool(ca.depends_on(d.hamiltonian, ca.vertcat(*free)))

    @cached_property
    def spans(self) -> dict[int, ArraySpan]:
        """Value reference of the first entry -> the array of FMI 3.0 that begins there; empty without `arrays`."""
        if not self.arrays:
            return {}
        place = {v.name: i for i, v in enumerate(self.variables)}
        ports = [p for p in self.declaration.ports if p.size is not None and not p.signal]
        groups = [g for p in ports for g in (p.input_names(), p.output_names(), p.output_names(MEAN))]
        return {place[g[0]]: ArraySpan(g[0].rpartition("[")[0], len(g)) for g in groups if g[0] in place}

    def outputs(self) -> list[int]:
        """Value references of the outputs."""
        return [i for i, v in enumerate(self.variables) if v.causality == "output"]

    def direct(self, v: FMUVariable) -> bool:
        """Whether an output may change as soon as an input changes."""
        if v.block != "PH_Y_END":
            return v.depends_on_inputs
        plan = self.model.instant
        return bool((plan.derivative.row == plan.nw + v.first).any())


def generation_tool() -> str:
    """Name and version of this package."""
    try:
        return f"phfmu {version('phfmu')}"
    except PackageNotFoundError:
        return "phfmu"


def generation_date() -> str | None:
    """The date of SOURCE_DATE_EPOCH; without it there is no date, so that the same model gives the same bytes."""
    epoch = os.environ.get("SOURCE_DATE_EPOCH")
    return datetime.fromtimestamp(int(epoch), UTC).strftime("%Y-%m-%dT%H:%M:%SZ") if epoch else None


def root(unit: ExportedUnit, fmi_version: str, token: tuple[str, str] | None) -> Element:
    """`fmiModelDescription`; `token`: name and value of the attribute, None leaves it and the date out."""
    element = etree.Element("fmiModelDescription", fmiVersion=fmi_version, modelName=unit.name)
    if token:
        element.set(*token)
    if unit.declaration.description:
        element.set("description", plain(unit.declaration.description))
    element.set("generationTool", generation_tool())
    date = generation_date()
    if date and token:
        element.set("generationDateAndTime", date)
    element.set("variableNamingConvention", "structured")
    return element


def add_units(parent: Element, unit: ExportedUnit) -> None:
    """`UnitDefinitions` with SI exponents and factors of all units in use."""
    texts = sorted({v.unit for v in unit.variables if v.unit != "1"})
    definitions = etree.SubElement(parent, "UnitDefinitions")
    for text in texts:
        parsed = parse_unit(text)
        base = etree.SubElement(etree.SubElement(definitions, "Unit", name=text), "BaseUnit")
        for symbol, exponent in zip(BASE, parsed.exponents, strict=True):
            if exponent:
                base.set(symbol, str(exponent))
        if parsed.factor != 1.0:
            base.set("factor", number(parsed.factor))


def add_limits(element: Element, v: FMUVariable) -> None:
    """`min` and `max`; the standard has no open intervals: a min that is not allowed itself is refused by the unit."""
    if v.limit is None:
        return
    for name in ("min", "max"):
        value = getattr(v.limit, name)
        if math.isfinite(value):
            element.set(name, number(value))


def add_log_categories(parent: Element) -> None:
    categories = etree.SubElement(parent, "LogCategories")
    for name, text in LOG_CATEGORIES.items():
        etree.SubElement(categories, "Category", name=name, description=text)


def add_experiment(parent: Element, unit: ExportedUnit) -> None:
    """`DefaultExperiment`: importers take the communication step from stepSize."""
    experiment = etree.SubElement(parent, "DefaultExperiment", startTime=number(unit.model.t0))
    if unit.stop is not None:
        experiment.set("stopTime", number(unit.stop))
    experiment.set("stepSize", number(unit.step))


def build_description(unit: ExportedUnit, sources: Sequence[str]) -> bytes:
    """buildDescription.xml of FMI 3.0, in all archives: how to compile `sources`, which export the standard's functions only."""
    root = etree.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = etree.SubElement(root, "BuildConfiguration", modelIdentifier=unit.identifier)
    files = etree.SubElement(configuration, "SourceFileSet", language="C11")
    for name in sources:
        etree.SubElement(files, "SourceFile", name=name)
    etree.SubElement(files, "PreprocessorDefinition", name="PH_API", value="",
                     description="functions of the runtime stay inside the library")  # fmt: skip
    return text_of(root)
