"""What compiled code tells of an instance: its state, its last step, the present, and what failed."""

from __future__ import annotations

import ctypes
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.compiled import compiled
from phfmu.engine.instance import Instance
from phfmu.engine.library import enums, view
from phfmu.engine.limits import LIMITS
from phfmu.engine.model import Model
from phfmu.engine.rest_changes import RestChange, named
from phfmu.engine.status import Status, StepFailure, attempts

STATUS = tuple(Status)
Floats = NDArray[np.float64]


class NativeReadings(Instance):
    """The memory of an instance of `model` in its library, and how it is read."""

    def __init__(self, model: Model, announce: Callable[[], None] | None) -> None:
        super().__init__(model)
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
        tried = attempts(0.0 if r.instant else r.h, r.spent)
        raise StepFailure(
            status, name, r.time, r.h, equation=equation, residual=r.residual, floor=r.floor,
            update=r.update, iterations=r.iterations, spent=r.spent, tried=tried,
        )  # fmt: skip
