"""modelDescription.xml and buildDescription.xml of FMI 3.0 for Co-Simulation."""

from __future__ import annotations

from collections.abc import Sequence

from phfmu.fmu import description
from phfmu.fmu.description import Unit
from phfmu.fmu.variables import FMUVariable
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
    "mightReturnEarlyFromDoStep": "false",
    "canReturnEarlyAfterIntermediateUpdate": "false",
    "hasEventMode": "false",
}


def model_description(unit: Unit, token: str | None = None) -> bytes:
    """The document; without `token` it is the text the token is made of."""
    root = description.root(unit, "3.0", ("instantiationToken", token) if token else None)
    interface = etree.SubElement(root, "CoSimulation", modelIdentifier=unit.identifier, needsExecutionTool="false")
    for name, value in CAPABILITIES.items():
        interface.set(name, value)
    description.add_units(root, unit)
    description.add_log_categories(root)
    description.add_experiment(root, unit)
    listed = etree.SubElement(root, "ModelVariables")
    for reference, v in enumerate(unit.variables):
        _variable(listed, reference, v)
    structure = etree.SubElement(root, "ModelStructure")
    for tag in ("Output", "InitialUnknown"):
        for reference in unit.outputs():
            unknown = etree.SubElement(structure, tag, valueReference=str(reference))
            if tag == "Output" and not unit.direct(unit.variables[reference]):
                unknown.set("dependencies", "")
    return text_of(root)


def _variable(parent: Element, reference: int, v: FMUVariable) -> None:
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


def build_description(unit: Unit, sources: Sequence[str]) -> bytes:
    """How to compile `sources`; only the functions of the standard are exported."""
    root = etree.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = etree.SubElement(root, "BuildConfiguration", modelIdentifier=unit.identifier)
    files = etree.SubElement(configuration, "SourceFileSet", language="C11")
    for name in sources:
        etree.SubElement(files, "SourceFile", name=name)
    etree.SubElement(files, "PreprocessorDefinition", name="PH_API", value="",
                     description="functions of the runtime stay inside the library")  # fmt: skip
    return text_of(root)
