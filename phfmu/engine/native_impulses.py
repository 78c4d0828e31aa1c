"""Impulses of native instances: a small library with the functions of the ports, made when they are asked for."""

from __future__ import annotations

import ctypes
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.compile import compile, host_flags
from phfmu.engine.impulses import PortKernels
from phfmu.engine.library import placed, runtime_sources, view
from phfmu.engine.port_text import port_text

Floats = NDArray[np.float64]


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
