"""Lanes: runs of one model whose steps are taken together, each number a vector with one of each run.

Each run has the bits of its own steps: vectors have the same operations in the same order, and a run that anything unusual
happens to (another pivot order, a step that is halved or refused) takes that step by itself.
"""

from __future__ import annotations

import ctypes
import re
from pathlib import Path

import numpy as np

from phfmu.engine.native.code import Interpreted
from phfmu.engine.native.compiled import made_of
from phfmu.engine.native.native import NativeInstance

#: runs side by side
LANES = int(re.findall(r"#define PH_LANE_WIDTH (\d+)", (Path(__file__).parent / "runtime" / "wide.h").read_text())[0])


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
    """Lanes for runs of the model of an instance, with the address of their books.

    None if it has a Schur stepper, constraints that may rest, or operations that are not interpreted.
    """
    made = made_of(instance.model, instance.kind)
    if made.kernels.unknown:
        return None
    lanes = Lanes(Interpreted(made.kernels, lib=lib, prefix="ph_wide_interpret"), lib, made.tables.pointer, books)
    return lanes if lanes.fits else None
