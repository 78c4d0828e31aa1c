"""The compiled master as Python sees it: structures of `runtime/master.h`, and its library, the same for every network."""

from __future__ import annotations

import ctypes
import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from phfmu.engine.compile import compile, host_flags
from phfmu.engine.library import runtime_sources
from phfmu.engine.tables import ARRAYS, Field, declared, for_ctypes

RUNTIME = Path(__file__).parent / "runtime"
STRUCTS = ("ph_share", "ph_rules", "ph_master")
#: of the runtime of models, what the master has in common with it
SHARED = "lu.c"


def sources() -> dict[str, Path]:
    """File name -> path."""
    common = {n: p for n, p in runtime_sources().items() if n.endswith(".h") or n == SHARED}
    return common | {p.name: p for p in sorted(RUNTIME.iterdir())}


@cache
def library() -> ctypes.CDLL:
    """The library with its signatures; CompilerMissing, CompileError."""
    lib = ctypes.CDLL(str(compile(sources(), flags=host_flags()).path))
    pointer, integer = ctypes.c_void_p, ctypes.c_int
    lib.ph_master_lu_size.restype, lib.ph_master_lu_size.argtypes = ctypes.c_size_t, [integer] * 3
    lib.ph_master_lu_init.restype, lib.ph_master_lu_init.argtypes = None, [pointer]
    run = lib.ph_master_run
    run.restype, run.argtypes = (
        integer,
        [pointer, *[ctypes.c_double] * 2, integer, ctypes.c_longlong, integer],
    )
    return lib


@cache
def _fields() -> dict[str, tuple[Field, ...]]:
    return declared((RUNTIME / "master.h").read_text(), STRUCTS)


@cache
def _structures() -> dict[str, type[ctypes.Structure]]:
    return for_ctypes(_fields())


@cache
def _functions() -> list[str]:
    """Names of the functions of `ph_calls`, in order."""
    body = re.search(r"typedef struct ph_calls \{(.*?)\} ph_calls;", (RUNTIME / "master.h").read_text(), re.S)
    assert body
    return re.findall(r"\(\*(\w+)\)\(", body[1])


class Structures:
    """Structures with all they point to, kept alive."""

    def __init__(self) -> None:
        self._keep: list[Any] = []

    def calls(self, lib: ctypes.CDLL) -> int:
        """Address of `ph_calls` of a model's library."""
        names = _functions()
        table = (ctypes.c_void_p * len(names))(
            *(ctypes.cast(getattr(lib, "ph_" + n), ctypes.c_void_p).value for n in names)
        )
        self._keep.append(table)
        return ctypes.addressof(table)

    def fill(self, name: str, values: Mapping[str, Any]) -> Any:
        """The structure with the values of its fields: numbers, addresses, or arrays.

        Arrays that are written to or change later are kept as they are, so they must be contiguous and of the field's type.
        """
        struct = _structures()[name]()
        for field in _fields()[name]:
            value = values[field.name]
            if isinstance(value, ctypes.Array):
                self._keep.append(value)
                value = ctypes.addressof(value)
            elif field.pointer and (value is not None and not isinstance(value, int)):
                array = np.ascontiguousarray(value, ARRAYS.get(field.ctype, np.float64))
                self._keep.append(array)
                value = array.ctypes.data
            setattr(struct, field.name, value)
        self._keep.append(struct)
        return struct

    def array(self, structs: list[Any]) -> Any:
        """Copies of structures, one after the other."""
        kind: Any = type(structs[0])
        array = (kind * len(structs))(*structs)
        self._keep.append(array)
        return array
