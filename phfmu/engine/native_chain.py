"""Sensitivities of native instances over several internal steps: a second library, made when they are asked for."""

from __future__ import annotations

import ctypes

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.codegen import kernel_table
from phfmu.engine.library import build, load
from phfmu.engine.model import Model, kernels
from phfmu.engine.tables import CTables
from phfmu.engine.tangent_text import tangent_text


class NativeChain:
    """An instance with the tangents of the kernels; it takes over the state of one without them."""

    def __init__(self, model: Model) -> None:
        self._nu = model.step.nu
        table = kernel_table(kernels(model), model.step.schur)
        self._lib = load(build(table, more={"tangents.c": tangent_text(table, model.step)}).path)
        address = ctypes.addressof(ctypes.c_char.in_dll(self._lib, "ph_tangents"))
        self._tables = CTables(model, table.index, table.token, address)
        self._memory = np.zeros(self._lib.ph_size(self._tables.pointer) // 8 + 1)
        self._in = self._memory.ctypes.data
        self._init = self._lib.ph_init(self._in, self._tables.pointer)

    def sensitivity(self, state: bytes) -> tuple[int, NDArray[np.float64]]:
        """Status and S of the last step of a saved state."""
        s = np.empty((self._nu, self._nu))
        code = self._init or self._lib.ph_load(self._in, state)
        return code or self._lib.ph_sensitivity(self._in, s.ctypes.data), s
