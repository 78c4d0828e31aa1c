"""Instances that step in compiled code, and their addresses for compiled code that steps them itself.

Their base class reads the state, the last step, values at the present time, and failures.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any
from weakref import ref

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phfmu.engine.impulses import Ports
from phfmu.engine.instance import Instance
from phfmu.engine.model import EngineModel
from phfmu.engine.native.code import Kind
from phfmu.engine.native.library import Column, Record, enums, record_widths, view
from phfmu.engine.native.native_model import native_model
from phfmu.engine.node_sensitivity import NodeSensitivity, chosen, columns, directions
from phfmu.engine.record import Grid, step_by_step
from phfmu.engine.rest_changes import RestChange, named
from phfmu.outcome.limits import LIMITS
from phfmu.outcome.status import Status, StepFailure, attempts
from phfmu.outcome.steps import Landed

if TYPE_CHECKING:
    from phfmu.engine.native.derivatives import NativeChain, NativeImpulses
    from phfmu.engine.native.native_landing import NativeLanding


STATUS = tuple(Status)
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Handle:
    """Library and addresses of an instance, which must outlive the code that uses them.

    kicked: its impulses if there are any yet;  check: raises what a status means;  impulses, tangents: makes them, and
    compiles for it what they need
    """

    lib: ctypes.CDLL
    instance: int
    state_size: int
    signals: int
    node_outputs: int
    kicked: NativeImpulses | None
    check: Callable[[int], None]
    impulses: Callable[[], NativeImpulses]
    tangents: Callable[[], NativeChain]


class NativeReadings(Instance):
    """The memory of an instance of `model` in its library, and how it is read."""

    def __init__(self, model: EngineModel, announce: Callable[[], None] | None, kernels: Kind) -> None:
        super().__init__(model)
        self._native_model = native_model(model, kernels, announce)
        #: the form of kernels that was asked for
        self.kind: Kind = kernels
        self._tables, self._lib = self._native_model.tables, self._native_model.lib
        size = self._lib.ph_size(self._tables.pointer)
        if size == 0:
            raise StepFailure(Status.ABI, model.name, model.t0, 0.0)
        self._memory = np.zeros(size // 8 + 1)
        self._in = self._memory.ctypes.data
        self._check(self._lib.ph_init(self._in, self._tables.pointer))
        names = enums()["ph_block"]
        offset = (ctypes.c_int * (len(names) + 1))()
        self._lib.ph_layout(self._tables.pointer, offset)
        self._places = {n if n != "h" else "H": slice(offset[i], offset[i + 1]) for i, n in enumerate(names)}
        self._table = view(self._lib.ph_signals(self._in), offset[len(names)])
        self._state_size = self._lib.ph_state_size(self._in)
        self._means = self._table[self._places["y_step"]][: model.step.nu]

    @property
    def layout(self) -> dict[str, slice]:
        return self._places

    @property
    def time(self) -> float:
        return float(self._table[self.model.step.nx])

    @property
    def x(self) -> Floats:
        return self._table[self._places["x"]].copy()

    @property
    def counts(self) -> dict[str, int]:
        names = enums()["ph_count"]
        values = view(self._lib.ph_counts(self._in), len(names), np.int64)
        return {n: int(v) for n, v in zip(names, values, strict=True)}

    @property
    def rest_changes(self) -> list[RestChange]:
        n, kept = ctypes.c_int(), int(LIMITS["KEPT_CHANGES"])
        ring = self._lib.ph_rest_changes(self._in, n)
        found = ((i, ring[i % kept]) for i in range(max(0, n.value - kept), n.value))
        return named(((i + 1, c.time, c.rests, c.needed) for i, c in found), self.model.hold_names)

    def output(self) -> Floats:
        return self._means.copy()

    def node_output(self) -> Floats:
        plan = self.model.step
        values = view(self._lib.ph_node_outputs(self._in), plan.k * plan.nq).reshape(plan.k, plan.nq)
        return values[:, : plan.nu].copy()

    def ledger(self) -> dict[str, Floats]:
        names, plan = enums()["ph_row"], self.model.step
        sizes = {name: plan.nq if name == "pairs" else plan.ncomp for name in names}
        return {n: view(self._lib.ph_ledger(self._in, i), sizes[n]).copy() for i, n in enumerate(names)}

    @property
    def solves(self) -> int:
        return self._lib.ph_solves(self._in)

    @property
    def unknowns(self) -> Floats:
        return view(self._lib.ph_unknowns(self._in), self.model.step.nw).copy()

    def signals(self) -> dict[str, Floats]:
        self._check(self._lib.ph_refresh(self._in))
        return {name: self._table[place].copy() for name, place in self._places.items()}

    def signal(self, block: str) -> Floats:
        if self._places[block].start >= self._places["a_end"].start:
            self._check(self._lib.ph_refresh(self._in))
        return self._table[self._places[block]].copy()

    def _check(self, code: int) -> None:
        """Raise the error of a status other than PH_OK."""
        if code == 0:
            return
        status, name = STATUS[code], self.model.name
        if status in (Status.ABI, Status.ARGUMENT, Status.VALUE, Status.NO_SENSITIVITY):
            raise StepFailure(status, name, self.time, 0.0)
        r = self._lib.ph_last_report(self._in).contents
        names = self.model.instant_names if r.instant else self.model.row_names
        index = r.row if r.row >= 0 else r.column
        equation = names[index] if 0 <= index < len(names) else (f"row {index}" if index >= 0 else "")
        tried = attempts(0.0 if r.instant else r.h, r.spent)
        raise StepFailure(
            status, name, r.time, r.h, equation=equation, residual=r.residual, floor=r.floor,
            update=r.update, iterations=r.iterations, spent=r.spent, tried=tried,
        )  # fmt: skip


class NativeInstance(NativeReadings):
    """An instance in compiled code: one memory block, one C call a step, the numbers of `PythonInstance`.

    What both are says `Instance`.  `announce` is called before a compiler runs.  `kernels`: how those of the model run, compiled
    or interpreted, with the same bits; auto takes compiled ones where they are known, and else begins interpreted.  `steps`: how
    many are planned, if that is known; where so many earn it, a compiler works beside them from the beginning.
    """

    def __init__(
        self, model: EngineModel, announce: Callable[[], None] | None = None, kernels: Kind = "auto", steps: float = 0
    ) -> None:
        super().__init__(model, announce, kernels)
        self._step, self._steps = self._lib.ph_step, self._lib.ph_step_parts
        if self._native_model.code.count(steps):
            self._step = self._steps = self._counted()
        self._kicked: NativeImpulses | None = None
        self._landing: NativeLanding | None = None
        if model.events is not None:
            self._step = self._steps = self._landed_step
        self.initialise()

    @property
    def kernels(self) -> str:
        """The present form of the kernels: compiled or interpreted."""
        return "compiled" if self._native_model.code.compiled else "interpreted"

    def expect(self, steps: float) -> None:
        self._native_model.code.count(steps)

    def _counted(self) -> Callable[..., int]:
        """Steps while it is open whether they earn it to compile kernels."""
        code, lib, own = self._native_model.code, self._lib, ref(self)

        def step(address: int, t: float, h: float, parts: int = 1) -> int:
            instance = own()
            if not code.count(parts) and instance is not None:
                instance._step, instance._steps = lib.ph_step, lib.ph_step_parts
            return lib.ph_step_parts(address, t, h, parts)

        return step

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
            from phfmu.engine.native.derivatives import NativeImpulses

            self._kicked = NativeImpulses(self._native_model, self._in, self._ports.kernels)
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
        self.expect(grid.n * grid.parts)
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
        """The landing of the instance in compiled code, and the function that raises the error of a status."""
        return self._lands, self._check

    def _land(self, grid: Grid, names: tuple[str, ...], changed: bool) -> Iterator[Landed]:
        self.expect(grid.n)
        return self._lands.over(grid, names, changed, self._check)

    @property
    def _lands(self) -> NativeLanding:
        if self._landing is None:
            from phfmu.engine.native.native_landing import NativeLanding

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
        from phfmu.engine.native.derivatives import NativeChain

        return NativeChain(self.model, self._native_model)

    @property
    def handle(self) -> Handle:
        """The addresses of the instance, for compiled code that steps it itself."""
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
