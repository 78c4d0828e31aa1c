"""Instances that step in compiled code."""

from __future__ import annotations

import ctypes
import re
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phfmu.engine.codegen import KernelTable, kernel_table
from phfmu.engine.compile import Build, compile
from phfmu.engine.model import Model
from phfmu.engine.status import Status, StepFailure
from phfmu.engine.tables import RUNTIME, CTables

STATUS = tuple(Status)
Floats = NDArray[np.float64]


class _Report(ctypes.Structure):
    _fields_ = [
        *((n, ctypes.c_int) for n in ("status", "row", "column", "iterations", "instant")),
        *((n, ctypes.c_double) for n in ("residual", "update", "time", "h")),
    ]


class _Column(ctypes.Structure):
    _fields_ = [("data", ctypes.c_void_p), ("stride", ctypes.c_ssize_t)]


class _Record(ctypes.Structure):
    _fields_ = [("input", ctypes.c_void_p), ("input_stride", ctypes.c_ssize_t), ("parts", ctypes.c_int)]
    _fields_ += [
        (name, _Column)
        for name in ("signals", "x", "a", "y_step", "pairs", "stored", "dissipated", "supplied", "energy", "counts")
    ]


@lru_cache(maxsize=1)
def _enums() -> dict[str, tuple[str, ...]]:
    """Members of the enumerations of phfmu.h that name signal blocks, ledger rows and counters, in lower case."""
    text = re.sub(r"/\*.*?\*/", "", (RUNTIME / "phfmu.h").read_text(), flags=re.S)
    return {
        name: tuple(m.lower().removeprefix("ph_").removeprefix("row_") for m in re.findall(r"\w+", body)[:-1])
        for name, body in re.findall(r"typedef enum (ph_block|ph_row|ph_count) \{(.*?)\}", text, flags=re.S)
    }


@lru_cache(maxsize=None)
def _load(path: Path) -> ctypes.CDLL:
    lib = ctypes.CDLL(str(path))
    pointer, real, integer = ctypes.c_void_p, ctypes.c_double, ctypes.c_int
    signatures: dict[str, tuple[Any, list[Any]]] = {
        "ph_size": (ctypes.c_size_t, [pointer]),
        "ph_init": (integer, [pointer, pointer]),
        "ph_reset": (None, [pointer]),
        "ph_initialise": (integer, [pointer]),
        "ph_set_input": (None, [pointer, pointer]),
        "ph_set_node_inputs": (integer, [pointer, pointer]),
        "ph_set_parameters": (None, [pointer, pointer]),
        "ph_set_x": (None, [pointer, real, pointer]),
        "ph_set_algebraic": (None, [pointer, pointer]),
        "ph_parameters": (pointer, [pointer]),
        "ph_input": (pointer, [pointer]),
        "ph_step": (integer, [pointer, real, real]),
        "ph_step_parts": (integer, [pointer, real, real, integer]),
        "ph_run": (integer, [pointer, real, real, integer, ctypes.POINTER(_Record), ctypes.POINTER(integer)]),
        "ph_layout": (None, [pointer, ctypes.POINTER(integer)]),
        "ph_signals": (pointer, [pointer]),
        "ph_refresh": (integer, [pointer]),
        "ph_ledger": (pointer, [pointer, integer]),
        "ph_sensitivity": (integer, [pointer, pointer]),
        "ph_sensitivity_end": (integer, [pointer, pointer]),
        "ph_state_size": (ctypes.c_size_t, [pointer]),
        "ph_save": (None, [pointer, pointer]),
        "ph_load": (integer, [pointer, pointer]),
        "ph_counts": (pointer, [pointer]),
        "ph_last_report": (ctypes.POINTER(_Report), [pointer]),
        "ph_status_text": (ctypes.c_char_p, [integer]),
    }
    for name, (result, arguments) in signatures.items():
        function = getattr(lib, name)
        function.restype, function.argtypes = result, arguments
    return lib


def runtime_sources() -> dict[str, Path]:
    """The hand-written part of a library: file name -> path."""
    return {p.name: p for p in sorted(RUNTIME.iterdir()) if p.suffix in (".c", ".h", ".inc")}


def build(table: KernelTable) -> Build:
    """Library of runtime and kernels for this machine; models with the same kernels share it."""
    return compile({**runtime_sources(), "kernels.c": table.text})


def _view(address: int, n: int, dtype: Any = np.float64) -> NDArray[Any]:
    """Array on memory owned by the instance."""
    size = np.dtype(dtype).itemsize
    buffer = (ctypes.c_char * (n * size)).from_address(address)
    return np.frombuffer(buffer, dtype, n)


class NativeInstance:
    """A model in compiled code: one opaque block of memory, one C call a step.

    Inputs are held over a step, or given at the k quadrature nodes (k x nu). Units SI, power into the component.
    Errors: StepFailure; the instance is then at its last accepted step.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        table = kernel_table(model.kernels)
        self.build = build(table)
        self._tables = CTables(model, table.index, table.token)
        self._lib = _load(self.build.path)
        size = self._lib.ph_size(self._tables.pointer)
        if size == 0:
            raise StepFailure(Status.ABI)
        self._memory = np.zeros(size // 8 + 1)
        self._in = self._memory.ctypes.data
        self._check(self._lib.ph_init(self._in, self._tables.pointer))
        names = _enums()["ph_block"]
        offset = (ctypes.c_int * (len(names) + 1))()
        self._lib.ph_layout(self._tables.pointer, offset)
        #: place of each block in the signal table
        self.layout = {n: slice(offset[i], offset[i + 1]) for i, n in enumerate(names)}
        self._table = _view(self._lib.ph_signals(self._in), offset[len(names)])
        self._state_size = self._lib.ph_state_size(self._in)
        self._step = self._lib.ph_step
        self._y_step = self._table[self.layout["y_step"]]

    # -- settings

    def reset(self) -> None:
        """Back to the start values of the model."""
        self._lib.ph_reset(self._in)

    def initialise(self) -> None:
        """End values at the present time; the step means take their values. Call it before the first step."""
        self._check(self._lib.ph_initialise(self._in))

    def set_input(self, u: ArrayLike) -> None:
        """Inputs of the next steps: nu held values, or k x nu values at the nodes of the step."""
        values = np.ascontiguousarray(u, float)
        plan = self.model.step
        if values.shape == (plan.nu,):
            self._lib.ph_set_input(self._in, values.ctypes.data)
        elif values.shape == (plan.k, plan.nu):
            self._check(self._lib.ph_set_node_inputs(self._in, values.ctypes.data))
        else:
            raise ValueError(f"inputs have shape {values.shape}, not ({plan.nu},) or ({plan.k}, {plan.nu})")

    def set_parameters(self, p: ArrayLike) -> None:
        """All np parameters."""
        self._lib.ph_set_parameters(self._in, self._vector(p, "np").ctypes.data)

    def set_x(self, x: ArrayLike, t: float | None = None) -> None:
        """State (nx) and time; what was accumulated stays."""
        values = self._vector(x, "nx")
        self._lib.ph_set_x(self._in, self.time if t is None else t, values.ctypes.data)

    def set_algebraic(self, a: ArrayLike) -> None:
        """Start guesses of the na algebraic variables."""
        self._lib.ph_set_algebraic(self._in, self._vector(a, "na").ctypes.data)

    # -- stepping

    def do_step(self, t: float, h: float, parts: int = 1) -> None:
        """One step over [t, t+h], taken as `parts` equal internal steps."""
        if parts == 1:
            status = self._step(self._in, t, h)
        else:
            status = self._lib.ph_step_parts(self._in, t, h, parts)
        if status:
            self._check(status)

    def run(
        self,
        t0: float,
        h: float,
        n: int,
        record: Iterable[str] = (),
        inputs: ArrayLike | None = None,
        parts: int = 1,
    ) -> dict[str, Floats]:
        """Steps k = 0..n-1 from t0 + k h without leaving C; `inputs`: n x nu, row k held over step k.

        `record`: names among signals, x, a, y_step, pairs, stored, dissipated, supplied, energy, counts; one row
        a step each (ledger rows of that step; energy = H per component at its end; counts = iterations, solves).
        """
        plan = self.model.step
        widths = {"signals": len(self._table), "x": plan.nx, "a": plan.na, "y_step": plan.nq, "pairs": plan.nq}
        widths |= dict.fromkeys(("stored", "dissipated", "supplied", "energy"), plan.ncomp) | {"counts": 2}
        result = {name: np.full((n, widths[name]), np.nan) for name in record}
        request = _Record(parts=parts)
        for name, array in result.items():
            setattr(request, name, _Column(array.ctypes.data, array.shape[1]))
        if inputs is not None:
            rows = np.ascontiguousarray(inputs, float)
            if rows.shape != (n, plan.nu):
                raise ValueError(f"inputs have shape {rows.shape}, not ({n}, {plan.nu})")
            request.input, request.input_stride = rows.ctypes.data, plan.nu
        done = ctypes.c_int()
        self._check(self._lib.ph_run(self._in, t0, h, n, request, done))
        return result

    # -- reading

    @property
    def time(self) -> float:
        return float(self._table[self.model.step.nx])

    @property
    def x(self) -> Floats:
        """State (nx)."""
        return self._table[: self.model.step.nx].copy()

    def output(self) -> Floats:
        """Step-conjugate means of all pairs (nq), external ones first: h u y is the energy of the step."""
        return self._y_step.copy()

    def signals(self) -> Floats:
        """The whole signal table with end values; blocks by `layout`."""
        self._check(self._lib.ph_refresh(self._in))
        return self._table.copy()

    def signal(self, block: str) -> Floats:
        """One block of the table; blocks that hold at the present time are solved for if out of date."""
        if list(self.layout).index(block) >= list(self.layout).index("a_end"):
            self._check(self._lib.ph_refresh(self._in))
        return self._table[self.layout[block]].copy()

    def ledger(self) -> dict[str, Floats]:
        """Last step: stored, dissipated, supplied per component and energy per pair, in J."""
        names, plan = _enums()["ph_row"], self.model.step
        sizes = {name: plan.nq if name == "pair" else plan.ncomp for name in names}
        return {n: _view(self._lib.ph_ledger(self._in, i), sizes[n]).copy() for i, n in enumerate(names)}

    def sensitivity(self, end: bool = False) -> Floats:
        """S (nu x nu) = d (step means of the external outputs) / d (held inputs) of the last step.

        `end`: of the outputs at the present time instead. Errors: StepFailure NO_SENSITIVITY after a divided step.
        """
        s = np.empty((self.model.step.nu,) * 2)
        function = self._lib.ph_sensitivity_end if end else self._lib.ph_sensitivity
        self._check(function(self._in, s.ctypes.data))
        return s

    def get_state(self) -> bytes:
        """Complete state; in any instance of the model the same bits follow from it."""
        buffer = ctypes.create_string_buffer(self._state_size)
        self._lib.ph_save(self._in, buffer)
        return buffer.raw

    def set_state(self, state: bytes) -> None:
        """Restores what `get_state` gave."""
        if len(state) != self._state_size:
            raise ValueError(f"state of {len(state)} bytes, this model has {self._state_size}")
        self._check(self._lib.ph_load(self._in, state))

    @property
    def counters(self) -> dict[str, int]:
        """What the solver did since the instance was made."""
        names = _enums()["ph_count"]
        values = _view(self._lib.ph_counts(self._in), len(names), np.int64)
        return {n: int(v) for n, v in zip(names, values, strict=True)}

    # -- helpers

    def _vector(self, values: ArrayLike, size: str) -> Floats:
        array = np.ascontiguousarray(values, float)
        expected = getattr(self.model.step, size)
        if array.shape != (expected,):
            raise ValueError(f"shape {array.shape}, not ({expected},)")
        return array

    def _check(self, code: int) -> None:
        if code == 0:
            return
        status = STATUS[code]
        if status in (Status.ABI, Status.ARGUMENT, Status.NO_SENSITIVITY):
            raise StepFailure(status, time=self.time)
        r = self._lib.ph_last_report(self._in).contents
        names = self.model.instant_equations if r.instant else self.model.equations
        index = r.row if r.row >= 0 else r.column
        raise StepFailure(
            status,
            time=r.time,
            h=r.h,
            equation=r.row if r.row >= 0 else None,
            unknown=r.column if r.column >= 0 else None,
            name=names[index] if 0 <= index < len(names) else None,
            residual=r.residual,
            update=r.update,
            iterations=r.iterations,
            instant=bool(r.instant),
        )
