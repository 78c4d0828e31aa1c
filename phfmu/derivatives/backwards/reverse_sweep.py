"""Bars of measures that go back over the legs of a run, from its last row to its start.

The bar tau of an instant T that moves comes from what happens there and from the step that begins there, t_bar - h_bar of it.
The step that ends there has its length h from the guard, g(x, T_0 + h) = 0, so that with the bars of g through that step

    nu = (h_bar + tau) / g_h,    (x, t, p)_bar -= nu g_(x,t,p).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.derivatives.backwards.legs import CompiledCall, Leg, Occurrence
from phfmu.derivatives.backwards.run_bars import RunBars
from phfmu.derivatives.derived import DerivedSteps
from phfmu.derivatives.event_maps import EventInstant
from phfmu.derivatives.tangents import weights_at_end
from phfmu.engine.native.reverse import NativeReverse, RowBars
from phfmu.events.modes import Mode

Array = NDArray[np.float64]


class ReverseSweep:
    """Reverse sweep over the legs of a run, from the mode that it ended in.

    `tau`: bars of the instant where the next leg begins
    again: makes a call of the run once more, with values at the ends of steps if they are wanted
    """

    def __init__(
        self,
        run: DerivedSteps,
        bars: RunBars,
        total: int,
        mode: Mode | None,
        again: Callable[[CompiledCall, bool], None],
    ):
        self._run, self._bars, self._total, self._maps, self._again = run, bars, total, run.maps, again
        self._backs: dict[tuple[Mode | None, bool, int], NativeReverse] = {}
        self._mode = mode
        self.back = self._of(self._mode)
        self._nx, self._d = run.model.step.nx, run.by.directions
        self._tau = np.zeros(total)
        #: places of measures that are instants, by leg; the next one
        self._instants: list[tuple[Leg, slice]] = []
        self._free = total

    def _of(self, mode: Mode | None, guard: bool = False, damped: Any = None) -> NativeReverse:
        """Reverse sweep over steps in a mode, or of a companion, of the measures or of a guard."""
        key = mode, guard, id(damped)
        if key not in self._backs:
            instance = self._run.instance if mode is None else self._run.instance.of(mode)[0]
            model, instance = (self._run.model_in(mode), instance) if damped is None else (damped.model, damped)
            self._backs[key] = NativeReverse(model, instance._native_model, 1 if guard else self._total)
        return self._backs[key]

    def enter(self, mode: Mode | None, damped: Any = None) -> None:
        """Bars go on in a mode, or in steps of a companion."""
        before, self.back = self.back, self._of(mode, damped=damped)
        self._mode = mode
        if before is not self.back:
            for old, new in zip(before.bars.all, self.back.bars.all, strict=True):
                new[:] = old

    def over(self, leg: Leg) -> None:
        """Back over a leg."""
        if leg.occurrence is not None:
            self._happened(leg, leg.occurrence)
        self.enter(leg.mode, leg.damped)
        if not leg.n:
            return
        if leg.kept is None:
            told, instants = self._bars.of_rows(leg.first_row, leg.n, self._total)
            self._again(leg.call, instants is not None)
        self._steps(leg)
        leg.kept = None

    def require_together(self, found: Array, sizes: Array) -> None:
        """NoDerivative where instants that coincide part; found: derivatives (instants x names) of those of all guards."""
        for leg, place in self._instants:
            assert self._maps is not None and leg.occurrence is not None
            first = self._total - len(found)
            own = found[place.start - first : place.stop - first]
            self._maps.require_together(leg.occurrence.t, leg.occurrence.fired, own, sizes)

    def _happened(self, leg: Leg, e: Occurrence) -> None:
        """From the row after events to the states before them."""
        self.enter(e.entered)
        b, at, row, maps = self.back.bars, e.after, leg.first_row + leg.n, self._run.maps_in(leg.mode)
        told, instants = self._bars.of_rows(row, 1, self._total)
        there = self._bars.means_at_start(told[0]) + (0.0 if instants is None else instants[0])
        if there.any():
            self._at_instant(at, there)
        b.x[:, : self._nx] += told[0][:, : self._nx]
        b.pairs[:] += self._bars.energies(told[0])[0]
        b.lost[:] += self._bars.energies(told[0])[1]
        self._tau += self._bars.by_time(row, self._total)
        before = EventInstant(e.t, leg.end, e.a_before, at.u, at.p)
        if self._run.entry is not None:
            entry = self._run.entry.slope(replace(before, x=maps.jumped(before, e.fired, e.rests)), at.x)
            own = b.x[:, : self._nx].copy()
            b.x[:, : self._nx] = own @ entry.x
            self._tau += own @ entry.t
            self._along(own @ entry.along)
        jump = maps.jump(e.fired, e.rests, before)
        if jump is not None:
            own = b.x[:, jump.moved]
            b.x[:, : self._nx] += own @ jump.x
            self._tau += own @ jump.t
            self._along(own @ jump.along)

    def _along(self, along: Array) -> None:
        """Bars (measures x directions) of parameters and inputs are added."""
        d, b = self._d, self.back.bars
        b.p[:, list(d.parameters)] += along[:, : len(d.parameters)]
        b.u[:, list(d.inputs)] += along[:, len(d.parameters) :]

    def _at_instant(self, at: EventInstant, there: Array) -> None:
        """Bars of values at an instant become those of its states and time."""
        b = self.back.bars
        kept = b.x.copy()
        b.x[:] = 0.0
        self.back.instant(at.t, at.x, at.u, at.p, at.a, self._bars.in_model(there, self._run.model_in(self._mode)))
        self._tau += b.x[:, self._nx]
        b.x[:] += kept

    def _steps(self, leg: Leg) -> None:
        told, instants = self._bars.of_rows(leg.first_row, leg.n, self._total)
        kept, lands = leg.kept, leg.occurrence is not None
        assert kept is not None
        rows = kept.rows
        step = np.clip(np.searchsorted(leg.starts + leg.sizes, rows[:, 0] + 0.5 * rows[:, 1]), 0, leg.n - 1)
        if not lands:
            self._tau[:] = 0.0
        if instants is not None:
            assert kept.a_end is not None
            self._instant_rows(leg, told, instants, kept.a_end, step)
        some = np.flatnonzero(told.any(axis=(1, 2)))
        bars = RowBars(np.asarray(some, np.int32), told[some])
        begin, end = 0, len(rows)
        if lands:
            self._tau += self._bars.by_time(leg.first_row + leg.n - 1, self._total)
            end = int(np.searchsorted(step, leg.n - 1))
            self._land(leg, slice(end, len(rows)), step, bars)
        if leg.moves and end:
            begin = int(np.searchsorted(step, 0, "right"))
        if end > begin:
            self._parts(leg, slice(begin, end), step, bars)
        if begin:
            self._clear()
            self._parts(leg, slice(0, begin), step, bars, moves=True)
            b = self.back.bars  # it ends on the grid: its length is less by what its start is later
            self._tau[:] = b.x[:, self._nx] - b.h[:, 0]

    def _clear(self) -> None:
        b = self.back.bars
        b.x[:, self._nx] = b.h[:] = 0.0

    def _parts(
        self, leg: Leg, which: slice, step: Any, bars: RowBars, moves: bool = False, back: NativeReverse | None = None
    ) -> None:
        assert leg.kept is not None
        rows = leg.kept.rows[which]
        part = rows[:, 1] / leg.sizes[step[which]]
        (back or self.back).back(rows, leg.parameters, np.asarray(step[which], np.int32), part, bars, moves)

    def _land(self, leg: Leg, which: slice, step: Any, bars: RowBars) -> None:
        """Back over the step that ends where guards are zero, whose length follows from where it begins."""
        e, maps, nx = leg.occurrence, self._run.maps_in(leg.mode), self._nx
        assert e is not None
        self._clear()
        self._parts(leg, which, step, bars, moves=True)
        b = self.back.bars
        t, h = b.x[:, nx] + self._tau, b.h[:, 0] + self._tau
        at = EventInstant(e.t, leg.end, e.a_before, leg.held, leg.parameters)
        through = [self._guard(i, at, leg, which, step) for i in e.fired]
        for i, g in zip(e.fired, through, strict=True):
            maps.require_crossing(i, e.t, g.h, leg.call.grid.h)
        if len(through) > 1:
            place = slice(self._free - len(through), self._free)
            self._free = place.start
            self._instants.append((leg, place))
            t[place], h[place] = 1.0, 1.0
        weights = np.zeros((self._total, len(through)))
        weights[:, 0] = h / through[0].h
        if len(through) > 1:
            weights[place] = np.diag([1.0 / g.h for g in through])
        for g, own in zip(through, weights.T, strict=True):
            b.x[:, :nx] -= np.outer(own, g.x)
            t = t - own * g.t
            self._along(-np.outer(own, g.along))
        self._tau = t

    def _guard(self, i: int, at: EventInstant, leg: Leg, which: slice, step: Any) -> _GuardSlope:
        """Guard i at the end of a step by where it begins."""
        g, nx = self._run.maps_in(leg.mode).guard(i, at), self._nx
        probe = self._of(leg.mode, guard=True)
        b = probe.bars
        for bar in b.all:
            bar[:] = 0.0
        b.x[0, :nx] = g.x
        nothing = RowBars(np.zeros(0, np.int32), np.zeros((0, 1, 1)))
        self._parts(leg, which, step, nothing, moves=True, back=probe)
        along = self._d.of(b.p[0], b.u[0]) + g.along
        return _GuardSlope(b.x[0, :nx].copy(), float(b.x[0, nx]) + g.t, float(b.h[0, 0]) + g.t, along)

    def _instant_rows(self, leg: Leg, told: Array, instants: Array, a_end: Array, step: Any) -> None:
        """Bars of values at the ends of steps become bars of the states there, and of the time of the last one."""
        assert leg.kept is not None
        nx, rows = self._nx, leg.kept.rows
        model = self._run.model_in(leg.mode) if leg.damped is None else leg.damped.model
        last = weights_at_end(model)
        b, tau = self.back.bars, self._tau.copy()
        kept, begins = b.x.copy(), np.searchsorted(step, np.arange(leg.n), "left")
        for i in np.flatnonzero(instants.any(axis=(1, 2))).tolist():
            x = leg.end if i == leg.n - 1 else rows[begins[i + 1], 2 : 2 + nx]
            b.x[:] = 0.0
            t = float(leg.starts[i] + leg.sizes[i])
            own = self._bars.in_model(instants[i], model)
            self.back.instant(t, x, leg.input_at_end(i, last), leg.parameters, a_end[i], own)
            told[i, :, :nx] += b.x[:, :nx]
            if i == leg.n - 1 and leg.occurrence is not None:
                tau += b.x[:, nx]
        b.x[:], self._tau = kept, tau


@dataclass(frozen=True)
class _GuardSlope:
    """Derivative of a guard at the end of a step by its states at the start, its start, its length and the directions."""

    x: Array
    t: float
    h: float
    along: Array
