"""Check of documents against the schemas of the standard, by lxml.

Those of SSP 1.0 come with FMPy, those of 2.0 with the package pyssp-standard (extra `ssp`); documents of a
version without are read unchecked.
"""

from __future__ import annotations

from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from phfmu.fmu.words import plain
from phfmu.fmu.xml import Element, etree
from phfmu.ssp.names import DRAFT, ROOTS, VERSIONS, tag
from phfmu.ssp.structure import SSPError
from phfmu.ssp.terminals import without

_FILES = {
    "ssd": "SystemStructureDescription.xsd",
    "ssv": "SystemStructureParameterValues.xsd",
    "ssm": "SystemStructureParameterMapping.xsd",
    "ssb": "SystemStructureSignalDictionary.xsd",
}
#: version -> package that brings its schemas, and their folder there
_FOLDERS = {"1": ("fmpy", "ssp/schema"), "2": ("pyssp_standard", "resources/ssp2")}


def version_of(root: Element, kind: str, where: str) -> str:
    """The version of a document whose root must be that of `kind` (ssd, ssv, ssm); SSPError for others."""
    if root.tag != tag(kind, ROOTS[kind]):
        raise SSPError(f"{where}: the root is '{plain(str(root.tag), 200)}', expected {kind}:{ROOTS[kind]} of SSP")
    version = root.get("version", "")
    if version.partition(".")[0] not in _FOLDERS:
        raise SSPError(f"{where}: SSP version '{plain(version, 50)}'; this reads {' and '.join(VERSIONS)}")
    return version


def require_valid(root: Element, kind: str, where: str) -> str:
    """SSPError with the first thing that does not fit the schema; a line if there is no schema to check with, else none."""
    version = version_of(root, kind, where)
    if version == DRAFT:
        lines = [f"SSP {DRAFT} is a draft: terminals are read by it, all else by SSP 2.0"]
        return "; ".join(lines + [more for more in [require_valid(without(root), kind, where)] if more])
    schema = _schema(version.partition(".")[0], kind)
    if schema is None:
        return f"not checked against the schemas of SSP {version}, which come with: pip install phfmu[ssp]"
    if not schema.validate(root):
        first = schema.error_log[0]
        raise SSPError(f"{where}, line {first.line}: not what SSP {version} allows: {plain(_shortened(first.message))}")
    return ""


def _shortened(message: str) -> str:
    """Names without their namespaces."""
    for prefix in _FILES:
        message = message.replace(tag(prefix, ""), f"{prefix}:")
    return message.replace(tag("ssc", ""), "ssc:")


@cache
def _schema(major: str, kind: str) -> Any:
    package, folder = _FOLDERS[major]
    found = find_spec(package)
    places = [Path(p) / folder for p in (found.submodule_search_locations or ())] if found else []
    for place in places:
        if (place / _FILES[kind]).is_file():
            return etree.XMLSchema(file=str(place / _FILES[kind]))
    return None
