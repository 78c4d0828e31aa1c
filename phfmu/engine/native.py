"""Instances that step in compiled code."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phfmu.engine.handle import Handle
from phfmu.engine.impulses import Ports
from phfmu.engine.library import Column, Record, record_widths, view
from phfmu.engine.model import Model
from phfmu.engine.native_readings import NativeReadings
from phfmu.engine.node_sensitivity import NodeSensitivity, chosen, columns, directions
from phfmu.engine.record import Grid, step_by_step
from phfmu.engine.status import StepFailure
from phfmu.events.happened import Landed

if TYPE_CHECKING:
    from phfmu.engine.native_chain import NativeChain
    from phfmu.engine.native_impulses import NativeImpulses
    from phfmu.engine.native_landing import NativeLanding

Floats = NDArray[np.float64]


class NativeInstance(NativeReadings):
    """An instance in compiled code, the twin of `PythonInstance`: one memory block, one C call a step.

    What both are says `Instance`.  `announce` is called before a compiler runs.
    """

    def __init__(self, model: Model, announce: Callable[[], None] | None = None) -> None:
        super().__init__(model, announce)
        self._step, self._steps = self._lib.ph_step, self._lib.ph_step_parts
        self._kicked: NativeImpulses | None = None
        self._landing: NativeLanding | None = None
        if model.events is not None:
            self._step = self._steps = self._landed_step
        self.initialise()

    def reset(self) -> None:
        self._check(self._lib.ph_reset(self._in))
        if self._kicked is not None:
            self._kicked.values[:] = 0.0
        self.initialise()

    def initialise(self) -> None:
        self._check(self._lib.ph_initialise(self._in))

    def set_input(self, u: ArrayLike) -> None:
        values = self._array(u, self.model.step.nu)
        self._check(self._lib.ph_set_input(self._in, values.ctypes.data))

    def set_node_inputs(self, u: ArrayLike) -> None:
        values = self._array(u, self.model.step.k, self.model.step.nu)
        self._check(self._lib.ph_set_node_inputs(self._in, values.ctypes.data))

    @property
    def held_input(self) -> Floats:
        return view(self._lib.ph_input(self._in), self.model.step.nu).copy()

    @property
    def parameters(self) -> Floats:
        return view(self._lib.ph_parameters(self._in), self.model.step.np).copy()

    def set_parameters(self, p: ArrayLike) -> None:
        values = self._array(p, self.model.step.np)
        self._check(self._lib.ph_set_parameters(self._in, values.ctypes.data))

    def set_x(self, t: float, x: ArrayLike) -> None:
        values = self._array(x, self.model.step.nx)
        self._check(self._lib.ph_set_x(self._in, t, values.ctypes.data))

    def continue_from(self, other: NativeInstance) -> None:
        self._check(self._lib.ph_continue(self._in, other._in))

    def _take_impulses(self, s: Floats) -> None:
        self._check(self._kicks.set(s))
        self._step, self._steps = self._kicked_step, self._kicked_step

    def add_impulse(self, s: ArrayLike) -> None:
        self._check(self._kicks.more(self._array(s, self._ports.kernels.n)))

    def jump(self) -> Floats:
        return self._kicks.jump() if self._ports.kernels.n else np.zeros((0, 0))

    @cached_property
    def _ports(self) -> Ports:
        return Ports(self.model.declaration)

    @property
    def _kicks(self) -> NativeImpulses:
        if self._kicked is None:
            from phfmu.engine.native_impulses import NativeImpulses

            self._kicked = NativeImpulses(self._lib, self._in, self._ports.kernels)
        return self._kicked

    def _kicked_step(self, _: int, t: float, h: float, parts: int = 1) -> int:
        return self._kicks.step(t, h, parts)

    def do_step(self, t: float, h: float, parts: int = 1) -> None:
        status = self._step(self._in, t, h) if parts == 1 else self._steps(self._in, t, h, parts)
        if status:
            self._check(status)

    def skip(self, t: float) -> None:
        self._check(self._lib.ph_skip(self._in, t))

    def step_exactly(self, t: float, h: float, parts: int = 1) -> None:
        self._check(self._lib.ph_step_exactly(self._in, t, h, parts))

    def _run(self, grid: Grid, names: tuple[str, ...], inputs: Floats | None) -> dict[str, Floats]:
        if self.model.events is not None:
            result, self.happened = step_by_step(self, grid, names, inputs)
            return result
        if self._kicked is not None:
            self._ports.require_none(self._kicked.values[:2])
            self._kicked.values[2:] = 0.0
        width = record_widths(self.model, len(self._table))
        result = {name: np.empty((grid.n, width[name])) for name in names}
        request = Record(parts=grid.parts, first=grid.first)
        for name, array in result.items():
            setattr(request, name, Column(array.ctypes.data, array.shape[1]))
        if inputs is not None:
            request.input, request.input_stride = inputs.ctypes.data, math.prod(inputs.shape[1:])
            request.at_nodes = inputs.ndim == 3
        done = ctypes.c_int()
        code = self._lib.ph_run(self._in, grid.t0, grid.h, grid.n, request, done)
        try:
            self._check(code)
        except StepFailure as failure:
            failure.recorded = {name: rows[: done.value] for name, rows in result.items()}
            raise
        return result

    @property
    def landing(self) -> tuple[NativeLanding, Callable[[int], None]]:
        return self._lands, self._check

    def _land(self, grid: Grid, names: tuple[str, ...], changed: bool) -> Iterator[Landed]:
        return self._lands.over(grid, names, changed, self._check)

    @property
    def _lands(self) -> NativeLanding:
        if self._landing is None:
            from phfmu.engine.native_landing import NativeLanding

            self._landing = NativeLanding(self.model, self._lib, self._in, self._tables.events, len(self._table))
        return self._landing

    def _landed_step(self, _: int, t: float, h: float, parts: int = 1) -> int:
        self.happened = self._lands.step(t, h, parts, self._check)
        return 0

    @property
    def memory_size(self) -> int:
        """Bytes of the instance's block and of the tables it points to."""
        return self._memory.nbytes + self._tables.size

    def sensitivity(self, end: bool = False) -> Floats:
        if not end and self._lib.ph_solves(self._in) > 1:
            code, s = self._chain.sensitivity(self.get_state())
            self._check(code)
            return s
        s = np.empty((self.model.step.nu,) * 2)
        function = self._lib.ph_sensitivity_end if end else self._lib.ph_sensitivity
        self._check(function(self._in, s.ctypes.data))
        return s

    def node_sensitivity(
        self, inputs: Sequence[int] | None = None, impulses: bool = False, end: bool = False
    ) -> NodeSensitivity:
        plan = self.model.step
        kicks = self._kicks if impulses else self._kicked
        du, ds = directions(plan, chosen(plan, inputs), kicks.n if kicks and impulses else 0)
        dx = np.zeros((len(du), plan.nx + 1 + plan.na))
        starts, ends = np.ascontiguousarray(ds[:, 0]), np.ascontiguousarray(ds[:, 1])
        if kicks and impulses:
            kicks.along(False, starts, dx)
        code, dy = self._chain.along(self.get_state(), du, dx)
        self._check(code)
        if kicks:
            kicks.along(True, ends if impulses else np.zeros((len(dx), kicks.n)), dx)
        return columns(plan, dy, dx, self._end_along(du, dx) if end else None)

    def _end_along(self, du: Floats, dx: Floats) -> Floats:
        code, dy = self._chain.end_along(du, dx)
        self._check(code)
        return dy

    @cached_property
    def _chain(self) -> NativeChain:
        from phfmu.engine.native_chain import NativeChain

        return NativeChain(self.model)

    @property
    def handle(self) -> Handle:
        """For compiled code that steps the instance itself."""
        lib, at = self._lib, self._in
        places = lib.ph_signals(at), lib.ph_node_outputs(at)
        return Handle(
            lib, at, self._state_size, *places, self._kicked, self._check, lambda: self._kicks, lambda: self._chain
        )

    def get_state(self) -> bytes:
        buffer = ctypes.create_string_buffer(self._state_size)
        self._lib.ph_save(self._in, buffer)
        return buffer.raw if self._kicked is None else buffer.raw + self._kicked.values.tobytes()

    def set_state(self, state: bytes) -> None:
        more = len(state) - self._state_size
        if more and (more < 0 or more % 32 or more != 32 * self._ports.kernels.n):
            raise ValueError(f"{self.model.name}: state of {len(state)} bytes, expected {self._state_size}")
        self._check(self._lib.ph_load(self._in, state))
        if more:
            self._kicks.values[:] = np.frombuffer(state[self._state_size :]).reshape(4, -1)
            self._step, self._steps = self._kicked_step, self._kicked_step
        elif self._kicked is not None:
            self._kicked.values[:] = 0.0

    def restore(self, state: Any) -> None:
        self.set_state(state)
