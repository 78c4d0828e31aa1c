"""Directional derivatives of native instances: a second library with tangents, made when they are asked for.

Impulses of native instances: a small library with the functions of the ports, made when they are asked for.
"""

from __future__ import annotations

import ctypes
from functools import lru_cache
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.build.codegen import kernel_table, port_text, tangent_text
from phfmu.engine.build.compile import compile, host_flags
from phfmu.engine.build.tables import CTables
from phfmu.engine.impulses import PortKernels
from phfmu.engine.model import Model, first, kernels
from phfmu.engine.native.library import Directions, build, load, placed, runtime_sources, view

Floats = NDArray[np.float64]


_MADE: WeakKeyDictionary[Model, tuple[ctypes.CDLL, CTables]] = WeakKeyDictionary()


def with_tangents(model: Model) -> tuple[ctypes.CDLL, CTables]:
    """The library with tangents and the tables of a model, made once for all that share its plans."""
    made, alike = _MADE.get(model), first(model)
    if made is None and alike is not None:
        lib, tables = with_tangents(alike)
        made = _MADE[model] = lib, tables.like(model)
    elif made is None:
        table = kernel_table(kernels(model), model.step.schur)
        lib = load(build(table, more={"tangents.c": tangent_text(table, model.step, model.instant)}).path)
        address = ctypes.addressof(ctypes.c_char.in_dll(lib, "ph_tangents"))
        made = _MADE[model] = lib, CTables(model, table.index, table.token, address)
    return made


class NativeChain:
    """An instance with the tangents of the kernels; it takes over the state of one without them."""

    def __init__(self, model: Model) -> None:
        self._plan = model.step
        self.lib, self._tables = with_tangents(model)
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


@lru_cache(maxsize=64)
def _library(kernels: PortKernels) -> ctypes.CDLL:
    headers = {name: path for name, path in runtime_sources().items() if name.endswith(".h")}
    built = compile({**headers, "ports.c": port_text(kernels)}, flags=host_flags())
    return ctypes.CDLL(str(built.path))


class NativeImpulses:
    """Impulses on the instance at address `instance` of the library `lib`."""

    def __init__(self, lib: ctypes.CDLL, instance: int, kernels: PortKernels) -> None:
        self.n, self._lib = kernels.n, lib
        self._ports = _library(kernels)
        ports = ctypes.addressof(ctypes.c_char.in_dll(self._ports, "ph_the_ports"))
        self._memory, self.address = placed(lib, "ph_impulses", instance, ports)
        address = lib.ph_impulse_values(self.address)
        #: at start and end of the coming steps, then of the last one (4 x n)
        self.values = view(address, 4 * self.n).reshape(4, self.n)

    def set(self, s: Floats) -> int:
        """Status; s: at start and end of the coming steps (2 x n)."""
        return self._lib.ph_set_impulses(self.address, s.ctypes.data)

    def step(self, t: float, h: float, parts: int = 1) -> int:
        """Status of a step with impulses."""
        return self._lib.ph_step_impulses(self.address, t, h, parts)

    def more(self, s: Floats) -> int:
        """Status of one more impulse (n) at the end of the last step."""
        return self._lib.ph_kick_more(self.address, s.ctypes.data)

    def jump(self) -> Floats:
        """S at the present time (n x n)."""
        s = np.empty((self.n, self.n))
        self._lib.ph_jump(self.address, s.ctypes.data)
        return s

    def along(self, end: bool, ds: Floats, dx: Floats) -> None:
        """Directions dx of the states (m x (nx+1+na)) through the impulse at start or end of the last step, along ds (m x n)."""
        self._lib.ph_impulses_along(self.address, int(end), len(dx), ds.ctypes.data, dx.ctypes.data)
