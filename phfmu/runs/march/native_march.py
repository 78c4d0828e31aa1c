"""The march of `Adaptive` in compiled code: many accepted steps a call, with the same sizes as its loop in Python."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.native.library import Column, Record, drivers, record_widths
from phfmu.engine.native.native import NativeInstance
from phfmu.engine.native.native_landing import LandedRows, LandingMemory
from phfmu.engine.native.structures import Header, Structures
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.outcome.status import StepFailure
from phfmu.outcome.steps import Landed, Steps

Array = NDArray[Any]

RUNTIME = Path(__file__).parent / "runtime"
HEADER = Header((RUNTIME / "march.h",), ("ph_march",))
#: what the controller carries from step to step
CONTROL = ("h", "last", "smallest", "largest", "rejected")
#: results beside those of ph_status
MISSED, SMALL = -1, -2


class _Goals(ctypes.Structure):
    """The structure ph_goals of the runtime."""

    _fields_ = [("t", ctypes.c_void_p), ("n", ctypes.c_int)]

    @classmethod
    def of(cls, goals: Array) -> _Goals:
        """The structure for an array that outlives the call."""
        return cls(goals.ctypes.data, len(goals))


@cache
def _library() -> ctypes.CDLL:
    """The runtime with the signatures of march.h; CompilerMissing, CompileError."""
    lib = drivers()
    pointer, integer = ctypes.c_void_p, ctypes.c_int
    record = ctypes.POINTER(Record)
    lib.ph_march_steps.restype = lib.ph_march_landed.restype = integer
    goals = ctypes.POINTER(_Goals)
    lib.ph_march_steps.argtypes = [pointer, record, goals, integer, ctypes.POINTER(integer)]
    lib.ph_march_landed.argtypes = [pointer, record, goals, ctypes.POINTER(LandedRows), pointer]
    return lib


class AdaptiveInterface(Protocol):
    """The interface of `Adaptive` to its march: instances, tolerances and limits, the controller, and how it tells of a miss."""

    stepper: Monolithic
    other: Any
    control: Any
    parts: int
    order: int
    share: float
    rtol: float
    atol: float
    min_step: float
    max_step: float
    nominal: Array

    def missed(self, t: float, h: float, error: float, worst: int) -> StepFailure: ...


@dataclass(frozen=True)
class MarchOutcome:
    """Ends of accepted steps [s], the steps (None: there are none), and the failure that ended them."""

    ends: list[float]
    steps: Steps | None
    failure: StepFailure | None = None


class NativeMarch:
    """The march of an `Adaptive` whose instances are native; `pauses`: steps with guards are handed over after each event."""

    CARRIED = ("crowd",)

    def __init__(self, adaptive: AdaptiveInterface, pauses: bool = False):
        self._adaptive, memory = adaptive, Structures(HEADER)
        self._memory, self._lib = memory, _library()
        n = adaptive.stepper.model.step.nx
        self._march = memory.fill("ph_march", {
            **self._instances(adaptive.stepper.instance, adaptive.other), "pauses": int(pauses),
            **{name: getattr(adaptive, name) for name in ("parts", "order", "share", "rtol", "atol", "min_step", "max_step")},
            "nx": n, "nominal": adaptive.nominal, "before": np.zeros(n), "state": None, "room": 0, "ends": None, "t": 0.0,
            **{name: getattr(adaptive.control, name) for name in CONTROL},
            "crowd": 0, "unfinished": 0, "end": 0.0, "spent": 0.0, "estimator": 0, "size": 0.0, "error": 0.0, "worst": 0,
        })  # fmt: skip
        self._ends, self._state = np.zeros(0), np.zeros(0)

    def _instances(self, own: Any, other: Any) -> dict[str, Any]:
        """Pointers to instance and companion, with guards and modes if they have some."""
        model, none = own.model, {"landing": None, "modes": None, "others": None, "sides": None, "beside": None,
                                  "kept": None, "nside": 0, "nguard": 0, "ncomp": 0, "nsignal": 0}  # fmt: skip
        if model.events is None:
            return {"in": own.handle.instance, "companion": other.handle.instance, **none}
        widths = {"nguard": model.events.n, "ncomp": model.step.ncomp}
        self._landing = own.landing[0] if model.modes is None else own.native
        widths["nsignal"] = self._landing.room(0, ()).width
        if model.modes is None:
            landing = self._landing.address
            return {"in": own.handle.instance, "companion": other.handle.instance, **none, **widths, "landing": landing}
        return {"in": None, "companion": None, **none, **widths, "modes": own.native.address, "others": other.native.address,
                "sides": own.native.sides.ctypes.data, "beside": other.native.sides.ctypes.data,
                "kept": np.zeros_like(own.native.sides), "nside": len(own.native.sides)}  # fmt: skip

    @staticmethod
    def fits(adaptive: AdaptiveInterface) -> bool:
        """Whether compiled code may step: inputs are held, rows within steps are asked for of models with one mode only."""
        stepper, both = adaptive.stepper, (adaptive.stepper.instance, adaptive.other)
        one_mode = stepper.lands and stepper.model.modes is None
        plain = stepper.followed is None and (stepper.between is None or one_mode)
        present = [i if i.model.modes is None else i.present for i in both]
        return plain and all(type(i) is NativeInstance and i.handle.kicked is None for i in present)

    def take(self, t: float, goals: Array, room: int) -> MarchOutcome:
        """Accepted steps from t that land on `goals` (n) up to the last one, about `room` at most.

        After a failure the instance is where the last one ended.
        """
        stepper, done = self._adaptive.stepper, ctypes.c_int()
        room = max(room, self._adaptive.parts)
        rows, request = self._record(room)
        if len(self._ends) < room:
            self._ends = np.zeros(room)
            self._march.ends = self._ends.ctypes.data
        stepper.instance.expect(room)
        code = self._called(t, lambda at: self._lib.ph_march_steps(at, request, _Goals.of(goals), room, done))
        n = done.value
        steps = stepper.steps_of(stepper.instance, {name: values[:n] for name, values in rows.items()}) if n else None
        return MarchOutcome(self._ends[:n].tolist(), steps, self._failure(code) if code else None)

    def land(self, t: float, goals: Array, room: int) -> Iterator[Landed]:
        """Accepted steps and events of a model with guards; raises StepFailure after those before it."""
        stepper, landing = self._adaptive.stepper, self._landing
        found: LandingMemory = landing.room(room, stepper.landed_records(stepper.instance))
        switched = stepper.model.modes is not None
        if switched:
            landing.push()
            self._adaptive.other.native.push()
        code = self._called(
            t,
            lambda at: self._lib.ph_march_landed(
                at, found.request, _Goals.of(goals), found.out, found.changed.ctypes.data
            ),
        )
        if switched:
            landing.pull()
            self._adaptive.other.native.pull()
        yield from landing.parts(found) if switched else found.parts()
        if code and code != SMALL:  # which the next call makes room for
            raise self._failure(code)

    @property
    def t(self) -> float:
        """Time at the end of the last accepted step [s]."""
        return float(self._march.t)

    @property
    def crowd(self) -> int:
        """Spans in a row that ended on events."""
        return int(self._march.crowd)

    @crowd.setter
    def crowd(self, value: int) -> None:
        self._march.crowd = value

    @property
    def unfinished(self) -> bool:
        """Whether a span with its events goes on in the next call."""
        return bool(self._march.unfinished)

    def _called(self, t: float, call: Any) -> int:
        """The answer of a function of march.h from t on, with the controller handed over and back."""
        march, control = self._march, self._adaptive.control
        march.t = t
        for name in CONTROL:
            setattr(march, name, getattr(control, name))
        self._make_room()
        code = call(ctypes.addressof(march))
        for name in CONTROL:
            setattr(control, name, getattr(march, name))
        return code

    def _make_room(self) -> None:
        """For the state of the present mode."""
        own = self._adaptive.stepper.instance
        size = (own if own.model.modes is None else own.present).handle.state_size
        if size > 8 * self._march.room:
            self._state = np.zeros(size // 8 + 1)
            self._march.state, self._march.room = self._state.ctypes.data, len(self._state)

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
        march, adaptive = self._march, self._adaptive
        if code == MISSED:
            return adaptive.missed(march.t, march.size, march.error, march.worst)
        instance = adaptive.other if march.estimator else adaptive.stepper.instance
        try:
            if instance.model.modes is not None:
                instance.native.refuse(code)
            elif instance.model.events is not None:
                instance.landing[0].refuse(code)
            instance.handle.check(code)
        except StepFailure as failure:
            return failure
        raise AssertionError(code)
