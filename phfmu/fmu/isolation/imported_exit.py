"""`_exit` of a library, which runs no handler: the library's own table of imported functions is led to another function.

Of an ELF library (Linux) the dynamic linker keeps the addresses of imported functions in a table (GOT) that its relocations
tell.  Other formats are left as they are.

Source: System V ABI, chapter 5 (dynamic linking); `link_map` of <link.h>.
"""

from __future__ import annotations

import ctypes
import mmap
import sys
from collections.abc import Iterator
from typing import Any

#: functions that end the process at once
NAMES = frozenset({b"_exit", b"_Exit", b"quick_exit"})

_STRTAB, _SYMTAB, _RELA, _RELASZ, _PLTRELSZ, _PLTREL, _JMPREL = 5, 6, 7, 8, 2, 20, 23
_WRITABLE = mmap.PROT_READ | mmap.PROT_WRITE if sys.platform != "win32" else 0


class _LinkMap(ctypes.Structure):
    _fields_ = [("base", ctypes.c_size_t), ("name", ctypes.c_char_p), ("dynamic", ctypes.c_void_p)]


class _Dynamic(ctypes.Structure):
    _fields_ = [("tag", ctypes.c_int64), ("value", ctypes.c_size_t)]


class _Relocation(ctypes.Structure):
    _fields_ = [("offset", ctypes.c_size_t), ("info", ctypes.c_uint64), ("addend", ctypes.c_int64)]


class _Symbol(ctypes.Structure):
    _fields_ = [
        ("name", ctypes.c_uint32),
        ("_", ctypes.c_uint32),
        ("value", ctypes.c_size_t),
        ("size", ctypes.c_uint64),
    ]


def lead(library: ctypes.CDLL, to: Any) -> None:
    """Calls of `_exit` from the library go to the C function `to` of the exit code, which has to live as long as the library."""
    if sys.platform != "linux" or ctypes.sizeof(ctypes.c_void_p) != 8:
        return
    address, protect = ctypes.cast(to, ctypes.c_void_p).value, ctypes.CDLL(None).mprotect
    protect.argtypes = (ctypes.c_size_t, ctypes.c_size_t, ctypes.c_int)
    for place in _places(library):
        page = place - place % mmap.PAGESIZE
        if protect(page, mmap.PAGESIZE, _WRITABLE) == 0:
            ctypes.c_void_p.from_address(place).value = address


def _places(library: ctypes.CDLL) -> Iterator[int]:
    """Places of the addresses of these functions in the table of the library."""
    link = _LinkMap.from_address(library._handle)
    known = dict[int, int]()
    entry = link.dynamic
    while entry and (told := _Dynamic.from_address(entry)).tag:
        known.setdefault(told.tag, told.value)
        entry += ctypes.sizeof(_Dynamic)
    if not {_STRTAB, _SYMTAB} <= known.keys():
        return
    for start, size in ((_RELA, _RELASZ), (_JMPREL, _PLTRELSZ)):
        if start not in known or (start == _JMPREL and known.get(_PLTREL) != _RELA):
            continue
        for i in range(known.get(size, 0) // ctypes.sizeof(_Relocation)):
            relocation = _Relocation.from_address(known[start] + i * ctypes.sizeof(_Relocation))
            number = relocation.info >> 32
            if number and _name(known, number) in NAMES:
                yield link.base + relocation.offset


def _name(known: dict[int, int], number: int) -> bytes:
    symbol = _Symbol.from_address(known[_SYMTAB] + number * ctypes.sizeof(_Symbol))
    return ctypes.string_at(known[_STRTAB] + symbol.name)
