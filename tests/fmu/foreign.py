"""Units of another tool, made by hand: descriptions in XML, and a library in C that misbehaves on request."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path

import fmpy

from phfmu.engine.compile import compile
from phfmu.fmu import sources

CODE = Path(__file__).parent / "foreign_unit.c"


def description(version: str, variables: str, name: str = "foreign") -> str:
    """modelDescription.xml for Co-Simulation around `variables`."""
    token, saves = (
        ("guid", "canGetAndSetFMUstate") if version == "2.0" else ("instantiationToken", "canGetAndSetFMUState")
    )
    return (
        f'<?xml version="1.0" encoding="UTF-8"?>\n<fmiModelDescription fmiVersion="{version}" modelName="{name}" '
        f'{token}="1"><CoSimulation modelIdentifier="foreign" {saves}="false"/>'
        f'<DefaultExperiment stopTime="1" stepSize="0.1"/>'
        f"<ModelVariables>{variables}</ModelVariables><ModelStructure/></fmiModelDescription>"
    )


def archive(path: Path, files: Mapping[str, bytes | str]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as out:
        for name, data in files.items():
            out.writestr(name, data)
    return path


def library() -> bytes:
    """The library of foreign_unit.c, for both versions."""
    return compile({CODE.name: CODE, **sources.headers()}).path.read_bytes()


def unit(path: Path, version: str, variables: str) -> Path:
    """A unit with that library for this machine."""
    folder = fmpy.platform if version == "2.0" else fmpy.platform_tuple
    name = f"binaries/{folder}/foreign{fmpy.sharedLibraryExtension}"
    return archive(path, {"modelDescription.xml": description(version, variables), name: library()})
