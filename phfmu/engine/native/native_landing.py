"""Steps with state events in compiled code: rows and events of many steps a call."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterable, Iterator
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.model import EngineModel
from phfmu.engine.native.library import Column, Record, Signatures, placed, record_widths, typed, view
from phfmu.engine.record import Grid
from phfmu.outcome.status import EventRefused, Status, StepFailure
from phfmu.outcome.steps import EventRecord, Landed

Floats = NDArray[np.float64]

#: rows and events written between two returns, beyond the grid steps asked for
STEPS, EVENTS = 64, 128


class LandedRows(ctypes.Structure):
    """The structure ph_landed of the runtime."""

    _fields_ = [
        *((n, ctypes.c_int) for n in ("steps_room", "events_room", "pause", "steps", "events", "done")),
        *((n, ctypes.c_void_p) for n in ("t", "h", "event_t", "event_step", "event_fired")),
        *((n, ctypes.c_void_p) for n in ("event_energy", "event_lost", "event_signals")),
    ]


class EventRefusal(ctypes.Structure):
    """The structure ph_event_refusal of the runtime."""

    _fields_ = [
        ("reason", ctypes.c_int),
        *((n, ctypes.c_double) for n in ("t", "value", "limit")),
        ("fired", ctypes.c_void_p),
    ]


class LentSteps(Protocol):
    """Steps that others take for an instance: coupled members, whose states together are its own."""

    @property
    def halved(self) -> int:
        """Number of steps so far that were taken in parts."""
        ...

    @property
    def x(self) -> Floats:
        """The states (nx) now."""
        ...

    def step(self, t: float, h: float) -> None:
        """Takes one; StepFailure if it is refused."""
        ...

    def inside(self, x: Floats, tau: float) -> Floats:
        """The states at the fraction tau of the last step, from those at its start."""
        ...

    def save(self) -> None:
        """Keep the present state, in place of the one kept before."""
        ...

    def back(self) -> None:
        """Return to the state that was kept."""
        ...


_STEP = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_double, ctypes.c_double)
_HALVED = ctypes.CFUNCTYPE(ctypes.c_longlong, ctypes.c_void_p)
_INSIDE = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_double, ctypes.c_void_p)
_MOVE = ctypes.CFUNCTYPE(None, ctypes.c_void_p)


class _LentStepsStruct(ctypes.Structure):
    """The structure ph_lent_steps of the runtime."""

    _fields_ = [("world", ctypes.c_void_p), ("step", _STEP), ("halved", _HALVED), ("inside", _INSIDE), ("save", _MOVE),
                ("load", _MOVE)]  # fmt: skip


class StepCallbacks:
    """Steps lent to the instance as compiled code calls them; an error they raise is kept until its call has returned."""

    def __init__(self, steps: LentSteps, instance: Any):
        self._steps, self._instance, self._n = steps, instance, instance.model.step.nx
        self._refused: StepFailure | None = None
        self._broken: BaseException | None = None
        self.table = _LentStepsStruct(
            None, _STEP(self._step), _HALVED(self._halved), _INSIDE(self._inside), _MOVE(self._save), _MOVE(self._back)
        )

    def require(self, status: int) -> None:
        """Raise the error that was kept: that of a refused step only if compiled code could not go on without it."""
        failure, self._broken = self._broken or (self._refused if status else None), None
        self._refused = None
        if failure is not None:
            raise failure

    def _step(self, _: int, t: float, h: float) -> int:
        self._refused = None
        try:
            self._steps.step(t, h)
            self._instance.set_x(t + h, self._steps.x)
        except StepFailure as failure:
            self._refused = failure
        except BaseException as failure:
            self._broken = failure
        return 0 if self._refused is None and self._broken is None else _REFUSED

    def _halved(self, _: int) -> int:
        return self._steps.halved

    def _inside(self, _: int, tau: float, x: int) -> None:
        values = view(x, self._n)
        self._kept(lambda: values.__setitem__(slice(None), self._steps.inside(values.copy(), tau)))

    def _save(self, _: int) -> None:
        self._kept(self._steps.save)

    def _back(self, _: int) -> None:
        self._kept(self._steps.back)

    def _kept(self, call: Callable[[], None]) -> None:
        try:
            call()
        except BaseException as failure:
            self._broken = failure


#: status that a refused step of others is to compiled code
_REFUSED = tuple(Status).index(Status.NO_CONVERGENCE)


def one_by_one(
    room: LandingMemory, take: Callable[[], Iterable[Landed]], pause: bool
) -> Iterator[tuple[float, float, EventRecord | None]]:
    """(start, length, None) of each step, (time, 0, what happened) of each event: `take` calls compiled code once more.

    Others follow each of these before the next.  `pause`: ends after the events of one time, if there are any.
    """
    happened = False
    while not room.out.done:
        room.out.steps_room, room.out.events_room = 0, 1
        events = [part.happened for part in take() if part.happened is not None]
        for event in events:
            happened = True
            yield event.t, 0.0, event
        if events:
            continue
        if room.out.done or (pause and happened):
            return
        room.out.steps_room, room.out.events_room = 1, 0
        for part in take():
            yield from zip(part.t.tolist(), part.h.tolist(), [None] * len(part.t), strict=True)


def _typed(lib: ctypes.CDLL) -> ctypes.CDLL:
    """The library of a model with state events, with the signatures of events.h."""
    pointer, real, integer = ctypes.c_void_p, ctypes.c_double, ctypes.c_int
    signatures: Signatures = {
        "ph_landing_size": (ctypes.c_size_t, [pointer, pointer]),
        "ph_landing_init": (pointer, [pointer, pointer, pointer]),
        "ph_land_from": (None, [pointer, real, real, integer, integer, integer]),
        "ph_land_to": (None, [pointer, real, real, integer]),
        "ph_land_lent": (None, [pointer, ctypes.POINTER(_LentStepsStruct)]),
        "ph_land": (integer, [pointer, ctypes.POINTER(Record), ctypes.POINTER(LandedRows)]),
        "ph_land_begin": (integer, [pointer, real, real, integer]),
        "ph_land_on": (integer, [pointer, ctypes.POINTER(LandedRows)]),
        "ph_land_stops": (None, [pointer, pointer]),
        "ph_land_stopped": (pointer, [pointer, ctypes.POINTER(real), ctypes.POINTER(integer)]),
        "ph_land_after": (integer, [pointer, pointer]),
        "ph_land_rates": (pointer, [pointer]),
        "ph_happen_decide": (integer, [pointer]),
        "ph_happen_jump": (integer, [pointer, pointer, pointer]),
        "ph_happen_flags": (None, [pointer, pointer]),
        "ph_happen_parameters": (pointer, [pointer]),
        "ph_land_refusal": (ctypes.POINTER(EventRefusal), [pointer]),
    }
    return typed(lib, signatures)


class NativeLanding:
    """The landing of the instance at address `instance` of the library `lib`; `width`: of its signal table."""

    def __init__(self, model: EngineModel, lib: ctypes.CDLL, instance: int, events: int | None, width: int):
        if events is None or model.events is None:
            raise ValueError(f"{model.name} has no state events: use run")
        self._model, self._plan, self._lib, self._width = model, model.events, _typed(lib), width
        self._memory, self._in = placed(lib, "ph_landing", instance, events)
        self._lent: StepCallbacks | None = None

    def over(self, grid: Grid, record: Iterable[str], changed: bool, check: Callable[[int], None]) -> Iterator[Landed]:
        """The steps of a grid; `check` raises the error of a status."""
        self._lib.ph_land_from(self._in, grid.t0, grid.h, grid.first, grid.n, int(changed))
        yield from self.on(grid.n, record, check, grid.pause)

    def lend(self, lent: StepCallbacks) -> None:
        """Take the steps of others in place of those of the instance from now on."""
        self._lent = lent
        self._lib.ph_land_lent(self._in, lent.table)

    def to(
        self, t: float, end: float, changed: bool, pause: bool, check: Callable[[int], None]
    ) -> Iterator[tuple[float, float, EventRecord | None]]:
        """The lent steps and events in [t, end], after those before them; see `one_by_one`."""
        self._lib.ph_land_to(self._in, t, end, int(changed))
        room = self.room(1, ())

        def take() -> Iterator[Landed]:
            self._require(self._lib.ph_land(self._in, room.request, room.out), check)
            return room.parts()

        return one_by_one(room, take, pause)

    def stopping(
        self, t: float, end: float, changed: bool, pause: bool, check: Callable[[int], None]
    ) -> Iterator[tuple[float, float]]:
        """(start, length) of the lent steps in [t, end], (time, 0) where events happen elsewhere, who goes on by `after`.

        `pause`: ends after the events of one time, if there are any.
        """
        self._lib.ph_land_to(self._in, t, end, int(changed))
        room, now, count = self.room(1, ()), ctypes.c_double(), ctypes.c_int()
        room.out.steps_room = 1
        while not room.out.done:
            self._require(self._lib.ph_land(self._in, room.request, room.out), check)
            for part in room.parts():
                yield from zip(part.t.tolist(), part.h.tolist(), strict=True)
            if self._lib.ph_land_stopped(self._in, now, count):
                yield now.value, 0.0
                room.out.steps_room = 0 if pause else 1
            elif room.out.steps_room == 0:
                return

    def stop_before(self, events: NDArray[np.int8]) -> None:
        """Events with 1 (n) happen elsewhere: it ends before them."""
        self._stops = np.ascontiguousarray(events, np.int8)
        self._lib.ph_land_stops(self._in, self._stops.ctypes.data)

    def decide(self, check: Callable[[int], None]) -> None:
        """Which of the events it stopped before come to rest, and the parameters after them; EventRefused."""
        self._require(self._lib.ph_happen_decide(self._in), check)

    def jump(self, check: Callable[[int], None]) -> tuple[Floats, Floats]:
        """`decide`, and the states jump; what the energy of each component got, and what it lost."""
        energy, lost = np.zeros((2, self._model.step.ncomp))
        self._require(self._lib.ph_happen_jump(self._in, energy.ctypes.data, lost.ctypes.data), check)
        return energy, lost

    @property
    def decided(self) -> tuple[list[int], list[int], Floats]:
        """Numbers of the events that happen, and of those that come to rest; the parameters after them (np)."""
        flags, size = np.zeros(self._plan.n, np.int8), self._model.step.np
        self._lib.ph_happen_flags(self._in, flags.ctypes.data)
        p = view(self._lib.ph_happen_parameters(self._in), size).copy() if size else np.zeros(0)
        return [*_numbers(flags > 0)], [*_numbers(flags > 1)], p

    def after(self, check: Callable[[int], None]) -> None:
        """The events it stopped before have happened."""
        self._require(self._lib.ph_land_after(self._in, self._in), check)

    @property
    def rates(self) -> Floats:
        """|d guard / dt| (n) where the present instant was reached, by which a guard that was landed on is zero; may be set."""
        return view(self._lib.ph_land_rates(self._in), self._plan.n)

    def _require(self, status: int, check: Callable[[int], None]) -> None:
        """Raises what a status other than PH_OK means, or a lent step that was refused."""
        if self._lent is not None:
            self._lent.require(status)
        if status:
            self.refuse(status)
            check(status)

    @property
    def address(self) -> int:
        """Address of the landing in memory."""
        return self._in

    def on(self, n: int, record: Iterable[str], check: Callable[[int], None], pause: bool = False) -> Iterator[Landed]:
        """The rest of n grid steps, up to the first event if it is to `pause` there."""
        room = self.room(n, record, pause)
        while not room.over:
            status = self._lib.ph_land(self._in, room.request, room.out)
            yield from room.parts()
            self._require(status, check)

    def room(self, n: int, record: Iterable[str], pause: bool = False) -> LandingMemory:
        """Memory for n grid steps with their events, and some more."""
        sizes = record_widths(self._model, self._width)
        rows = {name: np.full((n + STEPS, sizes[name]), np.nan) for name in record}
        return LandingMemory(rows, n + STEPS, self._plan.n, self._model.step.ncomp, self._width, pause=pause)

    def step(self, t: float, h: float, parts: int, check: Callable[[int], None]) -> tuple[EventRecord, ...]:
        """A communication step in `parts` equal internal steps, told as one; the events in it."""
        out, found = self._one.rows, list[EventRecord]()
        code, out.done = self._lib.ph_land_begin(self._in, t, h, parts), 0
        while not code and not out.done:
            code = self._lib.ph_land_on(self._in, out)
            if not code and out.events:
                found.append(self._one.happened())
        if code:
            self.refuse(code)
            check(code)
        return tuple(found)

    @cached_property
    def _one(self) -> _Event:
        return _Event(self._plan.n, self._model.step.ncomp, self._width)

    def refuse(self, status: int) -> None:
        """EventRefused where the status says so."""
        if tuple(Status)[status] is not Status.EVENT:
            return
        r = self._lib.ph_land_refusal(self._in).contents
        names = [self._plan.names[i] for i in np.flatnonzero(view(r.fired, self._plan.n, np.int8))]
        raise EventRefused(self._model.name, r.t, r.reason, names, r.value, r.limit)


class LandingMemory:
    """Memory that steps and events are written to: `rows` for `steps` of them, and EVENTS events of `n` guards.

    `width`: of the signals after an event;  `changed` (EVENTS x switches): 1 = went off, 2 = on;  `pause`: it is full after
    the events of one time
    """

    def __init__(
        self,
        rows: dict[str, Floats],
        steps: int,
        n: int,
        ncomp: int,
        width: int,
        switches: int = 0,
        *,
        pause: bool = False,
    ):
        self.request, self._rows, self.width = Record(parts=1), rows, width
        for name, array in rows.items():
            setattr(self.request, name, Column(array.ctypes.data, array.shape[1]))
        self._t, self._h, self._when = np.zeros(steps), np.zeros(steps), np.zeros(EVENTS)
        self._step, self._fired = np.zeros(EVENTS, np.int32), np.zeros((EVENTS, n), np.int8)
        self._energy, self._lost = np.zeros((2, EVENTS, ncomp))
        self._signals, self.changed = np.zeros((EVENTS, width)), np.zeros((EVENTS, switches), np.int8)
        arrays = (self._t, self._h, self._when, self._step, self._fired, self._energy, self._lost, self._signals)
        self.out = LandedRows(steps, EVENTS, pause, 0, 0, 0, *(a.ctypes.data for a in arrays))

    @property
    def over(self) -> bool:
        """True if nothing is left to land."""
        return bool(self.out.done or (self.out.pause and self.out.events))

    def parts(self, words: Callable[[NDArray[np.int8]], tuple[str, ...]] = lambda _: ()) -> Iterator[Landed]:
        """The steps and events of the last call; `words`: the words for a row of `changed`."""
        begin = 0
        for i in range(self.out.events):
            who, end = self._fired[i], int(self._step[i])
            parts = self._energy[i].copy(), self._lost[i].copy(), self._signals[i].copy()
            happened = EventRecord(
                float(self._when[i]), _numbers(who > 0), _numbers(who > 1), *parts, words(self.changed[i])
            )
            yield self._landed(begin, end, happened)
            begin = end
        if begin < self.out.steps:
            yield self._landed(begin, self.out.steps, None)

    def _landed(self, begin: int, end: int, happened: EventRecord | None) -> Landed:
        part = {name: array[begin:end].copy() for name, array in self._rows.items()} if end > begin else {}
        return Landed(self._t[begin:end].copy(), self._h[begin:end].copy(), part, happened)


class _Event:
    """Memory for one event."""

    def __init__(self, n: int, ncomp: int, width: int):
        self._when, self._step, self._fired = np.zeros(1), np.zeros(1, np.int32), np.zeros(n, np.int8)
        self._parts = np.zeros(ncomp), np.zeros(ncomp), np.zeros(width)
        arrays = (self._when, self._step, self._fired, *self._parts)
        self.rows = LandedRows(0, 0, 0, 0, 0, 0, None, None, *(a.ctypes.data for a in arrays))

    def happened(self) -> EventRecord:
        energy, lost, signals = (part.copy() for part in self._parts)
        return EventRecord(
            float(self._when[0]), _numbers(self._fired > 0), _numbers(self._fired > 1), energy, lost, signals
        )


def _numbers(flags: NDArray[np.bool_]) -> tuple[int, ...]:
    return tuple(int(i) for i in np.flatnonzero(flags))
