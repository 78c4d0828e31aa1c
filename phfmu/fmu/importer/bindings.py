"""FMPy's bindings of a library that may lack functions: what needs them is off, and the rest runs.

FMPy wants every function that the standard has.  Libraries in the wild lack some that nobody calls, or that a capability needs
which they claim all the same.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from phfmu.fmu.export.variables import FMUError
from phfmu.fmu.importer.unit_interface import UnitInterface
from phfmu.fmu.isolation import exit_guard

#: without these there is no unit, in the names of the standard less the version
ESSENTIAL = (
    "Instantiate",
    "InstantiateCoSimulation",
    "FreeInstance",
    "EnterInitializationMode",
    "ExitInitializationMode",
    "DoStep",
)
#: of states that are saved and restored;  of derivatives;  of states as bytes
_STATES = ("GetFMUState", "SetFMUState", "FreeFMUState")
_DERIVATIVES = ("GetDirectionalDerivative",)
_SERIALISED = ("SerializedFMUStateSize", "SerializeFMUState", "DeserializeFMUState")


class MissingFunction:
    """Stands for a function that the library lacks: calling it is an FMUError with its name."""

    def __init__(self, unit: str, function: str):
        self.unit, self.__name__ = unit, function
        self.argnames: Any = None
        self.argtypes: Any = None
        self.restype: Any = None

    def __call__(self, *_: Any) -> Any:
        raise FMUError(f"{self.unit}: its library lacks {self.__name__}")


class PartialBinding:
    """A binding in front of one of FMPy's, which tells in `absent` what the library lacks."""

    dll: Any
    instanceName: str
    absent: tuple[str, ...] = ()

    def __init__(self, **common: Any):
        here = os.getcwd()
        try:
            super().__init__(**common)
        finally:
            os.chdir(here)  # FMPy stays in the folder of a library that cannot be loaded

    def _loadFunctions(self) -> None:
        prefix = type(self).__name__[:4].lower().replace("fmu", "fmi")
        wanted = [n for n in dir(type(self)) if n.startswith(prefix)]
        self.absent = tuple(n for n in wanted if not hasattr(self.dll, n))
        for name in self.absent:
            setattr(self.dll, name, MissingFunction(self.instanceName, name))
        exit_guard.watch(self.dll, self.instanceName)
        super()._loadFunctions()  # pyright: ignore[reportAttributeAccessIssue]


def require_essential(absent: Sequence[str], prefix: str, number: str) -> None:
    """FMUError for a library that is none of the version with this prefix of functions."""
    missing = [n for n in absent if n.removeprefix(prefix) in ESSENTIAL]
    if missing:
        raise FMUError(f"its library lacks {', '.join(missing)}, so it is none of FMI {number} for Co-Simulation")


def able(interface: UnitInterface, absent: Sequence[str]) -> UnitInterface:
    """The interface without the capabilities whose functions are absent."""
    missing = {n[4:].lower() for n in absent}
    off = {
        name: False
        for name, needed in (("saves", _STATES), ("serialises", _SERIALISED), ("derivatives", _DERIVATIVES))
        if missing & {n.lower() for n in needed}
    }
    return replace(interface, **off) if off else interface


def told(interface: UnitInterface, absent: Sequence[str]) -> list[str]:
    """A line about what the library lacks, and what is off of it though the description claims it."""
    if not absent:
        return []
    now = able(interface, absent)
    off = [
        what
        for what, claimed, has in (
            ("saving its state", interface.saves, now.saves),
            ("directional derivatives", interface.derivatives, now.derivatives),
        )
        if claimed and not has
    ]
    more = f", {len(absent) - 3} more" if len(absent) > 3 else ""
    also = f"; it claims {' and '.join(off)}, which is off" if off else ""
    return [f"its library lacks {', '.join(absent[:3])}{more}{also}"]
