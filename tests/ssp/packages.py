"""Packages of SSP made by hand."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path

from phfmu.ssp.names import NAMESPACES

SPACES = " ".join(f'xmlns:{k}="{v}"' for k, v in NAMESPACES.items())


def pack(path: Path, files: Mapping[str, bytes | str]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as out:
        for name, data in files.items():
            out.writestr(name, data)
    return path


def unpacked(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        return {n: archive.read(n) for n in archive.namelist()}


def document(system: str, version: str = "1.0", after: str = '<ssd:DefaultExperiment stopTime="0.2"/>') -> str:
    """A description around the content of the root system, which is called `pair`."""
    return (
        f'<ssd:SystemStructureDescription {SPACES} version="{version}" name="pair">'
        f'<ssd:System name="pair">{system}</ssd:System>{after}</ssd:SystemStructureDescription>'
    )
