"""Names of FMI 2.0 for Co-Simulation: modelDescription.xml, and the calls that differ from other versions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import fmpy
from fmpy.fmi2 import (
    FMU2Slave,
    fmi2CallbackAllocateMemoryTYPE,
    fmi2CallbackFreeMemoryTYPE,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
)

from phfmu.fmu.export import description
from phfmu.fmu.export.description import ExportedUnit
from phfmu.fmu.export.variables import FMUError, FMUVariable
from phfmu.fmu.importer.bindings import PartialBinding, require_essential
from phfmu.fmu.importer.refusal import UnitCallError
from phfmu.fmu.version import Caller
from phfmu.fmu.xml import Element, etree, number, text_of

CAPABILITIES = {
    "canHandleVariableCommunicationStepSize": "true",
    "canInterpolateInputs": "false",
    "maxOutputDerivativeOrder": "0",
    "canRunAsynchronuously": "false",
    "canBeInstantiatedOnlyOncePerProcess": "false",
    "canNotUseMemoryManagementFunctions": "true",
    "canGetAndSetFMUstate": "true",
    "canSerializeFMUstate": "true",
    "providesDirectionalDerivative": "true",
}
#: what a unit has -> the capabilities that need it
NEEDS = {
    "derives": ("providesDirectionalDerivative",), "saves": ("canGetAndSetFMUstate",),
    "serialises": ("canSerializeFMUstate",), "varies": ("canHandleVariableCommunicationStepSize",),
}  # fmt: skip


#: kinds of the status of a step
_LAST_SUCCESSFUL_TIME, _TERMINATED = 2, 3


def model_description(
    unit: ExportedUnit, number: str, token: tuple[str, str] | None = None, sources: Sequence[str] = ()
) -> bytes:
    """The document; without `token` (attribute, value) it is the text the token is made of.  `sources`: files to compile."""
    root = description.root(unit, number, token)
    interface = etree.SubElement(root, "CoSimulation", modelIdentifier=unit.identifier, needsExecutionTool="false")
    for name, value in unit.capabilities(CAPABILITIES, NEEDS).items():
        interface.set(name, value)
    if sources:
        files = etree.SubElement(interface, "SourceFiles")
        for name in sources:
            etree.SubElement(files, "File", name=name)
    description.add_units(root, unit)
    description.add_log_categories(root)
    description.add_experiment(root, unit)
    listed = etree.SubElement(root, "ModelVariables")
    # time is optional here, and a widely used importer reports it as an error for having no start value
    written = [r for r, v in enumerate(unit.variables) if v.causality != "independent"]
    for reference in written:
        _variable(listed, reference, unit.variables[reference])
    place = {reference: str(i + 1) for i, reference in enumerate(written)}
    structure = etree.SubElement(root, "ModelStructure")
    outputs = etree.SubElement(structure, "Outputs")
    unknowns = etree.SubElement(structure, "InitialUnknowns")
    for reference in unit.outputs():
        unknown = etree.SubElement(outputs, "Unknown", index=place[reference])
        if not unit.direct(unit.variables[reference]):
            unknown.set("dependencies", "")
        etree.SubElement(unknowns, "Unknown", index=place[reference])
    return text_of(root)


def _variable(parent: Element, reference: int, v: FMUVariable) -> None:
    scalar = etree.SubElement(parent, "ScalarVariable", name=v.name, valueReference=str(reference))
    scalar.set("description", v.description)
    scalar.set("causality", v.causality)
    scalar.set("variability", v.variability)
    if v.initial:
        scalar.set("initial", v.initial)
    real = etree.SubElement(scalar, "Real")
    if v.unit != "1":
        real.set("unit", v.unit)
    description.add_limits(real, v)
    if v.nominal is not None:
        real.set("nominal", number(v.nominal))
    if v.start is not None:
        real.set("start", number(v.start))


class FMU2Library(PartialBinding, FMU2Slave):
    """The binding of a library."""


def instance(
    library: Path, common: dict[str, Any], log: Callable[[bytes | None], None], loud: bool, early_return: bool
) -> FMU2Slave:
    """The binding, instantiated; a step has no early return here."""
    del early_return
    callbacks = fmi2CallbackFunctions()
    callbacks.logger = fmi2CallbackLoggerTYPE(lambda _environment, _name, _status, _category, text: log(text))
    callbacks.allocateMemory = fmi2CallbackAllocateMemoryTYPE(fmpy.calloc)
    callbacks.freeMemory = fmi2CallbackFreeMemoryTYPE(fmpy.free)
    fmu = FMU2Library(libraryPath=str(library), **common)
    require_essential(fmu.absent, "fmi2", "2.0")
    fmu.instantiate(callbacks=callbacks, loggingOn=loud)
    return fmu


def unescaped(words: str) -> str:
    """Messages are formats of printf, in which # marks value references."""
    return words.replace("%%", "%").replace("##", "#")


def enter(slave: Caller, start: float, stop: float | None, tolerance: float | None) -> None:
    slave.call(slave.fmu.setupExperiment, tolerance, start, stop)
    slave.call(slave.fmu.enterInitializationMode)


def do_step(slave: Caller, t: float, h: float, no_set_prior: bool) -> tuple[float, bool]:
    """The time reached, t + h, and whether the unit asks to end: of a step that is discarded it tells that on request."""
    try:
        slave.call(slave.fmu.doStep, t, h, no_set_prior)
    except UnitCallError as error:
        if error.answer != "discard":
            raise
        last, ended = _discarded(slave, t)
        if ended:
            return last, True
        words = (*error.words, *([] if last is None else [f"last successful time {last:.9g} s"]))
        raise UnitCallError(error.unit, error.function, error.answer, words) from None
    return t + h, False


def _discarded(slave: Caller, t: float) -> Any:
    """The last successful time, None if it is not told, and whether the unit asks to end."""
    ended, last = False, None
    with suppress(FMUError):  # some libraries lack these functions
        ended = bool(slave.call(slave.fmu.getBooleanStatus, _TERMINATED))
        last = t if ended else None
        last = float(slave.call(slave.fmu.getRealStatus, _LAST_SUCCESSFUL_TIME))
    return last, ended
