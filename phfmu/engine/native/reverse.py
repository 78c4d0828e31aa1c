"""Derivatives of runs backwards in compiled code: the tape of a native instance, and the way back over it."""

from __future__ import annotations

import ctypes
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.build.compile import CompilerMissing, compile, host_flags
from phfmu.engine.build.runtime_sources import headers
from phfmu.engine.model import EngineModel
from phfmu.engine.native.code import Code, Functions
from phfmu.engine.native.library import Signatures, backwards, placed, typed, view
from phfmu.engine.native.native import NativeInstance
from phfmu.engine.native.native_model import NativeModel
from phfmu.engine.switched import SwitchedInstance
from phfmu.events.modes import Mode
from phfmu.outcome.status import NoDerivative, Status
from phfmu.plan.reverse import reverse, reverse_ledger
from phfmu.schur.back_text import back_text
from phfmu.schur.lanes import NoLanes
from phfmu.schur.stepper import SchurStepper

Floats = NDArray[np.float64]


class _Tape(ctypes.Structure):
    """The structure ph_tape of the runtime."""

    _fields_ = [
        *((n, ctypes.c_void_p) for n in ("take", "rows")),
        *((n, ctypes.c_int) for n in ("room", "width", "n", "full")),
    ]


class _Parts(ctypes.Structure):
    """The structure ph_parts of the runtime."""

    _fields_ = [
        ("n", ctypes.c_int),
        *((n, ctypes.c_void_p) for n in ("rows", "row", "part")),
        ("moves", ctypes.c_int),
    ]


class _RowBarsStruct(ctypes.Structure):
    """The structure ph_row_bars of the runtime."""

    _fields_ = [("n", ctypes.c_int), ("row", ctypes.c_void_p), ("bar", ctypes.c_void_p)]


class _Backwards(ctypes.Structure):
    """The structure ph_backwards of the runtime."""

    _fields_ = [(n, ctypes.c_void_p) for n in ("kernels", "ledgers", "schur")]


class _ReverseFunctions:
    """The kernels of code in reverse, and their ledgers; the way back of the Schur stepper of a model."""

    def __init__(self, native: NativeModel, schur: SchurStepper | None):
        own = [m.kernel for m in native.kernels.members]
        compiled = native.code.compiled
        self._kept = [Functions([f(k) for k in own], compiled) for f in (reverse, reverse_ledger)]
        self._lib = None if schur is None or not compiled else _schur_back(schur)
        address = None
        if self._lib is not None:
            address = ctypes.addressof(ctypes.c_char.in_dll(self._lib, "ph_schur_backwards"))
        functions = [f.address for f in self._kept]
        self.table, self.sparse = _Backwards(*functions, address), _Backwards(*functions, None)


def _schur_back(schur: SchurStepper) -> ctypes.CDLL | None:
    """The compiled way back of a Schur stepper; None where it has none, as for light directions at order 6."""
    if len(schur.light) and schur.k > 1:
        return None
    try:
        return ctypes.CDLL(str(compile(headers() | {"schur_back.c": back_text(schur)}, flags=host_flags()).path))
    except (CompilerMissing, NoLanes):
        return None


#: reverse functions of code, made once for all models with the same
_REVERSE: WeakKeyDictionary[Code, _ReverseFunctions] = WeakKeyDictionary()


def _functions(native: NativeModel, model: EngineModel) -> _ReverseFunctions:
    """The reverse functions of the code of a model."""
    found = _REVERSE.get(native.code)
    if found is None:
        found = _REVERSE[native.code] = _ReverseFunctions(native, model.step.schur)
    return found


def _typed(lib: ctypes.CDLL) -> ctypes.CDLL:
    """The library with the signatures of reverse.h."""
    pointer, integer, size = ctypes.c_void_p, ctypes.c_int, ctypes.c_size_t
    signatures: Signatures = {
        "ph_tape_width": (integer, [pointer]),
        "ph_tape_on": (None, [pointer, pointer, pointer, integer]),
        "ph_reverse_size": (size, [pointer, pointer, integer]),
        "ph_reverse_init": (pointer, [pointer, pointer, pointer, integer]),
        "ph_reverse_width": (integer, [pointer]),
        "ph_reverse_bars": (pointer, [pointer]),
        "ph_reverse_by_schur": (integer, [pointer]),
        "ph_reverse_steps": (integer, [pointer, *(ctypes.POINTER(c) for c in (_Parts, _RowBarsStruct, ctypes.c_double))]),
        "ph_reverse_instant": (integer, [pointer, pointer]),
    }  # fmt: skip
    return typed(lib, signatures)


class NativeTape:
    """The parts of steps that an instance takes in a `with` block, `room` of them."""

    def __init__(self, instance: NativeInstance, room: int):
        self._instance, self._lib = instance, _typed(backwards())
        self._rows = np.empty((room, self._lib.ph_tape_width(instance._tables.pointer)))
        self._tape = _Tape()

    def __enter__(self) -> NativeTape:
        self._lib.ph_tape_on(
            self._instance.handle.instance, ctypes.addressof(self._tape), self._rows.ctypes.data, len(self._rows)
        )
        return self

    def __exit__(self, *_: object) -> None:
        self._lib.ph_tape_on(self._instance.handle.instance, None, None, 0)

    def taken(self, begin: float, end: float) -> Floats:
        """A copy of the parts that begin in [begin, end), which leave the tape with those before: they were taken back."""
        rows = self.rows
        first, n = np.searchsorted(rows[:, 0], [begin, end]).tolist()
        found, left = rows[first:n].copy(), len(rows) - n
        self._rows[:left] = rows[n:].copy()
        self._tape.n = left
        return found

    @property
    def full(self) -> bool:
        """A part found no room."""
        return bool(self._tape.full)

    @property
    def rows(self) -> Floats:
        """[t | h | states at the start | unknowns | inputs at the nodes] of each part (n x width)."""
        return self._rows[: self._tape.n]


class NativeTapes:
    """Tapes of the instance, or of one in each mode of ideal switches, in a `with` block, with `room` for parts of each."""

    def __init__(self, instance: NativeInstance | SwitchedInstance, room: int):
        self._instance, self._room, self._stack = instance, room, ExitStack()
        self._tapes: dict[int, NativeTape] = {}

    def __enter__(self) -> NativeTapes:
        self._stack.__enter__()
        if isinstance(self._instance, SwitchedInstance):
            for own in self._instance.instances:
                self._add(own)
            self._instance.made = self._add
        else:
            self._add(self._instance)
        return self

    def __exit__(self, *of: Any) -> None:
        if isinstance(self._instance, SwitchedInstance):
            self._instance.made = None
        self._stack.__exit__(*of)

    def _add(self, instance: NativeInstance) -> None:
        self._tapes[id(instance)] = self._stack.enter_context(NativeTape(instance, self._room))

    def of(self, mode: Mode | None) -> NativeTape:
        """The tape of the instance in a mode."""
        own = self._instance
        if isinstance(own, SwitchedInstance) and mode is not None:
            own = own.of(mode)[0]
        return self._tapes[id(own)]


@dataclass(frozen=True)
class Bars:
    """Derivatives of some measures (n x ..) by states and time (nx + 1), parameters, held inputs, energies through pairs and lost
    since the start, and by the length of a step that moves (1): views into the memory of the way back."""

    x: Floats
    p: Floats
    u: Floats
    pairs: Floats
    lost: Floats
    h: Floats

    @property
    def all(self) -> tuple[Floats, ...]:
        """All arrays in the order of the fields."""
        return self.x, self.p, self.u, self.pairs, self.lost, self.h


@dataclass(frozen=True)
class RowBars:
    """Rows of a run, by ascending number, with the bars (rows x measures x [x | a | y_step | energy | dissipated]) of what they
    tell."""

    row: NDArray[np.int32]
    bar: Floats


class NativeReverse:
    """The way back of n measures, over tapes of instances of a model with the shared parts `native`.

    schur: where the model has a Schur stepper, its factor serves, and the sparse LU only where that one does not; False: the
    sparse LU always.
    """

    def __init__(self, model: EngineModel, native: NativeModel, n: int, schur: bool = True):
        self._model, self._lib = model, _typed(backwards())
        self._functions = _functions(native, model)
        self._memory, status = placed(self._lib, "ph", native.tables.pointer)
        if status:
            raise RuntimeError(f"{model.name}: no memory of an instance")
        self._instance = self._memory.ctypes.data
        self._table = self._functions.table if schur else self._functions.sparse
        about = self._instance, ctypes.addressof(self._table), n
        self._room = np.zeros(self._lib.ph_reverse_size(*about) // 8 + 1)
        self._in = self._lib.ph_reverse_init(self._room.ctypes.data, *about)
        plan, width = model.step, self._lib.ph_reverse_width(native.tables.pointer)
        values = view(self._lib.ph_reverse_bars(self._in), n * width).reshape(n, width)
        ends = np.cumsum([plan.nx + 1, plan.np, plan.nu, plan.nq, plan.ncomp]).tolist()
        self.bars = Bars(*np.split(values, ends, axis=1))
        self.n = n

    @property
    def by_schur(self) -> int:
        """Parts of steps, of each measure, that went back by the factor of the Schur stepper."""
        return self._lib.ph_reverse_by_schur(self._in)

    def back(
        self, rows: Floats, parameters: Floats, row: NDArray[np.int32], part: Floats, told: RowBars, moves: bool = False
    ) -> None:
        """Over parts of steps (rows of a tape), taken with `parameters`; `row`: the row of the run that each belongs to, `part`:
        what it is of its step.  `moves`: they are those of one step, whose start and length move: their bars are added to
        `bars.x[:, nx]` and `bars.h`.  NoDerivative."""
        self._lib.ph_set_parameters(self._instance, np.ascontiguousarray(parameters).ctypes.data)
        row, part = np.ascontiguousarray(row, np.int32), np.ascontiguousarray(part, float)
        given, bar = np.ascontiguousarray(told.row, np.int32), np.ascontiguousarray(told.bar, float)
        parts = _Parts(len(rows), rows.ctypes.data, row.ctypes.data, part.ctypes.data, int(moves))
        at = ctypes.c_double()
        bars = _RowBarsStruct(len(given), given.ctypes.data, bar.ctypes.data)
        if self._lib.ph_reverse_steps(self._in, parts, bars, at):
            raise NoDerivative(at.value)

    def instant(self, t: float, x: Floats, u: Floats, p: Floats, a: Floats, bar: Floats) -> None:
        """Go back from values at an instant; NoDerivative.

        bar: n x [a_end | y_end | observables | H];  a: the algebraic variables of the instant
        """
        lib, at = self._lib, self._instance
        x, u, p, a, bar = (np.ascontiguousarray(v, float) for v in (x, u, p, a, bar))
        lib.ph_set_parameters(at, p.ctypes.data)
        lib.ph_set_x(at, t, x.ctypes.data)
        lib.ph_set_input(at, u.ctypes.data)
        lib.ph_set_algebraic(at, a.ctypes.data)
        if lib.ph_reverse_instant(self._in, bar.ctypes.data) != tuple(Status).index(Status.OK):
            raise NoDerivative(t)
