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
    interface = etree.SubElement(root, "CoSimulation", modelIdentifier=unit.identifier, needsExecutionTool="false")
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
