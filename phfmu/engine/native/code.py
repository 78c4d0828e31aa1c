"""The code of a model's equations as ph_code: compiled, or tables that the runtime interprets.

Both have the same token and give the same bits.  A model that is new begins interpreted, at once; where its run is long enough
to earn it, the compiler works beside the run, and what it makes takes the place of the tables as soon as it is there.
"""

from __future__ import annotations

import ctypes
import hashlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from math import inf
from pathlib import Path
from threading import Thread
from typing import Literal

import casadi as ca

from phfmu.engine.build import codegen
from phfmu.engine.build.codegen import function_table, kernel_table
from phfmu.engine.build.compile import Build, CompileError, CompilerMissing, GeneratedSource, compile, find, host_flags
from phfmu.engine.build.kernels import Kernels
from phfmu.engine.build.operations import Operations, operations
from phfmu.engine.build.runtime_sources import headers
from phfmu.engine.build.tables import TableMemory
from phfmu.engine.native.library import runtime
from phfmu.schur.stepper import SchurStepper

#: forms of kernels; auto: compiled if that is in the cache, or a Schur stepper needs it, else interpreted to begin with
Kind = Literal["auto", "compiled", "interpreted"]

#: s that a compiler takes: always, and for each operation of the kernels (zig and gcc on one core, measured)
COMPILING = (0.3, 0.6e-3)
#: s that compiled kernels save in a step, for each operation of an evaluation of its plan (measured: 2 to 4.5 ns)
SAVED = 2.5e-9

Announce = Callable[[], None] | None


class KernelRow(ctypes.Structure):
    """The structure ph_kernel of the runtime."""

    _fields_ = [
        *((n, ctypes.c_void_p) for n in ("value", "full", "ledger")),
        *((n, ctypes.c_int) for n in ("nx", "ny", "np", "no", "nj", "nwork")),
        ("program", ctypes.c_void_p),
    ]


class FunctionRow(ctypes.Structure):
    """The structure ph_function of the runtime."""

    _fields_ = [
        ("call", ctypes.c_void_p),
        *((n, ctypes.c_int) for n in ("arg", "res", "iw", "w")),
        ("program", ctypes.c_void_p),
    ]


class CodeRow(ctypes.Structure):
    """The structure ph_code of the runtime."""

    _fields_ = [
        ("token", ctypes.c_uint64),
        ("nkernel", ctypes.c_int),
        ("kernels", ctypes.c_void_p),
        ("solver", ctypes.c_void_p),
    ]


class CompiledCode:
    """Kernels in a library of their own, with the solver of `schur`; `announce` is called before a compiler runs."""

    compiled = True

    def __init__(self, kernels: Kernels, source: GeneratedSource, announce: Announce = None) -> None:
        self.index = kernels.index
        self.build = compile(headers() | {"kernels.c": source}, flags=host_flags(), announce=announce)
        self._lib = ctypes.CDLL(str(self.build.path))
        self.address = ctypes.addressof(ctypes.c_char.in_dll(self._lib, "ph_the_code"))

    def count(self, steps: float) -> bool:
        """Steps that are or will be taken; whether more of them are to be told."""
        return False


class InterpretedCode(TableMemory):
    """Kernels as programs of the runtime, which become compiled ones when that is earned.

    `work`: operations of an evaluation of the plan of a step; 0: they stay interpreted.  prefix: of the functions of `lib`
    (default: the runtime) that interpret.  solver: address of a ph_schur_code.
    """

    build: Build | None = None

    def __init__(
        self, kernels: Kernels, work: int = 0, lib: ctypes.CDLL | None = None, prefix: str = "ph_interpret",
        solver: int | None = None,
    ) -> None:  # fmt: skip
        super().__init__()
        self._kernels, self.index, self.compiled = kernels, kernels.index, False
        lib = lib or runtime()[1]
        self._rows = (KernelRow * max(1, len(kernels.members)))()
        for row, member in zip(self._rows, kernels.members, strict=False):
            for name in ("nx", "ny", "np", "no", "nj"):
                setattr(row, name, getattr(member.kernel, name))
            programs: dict[str, int | None] = {"ledger": None}
            for name, table in member.tables.items():
                programs[name], slots = _program(self, table)
                row.nwork = max(row.nwork, slots)
                setattr(row, name, _address(lib, f"{prefix}_{name}"))
            row.program = ctypes.addressof(self.fill("ph_programs", None, programs))
        self._code = CodeRow(kernels.token, len(kernels.members), ctypes.addressof(self._rows), solver)
        self.address = ctypes.addressof(self._code)
        #: steps that are still to be taken before compiled kernels are worth their time
        self._left = (COMPILING[0] + COMPILING[1] * kernels.size) / (SAVED * work) if work else inf

    def count(self, steps: float) -> bool:
        """Steps that are or will be taken; whether more of them are to be told."""
        if self._left < inf:
            self._left -= steps
            if self._left <= 0:
                self._left = inf
                self._beside()
        return self._left < inf

    def compile(self, announce: Announce = None) -> None:
        """Compiled kernels at once."""
        if not self.compiled:
            self._take(CompiledCode(self._kernels, source(self._kernels, None), announce))

    def _beside(self) -> None:
        """The compiler beside the run; the text is made before, as CasADi is not for two threads."""
        text = source(self._kernels, None).with_text()

        def work() -> None:
            with suppress(CompilerMissing, CompileError, OSError):
                self._take(CompiledCode(self._kernels, text))

        Thread(target=work, name="phfmu compiler", daemon=True).start()

    def _take(self, other: CompiledCode) -> None:
        """Compiled kernels in place of the programs: functions by single stores, which may come between any two calls."""
        self._other = other
        at = CodeRow.from_address(other.address).kernels
        for row, found in zip(self._rows, (KernelRow * len(self._rows)).from_address(at), strict=True):
            row.value, row.full, row.ledger = found.value, found.full, found.ledger
        self.build, self.compiled = other.build, True


Code = CompiledCode | InterpretedCode


def code_of(kernels: Kernels, schur: SchurStepper | None, kind: Kind, work: int = 0, announce: Announce = None) -> Code:
    """The code of kernels; NotInterpreted, CompilerMissing, CompileError.

    Without a compiler a model with a Schur stepper takes Newton's method.
    """
    if kind == "interpreted":
        return InterpretedCode(kernels)
    text = source(kernels, schur)
    if kind == "auto" and schur is None and not kernels.unknown and not _found(text):
        return InterpretedCode(kernels, work)
    try:
        return CompiledCode(kernels, text, announce)
    except CompilerMissing:
        if kind == "compiled" or kernels.unknown:
            raise
        return InterpretedCode(kernels)


def source(kernels: Kernels, schur: SchurStepper | None) -> GeneratedSource:
    """The source kernels.c; without a Schur stepper it is known by its kernels and by the module that writes it."""
    if schur is not None:
        text = kernel_table(kernels, schur).text
        return GeneratedSource(text, lambda: text)
    writer = hashlib.sha256(Path(codegen.__file__).read_bytes()).hexdigest()
    return GeneratedSource(f"{kernels.token:#x} {ca.CasadiMeta.version()} {writer}", lambda: kernel_table(kernels).text)


def _found(text: GeneratedSource) -> bool:
    return find(headers() | {"kernels.c": text}, flags=host_flags()) is not None


class Functions(TableMemory):
    """ph_functions at `address`, compiled, if there is a compiler, or interpreted; None: one without a call."""

    def __init__(self, functions: Sequence[ca.Function | None], compiled: bool) -> None:
        super().__init__()
        try:
            self.address = self._compiled(functions) if compiled else self._interpreted(functions)
        except CompilerMissing:  # kernels were in the cache, these are not
            self.address = self._interpreted(functions)

    def of(self, place: int) -> int:
        """The address of one of them."""
        return self.address + place * ctypes.sizeof(FunctionRow)

    def _compiled(self, functions: Sequence[ca.Function | None]) -> int:
        text = function_table(functions, "ph_functions")
        self._lib = ctypes.CDLL(str(compile(headers() | {"functions.c": text}, flags=host_flags()).path))
        return ctypes.addressof(ctypes.c_char.in_dll(self._lib, "ph_functions"))

    def _interpreted(self, functions: Sequence[ca.Function | None]) -> int:
        rows = (FunctionRow * max(1, len(functions)))()
        for row, f in zip(rows, functions, strict=False):
            if f is not None:
                row.program, row.w = _program(self, operations(f))
                row.arg, row.res, row.call = f.n_in(), f.n_out(), _address(runtime()[1], "ph_interpret_function")
        self._keep.append(rows)
        return ctypes.addressof(rows)


def _program(memory: TableMemory, table: Operations) -> tuple[int, int]:
    """Address of a program that lives as long as `memory`, and the length of its work space."""
    made = table.program()
    return ctypes.addressof(memory.fill("ph_program", made, made.derived)), made.derived["nslot"]


def _address(lib: ctypes.CDLL, name: str) -> int | None:
    return ctypes.cast(getattr(lib, name), ctypes.c_void_p).value
