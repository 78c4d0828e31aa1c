"""The layered standard FMI-LS-REF: files inside a unit, each with the role that it plays.

They are listed in `extra/org.fmi-standard.fmi-ls-ref/fmi-ls-manifest.xml`; a path is relative to the folder of the list that
names it.  Source: github.com/modelica/fmi-ls-ref, 1.0.0-beta.1.
"""

from __future__ import annotations

import posixpath
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote, urlsplit

from phfmu.fmu import limits
from phfmu.fmu.export.variables import FMUError
from phfmu.fmu.importer.archive import checked, document, opened
from phfmu.fmu.words import plain
from phfmu.fmu.xml import etree, parse, text_of

LAYER, VERSION = "org.fmi-standard.fmi-ls-ref", "1.0.0-beta.1"
FOLDER = f"extra/{LAYER}"
MANIFEST = f"{FOLDER}/fmi-ls-manifest.xml"
_LS = "http://fmi-standard.org/fmi-ls-manifest"
_ABOUT = "Layered Standard providing information on related files included in an FMU."

#: roles that are used here; a role may have a second part, experiment/validation
PARAMETER, EXPERIMENT, RESULT = "parameter", "experiment", "result"
SMOKE_TEST = f"{EXPERIMENT}/smoke-test"
CSV, SSV = "text/csv", "application/x-ssp-parameter-set"


@dataclass(frozen=True)
class LayerFile:
    """A file of a unit: its name in the archive, role, MIME type, and a description to be shown."""

    name: str
    role: str
    type: str
    description: str = ""

    @property
    def main_role(self) -> str:
        """experiment of experiment/smoke-test."""
        return self.role.partition("/")[0]


def manifest(files: Iterable[LayerFile]) -> bytes:
    """The list of these files, which all are in FOLDER."""
    root = etree.Element("fmiReferences", nsmap={"fmi-ls": _LS})
    for word, value in (("name", LAYER), ("version", VERSION), ("description", _ABOUT)):
        root.set(f"{{{_LS}}}fmi-ls-{word}", value)
    for f in files:
        source = posixpath.relpath(f.name, FOLDER)
        etree.SubElement(root, "Related", type=f.type, source=source, role=f.role, description=f.description)
    return text_of(root)


def related(unit: Path) -> list[LayerFile]:
    """The files that the list of a unit names, empty without one; FMUError for a list that cannot be read."""
    with opened(unit) as archive:
        if MANIFEST not in checked(archive, unit):
            return []
        root = parse(document(archive, MANIFEST, unit), f"{unit.name}/{MANIFEST}")
    return [
        LayerFile(
            inside(FOLDER, e.get("source", "")),
            plain(e.get("role", ""), 100),
            plain(e.get("type", "application/octet-stream"), 200),
            plain(e.get("description", "")),
        )
        for e in root.findall("Related")
    ]


def inside(folder: str, source: str) -> str:
    """The name in the archive of what a list in `folder` calls `source`; FMUError for a URI that leaves the unit."""
    parts = urlsplit(source)
    name = posixpath.normpath(posixpath.join(folder, unquote(parts.path)))
    if parts.scheme or parts.netloc or not parts.path or "\\" in source or name.startswith(("/", "..")):
        raise FMUError(f"'{plain(source, 200)}' is not the relative path of a file inside the unit")
    return name


def content(unit: Path, name: str, limit: int = limits.DOCUMENT) -> bytes | None:
    """A file of the unit, None if it is not there; FMUError if it is longer than `limit` bytes."""
    with opened(unit) as archive:
        if name not in checked(archive, unit):
            return None
        size = archive.getinfo(name).file_size
        limits.within(f"{unit.name}/{name}", size, limit, "bytes")
        with archive.open(name) as source:
            return source.read(size)
