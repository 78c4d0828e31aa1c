"""A run that is kept to go back over: the tape of its steps, or the states to take them again from.

Every stretch of steps (`Leg`) keeps the state at its start; within the memory that is allowed it keeps its tape too, the last
stretches first.  Stretches without one are run again when the way back comes to them: the same steps, to the bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.derivatives.by import start_tangents_by
from phfmu.derivatives.derived import DerivedSteps
from phfmu.derivatives.tangents import OF_INSTANT, OF_STEP, places
from phfmu.discretise.model import Model
from phfmu.engine.native.native import NativeInstance
from phfmu.engine.native.reverse import NativeReverse, NativeTape, RowBars
from phfmu.outcome.steps import Steps
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


@dataclass
class Leg:
    """n equal steps: how they were taken, rows `first_row`.. of the run, states at the end, what was set after them."""

    state: Any
    t0: float
    h: float
    n: int
    first: int
    inputs: Array | None
    held: Array
    parameters: Array
    first_row: int
    end: Array = field(default_factory=lambda: np.zeros(0))
    kept: Kept | None = None
    cuts: list[str] = field(default_factory=list)

    @property
    def starts(self) -> Array:
        """Start of each step (n)."""
        return np.asarray(self.t0 + self.h * (self.first + np.arange(self.n)), np.float64)

    def input_at_end(self, i: int, last: Array) -> Array:
        """Inputs at the end of its i-th step; `last`: weights of the nodes there."""
        if self.inputs is None:
            return self.held
        own = self.inputs[i]
        return last @ own if own.ndim == 2 else own


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
        self._quantities = {q.name: q for q in quantities(model)}
        self._instants = False

    def needs(self, signals: Sequence[str]) -> None:
        """What will be measured."""
        self._instants = any(self._quantities[n].block in OF_INSTANT for n in signals)

    def forget(self) -> None:
        self.legs = []

    def cut(self, name: str) -> None:
        self.legs[-1].cuts.append(name)

    def read(self) -> Array:
        if not self.begun:
            i = self.instance
            self._start = i.time, i.x[: self.model.step.nx].copy(), self._inputs.u.copy(), i.parameters.copy()
            self._start_a = i.signal("a_end").copy()
        return super().read()

    def ran(self, instance: Any, t0: float, h: float, n: int, first: int, inputs: Array | None) -> Steps:
        self.require_continued(t0 + first * h)
        given = None if inputs is None else np.ascontiguousarray(inputs, float)
        row = 1 + sum(leg.n for leg in self.legs)
        leg = Leg(instance.get_state(), t0, h, n, first, given, self._inputs.u.copy(), instance.parameters.copy(), row)
        record, leg.kept = self._take(leg, self.wanted(instance))
        leg.end = self._last = instance.x[: self.model.step.nx].copy()
        self.legs.append(leg)
        self._forget()
        return self.steps_of(instance, record)

    def taken_again(self, leg: Leg, instants: bool = False) -> Kept:
        """The parts of the steps of a leg once more; with `instants` values at the ends of its steps too."""
        self.instance.set_state(leg.state)
        return self._take(leg, ("signals",) if instants else ())[1]

    def _take(self, leg: Leg, wanted: tuple[str, ...]) -> tuple[dict[str, Array], Kept]:
        """The steps of a leg, from its state on."""
        instance, room = self.instance, leg.n + 16
        while True:
            with NativeTape(instance, room) as tape:
                record = instance.run(leg.t0, leg.h, leg.n, record=wanted, inputs=leg.inputs, first=leg.first)
            if not tape.full:
                break
            room *= 2
            instance.set_state(leg.state)
        a = record["signals"][:, instance.layout["a_end"]].copy() if self._instants and "signals" in record else None
        return record, Kept(tape.rows, a)

    def _forget(self) -> None:
        """Within the memory: tapes of the first stretches go."""
        kept = [leg for leg in self.legs if leg.kept is not None]
        size = sum(leg.kept.size for leg in kept if leg.kept is not None)
        for leg in kept[:-1]:
            if size <= self.memory:
                break
            assert leg.kept is not None
            size, leg.kept = size - leg.kept.size, None

    # -- back --------------------------------------------------------------------------------------------------------

    def slopes(self, weights: Sequence[dict[str, Array]]) -> Array:
        """Derivatives (measures x names) of measures of the run, from their `weights` by signal and row (rows).

        NoDerivative, with its time.
        """
        bars = _AllBars(self.model, [{self._quantities[s]: c for s, c in w.items()} for w in weights])
        back, end = NativeReverse(self.model, self.instance._made, len(weights)), self.instance.get_state()
        for leg in reversed(self.legs):
            self._cut(leg, back)
            self._back(leg, back, bars)
        self.instance.set_state(end)
        t, x, u, p = self._start
        told, instants = bars.of_rows(0, 1)
        there = bars.means_at_start(told[0]) + (0.0 if instants is None else instants[0])
        if there.any():
            back.instant(t, x, u, p, self._start_a, there)
        nx = self.model.step.nx
        xb = back.bars.x[:, :nx] + told[0][:, :nx]
        S = start_tangents_by(self.model, self.by, self._given, x, p, t)
        d = self.by.directions
        along = np.hstack([back.bars.p[:, list(d.parameters)], back.bars.u[:, list(d.inputs)]])
        return xb @ S + self.by.spread(along) + bars.of_inputs(self.by.names)

    def _cut(self, leg: Leg, back: NativeReverse) -> None:
        """What follows from a value set after a leg does not follow from that at the start."""
        d, names = self.by.directions, self.by.names
        gone = {n for name in leg.cuts for n in self.by.among(name)}
        kinds = [(back.bars.p, i) for i in d.parameters] + [(back.bars.u, i) for i in d.inputs]
        for (bar, i), column in zip(kinds, self.by.columns, strict=True):
            if names[column] in gone:
                bar[:, i] = 0.0

    def _back(self, leg: Leg, back: NativeReverse, bars: _AllBars) -> None:
        told, instants = bars.of_rows(leg.first_row, leg.n)
        kept = leg.kept
        if kept is None:
            self.again += 1
            kept = self.taken_again(leg, instants is not None)
        ends, rows = leg.starts + leg.h, kept.rows
        step = np.clip(np.searchsorted(ends, rows[:, 0] + 0.5 * rows[:, 1]), 0, leg.n - 1)
        if instants is not None:
            assert kept.a_end is not None
            self._instant_rows(leg, back, told, instants, kept.a_end, rows, step)
        some = np.flatnonzero(told.any(axis=(1, 2)))
        row_bars = RowBars(np.asarray(some, np.int32), told[some])
        back.back(rows, leg.parameters, np.asarray(step, np.int32), rows[:, 1] / leg.h, row_bars)
        leg.kept = None

    def _instant_rows(
        self, leg: Leg, back: NativeReverse, told: Array, instants: Array, a_end: Array, rows: Array, step: Any
    ) -> None:
        """Bars of values at the ends of steps become bars of the states there."""
        nx, plan = self.model.step.nx, self.model.step
        last = np.array(self.model.scheme.nodes.value(1.0)) if plan.k > 1 else np.ones(1)
        kept = back.bars.x.copy()
        begins = np.searchsorted(step, np.arange(leg.n), "left")
        for i in np.flatnonzero(instants.any(axis=(1, 2))).tolist():
            x = leg.end if i == leg.n - 1 else rows[begins[i + 1], 2 : 2 + nx]
            back.bars.x[:] = 0.0
            t = float(leg.starts[i] + leg.h)
            back.instant(t, x, leg.input_at_end(i, last), leg.parameters, a_end[i], instants[i])
            told[i, :, :nx] += back.bars.x[:, :nx]
        back.bars.x[:] = kept


class _AllBars:
    """The weights of measures by row, in the blocks of rows (`OF_STEP`) and of instants (`OF_INSTANT`)."""

    def __init__(self, model: Model, weights: Sequence[dict[Quantity, Array]]):
        step, instant = model.step, model.instant
        self._weights, self._owner, self._n = weights, step.pair_owner, len(weights)
        self._told = places(("x", *OF_STEP), (step.nx, step.na, step.nq, step.nq, step.ncomp))
        self._instant = places(OF_INSTANT, (instant.na, instant.nq, instant.nobs, instant.ncomp))
        self._na, self._nq = step.na, step.nq

    def of_rows(self, first: int, n: int) -> tuple[Array, Array | None]:
        """Bars (rows x measures x width) of what rows tell, and of what holds at their ends, None for none."""
        told = np.zeros((n, self._n, self._told["dissipated"].stop))
        instants = np.zeros((n, self._n, self._instant["H"].stop))
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
        """Means of the first row (measures x width of `told`) are values at the start, of which these are the bars."""
        found = np.zeros((self._n, self._instant["H"].stop))
        found[:, self._instant["a_end"]] = told[:, self._told["a"]]
        found[:, self._instant["y_end"]] = told[:, self._told["y_step"]]
        return found

    def of_inputs(self, names: Sequence[str]) -> Array:
        """Derivatives (measures x names) of measures that read held inputs themselves."""
        found = np.zeros((self._n, len(names)))
        for m, weights in enumerate(self._weights):
            for q, c in weights.items():
                if q.block == "input" and q.name in names:
                    found[m, names.index(q.name)] += float(c.sum())
        return found
