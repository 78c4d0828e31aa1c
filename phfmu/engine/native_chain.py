"""Directional derivatives of native instances: a second library with tangents, made when they are asked for."""

from __future__ import annotations

import ctypes

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.codegen import kernel_table
from phfmu.engine.library import Directions, build, load
from phfmu.engine.model import Model, kernels
from phfmu.engine.tables import CTables
from phfmu.engine.tangent_text import tangent_text

Floats = NDArray[np.float64]


class NativeChain:
    """An instance with the tangents of the kernels; it takes over the state of one without them."""

    def __init__(self, model: Model) -> None:
        self._plan = model.step
        table = kernel_table(kernels(model), model.step.schur)
        self.lib = load(build(table, more={"tangents.c": tangent_text(table, model.step, model.instant)}).path)
        address = ctypes.addressof(ctypes.c_char.in_dll(self.lib, "ph_tangents"))
        self._tables = CTables(model, table.index, table.token, address)
        self._memory = np.zeros(self.lib.ph_size(self._tables.pointer) // 8 + 1)
        self.address = self._memory.ctypes.data
        self._init = self.lib.ph_init(self.address, self._tables.pointer)

    def sensitivity(self, state: bytes) -> tuple[int, Floats]:
        """Status and S of the last step of a saved state."""
        s = np.empty((self._plan.nu, self._plan.nu))
        code = self._take(state)
        return code or self.lib.ph_sensitivity(self.address, s.ctypes.data), s

    def along(self, state: bytes, du: Floats, dx: Floats) -> tuple[int, Floats]:
        """Status and changes of the outputs at the nodes (n x k x nu) along directions of the last step of a saved state.

        du: n x k x nu;  dx: n x (nx+1+na), directions of the state at its start, on return at its end.
        """
        dy = np.empty(du.shape)
        return self._take(state) or self.lib.ph_step_along(self.address, Directions.of(du, dx, dy)), dy

    def end_along(self, du: Floats, dx: Floats) -> tuple[int, Floats]:
        """The same of the outputs at the end (n x nu), for the state taken last; dx: directions of the state there."""
        dy = np.empty((len(du), self._plan.nu))
        return self.lib.ph_end_along(self.address, Directions.of(du, dx, dy)), dy

    def _take(self, state: bytes) -> int:
        return self._init or self.lib.ph_load(self.address, state)
