"""Lanes: runs of one model whose steps are taken together, each number a vector with one of each run.

Each run has the bits of its own steps: vectors have the same operations in the same order, and a run that anything unusual
happens to (another pivot order, a step that is halved or refused) takes that step by itself.
"""

from __future__ import annotations

import ctypes
import re
from pathlib import Path

import numpy as np

from phfmu.engine.build.codegen import solver_text
from phfmu.engine.build.compile import compile, host_flags
from phfmu.engine.native.code import Interpreted
from phfmu.engine.native.compiled import made_of
from phfmu.engine.native.library import headers
from phfmu.engine.native.native import NativeInstance
from phfmu.schur.stepper import SchurStepper

#: runs side by side
LANES = int(re.findall(r"#define PH_LANE_WIDTH (\d+)", (Path(__file__).parent / "runtime" / "lane_width.h").read_text())[0])


class Lanes:
    """Memory of the steps of runs side by side, at `address`, with the address of the books of all.

    fits: whether the steps of the model can be taken so
    """

    def __init__(self, code: Interpreted, lib: ctypes.CDLL, model: int, books: int):
        self._code, self._lib = code, lib
        size = lib.ph_lanes_size(model, code.address)
        self._memory = np.zeros(size // 8 + 9)
        self.address = -(-self._memory.ctypes.data // 64) * 64
        self.fits = lib.ph_lanes_init(self.address, model, code.address, books) == 0

    @property
    def inside(self) -> int:
        """Steps of runs that were taken with others."""
        return self._lib.ph_lanes_taken(self.address)


def lanes_of(instance: NativeInstance, lib: ctypes.CDLL, books: int) -> Lanes | None:
    """Lanes for runs of the model of an instance, with the address of their books; CompileError.

    None if it has constraints that may rest and no Schur stepper, or operations that are not interpreted.
    """
    made, schur = made_of(instance.model, instance.kind), instance.model.step.schur
    if made.kernels.unknown:
        return None
    solver = Solver(schur) if schur is not None and made.code.compiled else None
    at = None if solver is None else solver.address
    code = Interpreted(made.kernels, lib=lib, prefix="ph_wide_interpret", solver=at)
    lanes = Lanes(code, lib, made.tables.pointer, books)
    return lanes if lanes.fits else None


class Solver:
    """A Schur stepper compiled for runs side by side; `address`: of its ph_schur_code."""

    def __init__(self, schur: SchurStepper):
        self.build = compile(headers() | {"lanes.c": solver_text(schur, LANES)}, flags=host_flags())
        self._lib = ctypes.CDLL(str(self.build.path))
        self.address = ctypes.c_void_p.in_dll(self._lib, "ph_wide_solver").value
