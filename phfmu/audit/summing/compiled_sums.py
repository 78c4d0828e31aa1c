"""The sums of `sums.py` and the pass of `ordinary.py` in compiled code, for runs of many steps: the same bits."""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

from phfmu.engine.native.library import summing


@cache
def library() -> Any:
    """The functions of runtime/sums.c; CompilerMissing, CompileError."""
    lib = summing()
    size, pointer = ctypes.c_ssize_t, ctypes.c_void_p
    lib.ph_sums_down.restype = lib.ph_sums_across.restype = lib.ph_most_down.restype = None
    lib.ph_sums_down.argtypes = [size, size, *[pointer] * 4]
    lib.ph_sums_across.argtypes = [size, size, pointer, size, *[pointer] * 3]
    lib.ph_most_down.argtypes = [size, size, pointer, pointer]
    lib.ph_ordinary.argtypes = [pointer, size]
    return lib
