"""Steps of a model with switches in compiled code, which changes modes itself and asks for those it does not know."""

from __future__ import annotations

import ctypes
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from phfmu.discretise.model import Model
from phfmu.engine.build.kernels import Kernels
from phfmu.engine.build.mode_tables import ModeTables
from phfmu.engine.native.code import Code, Kind, code_of
from phfmu.engine.native.library import Record, Signatures, placed, record_widths, runtime, typed
from phfmu.engine.native.native_landing import STEPS, LandedRows, LandingMemory, LentSteps, StepCallbacks, one_by_one
from phfmu.engine.record import Grid
from phfmu.events.modes import Mode, most_held
from phfmu.events.switch_tables import mode_rows, switch_tables
from phfmu.outcome.status import EventRefused, Status
from phfmu.outcome.steps import EventRecord, Landed

ROWS = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)
MOST = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int)


class _Source(ctypes.Structure):
    """The structure ph_mode_source of the runtime."""

    _fields_ = [("world", ctypes.c_void_p), ("rows", ROWS), ("mode", ROWS), ("most", MOST)]


class _Mode(ctypes.Structure):
    """The structure ph_mode of the runtime."""

    _fields_ = [
        *((n, ctypes.c_void_p) for n in ("rows", "instance", "landing", "fresh")),
        ("length", ctypes.c_int),
    ]


class _Refusal(ctypes.Structure):
    """The structure ph_mode_refusal of the runtime."""

    _fields_ = [
        ("reason", ctypes.c_int),
        *((n, ctypes.c_double) for n in ("t", "value", "limit")),
        ("which", ctypes.c_void_p),
    ]


@dataclass(frozen=True)
class _ModeCode:
    """The common part of changes of modes of a model: tables, code, and the known rows of modes."""

    lib: ctypes.CDLL
    tables: ModeTables
    told: int
    code: Code
    rows: dict[Mode, int] = field(default_factory=dict)


_CODES: dict[bool, WeakKeyDictionary[Model, _ModeCode]] = {False: WeakKeyDictionary(), True: WeakKeyDictionary()}


def _mode_code(model: Model, kind: Kind) -> _ModeCode:
    known = _CODES[kind == "interpreted"]
    found = known.get(model)
    if found is None:
        assert model.modes is not None and model.events is not None
        tables = switch_tables(model.modes.modes, model.step, model.events, len(model.observable_names))
        code = code_of(Kernels(tables.kernels), None, kind)
        lib = _typed(runtime()[1])
        found = known[model] = _ModeCode(lib, ModeTables(tables, code.index, code.address), tables.told, code)
    return found


def _typed(lib: ctypes.CDLL) -> ctypes.CDLL:
    """The library with the signatures of modes.h."""
    pointer, real, integer = ctypes.c_void_p, ctypes.c_double, ctypes.c_int
    signatures: Signatures = {
        "ph_modes_size": (ctypes.c_size_t, [pointer]),
        "ph_modes_init": (pointer, [pointer, pointer, ctypes.POINTER(_Source), pointer]),
        "ph_modes_prepare": (None, [pointer, real]),
        "ph_modes_from": (None, [pointer, real, real, integer, integer, integer]),
        "ph_modes_begin": (None, [pointer, real, real, integer]),
        "ph_modes_on": (integer, [pointer, ctypes.POINTER(LandedRows), pointer]),
        "ph_modes_to": (None, [pointer, real, real, integer]),
        "ph_modes_land": (integer, [pointer, ctypes.POINTER(Record), ctypes.POINTER(LandedRows), pointer]),
        "ph_modes_refusal": (ctypes.POINTER(_Refusal), [pointer]),
        "ph_modes_failed": (pointer, [pointer]),
    }
    return typed(lib, signatures)


class NativeModes:
    """Changes of modes of a `SwitchedInstance` of native instances, which it asks for them."""

    def __init__(self, switched: Any):
        self._switched, self._model = switched, switched.model
        self._mode_code, self._n = _mode_code(switched.model, switched.present.kind), len(switched.mode)
        self._sides = np.zeros(1 + 2 * self._n, np.int8)
        self._known: dict[Mode, _Mode] = {}
        self._keep: list[Any] = []
        self._failure: BaseException | None = None
        self._steps: LentSteps | None = None
        self._lent: list[StepCallbacks] = []
        self._source = _Source(None, ROWS(self._rows), ROWS(self._whole), MOST(self._most))
        more = self._source, self._sides.ctypes.data
        self._memory, self._in = placed(self._mode_code.lib, "ph_modes", self._mode_code.tables.pointer, more=more)

    def land(self, grid: Grid, record: tuple[str, ...], changed: bool) -> Iterator[Landed]:
        """Grid steps with their events; modes change between two rows."""
        lib = self._mode_code.lib
        self.push()
        lib.ph_modes_from(self._in, grid.t0, grid.h, grid.first, grid.n, int(changed))
        room = self.room(grid.n, record, grid.pause)
        while not room.over:
            self.push()
            status = lib.ph_modes_land(self._in, room.request, room.out, room.changed.ctypes.data)
            self.pull()
            yield from self.parts(room)
            if status:
                self.refuse(status)

    def lend(self, steps: LentSteps) -> None:
        """Take the steps of others in place of those of the instances from now on, in each mode."""
        self._steps = steps

    def to(self, t: float, end: float, changed: bool, pause: bool) -> Iterator[tuple[float, float, EventRecord | None]]:
        """The lent steps and events in [t, end], after those before them; see `one_by_one`."""
        lib, room = self._mode_code.lib, self.room(1, ())
        self.push()
        lib.ph_modes_to(self._in, t, end, int(changed))

        def take() -> Iterator[Landed]:
            self.push()
            status = lib.ph_modes_land(self._in, room.request, room.out, room.changed.ctypes.data)
            self.pull()
            for lent in self._lent:
                lent.require(status)
            if status:
                self.refuse(status)
            return self.parts(room)

        return one_by_one(room, take, pause)

    def step(self, t: float, h: float, parts: int) -> tuple[EventRecord, ...]:
        """A communication step in `parts` equal internal steps, told as one; the events in it."""
        lib = self._mode_code.lib
        lib.ph_modes_begin(self._in, t, h, parts)
        room, found = self._one, list[EventRecord]()
        room.out.done = 0
        while not room.out.done:
            self.push()
            status = lib.ph_modes_on(self._in, room.out, room.changed.ctypes.data)
            self.pull()
            if status:
                self.refuse(status)
            found += [part.happened for part in room.parts(self._words) if part.happened is not None]
        return tuple(found)

    @cached_property
    def _one(self) -> LandingMemory:
        return self.room(0, ())

    def room(self, n: int, record: Iterable[str], pause: bool = False) -> LandingMemory:
        """Memory for n grid steps with their events, and some more."""
        model, plan = self._model, self._model.step
        width = self._mode_code.told + plan.ncomp
        sizes = record_widths(model, width)
        rows = {name: np.full((n + STEPS, sizes[name]), np.nan) for name in record}
        if "signals" in rows:  # hidden constraints that a mode shows before they are left out
            rows["signals"] = np.full((n + STEPS, width + plan.nx + plan.na), np.nan)
        return LandingMemory(rows, n + STEPS, model.events.n, plan.ncomp, width, self._n, pause=pause)

    def parts(self, room: LandingMemory) -> Iterator[Landed]:
        """The steps and events of the last call."""
        for part in room.parts(self._words):
            if "signals" in part.rows:
                part.rows["signals"] = part.rows["signals"][:, : room.width]
            yield part

    @property
    def address(self) -> int:
        """Address of the changes of modes in memory."""
        return self._in

    @property
    def sides(self) -> np.ndarray:
        """The memory of the sides of switches, which `push` writes and `pull` reads."""
        return self._sides

    def push(self) -> None:
        """Compiled code goes on in the mode that the instance is in."""
        self._mode_code.lib.ph_modes_prepare(self._in, self._switched.typical_step)
        self._sides[:] = self._switched.sides

    def pull(self) -> None:
        """The instance is in the mode where compiled code ended."""
        self._switched.sides = tuple(int(v) for v in self._sides)

    def _words(self, changed: Any) -> tuple[str, ...]:
        """Switches that changed, with the side they are on."""
        switches = self._model.modes.modes.switches
        return tuple(f"{switches[j].name} {'on' if changed[j] == 2 else 'off'}" for j in np.flatnonzero(changed))

    def refuse(self, status: int) -> None:
        """Raise the error of a status."""
        if self._failure is not None:
            failure, self._failure = self._failure, None
            raise failure
        found = self._mode_code.lib.ph_modes_refusal(self._in).contents
        if tuple(Status)[status] is Status.EVENT and found.reason >= 0:
            flags = ctypes.string_at(found.which, self._n)
            names = [s.name for s, flag in zip(self._model.modes.modes.switches, flags, strict=True) if flag]
            raise EventRefused(self._model.name, found.t, found.reason, names, found.value, found.limit)
        failed = self._mode_code.lib.ph_modes_failed(self._in)
        mode = next(m for m, entry in self._known.items() if ctypes.addressof(entry) == failed)
        landing, check = self._switched.of(mode)[0].landing
        landing.refuse(status)
        check(status)

    # -- what compiled code asks for -----------------------------------------------------------------------------------

    def _mode(self, on: int) -> Mode:
        return tuple(ctypes.string_at(on, self._n))

    def _rows(self, _: int, on: int) -> int | None:
        mode, known = self._mode(on), self._mode_code.rows
        if mode not in known:
            try:
                known[mode] = self._mode_code.tables.rows(mode_rows(self._model.modes.modes, mode))
            except Exception as failure:
                self._failure = failure
                return None
        return known[mode]

    def _whole(self, _: int, on: int) -> int | None:
        mode = self._mode(on)
        if mode not in self._known:
            try:
                self._known[mode] = self._entry(mode, on)
            except Exception as failure:
                self._failure = failure
                return None
        return ctypes.addressof(self._known[mode])

    def _entry(self, mode: Mode, on: int) -> _Mode:
        instance, fresh = self._switched.of(mode)
        landing, _ = instance.landing
        if self._steps is not None:
            self._lent.append(StepCallbacks(self._steps, instance))
            landing.lend(self._lent[-1])
        landing.stop_before(np.ones(self._model.events.n, np.int8))
        state = np.frombuffer(fresh, np.uint8)
        self._keep.append(state)
        return _Mode(
            self._rows(0, on), instance.handle.instance, landing.address, state.ctypes.data, instance.layout["H"].stop
        )

    def _most(self, _: int, on: int, a: int, j: int) -> float:
        values = np.frombuffer((ctypes.c_double * self._model.step.na).from_address(a))
        try:
            return most_held(self._model.modes.modes, self._mode(on), values, j)
        except Exception as failure:
            self._failure = failure
            return 0.0
