"""Runs in compiled code: one call takes many, side by side where that pays, and only measured values are worked out."""

from __future__ import annotations

import ctypes
from dataclasses import replace
from functools import cache
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.audit.judge import Judge
from phfmu.audit.summing.ordinary import Ordinary
from phfmu.audit.summing.run_sums import RunSums
from phfmu.discretise.constant_energy import Constants
from phfmu.discretise.model import CONSISTENCY
from phfmu.engine.build.compile import CompileError, CompilerMissing
from phfmu.engine.native.library import drivers
from phfmu.engine.native.native import NativeInstance
from phfmu.engine.native.structures import Header, Structures
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.network.members.columns import SignalColumns
from phfmu.network.members.consistent import InconsistentState, require_consistent
from phfmu.network.members.inputs import with_bare
from phfmu.network.scene import Event
from phfmu.outcome.status import StepFailure
from phfmu.runs.loop import segments
from phfmu.runs.march.march import pieces
from phfmu.runs.march.stretches import stretches
from phfmu.sweeps import lanes as side_by_side
from phfmu.sweeps.lanes import LANES, LaneMemory, LaneSolver, lanes_of, why_not
from phfmu.sweeps.outcome import RunOutcomes, SweepStopped
from phfmu.sweeps.places import INPUT, PARAMETER, Places
from phfmu.sweeps.task import ModelTask
from phfmu.sweeps.words import KINDS

RUNTIME = Path(__file__).parent / "runtime"
#: kind of structure -> the field of `ph_runs` that lists them
LISTS = {"place": "places", "change": "changes", "stretch": "stretches", "measure": "measures"}
HEADER = Header(
    (RUNTIME / "runs.h", RUNTIME / "books.h"), (*(f"ph_runs_{kind}" for kind in LISTS), "ph_runs", "ph_books")
)
#: answer of runs.c for runs that were told to stop
STOPPED = -2
#: steps of a thread that earn what lanes take once: 10 to 50 ms for instances, books and programs
PAYS = 20_000
#: energies of each component, see runs.h
ENERGIES = ("constant", "was", "now", "carry", "varying")


def fits(task: ModelTask) -> bool:
    """True if the compiled loop takes these runs: equal steps without damping, a projected start or state events, and without
    events that change the constant part of H."""
    o = task.options
    if o.rtol is not None or o.restart or o.project or task.model.events is not None:
        return False
    return not o.events or _constants_kept(task)


def _constants_kept(task: ModelTask) -> bool:
    """True if no event sets a parameter that the constant part of H depends on."""
    own, places = Constants(task.model).parameters, Places(task.model)
    return not own or not any(p.index in own for e in task.options.events for p in places.of(e.name, (PARAMETER,)))


@cache
def _library() -> ctypes.CDLL:
    """The runtime with the signatures of runs.h; CompilerMissing, CompileError."""
    lib = drivers()
    pointer, integer = ctypes.c_void_p, ctypes.c_int
    lib.ph_runs_take.restype = integer
    lib.ph_runs_take.argtypes = [pointer, integer, pointer, pointer, integer, pointer, integer, *[pointer] * 3]
    lib.ph_lanes_size.argtypes, lib.ph_lanes_size.restype = [pointer, pointer], ctypes.c_size_t
    lib.ph_lanes_init.argtypes, lib.ph_lanes_init.restype = [pointer] * 4, integer
    lib.ph_lanes_taken.argtypes, lib.ph_lanes_taken.restype = [pointer], ctypes.c_longlong
    return lib


class RunBooks:
    """The structure ph_books: the ledger of one run, or of `lanes` runs side by side."""

    def __init__(self, task: ModelTask, instance: NativeInstance, lib: ctypes.CDLL, lanes: int = 1):
        booking, memory, ncomp = Monolithic(task.model, instance).booking, Structures(HEADER), task.model.step.ncomp
        # parts of junctions are not told of a sweep
        booking = replace(booking, parts=(), divided={}) if booking.parts else booking
        self._accounts = Ordinary(lib, booking, RunSums(), Judge(task.options.audit_rtol), lanes)
        accounts, books = self._accounts.accounts
        values = {
            "ncomp": ncomp, "nbook": len(books) // lanes, "loses": int(task.model.loses_energy),
            "accounts": accounts, "books": books.ctypes.data, **{name: np.zeros(lanes * ncomp) for name in ENERGIES},
        }  # fmt: skip
        self._memory, self._struct = memory, memory.fill("ph_books", values)
        self.address = ctypes.addressof(self._struct)


class _NativeRun:
    """An instance with the structure ph_runs, on which runs.c works."""

    def __init__(self, task: ModelTask, lib: ctypes.CDLL, stop: NDArray[Any]):
        self.instance, self._memory, self._stop = NativeInstance(task.model), Structures(HEADER), stop
        self._model = task.model
        self._books = RunBooks(task, self.instance, lib)
        self.struct = self._memory.fill("ph_runs", self._values(task))

    def why(self, code: int) -> str:
        """The error of the run that has ended with this status."""
        try:
            if code < 0:
                require_consistent(self._model, self.instance)
            self.instance.handle.check(code)
        except (StepFailure, InconsistentState) as error:
            return str(error)
        raise AssertionError(code)

    def _values(self, task: ModelTask) -> dict[str, Any]:
        model, plan, layout, o = task.model, task.model.step, self.instance.layout, task.options
        memory, columns = self._memory, SignalColumns(model, layout)
        measured = [(m.kind, *columns.place(m.signal)) for m in task.measures]
        ends, energies = layout["a_end"].start, layout["H"].start
        places, kinds = Places(model), list(KINDS)
        listed = {
            "place": [
                {"kind": p.kind, "index": p.index, "column": j} for j, n in enumerate(task.names) for p in places.of(n)
            ],
            "measure": [{"kind": kinds.index(k), "first": first, "count": count} for k, first, count in measured],
            **_schedule(task, places),
        }
        lists = {
            LISTS[kind]: memory.array([memory.fill(f"ph_runs_{kind}", v) for v in rows])
            for kind, rows in listed.items()
        }
        work = {
            "p": plan.np,
            "x": plan.nx,
            "u": plan.nu,
        }
        work |= dict.fromkeys(("value", "held", "time"), len(measured))
        found = layout["observables"]
        return {
            "in": self.instance.handle.instance,
            **{n: getattr(plan, n) for n in ("np", "nx", "nu", "ncomp")},
            **{f"n{kind}": len(rows) for kind, rows in listed.items()},
            "ncheck": len(model.checks), "check": found.stop - len(model.checks), "energy": energies,
            "refresh": any(ends <= first < energies for _, first, _ in measured),
            "t0": o.t0, "length": o.stop - o.t0, "books": self._books.address,
            "stop": self._stop.ctypes.data,
            "p0": model.p0, "x0": model.x0, "u0": model.u0, "tolerance": CONSISTENCY * np.asarray(model.check_scale),
            **lists, **{name: np.zeros(size) for name, size in work.items()},
        }  # fmt: skip


class NativeRuns:
    """Takes runs; another thread needs another one.

    LANES at a time where they have many steps that fit into lanes (`lanes.py`), unless `lanes` is False.
    """

    def __init__(self, task: ModelTask, lanes: bool = True):
        self._task, self._width, self._count = task, len(task.names), len(task.measures)
        self._steps = (task.options.stop - task.options.t0) / task.options.step
        self._stop, self._lib = np.zeros(1, np.intc), _library()
        self._each = [_NativeRun(task, self._lib, self._stop)]
        self._held, places = Constants(task.model), Places(task.model)
        named = [(p, j) for j, n in enumerate(task.names) for p in places.of(n)]
        self._parameters = [(p.index, j) for p, j in named if p.kind == PARAMETER]
        own = self._held.parameters
        self._varies = any(place in own for place, _ in self._parameters)
        self._lanes: LaneMemory | None = None
        self._expected = 0.0
        self._alone = self._why_not() if lanes else ""
        self._may = lanes and not self._alone
        self._found: bool | None = None

    def take(self, rows: NDArray[Any], first: int = 0) -> RunOutcomes:
        """Runs with these values (n x names); their numbers do not matter here."""
        del first
        rows, n = np.ascontiguousarray(rows, float), len(rows)
        values, facts, errors = np.full((n, self._count), np.nan), np.zeros((n, 2)), [""] * n
        status, constants, begun = np.zeros(n, np.intc), self._constants(rows), 0
        self._begin_lanes(n)
        before = self._inside
        many, lanes = len(self._each), self._lanes.address if self._lanes else None
        if lanes is None:
            self._each[0].instance.expect(n * self._steps)
        structs = (ctypes.c_void_p * many)(*(ctypes.addressof(run.struct) for run in self._each))
        while begun < n:
            done = self._lib.ph_runs_take(
                structs, many, lanes, rows[begun:].ctypes.data, self._width, constants[begun:].ctypes.data, n - begun,
                values[begun:].ctypes.data, facts[begun:].ctypes.data, status[begun:].ctypes.data,
            )  # fmt: skip
            last = begun + (done - 1) // many * many
            for i in range(last, begun + done):
                if status[i] == STOPPED:
                    raise SweepStopped
                if status[i]:
                    errors[i] = self._each[i - last].why(int(status[i]))
            begun += done
        steps = facts[:, 0].astype(int)
        return RunOutcomes(values, steps, facts[:, 1].copy(), tuple(errors), self._inside - before, self._alone)

    def _begin_lanes(self, n: int) -> None:
        """Instances for runs side by side, once there are some, of steps enough."""
        self._expected += n * self._steps
        if not self._may or n < LANES or self._expected < PAYS or not self._has_solver():
            return
        self._may = False
        instance, schur = self._each[0].instance, self._task.model.step.schur
        try:
            solver = None if schur is None else LaneSolver(schur)
        except (CompilerMissing, CompileError, OSError) as error:
            self._alone = f"its Schur stepper is not compiled for several ({error})"
            return
        self._books = RunBooks(self._task, instance, self._lib, LANES)
        self._lanes = lanes_of(instance, self._lib, self._books.address, solver)
        if self._lanes is not None:
            self._each += [_NativeRun(self._task, self._lib, self._stop) for _ in range(LANES - 1)]

    def _has_solver(self) -> bool:
        """True if the Schur stepper of several runs was compiled before, or the steps to come earn the compiler's time."""
        schur = self._task.model.step.schur
        if schur is None or self._expected >= side_by_side.EARNS:
            return True
        if self._found is None:
            self._found = LaneSolver.found(schur)
        return self._found

    def _why_not(self) -> str:
        """Why no steps will be taken side by side."""
        if self._each[0].struct.refresh:
            return "a measure of values at an instant is solved for in each step of a run"
        return why_not(self._each[0].instance)

    @property
    def _inside(self) -> int:
        """Steps that were taken with those of other runs."""
        return 0 if self._lanes is None else self._lanes.inside

    def _constants(self, rows: NDArray[Any]) -> NDArray[Any]:
        """The constant part of H in each run (n x components); asked for once where it does not depend on what varies."""
        p, found = self._task.model.p0.copy(), np.zeros((len(rows), self._task.model.step.ncomp))
        if not self._varies:
            found[:] = self._held.at(p) or 0.0
            return found
        for row, own in zip(rows, found, strict=True):
            for place, column in self._parameters:
                p[place] = row[column]
            own[:] = self._held.at(p) or 0.0
        return found

    def stop(self) -> None:
        """Called from another thread: end runs under way with SweepStopped."""
        self._stop[0] = 1


def _schedule(task: ModelTask, places: Places) -> dict[str, list[dict[str, Any]]]:
    """Stretches of equal steps, and the changes by the events at their starts, as the run loop has them."""
    o, ports = task.options, task.model.declaration.ports
    free = with_bare([n for p in ports if p.external for n in p.input_names()])
    found = _Schedule(places)
    events = sorted(o.events, key=lambda e: e.t)
    for stretch in stretches(lambda: segments(o.t0, o.stop, events, 1e-9 * o.step), o.step, lambda name: name in free):
        for e in stretch.events:
            found.set(e, apart=stretch.start > o.t0)
        for t, h, n in pieces(stretch.start, stretch.end, o.step):
            first, inside = 0, False
            for at, changes in groupby(stretch.inputs.within(0, n), key=itemgetter(0)):
                found.steps(t, h, first, at - first, inside)
                first, inside = at, True
                for _, e in changes:
                    found.set(e)
            found.steps(t, h, first, n - first, inside)
    return {"stretch": found.stretches, "change": found.changes}


class _Schedule:
    """Rows of ph_runs_stretch and ph_runs_change."""

    def __init__(self, places: Places):
        self._places, self._begun = places, 0
        self.stretches, self.changes = list[dict[str, Any]](), list[dict[str, Any]]()

    def set(self, e: Event, apart: bool = False) -> None:
        """Add the changes of an event; `apart`: the model takes those of the events before it first."""
        if apart and len(self.changes) > self._begun:
            self.steps(e.t, 1.0, 0, 0)
        found = self._places.of(e.name, (PARAMETER, INPUT))
        self.changes += [{"kind": p.kind, "index": p.index, "value": e.value} for p in found]

    def steps(self, t: float, h: float, first: int, n: int, inside: bool = False) -> None:
        """n steps of a grid from the first one on, after the changes so far."""
        until = len(self.changes)
        row = {"t": t, "h": h, "first": first, "n": n, "change": self._begun, "until": until, "inside": int(inside)}
        self.stretches.append(row)
        self._begun = until
