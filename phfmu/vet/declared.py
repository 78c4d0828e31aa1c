"""Attributes of modelDescription.xml that vetting tries and that stepping has no use for."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from phfmu.fmu.importer.model_description import TRUE
from phfmu.fmu.xml import parse


@dataclass(frozen=True)
class DeclaredAttributes:
    """`abilities`: attributes of CoSimulation.  `limits`: variable -> (min, max), None where there is none.

    `dependencies`: output -> variables at the same instant that it depends on; None where the description leaves that open.
    `initial`: variable -> attribute `initial`.  `tolerance`: of its default experiment, None where it tells none.
    """

    abilities: Mapping[str, str]
    limits: Mapping[str, tuple[float | None, float | None]]
    dependencies: Mapping[str, frozenset[str] | None]
    initial: Mapping[str, str]
    tolerance: float | None

    def able(self, *names: str) -> bool:
        """Whether one of these attributes is true; versions of the standard spell some of them differently."""
        return any(self.abilities.get(n) in TRUE for n in names)


def declared(path: Path, version: str) -> DeclaredAttributes:
    """The attributes; the archive has been opened and checked before."""
    with zipfile.ZipFile(path) as archive:
        root = parse(archive.read("modelDescription.xml"), f"{path.name}/modelDescription.xml")
    variables = list(root.find("ModelVariables"))
    told = root.find("CoSimulation")
    keys = [v.get("name", "") for v in variables]
    if version == "2.0":
        names = {str(i + 1): name for i, name in enumerate(keys)}
        numbers = {n: next(iter(v), v) for n, v in zip(keys, variables, strict=True)}
        outputs, key = root.findall("ModelStructure/Outputs/Unknown"), "index"
    else:
        names = {v.get("valueReference", ""): n for n, v in zip(keys, variables, strict=True)}
        numbers = dict(zip(keys, variables, strict=True))
        outputs, key = root.findall("ModelStructure/Output"), "valueReference"
    experiment = root.find("DefaultExperiment")
    types = {t.get("name"): t for t in root.iterfind("TypeDefinitions/*")}
    return DeclaredAttributes(
        abilities=dict(told.attrib),
        limits={n: _limits(e, types) for n, e in numbers.items()},
        dependencies={
            names[o.get(key)]: None
            if (on := o.get("dependencies")) is None
            else frozenset(names[i] for i in on.split())
            for o in outputs
            if o.get(key) in names
        },
        initial={v.get("name", ""): v.get("initial", "") for v in variables},
        tolerance=None if experiment is None else _number(experiment.get("tolerance")),
    )


def _limits(numbers: Any, types: Mapping[Any, Any]) -> tuple[float | None, float | None]:
    """Limits (min, max) of a variable itself, else of its declared type."""
    own = types.get(numbers.get("declaredType"))
    of_type = {} if own is None else dict(next(iter(own), own).attrib) | dict(own.attrib)
    low, high = (numbers.get(k, of_type.get(k)) for k in ("min", "max"))
    return _number(low), _number(high)


def _number(text: str | None) -> float | None:
    try:
        return None if text is None else float(text)
    except ValueError:
        return None
