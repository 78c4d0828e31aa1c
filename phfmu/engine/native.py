"""Instances that step in compiled code."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phfmu.engine.compiled import compiled
from phfmu.engine.handle import Handle
from phfmu.engine.impulses import Ports
from phfmu.engine.landing import landed
from phfmu.engine.library import RECORD, Column, Record, enums, view
from phfmu.engine.limits import LIMITS
from phfmu.engine.model import Model
from phfmu.engine.node_sensitivity import NodeSensitivity, chosen, columns, directions
from phfmu.engine.rest_changes import RestChange, named
from phfmu.engine.status import Status, StepFailure
from phfmu.events.happened import Landed

if TYPE_CHECKING:
    from phfmu.engine.native_chain import NativeChain
    from phfmu.engine.native_impulses import NativeImpulses
    from phfmu.terms.port_impulses import PortImpulse

STATUS = tuple(Status)
Floats = NDArray[np.float64]


class NativeInstance:
    """A model in compiled code, the twin of `PythonInstance`: one memory block, one C call a step.

    Inputs u (nu) are held over a step, or given at its k quadrature nodes.  `output()` gives step-conjugate
    means, so that h u^T y is the supplied energy exactly.  Units SI, power into the component.
    StepFailure leaves the instance at its last accepted step.  `announce` is called before a compiler runs.
    """

    def __init__(self, model: Model, announce: Callable[[], None] | None = None) -> None:
        self.model = model
        made = compiled(model, announce)
        self.build, self._tables, self._lib = made.build, made.tables, made.lib
        size = self._lib.ph_size(self._tables.pointer)
        if size == 0:
            raise StepFailure(Status.ABI, model.name, model.t0, 0.0)
        self._memory = np.zeros(size // 8 + 1)
        self._in = self._memory.ctypes.data
        self._check(self._lib.ph_init(self._in, self._tables.pointer))
        names = enums()["ph_block"]
        offset = (ctypes.c_int * (len(names) + 1))()
        self._lib.ph_layout(self._tables.pointer, offset)
        #: place of each block in a row of recorded signals
        self.layout = {n if n != "h" else "H": slice(offset[i], offset[i + 1]) for i, n in enumerate(names)}
        self._table = view(self._lib.ph_signals(self._in), offset[len(names)])
        self._state_size = self._lib.ph_state_size(self._in)
        self._step, self._steps = self._lib.ph_step, self._lib.ph_step_parts
        self._kicked: NativeImpulses | None = None
        self._means = self._table[self.layout["y_step"]][: model.step.nu]
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
        s = self._ports.checked(s0, s1)
        self._check(self._kicks.set(s))
        self._step, self._steps = self._kicked_step, self._kicked_step

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
        rounding units of t or 1e-9 of the last internal step.
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
        if self._kicked is not None:
            self._ports.require_none(self._kicked.values[:2])
            self._kicked.values[2:] = 0.0
        plan = self.model.step
        width = dict.fromkeys(RECORD, plan.ncomp) | dict.fromkeys(("y_step", "pairs"), plan.nq)
        width |= {"unknowns": plan.nw, "signals": len(self._table), "x": plan.nx, "a": plan.na, "counts": 2}
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

    def land(
        self, t0: float, h: float, n: int, record: Iterable[str] = (), first: int = 0, changed: bool = True
    ) -> Iterator[Landed]:
        """Steps that end on the zeros of guards too; see `PythonInstance.land`."""
        return landed(self, t0, h, n, record, first, changed)

    @property
    def memory_size(self) -> int:
        """Bytes of the instance's block and of the tables it points to."""
        return self._memory.nbytes + self._tables.size

    @property
    def time(self) -> float:
        return float(self._table[self.model.step.nx])

    @property
    def x(self) -> Floats:
        return self._table[self.layout["x"]].copy()

    @property
    def counts(self) -> dict[str, int]:
        """What the solver did since the instance was made: steps, iterations, restarts, substeps, ..."""
        names = enums()["ph_count"]
        values = view(self._lib.ph_counts(self._in), len(names), np.int64)
        return {n: int(v) for n, v in zip(names, values, strict=True)}

    @property
    def rest_changes(self) -> list[RestChange]:
        """Which redundant constraints rest instead of which others, the last changes since the start."""
        n, kept = ctypes.c_int(), int(LIMITS["KEPT_CHANGES"])
        ring = self._lib.ph_rest_changes(self._in, n)
        found = ((i, ring[i % kept]) for i in range(max(0, n.value - kept), n.value))
        return named(((i + 1, c.time, c.rests, c.needed) for i, c in found), self.model.hold_names)

    def output(self) -> Floats:
        """Step-conjugate means of the external pairs (nu)."""
        return self._means.copy()

    def node_output(self) -> Floats:
        """Outputs at the k quadrature nodes (k x nu): h sum_i b_i u_i^T y_i is the supplied energy of the last step."""
        plan = self.model.step
        values = view(self._lib.ph_node_outputs(self._in), plan.k * plan.nq).reshape(plan.k, plan.nq)
        return values[:, : plan.nu].copy()

    def ledger(self) -> dict[str, Floats]:
        """Of the last communication step: stored, dissipated, supplied, numerical, moved per component, pairs [J]."""
        names, plan = enums()["ph_row"], self.model.step
        sizes = {name: plan.nq if name == "pairs" else plan.ncomp for name in names}
        return {n: view(self._lib.ph_ledger(self._in, i), sizes[n]).copy() for i, n in enumerate(names)}

    @property
    def unknowns(self) -> Floats:
        """w of the last solve: see `Plan`."""
        return view(self._lib.ph_unknowns(self._in), self.model.step.nw).copy()

    def signals(self) -> dict[str, Floats]:
        """All values by block: x, time, a, y_step, energy, ..., a_end, y_end, observables, H."""
        self._check(self._lib.ph_refresh(self._in))
        return {name: self._table[place].copy() for name, place in self.layout.items()}

    def signal(self, block: str) -> Floats:
        """One block; those that hold at the present time (from a_end on) are solved for if out of date."""
        if self.layout[block].start >= self.layout["a_end"].start:
            self._check(self._lib.ph_refresh(self._in))
        return self._table[self.layout[block]].copy()

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
        return Handle(lib, at, self._state_size, *places, self._kicked, lambda: self._kicks, lambda: self._chain)

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

    def _check(self, code: int) -> None:
        """Raises what a status other than PH_OK means."""
        if code == 0:
            return
        status, name = STATUS[code], self.model.name
        if status in (Status.ABI, Status.ARGUMENT, Status.VALUE, Status.NO_SENSITIVITY):
            raise StepFailure(status, name, self.time, 0.0)
        r = self._lib.ph_last_report(self._in).contents
        names = self.model.instant_names if r.instant else self.model.row_names
        index = r.row if r.row >= 0 else r.column
        equation = names[index] if 0 <= index < len(names) else (f"row {index}" if index >= 0 else "")
        tried = "two starts, " + (
            "line search" if r.instant else f"shorter steps, line search and {2 ** int(LIMITS['DEPTH'])} substeps"
        )
        raise StepFailure(
            status, name, r.time, r.h, equation=equation, residual=r.residual, floor=r.floor,
            update=r.update, iterations=r.iterations, spent=r.spent, tried=tried,
        )  # fmt: skip
