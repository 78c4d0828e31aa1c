"""Names of FMI 3.0 for Co-Simulation: modelDescription.xml, and the calls that differ from other versions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from fmpy.fmi3 import FMU3Slave

from phfmu.fmu.export import description
from phfmu.fmu.export.description import ExportedUnit
from phfmu.fmu.export.variables import FMUVariable
from phfmu.fmu.importer.bindings import PartialBinding, require_essential
from phfmu.fmu.importer.refusal import UnitCallError
from phfmu.fmu.version import Caller
from phfmu.fmu.xml import Element, etree, number, text_of

CAPABILITIES = {
    "canBeInstantiatedOnlyOncePerProcess": "false",
    "canGetAndSetFMUState": "true",
    "canSerializeFMUState": "true",
    "providesDirectionalDerivatives": "true",
    "providesAdjointDerivatives": "true",
    "canHandleVariableCommunicationStepSize": "true",
    "maxOutputDerivativeOrder": "0",
    "providesIntermediateUpdate": "false",
    "mightReturnEarlyFromDoStep": "true",
    "canReturnEarlyAfterIntermediateUpdate": "false",
    "hasEventMode": "false",
}
#: what a unit has -> the capabilities that need it
NEEDS = {
    "derives": ("providesDirectionalDerivatives", "providesAdjointDerivatives"), "saves": ("canGetAndSetFMUState",),
    "serialises": ("canSerializeFMUState",), "varies": ("canHandleVariableCommunicationStepSize",),
}  # fmt: skip


def model_description(
    unit: ExportedUnit, number: str, token: tuple[str, str] | None = None, sources: Sequence[str] = ()
) -> bytes:
    """The document; without `token` (attribute, value) it is the text the token is made of.

    `sources` stand in buildDescription.xml.
    """
    del sources
    root = description.root(unit, number, token)
    interface = etree.SubElement(root, "CoSimulation", modelIdentifier=unit.identifier, needsExecutionTool="false")
    for name, value in unit.capabilities(CAPABILITIES, NEEDS).items():
        interface.set(name, value)
    description.add_units(root, unit)
    description.add_log_categories(root)
    description.add_experiment(root, unit)
    listed = etree.SubElement(root, "ModelVariables")
    inner = {first + i for first, span in unit.spans.items() for i in range(1, span.size)}
    for reference, v in enumerate(unit.variables):
        if reference in unit.spans:
            _array(listed, reference, unit)
        elif reference not in inner:
            _variable(listed, reference, v)
    structure = etree.SubElement(root, "ModelStructure")
    for tag in ("Output", "InitialUnknown"):
        for reference in (r for r in unit.outputs() if r not in inner):
            unknown = etree.SubElement(structure, tag, valueReference=str(reference))
            if tag == "Output" and not any(unit.direct(v) for v in _entries(unit, reference)):
                unknown.set("dependencies", "")
    return text_of(root)


def _entries(unit: ExportedUnit, reference: int) -> tuple[FMUVariable, ...]:
    size = unit.spans[reference].size if reference in unit.spans else 1
    return unit.variables[reference : reference + size]


def _array(parent: Element, reference: int, unit: ExportedUnit) -> None:
    """The entries as one variable; the nominal value is the largest of theirs, the standard has but one."""
    entries, span = _entries(unit, reference), unit.spans[reference]
    nominal = [v.nominal for v in entries if v.nominal is not None]
    first = replace(entries[0], name=span.name, start=None, nominal=max(nominal, default=None))
    array = _variable(parent, reference, first)
    if entries[0].initial == "exact" or entries[0].causality == "input":
        array.set("start", " ".join(number(v.start or 0.0) for v in entries))
    etree.SubElement(array, "Dimension", start=str(span.size))


def _variable(parent: Element, reference: int, v: FMUVariable) -> Element:
    scalar = etree.SubElement(parent, "Float64", name=v.name, valueReference=str(reference))
    scalar.set("description", v.description)
    scalar.set("causality", v.causality)
    scalar.set("variability", v.variability)
    if v.initial:
        scalar.set("initial", v.initial)
    if v.unit != "1":
        scalar.set("unit", v.unit)
    description.add_limits(scalar, v)
    if v.nominal is not None:
        scalar.set("nominal", number(v.nominal))
    if v.start is not None:
        scalar.set("start", number(v.start))
    return scalar


class FMU3Library(PartialBinding, FMU3Slave):
    """The binding of a library."""


def instance(
    library: Path, common: dict[str, Any], log: Callable[[bytes | None], None], loud: bool, early_return: bool
) -> FMU3Slave:
    """The binding, instantiated; it finds the library in its folder."""
    del library
    fmu = FMU3Library(**common)
    require_essential(fmu.absent, "fmi3", "3.0")
    fmu.instantiate(
        loggingOn=loud,
        earlyReturnAllowed=early_return,
        logMessage=lambda _environment, _status, _category, text: log(text),
    )
    return fmu


def unescaped(words: str) -> str:
    """Messages are plain text."""
    return words


def enter(slave: Caller, start: float, stop: float | None, tolerance: float | None) -> None:
    slave.call(slave.fmu.enterInitializationMode, tolerance, start, stop)


def do_step(slave: Caller, t: float, h: float, no_set_prior: bool) -> tuple[float, bool]:
    """The time reached, t + h unless it may return early, and whether it asks to end; UnitCallError if it returns early where
    it may not.
    """
    _, ended, early, last = slave.call(slave.fmu.doStep, t, h, no_set_prior)
    if ended:
        return last, True
    if early and not slave.early_return:
        words = (*slave.last_words(), f"last successful time {last:.9g} s")
        raise UnitCallError(slave.name, "fmi3DoStep", "early return", words)
    return last if early else t + h, False
