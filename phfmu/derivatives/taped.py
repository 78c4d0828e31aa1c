"""A run that is kept to go back over: the tape of its steps, or the states to take them again from.

Every call of compiled code (`CompiledCall`) keeps the state at its start; within the memory that is allowed its stretches of
steps (`Leg`), which end where state events happen, keep their tapes too, those of the last calls first.  Calls without them are
made again when the way back comes to them: the same steps, to the bit.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.derivatives.backwards.legs import CompiledCall, Leg, Occurrence, TapeSegment
from phfmu.derivatives.backwards.reverse_sweep import ReverseSweep
from phfmu.derivatives.backwards.run_bars import RunBars
from phfmu.derivatives.by import start_tangents_by
from phfmu.derivatives.derived import ROOM, DerivedSteps, LandedSteps, span
from phfmu.derivatives.event_maps import EventInstant
from phfmu.derivatives.measured import TIME
from phfmu.derivatives.tangents import OF_INSTANT
from phfmu.discretise.model import Model
from phfmu.engine.native.native import NativeInstance
from phfmu.engine.native.reverse import NativeReverse, NativeTape, NativeTapes
from phfmu.engine.record import Grid
from phfmu.network.couplings.stepper import Landing
from phfmu.outcome.steps import Landed, StepEvent, Steps
from phfmu.signals import quantities

Array = NDArray[np.float64]

#: bytes that tapes may take, the longest stretch not counted
MEMORY = 150_000_000


class TapedSteps(DerivedSteps):
    """Steps of one composed model in compiled code that `slopes` goes back over, for measures of a run that was made with it.

    `memory`: bytes that tapes may take; stretches beyond it are run again.
    """

    def __init__(self, model: Model, instance: NativeInstance, by: Sequence[str], memory: int = MEMORY):
        super().__init__(model, instance, by)
        self.memory = memory
        #: stretches that had to be run again on the way back
        self.again = 0
        self.legs: list[Leg] = []
        self.calls: list[CompiledCall] = []
        self._moving = False
        self._quantities = {q.name: q for q in quantities(model)}
        self._instants = False

    def needs(self, signals: Sequence[str]) -> None:
        """Choose what is taped by the signals that will be measured."""
        self._instants = any(self._quantities[n].block in OF_INSTANT for n in signals)

    def forget(self) -> None:
        self.legs, self.calls, self._moving = [], [], False

    def cut(self, name: str) -> None:
        self.legs[-1].cuts.append(name)

    def read(self) -> Array:
        if not self.begun:
            i = self.instance
            self._start = i.time, i.x[: self.model.step.nx].copy(), self._inputs.u.copy(), i.parameters.copy()
            self._start_a = i.signal("a_end").copy()
            self._start_mode = None if self.model.modes is None else i.mode
        return super().read()

    def ran(self, instance: Any, t0: float, h: float, n: int, first: int, inputs: Array | None) -> Steps:
        self.require_continued(t0 + first * h)
        given = None if inputs is None else np.ascontiguousarray(inputs, float)
        call = self._called(CompiledCall(instance.get_state(), Grid(t0, h, n, first), given, None))
        starts = np.asarray(t0 + h * (first + np.arange(n)), np.float64)
        leg = self._leg(call, starts, np.full(n, h), self._inputs.u.copy(), instance.parameters.copy())
        leg.damped = None if instance is self.instance else instance
        record, leg.kept = self._take(call, self.wanted(instance))
        leg.end = self._last = instance.x[: self.model.step.nx].copy()
        self._forget()
        return self.steps_of(instance, record)

    def kept(self) -> Any:
        return list(self.legs), list(self.calls), self._last

    def back(self, kept: Any) -> None:
        legs, calls, self._last = kept
        self.legs, self.calls = list(legs), list(calls)

    def _called(self, call: CompiledCall) -> CompiledCall:
        self.calls.append(call)
        return call

    def _leg(self, call: CompiledCall, starts: Array, sizes: Array, u: Array, p: Array) -> Leg:
        """The next leg of the run."""
        row = self.legs[-1].first_row + self.legs[-1].rows if self.legs else 1
        leg = Leg(starts, sizes, call.inputs, u, p, row, call, moves=self._moving)
        call.legs.append(leg)
        self.legs.append(leg)
        if len(starts):
            self._moving = False
        return leg

    def landings(self, instance: Any, before: Array, parts: Iterable[Landed]) -> Iterator[Landing]:
        grid, changed = self._grid
        self._called(CompiledCall(instance.get_state(), grid, None, changed))
        yield from super().landings(instance, before, parts)
        self._forget()

    def follow_landed(
        self, found: LandedSteps, steps: Steps | None, row: tuple[StepEvent, Array] | None
    ) -> tuple[Steps | None, tuple[StepEvent, Array] | None]:
        part, e, layout = found.part, found.part.happened, self.instance.layout
        leg = self._leg(self.calls[-1], part.t, part.h, found.u, found.p)
        leg.mode = found.mode
        leg.end, a = found.x, np.zeros((0, self.model.step.na))
        if len(part.t):
            leg.end, a = (part.rows["signals"][:, layout[block]].copy() for block in ("x", "a_end"))
            leg.end = leg.end[-1]
        leg.kept = TapeSegment(found.rows, a)
        if e is not None:
            there = EventInstant(
                e.t, e.signals[layout["x"]].copy(), e.signals[layout["a_end"]].copy(), found.u, found.after
            )
            before = a[-1] if len(a) else there.a
            leg.occurrence = Occurrence(e.t, e.events, e.rests, there, before, found.entered)
            self._moving = leg.moves or len(part.t) > 0
        return steps, row

    def take_again(self, call: CompiledCall, instants: bool = False) -> None:
        """The parts of the steps of a call once more; with `instants` values at the ends of its steps too."""
        self.again += 1
        instance = self.instance if call.legs[0].damped is None else call.legs[0].damped
        instance.set_state(call.state)
        if call.changed is None:
            call.legs[0].kept = self._take(call, ("signals",) if instants else ())[1]
            return
        g = call.grid
        parts = instance.land(g.t0, g.h, g.n, ("signals",), g.first, call.changed, pause=g.pause)
        with NativeTapes(instance, g.n + ROOM) as tapes:
            for leg, part in zip(call.legs, parts, strict=True):
                a = part.rows["signals"][:, instance.layout["a_end"]].copy() if leg.n else np.zeros((0, 0))
                leg.kept = TapeSegment(tapes.of(leg.mode).taken(*span(part.t, part.h)), a)

    def _take(self, call: CompiledCall, wanted: tuple[str, ...]) -> tuple[dict[str, Array], TapeSegment]:
        """The steps of a call without events, from its state on."""
        damped, grid = call.legs[0].damped, call.grid
        instance = self.instance if damped is None else damped
        room = grid.n + 16
        while True:
            with NativeTape(instance, room) as tape:
                record = instance.run(grid.t0, grid.h, grid.n, record=wanted, inputs=call.inputs, first=grid.first)
            if not tape.full:
                break
            room *= 2
            instance.set_state(call.state)
        a = record["signals"][:, instance.layout["a_end"]].copy() if self._instants and "signals" in record else None
        return record, TapeSegment(tape.rows, a)

    def _forget(self) -> None:
        """Within the memory: tapes of the first calls go."""
        size = sum(call.kept for call in self.calls)
        for call in self.calls[:-1]:
            if size <= self.memory:
                break
            size -= call.kept
            for leg in call.legs:
                leg.kept = None

    # -- back --------------------------------------------------------------------------------------------------------

    def slopes(self, weights: Sequence[dict[str, Array]]) -> Array:
        """Derivatives (measures x names) of measures of the run, from their `weights` by signal and row (rows).

        NoDerivative, with its time.
        """
        plain = [{self._quantities[s]: c for s, c in w.items() if s != TIME} for w in weights]
        bars = RunBars(self.model, plain, [w.get(TIME) for w in weights])
        landed = self._coinciding()
        # measures, and behind them the instants of guards that are zero with others
        total = len(weights) + sum(len(leg.occurrence.fired) for leg in landed if leg.occurrence is not None)
        end = self.instance.get_state()
        last = self.legs[-1].entered if self.legs else self._start_mode
        way = ReverseSweep(self, bars, total, last, self.take_again)
        for leg in reversed(self.legs):
            self._cut(leg, way.back)
            way.over(leg)
        self.instance.set_state(end)
        way.enter(self._start_mode)
        back = way.back
        t, x, u, p = self._start
        told, instants = bars.of_rows(0, 1, total)
        there = bars.means_at_start(told[0]) + (0.0 if instants is None else instants[0])
        if there.any():
            back.instant(t, x, u, p, self._start_a, bars.in_model(there, self.model_in(self._start_mode)))
        nx = self.model.step.nx
        xb = back.bars.x[:, :nx] + told[0][:, :nx]
        S = start_tangents_by(self.model, self.by, self._given, x, p, t)
        along = self.by.directions.of(back.bars.p, back.bars.u)
        found = xb @ S + self.by.spread(along)
        way.require_together(found[len(weights) :], self.by.sizes(x, u, p))
        return found[: len(weights)] + bars.of_inputs(self.by.names)

    def _coinciding(self) -> list[Leg]:
        """Legs that end where several guards are zero."""
        return [leg for leg in self.legs if leg.n and leg.occurrence is not None and len(leg.occurrence.fired) > 1]

    def _cut(self, leg: Leg, back: NativeReverse) -> None:
        """Zero the bars of values that were set after a leg, since they do not follow those at the start."""
        d, names = self.by.directions, self.by.names
        gone = {n for name in leg.cuts for n in self.by.among(name)}
        kinds = [(back.bars.p, i) for i in d.parameters] + [(back.bars.u, i) for i in d.inputs]
        for (bar, i), column in zip(kinds, self.by.columns, strict=True):
            if names[column] in gone:
                bar[:, i] = 0.0
