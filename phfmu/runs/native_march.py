"""The march of `Adaptive` in compiled code: many accepted steps a call, with the same sizes as its loop in Python."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.native.library import Column, Record, drivers, record_widths
from phfmu.engine.native.native import NativeInstance
from phfmu.engine.native.structures import Header, Structures
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.outcome.status import StepFailure
from phfmu.outcome.steps import Steps

Array = NDArray[Any]

RUNTIME = Path(__file__).parent / "runtime"
HEADER = Header((RUNTIME / "march.h",), ("ph_march",))
#: what the controller carries from step to step
CONTROL = ("h", "last", "smallest", "largest", "rejected")
MISSED = -1


@cache
def _library() -> ctypes.CDLL:
    """The runtime with the signatures of march.h; CompilerMissing, CompileError."""
    lib = drivers()
    pointer, integer = ctypes.c_void_p, ctypes.c_int
    lib.ph_march_steps.restype = integer
    lib.ph_march_steps.argtypes = [pointer, ctypes.POINTER(Record), ctypes.c_double, integer, ctypes.POINTER(integer)]
    return lib


class Controlled(Protocol):
    """The interface of `Adaptive` to its march: instances, tolerances and limits, the controller, and how it tells of a miss."""

    stepper: Monolithic
    other: Any
    control: Any
    order: int
    rtol: float
    atol: float
    min_step: float
    max_step: float
    nominal: Array

    def missed(self, t: float, h: float, error: float, worst: int) -> StepFailure: ...


@dataclass(frozen=True)
class Marched:
    """When accepted steps ended, the steps (None: not recorded, or there are none), and why there are no more."""

    ends: list[float]
    steps: Steps | None
    failure: StepFailure | None = None


class NativeMarch:
    """The march of an `Adaptive` whose instances are native; `exactly`: steps however short, not recorded."""

    def __init__(self, adaptive: Controlled, exactly: bool):
        self._adaptive, self._exactly = adaptive, exactly
        own, other, memory = adaptive.stepper.instance, adaptive.other, Structures(HEADER)
        self._own, self._other, self._memory, self._lib = own.handle, other.handle, memory, _library()
        n = adaptive.stepper.model.step.nx
        self._march = memory.fill("ph_march", {
            "in": self._own.instance, "companion": self._other.instance,
            "nx": n, "order": adaptive.order, "exactly": int(exactly),
            "rtol": adaptive.rtol, "atol": adaptive.atol, "min_step": adaptive.min_step, "max_step": adaptive.max_step,
            "nominal": adaptive.nominal, "before": np.zeros(n), "state": np.zeros(self._own.state_size // 8 + 1),
            "ends": None, "t": 0.0, **{name: getattr(adaptive.control, name) for name in CONTROL},
            "spent": 0.0, "estimator": 0, "size": 0.0, "error": 0.0, "worst": 0,
        })  # fmt: skip
        self._ends = np.zeros(0)

    @staticmethod
    def fits(adaptive: Controlled, exactly: bool) -> bool:
        """Whether compiled code may step: inputs are held, no rows within steps are asked for, events do not happen in steps."""
        stepper, own = adaptive.stepper, adaptive.stepper.instance
        if type(own) is not NativeInstance or type(adaptive.other) is not NativeInstance:
            return False
        plain = exactly or own.model.events is None and stepper.between is None
        return plain and stepper.followed is None and own.handle.kicked is None

    def take(self, t: float, goal: float, room: int) -> Marched:
        """At most `room` accepted steps from t, not beyond `goal`; after a failure the instance is where the last one ended."""
        march, control, done = self._march, self._adaptive.control, ctypes.c_int()
        rows, request = ({}, None) if self._exactly else self._record(room)
        if len(self._ends) < room:
            self._ends = np.zeros(room)
            march.ends = self._ends.ctypes.data
        march.t = t
        for name in CONTROL:
            setattr(march, name, getattr(control, name))
        self._adaptive.stepper.instance.expect(room)
        code = self._lib.ph_march_steps(ctypes.addressof(march), request, goal, room, done)
        for name in CONTROL:
            setattr(control, name, getattr(march, name))
        n, stepper = done.value, self._adaptive.stepper
        taken = {name: values[:n] for name, values in rows.items()}
        steps = stepper.steps_of(stepper.instance, taken) if taken and n else None
        return Marched(self._ends[:n].tolist(), steps, self._failure(code) if code else None)

    @property
    def spent(self) -> float:
        """Iterations of the last accepted step, with all of its trials."""
        return float(self._march.spent)

    def _record(self, room: int) -> tuple[dict[str, Array], Record]:
        """Arrays for so many steps, and where they are."""
        stepper = self._adaptive.stepper
        instance = stepper.instance
        width = record_widths(instance.model, sum(s.stop - s.start for s in instance.layout.values()))
        rows = {name: np.empty((room, width[name])) for name in stepper.wanted(instance)}
        request = Record(parts=1)
        for name, array in rows.items():
            setattr(request, name, Column(array.ctypes.data, array.shape[1]))
        return rows, request

    def _failure(self, code: int) -> StepFailure:
        """Why there is no step."""
        march = self._march
        if code == MISSED:
            return self._adaptive.missed(march.t, march.size, march.error, march.worst)
        try:
            (self._other if march.estimator else self._own).check(code)
        except StepFailure as failure:
            return failure
        raise AssertionError(code)
