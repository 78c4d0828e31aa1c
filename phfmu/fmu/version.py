"""The FMI versions: a row for each, and what its file of names has to have.

A version is a row here, its file of names in Python (`fmi2.py`) and its C files in `runtime/` (`fmi2.c`).
"""

from __future__ import annotations

import ctypes
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol, cast


@dataclass(frozen=True, eq=False)
class Version:
    """Differences between versions of the standard, as data.

    `number`: `fmiVersion` of what is written; `reads`: pattern of that of what is read.  `prefix`: of functions, headers of the
    standard and names of archives.  `layers`: files of `runtime/` that no other version uses.  `names`: module, see Names.
    `folders`: platform -> folders in binaries/, the first is written, all are read; a platform that is not listed is called
    as it is.  `token`, `saves`, `serialises`, `derives`: attributes of modelDescription.xml.  `inner`: where the
    type of a variable is an element inside its own, what that is called -> type of variables; empty where a variable is an
    element of its type.
    `types`: type of variables -> word of its functions, element of their arrays.  `arrays`: variables may be arrays, so
    functions also take the number of values.
    """

    number: str
    reads: str
    prefix: str
    layers: tuple[str, ...]
    names: str
    folders: Mapping[str, tuple[str, ...]]
    token: str
    saves: str
    serialises: str
    derives: str
    inner: Mapping[str, str]
    types: Mapping[str, tuple[str, Any]]
    arrays: bool

    @property
    def code(self) -> Names:
        """Its file of names, imported when it is needed."""
        return cast(Names, import_module(self.names))

    def folders_of(self, platform: str) -> tuple[str, ...]:
        return self.folders.get(platform, (platform,))

    def description(self, unit: Any, token: str | None = None, sources: Sequence[str] = ()) -> bytes:
        """modelDescription.xml of a `Unit`; without `token` the text the token is made of."""
        return self.code.model_description(unit, self.number, (self.token, token) if token else None, sources)


class Caller(Protocol):
    """The view of a file of names on `slave.Slave`: the binding, and calls that raise UnitCallError with the unit's words."""

    name: str
    early_return: bool
    fmu: Any

    def call(self, function: Any, *arguments: Any) -> Any: ...

    def last_words(self) -> tuple[str, ...]: ...


class Names(Protocol):
    """The file of names of a version: its document, and its calls where they differ."""

    def model_description(
        self, unit: Any, number: str, token: tuple[str, str] | None = None, sources: Sequence[str] = ()
    ) -> bytes:
        """modelDescription.xml of a `description.Unit`; `token`: attribute and value; `sources`: files to compile."""
        ...

    def instance(
        self, library: Path, common: dict[str, Any], log: Callable[[bytes | None], None], loud: bool, early_return: bool
    ) -> Any:
        """FMPy's binding, instantiated; `log` gets what the unit says, `loud`: it is asked to."""
        ...

    def unescaped(self, words: str) -> str:
        """The text of the unit, as it is meant."""
        ...

    def enter(self, slave: Caller, start: float, stop: float | None, tolerance: float | None) -> None:
        """Into Initialization Mode."""
        ...

    def do_step(self, slave: Caller, t: float, h: float, no_set_prior: bool) -> tuple[float, bool]:
        """The time reached, and whether the unit asks to end; UnitCallError if that is not t + h where it has to be."""
        ...


_OWN = {n: (n, getattr(ctypes, f"c_{n.lower()}")) for n in (f"{u}Int{b}" for u in ("", "U") for b in (8, 16, 32, 64))}

FMI2 = Version(
    number="2.0",
    reads=r"2\.0",
    prefix="fmi2",
    layers=("fmi2.c",),
    names="phfmu.fmu.fmi2",
    # the standard has no names for ARM: those of 3.0 are borrowed, and other tools take what has the same width
    folders={
        "x86_64-linux": ("linux64", "x86_64-linux"),
        "aarch64-linux": ("aarch64-linux", "linux64"),
        "x86_64-windows": ("win64", "x86_64-windows"),
        "aarch64-windows": ("aarch64-windows", "win64"),
        "x86_64-darwin": ("darwin64", "x86_64-darwin"),
        "aarch64-darwin": ("aarch64-darwin", "darwin64"),
        "x86-linux": ("linux32", "x86-linux"),
        "x86-windows": ("win32", "x86-windows"),
    },
    token="guid",
    saves="canGetAndSetFMUstate",
    serialises="canSerializeFMUstate",
    derives="providesDirectionalDerivative",
    inner={"Real": "Float64", "Integer": "Int32", "Boolean": "Boolean", "Enumeration": "Enumeration"},
    types={
        "Float64": ("Real", ctypes.c_double),
        "Int32": ("Integer", ctypes.c_int),
        "Boolean": ("Boolean", ctypes.c_int),
        "Enumeration": ("Integer", ctypes.c_int),
    },
    arrays=False,
)

FMI3 = Version(
    number="3.0",
    reads=r"3\..*",
    prefix="fmi3",
    layers=("fmi3.c", "fmi3_absent.c"),
    names="phfmu.fmu.fmi3",
    folders={},
    token="instantiationToken",
    saves="canGetAndSetFMUState",
    serialises="canSerializeFMUState",
    derives="providesDirectionalDerivatives",
    inner={},
    types={
        "Float64": ("Float64", ctypes.c_double),
        "Float32": ("Float32", ctypes.c_float),
        "Boolean": ("Boolean", ctypes.c_bool),
        "Enumeration": ("Int64", ctypes.c_int64),
        **_OWN,
    },
    arrays=True,
)

#: number -> row, from the oldest
VERSIONS = {v.number: v for v in (FMI2, FMI3)}
LATEST = [*VERSIONS][-1]


def written_by(text: str) -> Version | None:
    """The row that reads documents of this `fmiVersion`; None if there is none."""
    return next((v for v in VERSIONS.values() if re.fullmatch(v.reads, text)), None)
