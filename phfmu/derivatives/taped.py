"""A run that is kept to go back over: the tape of its steps, or the states to take them again from.

Every call of compiled code (`Call`) keeps the state at its start; within the memory that is allowed its stretches of steps
(`Leg`), which end where state events happen, keep their tapes too, those of the last calls first.  Calls without them are made
again when the way back comes to them: the same steps, to the bit.

The bar tau of an instant T that moves comes from what happens there and from the step that begins there, t_bar - h_bar of it.
The step that ends there has its length h from the guard, g(x, T_0 + h) = 0, so that with the bars of g through that step

    nu = (h_bar + tau) / g_h,    (x, t, p)_bar -= nu g_(x,t,p).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.derivatives.by import start_tangents_by
from phfmu.derivatives.derived import ROOM, DerivedSteps, LandedSteps, span
from phfmu.derivatives.event_maps import Instant
from phfmu.derivatives.measured import TIME
from phfmu.derivatives.tangents import OF_INSTANT, OF_STEP, places
from phfmu.discretise.model import Model
from phfmu.engine.native.native import NativeInstance
from phfmu.engine.native.reverse import NativeReverse, NativeTape, NativeTapes, RowBars
from phfmu.engine.record import Grid
from phfmu.events.modes import Mode
from phfmu.network.couplings.stepper import Landing
from phfmu.outcome.steps import Landed, StepEvent, Steps
from phfmu.signals import Quantity, quantities

Array = NDArray[np.float64]

#: bytes that tapes may take, the longest stretch not counted
MEMORY = 150_000_000


@dataclass
class Kept:
    """Parts of steps (rows of a tape), and the algebraic variables at the ends of the steps (n x na) if they were asked for."""

    rows: Array
    a_end: Array | None

    @property
    def size(self) -> int:
        """Bytes."""
        return self.rows.nbytes + (0 if self.a_end is None else self.a_end.nbytes)


@dataclass(frozen=True)
class Occurrence:
    """State events at the end of a leg: numbers of those that happened and of those that came to rest; parameters, states and
    algebraic variables after them.  `end`: algebraic variables before them."""

    t: float
    fired: tuple[int, ...]
    rests: tuple[int, ...]
    after: Instant
    a_before: Array
    entered: Mode | None


@dataclass
class Leg:
    """n steps: starts and lengths (n), how they were taken, rows `first_row`.. of the run, states at the end, what was set after
    them.  `occurrence`: what happened at its end;  `moves`: its start is the instant of an event, and follows from values;
    mode: of ideal switches."""

    starts: Array
    sizes: Array
    inputs: Array | None
    held: Array
    parameters: Array
    first_row: int
    call: Call
    end: Array = field(default_factory=lambda: np.zeros(0))
    kept: Kept | None = None
    cuts: list[str] = field(default_factory=list)
    occurrence: Occurrence | None = None
    moves: bool = False
    mode: Mode | None = None

    @property
    def n(self) -> int:
        return len(self.starts)

    @property
    def entered(self) -> Mode | None:
        """The mode after it."""
        return self.mode if self.occurrence is None else self.occurrence.entered

    @property
    def rows(self) -> int:
        """Rows of the run that it has."""
        return self.n + (self.occurrence is not None)

    def input_at_end(self, i: int, last: Array) -> Array:
        """Inputs at the end of its i-th step; `last`: weights of the nodes there."""
        if self.inputs is None:
            return self.held
        own = self.inputs[i]
        return last @ own if own.ndim == 2 else own


@dataclass
class Call:
    """A call of compiled code for the steps of a grid: the state before it, what it was given, the legs that it made.

    changed: None for steps without events, else whether something was set before them
    """

    state: Any
    grid: Grid
    inputs: Array | None
    changed: bool | None
    legs: list[Leg] = field(default_factory=list)

    @property
    def kept(self) -> int:
        """Bytes of its tapes."""
        return sum(leg.kept.size for leg in self.legs if leg.kept is not None)


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
        self._calls: list[Call] = []
        self._moving = False
        self._quantities = {q.name: q for q in quantities(model)}
        self._instants = False

    def needs(self, signals: Sequence[str]) -> None:
        """What will be measured."""
        self._instants = any(self._quantities[n].block in OF_INSTANT for n in signals)

    def forget(self) -> None:
        self.legs, self._calls, self._moving = [], [], False

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
        call = self._called(Call(instance.get_state(), Grid(t0, h, n, first), given, None))
        starts = np.asarray(t0 + h * (first + np.arange(n)), np.float64)
        leg = self._leg(call, starts, np.full(n, h), self._inputs.u.copy(), instance.parameters.copy())
        record, leg.kept = self._take(call, self.wanted(instance))
        leg.end = self._last = instance.x[: self.model.step.nx].copy()
        self._forget()
        return self.steps_of(instance, record)

    def _called(self, call: Call) -> Call:
        self._calls.append(call)
        return call

    def _leg(self, call: Call, starts: Array, sizes: Array, u: Array, p: Array) -> Leg:
        """The next leg of the run."""
        row = self.legs[-1].first_row + self.legs[-1].rows if self.legs else 1
        leg = Leg(starts, sizes, call.inputs, u, p, row, call, moves=self._moving)
        call.legs.append(leg)
        self.legs.append(leg)
        if len(starts):
            self._moving = False
        return leg

    def landed(self, instance: Any, grid: Grid, changed: bool) -> Iterator[Landing]:
        self._landing = grid, changed
        yield from super().landed(instance, grid, changed)

    def landings(self, instance: Any, before: Array, parts: Iterable[Landed]) -> Iterator[Landing]:
        grid, changed = self._landing
        self._called(Call(instance.get_state(), grid, None, changed))
        yield from super().landings(instance, before, parts)
        self._forget()

    def follow_landed(
        self, found: LandedSteps, steps: Steps | None, row: tuple[StepEvent, Array] | None
    ) -> tuple[Steps | None, tuple[StepEvent, Array] | None]:
        part, e, layout = found.part, found.part.happened, self.instance.layout
        leg = self._leg(self._calls[-1], part.t, part.h, found.u, found.p)
        leg.mode = found.mode
        leg.end, a = found.x, np.zeros((0, self.model.step.na))
        if len(part.t):
            leg.end, a = (part.rows["signals"][:, layout[block]].copy() for block in ("x", "a_end"))
            leg.end = leg.end[-1]
        leg.kept = Kept(found.rows, a)
        if e is not None:
            there = Instant(e.t, e.signals[layout["x"]].copy(), e.signals[layout["a_end"]].copy(), found.u, found.after)
            before = a[-1] if len(a) else there.a
            leg.occurrence = Occurrence(e.t, e.events, e.rests, there, before, found.entered)
            self._moving = leg.moves or len(part.t) > 0
        return steps, row

    def take_again(self, call: Call, instants: bool = False) -> None:
        """The parts of the steps of a call once more; with `instants` values at the ends of its steps too."""
        self.again += 1
        instance = self.instance
        instance.set_state(call.state)
        if call.changed is None:
            call.legs[0].kept = self._take(call, ("signals",) if instants else ())[1]
            return
        g = call.grid
        parts = instance.land(g.t0, g.h, g.n, ("signals",), g.first, call.changed, pause=g.pause)
        with NativeTapes(instance, g.n + ROOM) as tapes:
            for leg, part in zip(call.legs, parts, strict=True):
                a = part.rows["signals"][:, instance.layout["a_end"]].copy() if leg.n else np.zeros((0, 0))
                leg.kept = Kept(tapes.of(leg.mode).taken(*span(part.t, part.h)), a)

    def _take(self, call: Call, wanted: tuple[str, ...]) -> tuple[dict[str, Array], Kept]:
        """The steps of a call without events, from its state on."""
        instance, grid = self.instance, call.grid
        room = grid.n + 16
        while True:
            with NativeTape(instance, room) as tape:
                record = instance.run(grid.t0, grid.h, grid.n, record=wanted, inputs=call.inputs, first=grid.first)
            if not tape.full:
                break
            room *= 2
            instance.set_state(call.state)
        a = record["signals"][:, instance.layout["a_end"]].copy() if self._instants and "signals" in record else None
        return record, Kept(tape.rows, a)

    def _forget(self) -> None:
        """Within the memory: tapes of the first calls go."""
        size = sum(call.kept for call in self._calls)
        for call in self._calls[:-1]:
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
        bars = _AllBars(self.model, plain, [w.get(TIME) for w in weights])
        landed = self._coinciding()
        # measures, and behind them the instants of guards that are zero with others
        total = len(weights) + sum(len(leg.occurrence.fired) for leg in landed if leg.occurrence is not None)
        end = self.instance.get_state()
        way = _Way(self, bars, total)
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
        d = self.by.directions
        along = np.hstack([back.bars.p[:, list(d.parameters)], back.bars.u[:, list(d.inputs)]])
        found = xb @ S + self.by.spread(along)
        way.require_together(found[len(weights) :], self.by.sizes(x, u, p))
        return found[: len(weights)] + bars.of_inputs(self.by.names)

    def _coinciding(self) -> list[Leg]:
        """Legs that end where several guards are zero."""
        return [leg for leg in self.legs if leg.n and leg.occurrence is not None and len(leg.occurrence.fired) > 1]

    def _cut(self, leg: Leg, back: NativeReverse) -> None:
        """What follows from a value set after a leg does not follow from that at the start."""
        d, names = self.by.directions, self.by.names
        gone = {n for name in leg.cuts for n in self.by.among(name)}
        kinds = [(back.bars.p, i) for i in d.parameters] + [(back.bars.u, i) for i in d.inputs]
        for (bar, i), column in zip(kinds, self.by.columns, strict=True):
            if names[column] in gone:
                bar[:, i] = 0.0


class _Way:
    """The way back over the legs of a run: `tau`, the bars of the instant where the next leg begins."""

    def __init__(self, run: TapedSteps, bars: _AllBars, total: int):
        self._run, self._bars, self._total, self._maps = run, bars, total, run.maps
        self._backs: dict[tuple[Mode | None, bool], NativeReverse] = {}
        self._mode = run.legs[-1].entered if run.legs else None
        self.back = self._of(self._mode)
        self._nx, self._d = run.model.step.nx, run.by.directions
        self._tau = np.zeros(total)
        #: places of measures that are instants, by leg; the next one
        self._instants: list[tuple[Leg, slice]] = []
        self._free = total

    def _of(self, mode: Mode | None, guard: bool = False) -> NativeReverse:
        """The way back over steps in a mode, of the measures or of a guard."""
        if (mode, guard) not in self._backs:
            instance = self._run.instance if mode is None else self._run.instance.of(mode)[0]
            n = 1 if guard else self._total
            self._backs[mode, guard] = NativeReverse(self._run.model_in(mode), instance._made, n)
        return self._backs[mode, guard]

    def enter(self, mode: Mode | None) -> None:
        """Bars go on in a mode."""
        before, self.back = self.back, self._of(mode)
        self._mode = mode
        if before is not self.back:
            for old, new in zip(before.bars.all, self.back.bars.all, strict=True):
                new[:] = old

    def over(self, leg: Leg) -> None:
        """Back over a leg."""
        if leg.occurrence is not None:
            self._happened(leg, leg.occurrence)
        self.enter(leg.mode)
        if not leg.n:
            return
        if leg.kept is None:
            told, instants = self._bars.of_rows(leg.first_row, leg.n, self._total)
            self._run.take_again(leg.call, instants is not None)
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
        before = Instant(e.t, leg.end, e.a_before, at.u, at.p)
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

    def _at_instant(self, at: Instant, there: Array) -> None:
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
        at = Instant(e.t, leg.end, e.a_before, leg.held, leg.parameters)
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

    def _guard(self, i: int, at: Instant, leg: Leg, which: slice, step: Any) -> _Through:
        """Guard i at the end of a step by where it begins."""
        g, d, nx = self._run.maps_in(leg.mode).guard(i, at), self._d, self._nx
        probe = self._of(leg.mode, guard=True)
        b = probe.bars
        for bar in b.all:
            bar[:] = 0.0
        b.x[0, :nx] = g.x
        nothing = RowBars(np.zeros(0, np.int32), np.zeros((0, 1, 1)))
        self._parts(leg, which, step, nothing, moves=True, back=probe)
        along = np.concatenate([b.p[0, list(d.parameters)], b.u[0, list(d.inputs)]]) + g.along
        return _Through(b.x[0, :nx].copy(), float(b.x[0, nx]) + g.t, float(b.h[0, 0]) + g.t, along)

    def _instant_rows(self, leg: Leg, told: Array, instants: Array, a_end: Array, step: Any) -> None:
        """Bars of values at the ends of steps become bars of the states there, and of the time of the last one."""
        assert leg.kept is not None
        nx, model, rows = self._nx, self._run.model_in(leg.mode), leg.kept.rows
        last = np.array(model.scheme.nodes.value(1.0)) if model.step.k > 1 else np.ones(1)
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
class _Through:
    """Derivative of a guard at the end of a step by its states at the start, its start, its length and the directions."""

    x: Array
    t: float
    h: float
    along: Array


class _AllBars:
    """The weights of measures by row, in the blocks of rows (`OF_STEP`) and of instants (`OF_INSTANT`)."""

    def __init__(self, model: Model, weights: Sequence[dict[Quantity, Array]], times: Sequence[Array | None]):
        step, instant = model.step, model.instant
        self._times = times
        self._weights, self._owner, self._n = weights, step.pair_owner, len(weights)
        self._told = places(("x", *OF_STEP), (step.nx, step.na, step.nq, step.nq, step.ncomp))
        self._instant = places(OF_INSTANT, (instant.na, instant.nq, len(model.observable_names), instant.ncomp))
        self._na, self._nq, self._nobs = step.na, step.nq, len(model.observable_names)

    def of_rows(self, first: int, n: int, total: int) -> tuple[Array, Array | None]:
        """Bars (rows x total x width) of what rows tell, and of what holds at their ends, None for none; those of the measures
        come first, the others are 0."""
        told = np.zeros((n, total, self._told["dissipated"].stop))
        instants = np.zeros((n, total, self._instant["H"].stop))
        for m, weights in enumerate(self._weights):
            for q, c in weights.items():
                own = c[first : first + n]
                entries = np.arange(q.first, q.first + q.count)
                if q.block == "supplied":
                    pairs = np.flatnonzero(np.isin(self._owner, entries))
                    told[:, m, self._told["energy"].start + pairs] += own[:, None]
                elif q.block in self._told:
                    told[:, m, self._told[q.block].start + entries] += own[:, None]
                elif q.block in self._instant:
                    instants[:, m, self._instant[q.block].start + entries] += own[:, None]
        return told, instants if instants.any() else None

    def means_at_start(self, told: Array) -> Array:
        """Means of a row (measures x width of `told`) at a start, or after an event, are values there, of which these are the
        bars."""
        found = np.zeros((len(told), self._instant["H"].stop))
        found[:, self._instant["a_end"]] = told[:, self._told["a"]]
        found[:, self._instant["y_end"]] = told[:, self._told["y_step"]]
        return found

    def in_model(self, bars: Array, model: Model) -> Array:
        """Bars of an instant for a mode, which has rows of its own behind the observables."""
        end, more = self._instant["observables"].stop, model.instant.nobs - self._nobs
        return bars if not more else np.insert(bars, [end] * more, 0.0, axis=-1)

    def energies(self, told: Array) -> tuple[Array, Array]:
        """Bars (measures x ..) of energies through pairs and of those lost, since the start."""
        return told[:, self._told["energy"]], told[:, self._told["dissipated"]]

    def by_time(self, row: int, total: int) -> Array:
        """Bars (total) of the time of a row."""
        found = np.zeros(total)
        found[: self._n] = [0.0 if w is None else w[row] for w in self._times]
        return found

    def of_inputs(self, names: Sequence[str]) -> Array:
        """Derivatives (measures x names) of measures that read held inputs themselves."""
        found = np.zeros((self._n, len(names)))
        for m, weights in enumerate(self._weights):
            for q, c in weights.items():
                if q.block == "input" and q.name in names:
                    found[m, names.index(q.name)] += float(c.sum())
        return found
