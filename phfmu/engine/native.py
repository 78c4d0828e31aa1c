"""Instances that step in compiled code."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phfmu.engine.compiled import compiled
from phfmu.engine.event_step import require_no_events, run_told
from phfmu.engine.handle import Handle
from phfmu.engine.impulses import Ports
from phfmu.engine.library import Column, Record, record_widths, view
from phfmu.engine.model import Model, require_built, require_one_mode
from phfmu.engine.native_readings import NativeReadings
from phfmu.engine.node_sensitivity import NodeSensitivity, chosen, columns, directions
from phfmu.engine.status import StepFailure
from phfmu.events.happened import Happened, Landed

if TYPE_CHECKING:
    from phfmu.engine.native_chain import NativeChain
    from phfmu.engine.native_impulses import NativeImpulses
    from phfmu.engine.native_landing import NativeLanding
    from phfmu.terms.port_impulses import PortImpulse

Floats = NDArray[np.float64]


class NativeInstance(NativeReadings):
    """A model in compiled code, the twin of `PythonInstance`: one memory block, one C call a step.

    Inputs u (nu) are held over a step, or given at its k quadrature nodes.  `output()` gives step-conjugate
    means, so that h u^T y is the supplied energy exactly.  Units SI, power into the component.
    StepFailure leaves the instance at its last accepted step.  `announce` is called before a compiler runs.
    """

    def __init__(self, model: Model, announce: Callable[[], None] | None = None) -> None:
        require_built(model, "NativeInstance")
        require_one_mode(model)
        super().__init__(model, compiled(model, announce))
        self._step, self._steps = self._lib.ph_step, self._lib.ph_step_parts
        self._kicked: NativeImpulses | None = None
        self._landing: NativeLanding | None = None
        #: state events of the last `do_step` or `run`
        self.happened: tuple[Happened, ...] = ()
        if model.events is not None:
            self._step = self._steps = self._landed_step
        self.initialise()

    def reset(self) -> None:
        """Back to the start values; the algebraic variables are solved for the start."""
        self._check(self._lib.ph_reset(self._in))
        if self._kicked is not None:
            self._kicked.values[:] = 0.0
        self.initialise()

    def initialise(self) -> None:
        """Solve the instant system; step means take their instantaneous values."""
        self._check(self._lib.ph_initialise(self._in))

    def set_input(self, u: ArrayLike) -> None:
        """Inputs (nu), held over the next steps."""
        values = self._array(u, self.model.step.nu)
        self._check(self._lib.ph_set_input(self._in, values.ctypes.data))

    def set_node_inputs(self, u: ArrayLike) -> None:
        """Inputs at the k quadrature nodes of the next step (k x nu)."""
        values = self._array(u, self.model.step.k, self.model.step.nu)
        self._check(self._lib.ph_set_node_inputs(self._in, values.ctypes.data))

    @property
    def held_input(self) -> Floats:
        """Inputs (nu) as they were set, held."""
        return view(self._lib.ph_input(self._in), self.model.step.nu).copy()

    @property
    def parameters(self) -> Floats:
        return view(self._lib.ph_parameters(self._in), self.model.step.np).copy()

    def set_parameters(self, p: ArrayLike) -> None:
        """All parameters (np)."""
        values = self._array(p, self.model.step.np)
        self._check(self._lib.ph_set_parameters(self._in, values.ctypes.data))

    def set_x(self, t: float, x: ArrayLike) -> None:
        """Place the state; call `initialise` afterwards."""
        values = self._array(x, self.model.step.nx)
        self._check(self._lib.ph_set_x(self._in, t, values.ctypes.data))

    def continue_from(self, other: NativeInstance) -> None:
        """Go on from the state, time, held inputs, parameters and cumulative energies of `other`.

        `other` is of the same declaration under another scheme.
        """
        self._check(self._lib.ph_continue(self._in, other._in))

    @property
    def impulse_ports(self) -> tuple[PortImpulse, ...]:
        """What each external port does with impulses, and why not more."""
        return self._ports.offered

    def set_impulses(self, s0: ArrayLike, s1: ArrayLike) -> None:
        """Impulses at start and end of the coming steps (n each), as of `PythonInstance`; a small library is compiled first."""
        require_no_events(self.model)
        s = self._ports.checked(s0, s1)
        self._check(self._kicks.set(s))
        self._step, self._steps = self._kicked_step, self._kicked_step

    def add_impulse(self, s: ArrayLike) -> None:
        """One more impulse (n) at the end of the last step, which counts as part of it."""
        self._check(self._kicks.more(self._array(s, self._ports.kernels.n)))

    def jump(self) -> Floats:
        """S = L^T H'' L at the present time (n x n): by how much impulses change the outputs, y* = y + S s (A/(V s))."""
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
        """One communication step over [t, t + h] in `parts` equal internal steps.

        h < 0 goes back in time: the schemes are symmetric, so a step and the same step back give the old state
        to rounding.  h = 0 leaves the state as it is, books nothing, and gives the means their values at t.
        A sliver, what rounding leaves of a master's clock, books nothing and keeps state and means: |h| up to two
        rounding units of t or 1e-9 of the last internal step.  State events happen where they are, see `happened`; the
        step is told as one, h < 0 and inputs that are not held are refused.
        """
        status = self._step(self._in, t, h) if parts == 1 else self._steps(self._in, t, h, parts)
        if status:
            self._check(status)

    def step_exactly(self, t: float, h: float, parts: int = 1) -> None:
        """`do_step`, however short the step is."""
        self._check(self._lib.ph_step_exactly(self._in, t, h, parts))

    def run(
        self,
        t0: float,
        h: float,
        n: int,
        record: Iterable[str] = (),
        inputs: ArrayLike | None = None,
        parts: int = 1,
        first: int = 0,
    ) -> dict[str, Floats]:
        """Steps k = first..first+n-1 from t0 + k h without leaving C; `inputs`: n x nu, one row held over each.

        `record`: names from RECORD, a row a step each.  pairs, stored, dissipated, supplied, numerical, moved: ledger of
        that step; unknowns: w of its last solve; energy: H per component at its end; counts: iterations and
        solves; signals: see `layout`.
        """
        if self.model.events is not None:
            result, self.happened = run_told(self, t0, h, n, record, inputs, parts, first)
            return result
        if self._kicked is not None:
            self._ports.require_none(self._kicked.values[:2])
            self._kicked.values[2:] = 0.0
        plan, width = self.model.step, record_widths(self.model, len(self._table))
        result = {name: np.full((n, width[name]), np.nan) for name in record}
        request = Record(parts=parts, first=first)
        for name, array in result.items():
            setattr(request, name, Column(array.ctypes.data, array.shape[1]))
        if inputs is not None:
            rows = self._array(inputs, n, plan.nu)
            request.input, request.input_stride = rows.ctypes.data, plan.nu
        done = ctypes.c_int()
        code = self._lib.ph_run(self._in, t0, h, n, request, done)
        try:
            self._check(code)
        except StepFailure as failure:
            failure.recorded = {name: rows[: done.value] for name, rows in result.items()}
            raise
        return result

    @property
    def landing(self) -> tuple[NativeLanding, Callable[[int], None]]:
        """Its landing, and what raises the status of one."""
        return self._lands, self._check

    def land(
        self, t0: float, h: float, n: int, record: Iterable[str] = (), first: int = 0, changed: bool = True
    ) -> Iterator[Landed]:
        """Steps that end on the zeros of guards too, in compiled code; see `PythonInstance.land`."""
        return self._lands.over(t0, h, n, record, first, changed, self._check)

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
        """S = d(mean external outputs)/d(held inputs) of the last step (nu x nu): implicit function theorem.

        Internal steps are chained, in a library that is compiled when that is first asked for.  `end`: of the outputs at the
        present time instead.  StepFailure NO_SENSITIVITY before the first step, or where more than 16 internal steps of the
        last one were halved.
        """
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
        """Derivatives of the last step with respect to the chosen inputs (default: all) at each of its nodes.

        `impulses`: then with respect to those at its start and at its end too, in the order of `set_impulses`;  `end`: of the
        outputs at its end too.  In a library that is compiled when that is first asked for.
        StepFailure NO_SENSITIVITY as in `sensitivity`.
        """
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
        """A complete opaque copy; after `set_state`, in any instance of the model, the same bits follow."""
        buffer = ctypes.create_string_buffer(self._state_size)
        self._lib.ph_save(self._in, buffer)
        return buffer.raw if self._kicked is None else buffer.raw + self._kicked.values.tobytes()

    def set_state(self, state: bytes) -> None:
        """Restores what `get_state` gave."""
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
        """`set_state`; the counts of what the solver did go on, as they always do here."""
        self.set_state(state)

    def _array(self, values: ArrayLike, *shape: int) -> Floats:
        array = np.ascontiguousarray(values, float)
        if array.shape != shape:
            raise ValueError(f"{self.model.name}: expected values of shape {shape}, got {array.shape}")
        return array
