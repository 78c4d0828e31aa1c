"""Directional derivatives of native instances: tangents of the kernels, made when they are asked for.

Impulses of native instances: functions of the ports, made when they are asked for.
"""

from __future__ import annotations

import ctypes
from functools import lru_cache
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.build.codegen import tangents
from phfmu.engine.impulses import PortKernels
from phfmu.engine.model import EngineModel
from phfmu.engine.native.code import Code, Functions
from phfmu.engine.native.library import Directions, placed, view
from phfmu.engine.native.native_model import NativeModel

Floats = NDArray[np.float64]


#: tangents of code
_TANGENTS: WeakKeyDictionary[Code, Functions] = WeakKeyDictionary()


def _tangents(model: EngineModel, native: NativeModel) -> Functions:
    """The tangents of the kernels, made once for all models with the same code."""
    found = _TANGENTS.get(native.code)
    if found is None:
        wanted = tangents(native.kernels, model.step, model.instant)
        found = _TANGENTS[native.code] = Functions(wanted, native.code.compiled)
    return found


class NativeChain:
    """An instance with the tangents of the kernels; it takes over the state of one without them."""

    def __init__(self, model: EngineModel, native: NativeModel) -> None:
        self._plan, self.lib = model.step, native.lib
        self._functions = _tangents(model, native)
        self._tables = native.tables.with_tangents(model, self._functions.address)
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
        """Status and changes of the outputs at the end (n x nu), for the state taken last; dx: directions of the state there."""
        dy = np.empty((len(du), self._plan.nu))
        return self.lib.ph_end_along(self.address, Directions.of(du, dx, dy)), dy

    def _take(self, state: bytes) -> int:
        return self._init or self.lib.ph_load(self.address, state)


class _PortFunctions(Functions):
    """Functions of the ports of a model, with its ph_ports at the address `ports`."""

    def __init__(self, kernels: PortKernels, compiled: bool) -> None:
        names = ("shift", "jump", "tangent")
        super().__init__([getattr(kernels, n) for n in names], compiled)
        forms = kernels.forms
        values = {"n": len(forms.pairs), "nstate": len(forms.states), "pair": forms.pairs, "state": forms.states}
        values |= {name: self.of(i) for i, name in enumerate(names)} | {"slopes": None}
        self.ports = ctypes.addressof(self.fill("ph_ports", None, values))


_ports = lru_cache(maxsize=64)(_PortFunctions)


class NativeImpulses:
    """Impulses on the instance at address `instance`, of a model with the shared parts `native`."""

    def __init__(self, native: NativeModel, instance: int, kernels: PortKernels) -> None:
        lib = native.lib
        self.n, self._lib = kernels.n, lib
        self._ports = _ports(kernels, native.code.compiled)
        self._memory, self.address = placed(lib, "ph_impulses", instance, self._ports.ports)
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
