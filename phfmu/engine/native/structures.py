"""Structures of a C header as Python fills them, for compiled code that steps native instances itself."""

from __future__ import annotations

import ctypes
import re
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from phfmu.engine.build.tables import ARRAYS, Field, declared, for_ctypes


class Header:
    """Structures `names` of headers, whose members are plain values and single pointers (`declared`)."""

    def __init__(self, paths: Sequence[Path], names: Sequence[str]):
        self._text, self._names = "".join(p.read_text() for p in paths), tuple(names)

    @cached_property
    def fields(self) -> dict[str, tuple[Field, ...]]:
        return declared(self._text, self._names)

    @cached_property
    def structures(self) -> dict[str, type[ctypes.Structure]]:
        return for_ctypes(self.fields)

    def functions(self, name: str) -> list[str]:
        """Names of the functions of a structure of these, in order."""
        body = re.search(rf"typedef struct {name} {{(.*?)}} {name};", self._text, re.S)
        assert body
        return re.findall(r"\(\*(\w+)\)\(", body[1])


class Structures:
    """Structures with all they point to, kept alive."""

    def __init__(self, header: Header) -> None:
        self._header = header
        #: names and values of the structures, in order
        self.filled: list[tuple[str, Mapping[str, Any]]] = []
        self._keep: list[Any] = []

    def functions(self, functions: Sequence[Any]) -> int:
        """Address of a structure of these functions of libraries."""
        table = (ctypes.c_void_p * len(functions))(*(ctypes.cast(f, ctypes.c_void_p).value for f in functions))
        self._keep.append(table)
        return ctypes.addressof(table)

    def fill(self, name: str, values: Mapping[str, Any]) -> Any:
        """The structure with the values of its fields: numbers, addresses, or arrays.

        Arrays that are written to or change later are kept as they are, so they must be contiguous and of the field's type.
        """
        struct = self._header.structures[name]()
        self.filled.append((name, values))
        for field in self._header.fields[name]:
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
        """Copies of structures, one after the other; None of none."""
        if not structs:
            return None
        kind: Any = type(structs[0])
        array = (kind * len(structs))(*structs)
        self._keep.append(array)
        return array
