"""modelDescription.xml of FMI 2.0 for Co-Simulation."""

from __future__ import annotations

from collections.abc import Sequence

from phfmu.fmu import description
from phfmu.fmu.description import Unit
from phfmu.fmu.variables import FMUVariable
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


def model_description(unit: Unit, token: str | None = None, sources: Sequence[str] = ()) -> bytes:
    """The document; without `token` it is the text the token is made of.  `sources`: files to compile."""
    root = description.root(unit, "2.0", ("guid", token) if token else None)
    interface = etree.SubElement(
        root, "CoSimulation", modelIdentifier=unit.identifier, needsExecutionTool="false"
    )
    for name, value in CAPABILITIES.items():
        interface.set(name, value)
    if sources:
        files = etree.SubElement(interface, "SourceFiles")
        for name in sources:
            etree.SubElement(files, "File", name=name)
    description.add_units(root, unit)
    description.add_log_categories(root)
    description.add_experiment(root, unit)
    listed = etree.SubElement(root, "ModelVariables")
    for reference, v in enumerate(unit.variables):
        _variable(listed, reference, v)
    structure = etree.SubElement(root, "ModelStructure")
    outputs = unit.outputs()
    if outputs:
        _unknowns(etree.SubElement(structure, "Outputs"), unit, outputs, initial=False)
        _unknowns(etree.SubElement(structure, "InitialUnknowns"), unit, outputs, initial=True)
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
    if v.nominal is not None:
        real.set("nominal", number(v.nominal))
    if v.start is not None:
        real.set("start", number(v.start))


def _unknowns(parent: Element, unit: Unit, references: list[int], *, initial: bool) -> None:
    """Indices count from 1 in the order of ModelVariables."""
    for reference in references:
        unknown = etree.SubElement(parent, "Unknown", index=str(reference + 1))
        if not initial and not unit.direct(unit.variables[reference]):
            unknown.set("dependencies", "")
