"""Lanes: runs of one model whose steps are taken together, each number a vector with one of each run.

Each run has the bits of its own steps: vectors have the same operations in the same order, and a run that anything unusual
happens to (another pivot order, a step that is halved or refused) takes that step by itself.  Newton's method has interpreted
kernels; a Schur stepper is compiled once more, for so many runs.
"""

from __future__ import annotations

import ctypes
import re
from pathlib import Path

import numpy as np

from phfmu.engine.build.codegen import solver_text
from phfmu.engine.build.compile import Source, compile, find, host_flags
from phfmu.engine.build.runtime_sources import headers
from phfmu.engine.native.code import InterpretedCode
from phfmu.engine.native.native import NativeInstance
from phfmu.engine.native.native_model import native_model
from phfmu.schur.stepper import SchurStepper

#: runs side by side
LANES = int(
    re.findall(r"#define PH_LANE_WIDTH (\d+)", (Path(__file__).parent / "runtime" / "lane_width.h").read_text())[0]
)


#: a Schur stepper of more nodes fills the vectors of a processor with those of one run: side by side it gained nothing (measured)
NODES = 1
#: steps of a thread that earn the compiler's time of a Schur stepper, some seconds at 0.3 to 8 us a step
EARNS = 5_000_000


class LaneMemory:
    """Memory of the steps of runs side by side, at `address`, with the address of the books of all.

    fits: whether the steps of the model can be taken so
    """

    def __init__(self, code: InterpretedCode, lib: ctypes.CDLL, model: int, books: int):
        self._code, self._lib = code, lib
        size = lib.ph_lanes_size(model, code.address)
        self._memory = np.zeros(size // 8 + 9)
        self.address = -(-self._memory.ctypes.data // 64) * 64
        self.fits = lib.ph_lanes_init(self.address, model, code.address, books) == 0

    @property
    def inside(self) -> int:
        """Steps of runs that were taken with others."""
        return self._lib.ph_lanes_taken(self.address)


def lanes_of(instance: NativeInstance, lib: ctypes.CDLL, books: int, solver: LaneSolver | None) -> LaneMemory | None:
    """Lanes for runs of the model of an instance, with the address of their books, `solver`: its Schur stepper's.

    None if the library does not take the steps of the model so.
    """
    native = native_model(instance.model, instance.kind)
    at = None if solver is None else solver.address
    code = InterpretedCode(native.kernels, lib=lib, prefix="ph_wide_interpret", solver=at)
    lanes = LaneMemory(code, lib, native.tables.pointer, books)
    return lanes if lanes.fits else None


def why_not(instance: NativeInstance) -> str:
    """Why the steps of a model are taken run by run; "" if lanes take them."""
    native, plan = native_model(instance.model, instance.kind), instance.model.step
    if native.kernels.unknown:
        return "an equation has an operation that only compiled code has"
    if plan.nw == 0:
        return "its steps are explicit"
    if plan.schur is None or not native.code.compiled:
        return f"Newton's method with {len(plan.hold)} constraints that may come to rest" if len(plan.hold) else ""
    if plan.hold.rests.any():
        return "redundant constraints rest, which are looked at in each step of a run"
    return (
        ""
        if plan.k <= NODES
        else f"the Schur stepper of {plan.k} nodes fills the vectors of the processor with one run"
    )


class LaneSolver:
    """A Schur stepper compiled for runs side by side; `address`: of its ph_schur_code.  CompilerMissing, CompileError."""

    def __init__(self, schur: SchurStepper):
        self._lib = ctypes.CDLL(str(compile(_sources(schur), flags=host_flags()).path))
        self.address = ctypes.c_void_p.in_dll(self._lib, "ph_wide_solver").value

    @staticmethod
    def found(schur: SchurStepper) -> bool:
        """True if the Schur stepper was compiled for several runs before."""
        return find(_sources(schur), flags=host_flags()) is not None


def _sources(schur: SchurStepper) -> dict[str, Source]:
    return {**headers(), "lanes.c": solver_text(schur, LANES)}
