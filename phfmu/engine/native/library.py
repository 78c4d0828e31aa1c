"""The runtime, one library for all models, as Python sees it: signatures, records and names of phfmu.h."""

from __future__ import annotations

import ctypes
import re
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.build.cache import cache_folder
from phfmu.engine.build.compile import Build, CompilerMissing, compile_once, require_compiler
from phfmu.engine.build.runtime_sources import LIBRARIES, RUNTIME
from phfmu.engine.model import EngineModel
from phfmu.engine.record import RECORD

#: result and arguments of functions, by name
Signatures = dict[str, tuple[Any, list[Any]]]


def record_widths(model: EngineModel, signals: int) -> dict[str, int]:
    """Length of a row of each; `signals`: of the signal table."""
    plan = model.step
    width = dict.fromkeys(RECORD, plan.ncomp) | dict.fromkeys(("y_step", "pairs"), plan.nq)
    return width | {"unknowns": plan.nw, "signals": signals, "x": plan.nx, "a": plan.na, "counts": 2}


class StepReport(ctypes.Structure):
    """The structure ph_report of the runtime."""

    _fields_ = [
        *((n, ctypes.c_int) for n in ("status", "row", "column", "iterations", "spent", "instant", "solved")),
        *((n, ctypes.c_double) for n in ("residual", "floor", "update", "time", "h")),
    ]


class Column(ctypes.Structure):
    """The structure ph_column of the runtime."""

    _fields_ = [("data", ctypes.c_void_p), ("stride", ctypes.c_ssize_t)]


class Record(ctypes.Structure):
    """The structure ph_record of the runtime."""

    _fields_ = [("input", ctypes.c_void_p), ("input_stride", ctypes.c_ssize_t)]
    _fields_ += [("at_nodes", ctypes.c_int), ("parts", ctypes.c_int), ("first", ctypes.c_longlong)]
    _fields_ += [(name, Column) for name in RECORD]


class RestChangeStruct(ctypes.Structure):
    """The structure ph_rest_change of the runtime."""

    _fields_ = [("time", ctypes.c_double), ("rests", ctypes.c_int), ("needed", ctypes.c_int)]


class Directions(ctypes.Structure):
    """The structure ph_directions of the runtime."""

    _fields_ = [("n", ctypes.c_int), *((name, ctypes.c_void_p) for name in ("du", "dx", "dy", "dp", "da", "dobs"))]

    @classmethod
    def of(cls, du: NDArray[np.float64], dx: NDArray[np.float64], dy: NDArray[np.float64]) -> Directions:
        """The structure for arrays that outlive the call."""
        return cls(len(du), du.ctypes.data, dx.ctypes.data, dy.ctypes.data)


@cache
def enums() -> dict[str, tuple[str, ...]]:
    """Names of signal blocks, ledger rows and counters, from the enumerations of phfmu.h."""
    text = re.sub(r"/\*.*?\*/", "", (RUNTIME / "phfmu.h").read_text(), flags=re.S)
    return {
        name: tuple(m.removeprefix("PH_").removeprefix("ROW_").lower() for m in re.findall(r"\w+", body)[:-1])
        for name, body in re.findall(r"typedef enum (ph_block|ph_row|ph_count) \{(.*?)\}", text, flags=re.S)
    }


def typed(lib: ctypes.CDLL, signatures: Signatures) -> ctypes.CDLL:
    """The library with the results and arguments of its functions."""
    for name, (result, arguments) in signatures.items():
        function = getattr(lib, name)
        function.restype, function.argtypes = result, arguments
    return lib


def placed(lib: ctypes.CDLL, name: str, *about: Any, more: Sequence[Any] = ()) -> tuple[NDArray[np.float64], int]:
    """Memory of `name_size` bytes with the result of `name_init` from `about` and `more`, to be kept, and its address."""
    memory = np.zeros(getattr(lib, f"{name}_size")(*about) // 8 + 1)
    return memory, getattr(lib, f"{name}_init")(memory.ctypes.data, *about, *more)


@cache
def load(path: Path) -> ctypes.CDLL:
    """The library with the signatures of phfmu.h."""
    lib = ctypes.CDLL(str(path))
    pointer, real, integer = ctypes.c_void_p, ctypes.c_double, ctypes.c_int
    signatures: Signatures = {
        "ph_size": (ctypes.c_size_t, [pointer]),
        "ph_init": (integer, [pointer, pointer]),
        "ph_reset": (integer, [pointer]),
        "ph_initialise": (integer, [pointer]),
        "ph_set_input": (integer, [pointer, pointer]),
        "ph_set_node_inputs": (integer, [pointer, pointer]),
        "ph_set_parameters": (integer, [pointer, pointer]),
        "ph_set_x": (integer, [pointer, real, pointer]),
        "ph_set_algebraic": (integer, [pointer, pointer]),
        "ph_parameters": (pointer, [pointer]),
        "ph_input": (pointer, [pointer]),
        "ph_node_outputs": (pointer, [pointer]),
        "ph_continue": (integer, [pointer, pointer]),
        "ph_unknowns": (pointer, [pointer]),
        "ph_rest_changes": (ctypes.POINTER(RestChangeStruct), [pointer, ctypes.POINTER(integer)]),
        "ph_step": (integer, [pointer, real, real]),
        "ph_step_parts": (integer, [pointer, real, real, integer]),
        "ph_step_exactly": (integer, [pointer, real, real, integer]),
        "ph_skip": (integer, [pointer, real]),
        "ph_run": (integer, [pointer, real, real, integer, ctypes.POINTER(Record), ctypes.POINTER(integer)]),
        "ph_layout": (None, [pointer, ctypes.POINTER(integer)]),
        "ph_signals": (pointer, [pointer]),
        "ph_refresh": (integer, [pointer]),
        "ph_ledger": (pointer, [pointer, integer]),
        "ph_sensitivity": (integer, [pointer, pointer]),
        "ph_solves": (integer, [pointer]),
        "ph_step_along": (integer, [pointer, ctypes.POINTER(Directions)]),
        "ph_end_along": (integer, [pointer, ctypes.POINTER(Directions)]),
        "ph_sensitivity_end": (integer, [pointer, pointer]),
        "ph_impulses_size": (ctypes.c_size_t, [pointer, pointer]),
        "ph_impulses_init": (pointer, [pointer, pointer, pointer]),
        "ph_set_impulses": (integer, [pointer, pointer]),
        "ph_impulse_values": (pointer, [pointer]),
        "ph_step_impulses": (integer, [pointer, real, real, integer]),
        "ph_kick_more": (integer, [pointer, pointer]),
        "ph_jump": (None, [pointer, pointer]),
        "ph_impulses_along": (None, [pointer, integer, integer, pointer, pointer]),
        "ph_state_size": (ctypes.c_size_t, [pointer]),
        "ph_save": (None, [pointer, pointer]),
        "ph_load": (integer, [pointer, pointer]),
        "ph_counts": (pointer, [pointer]),
        "ph_last_report": (ctypes.POINTER(StepReport), [pointer]),
        "ph_status_text": (ctypes.c_char_p, [integer]),
    }
    return typed(lib, signatures)


def runtime(announce: Callable[[], None] | None = None) -> tuple[Build, ctypes.CDLL]:
    """The library that steps all models; CompilerMissing, CompileError."""
    build = _built("steps", announce)
    return build, load(build.path)


def backwards() -> ctypes.CDLL:
    """The library that also goes back over steps, which a first gradient by adjoints waits for; as `drivers`."""
    return load(_built("backwards").path)


def drivers() -> ctypes.CDLL:
    """The library that also drives steps, which a first sweep, coupled run or run within a tolerance waits for.

    It has the same functions, and they have no state of their own: it steps the instances of the other one.
    """
    return load(_built("drivers").path)


def summing() -> ctypes.CDLL:
    """The small library of the sums of a run and the judge of its steps, which steps nothing."""
    return ctypes.CDLL(str(_built("summing").path))


def _built(name: str, announce: Callable[[], None] | None = None) -> Build:
    """The library `name`: that of the package, else compiled once for a cache."""
    key = name, cache_folder()
    if key not in _BUILT:
        _BUILT[key] = compile_once(LIBRARIES[name](), announce)
    return _BUILT[key]


def require_runtime() -> None:
    """Raise CompilerMissing if there is neither a compiler nor a runtime in the package or in the cache."""
    try:
        require_compiler()
    except CompilerMissing:
        runtime()


#: libraries by name and cache
_BUILT: dict[tuple[str, Path], Build] = {}


def view(address: int, n: int, dtype: Any = np.float64) -> NDArray[Any]:
    """Array on memory owned by the instance."""
    size = np.dtype(dtype).itemsize
    return np.frombuffer(memoryview((ctypes.c_char * (n * size)).from_address(address)), dtype, n)
