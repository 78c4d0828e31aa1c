"""Members stepped apart with derivatives: beside each column `s` of a run stand columns `d(s)/d(name)`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.derivatives.apart.derived_members import DerivedMembers
from phfmu.derivatives.apart.joint_maps import JointSlopes, JointSteps
from phfmu.derivatives.apart.member_maps import Instants, MemberMaps
from phfmu.derivatives.event_maps import EventInstant
from phfmu.derivatives.measured import TIME
from phfmu.derivatives.sensitive import quotient, slope_units
from phfmu.interrupt import Interrupted
from phfmu.network.couplings.coupled import Coupled
from phfmu.network.couplings.stepper import Landing
from phfmu.outcome.status import StepFailure
from phfmu.outcome.steps import Steps
from phfmu.signals import SignalKind, derivative_name

Array = NDArray[np.float64]


class SensitiveMembers(DerivedMembers):
    """Members stepped apart, each row with its derivatives by parameters, held inputs or start values `by`.

    `signals`: which columns are derived (default: all that have derivatives: those of members, means at junctions, sums).
    Errors: those of `DerivedMembers`; ValueError for signals without derivatives.
    """

    through_events = True

    def __init__(self, apart: Coupled, by: Sequence[str], signals: Sequence[str] | None = None):
        super().__init__(apart, by)
        #: the times of rows move at state events
        self._times = [] if self.events is None else [derivative_name(TIME, n) for n in self.by.names]
        self.choose(signals)
        self._S: list[Array] = []
        #: tangents of the present time, which moves at events, of junction unknowns, and what was told of members last
        self._T, self._xi, self._blocks_now = np.zeros(len(self.by.names)), np.zeros(0), list[dict[str, Array]]()
        self._energies: list[dict[str, Array]] = []
        self._row_slopes = np.zeros(0)

    def like(self, apart: Coupled) -> SensitiveMembers:
        return SensitiveMembers(apart, self.by.names, self.derived_names)

    def go_on(self, other: Any) -> None:
        super().go_on(other)
        self._S, self._row_slopes, self._xi = other._S, other._row_slopes, other._xi
        self._energies = [dict(sums) for sums in other._energies]

    def choose(self, signals: Sequence[str] | None) -> None:
        """Derives these columns, None: all that have derivatives.  ValueError for those that have none."""
        for n in signals or ():
            self.require_derivable(n)
        self.derived_names = [n for n in self.derivable if signals is None or n in signals]
        self._places = [self.own_names.index(n) for n in self.derived_names]
        self.names = [
            *self.own_names,
            *self._times,
            *(derivative_name(s, n) for s in self.derived_names for n in self.by.names),
        ]

    @property
    def columns(self) -> list[str]:
        """Derivatives of the times of rows where they move, and the signals that are derived, each followed by its own."""
        return self._times + [
            c for s in self.derived_names for c in (s, *(derivative_name(s, n) for n in self.by.names))
        ]

    @property
    def units(self) -> dict[str, str]:
        own = super().units
        given = self.known.units | own
        moved = {m: quotient("s", given.get(n, "1")) for m, n in zip(self._times, self.by.names, strict=False)}
        return own | moved | slope_units(self.derived_names, self.by.names, own, given)

    @property
    def kinds(self) -> dict[str, SignalKind]:
        own = super().kinds
        more: dict[str, SignalKind] = {
            derivative_name(s, n): own[s] for s in self.derived_names if s in own for n in self.by.names
        }
        more |= dict.fromkeys(self._times, "observable")
        return own | more

    def read(self) -> Array:
        own = super().read()
        if not self._begun:
            self._S, slopes = self.at_start(own)
            width = len(self.by.names)
            self._energies = [m.sums(width) for m in self.maps.members]
            self._T = np.zeros(width)
            self._xi = slopes[[self.own_names.index(n) for n in self.joined.face.names]]
            self._row_slopes = np.concatenate([np.zeros(len(self._times)), slopes[self._places].ravel()])
        return np.concatenate([own, self._row_slopes])

    # -- steps -----------------------------------------------------------------------------------------------------------

    def advance(self, t0: float, h: float, n: int, first: int = 0) -> Steps:
        parts, kept, failure = self.kept_steps(t0, h, n, first)
        done = self._derived(parts, kept) if parts else None
        if failure is not None:
            failure.recorded = {} if done is None else {"steps": done}
            raise failure
        assert done is not None
        return done

    def _derived(self, parts: list[Steps], kept: list[JointSteps]) -> Steps:
        """The record of steps with the derivatives of their rows."""
        steps, rows = Steps.joined(parts), list[Array]()
        for i in range(0, len(kept), self.maps.at_once):
            rows.append(self._along(JointSteps.joined(kept[i : i + self.maps.at_once])))
        found = np.concatenate(rows)
        self._row_slopes = found[-1].copy()
        return replace(steps, signals=np.hstack([steps.signals, found]))

    def _along(self, steps: JointSteps, events: Sequence[int] = (), end: EventInstant | None = None) -> Array:
        """Derivatives of the rows at the ends of steps (n x columns), to which the tangents go on; events: guards that are zero
        at the `end` of the last one."""
        maps, n, width = self.maps.members, len(steps.z), len(self.by.names)
        acts = [self._acts[at] for at in self.at]
        slopes = self.maps.slopes(steps, acts)
        D = [np.zeros((n, m.given + m.reached, width)) for m in maps]
        dz = np.zeros((n, steps.z.shape[1], width))
        for m, d, at in zip(maps, D, self.at, strict=True):
            d[:, m.nx + np.arange(m.names), at] = 1.0
        for i in range(n):
            right = np.zeros(dz.shape[1:])
            for m, d, S, rows, at in zip(maps, D, self._S, slopes.rows, slopes.at, strict=True):
                d[i, : m.nx] = S
                if self.events is not None:  # from an instant that moves to one that does not
                    d[i, m.moves] = self._T, -self._T
                first = m.given
                right[at] += rows[i, :, :first] @ d[i, :first]
            dz[i] = slopes.solved(i, right)
            for m, d in zip(maps, D, strict=True):
                d[i, m.given :] = dz[i][m.part.col]
            self._S = [own.x[i] @ d[i] for own, d in zip(slopes.members, D, strict=True)]
            self._T = np.zeros(width)
        if events and end is not None:
            self._ends(slopes, D, dz, events, end)
        told = [own.told @ d for own, d in zip(slopes.members, D, strict=True)]
        self.maps.passed_on(slopes, told, dz)
        states = (own.x @ d for own, d in zip(slopes.members, D, strict=True))
        blocks = [self._blocks(j, own, S) for j, (own, S) in enumerate(zip(told, states, strict=True))]
        junctions = (self.maps.means(steps.h) @ dz)[:, : len(self.joined.face.names)]
        self._xi, self._blocks_now = junctions[-1], blocks
        return self._rows_of(blocks, junctions)

    def _ends(self, slopes: JointSlopes, D: list[Array], dz: Array, events: Sequence[int], at: EventInstant) -> None:
        """The last step ends where guards are zero: its length follows, and with it the states and unknowns."""
        assert self.events is not None
        maps, right = self.maps.members, np.zeros((dz.shape[1], 1))
        for m, rows, place in zip(maps, slopes.rows, slopes.at, strict=True):
            right[place, 0] += rows[-1][:, m.moves.stop - 1]
        z = slopes.solved(-1, right)
        rate = [
            own.x[-1][:, m.moves.stop - 1] + own.x[-1][:, m.given :] @ z[m.part.col, 0]
            for m, own in zip(maps, slopes.members, strict=True)
        ]
        T = self.events.landed(events, at, self._S, rate, self.grid, self._acts)
        dz[-1] += z * T
        for m, d in zip(maps, D, strict=True):
            d[-1, m.moves.stop - 1] += T
            d[-1, m.given :] += z[m.part.col] * T
        self._S = [S + np.outer(x, T) for S, x in zip(self._S, rate, strict=True)]
        self._T = T

    # -- state events ----------------------------------------------------------------------------------------------------

    def land(self, t0: float, h: float, n: int, first: int = 0, changed: bool = True) -> Iterator[Landing]:
        """Land as `Coupled` does; a step comes with the event at its end, by which its length is derived."""
        assert self.events is not None
        self._begun, self.grid, own = True, h, len(self.own_names)
        waiting: tuple[Array, Array, Steps, JointSteps] | None = None
        at, before = self.events.now(), self.states_now()

        def followed(events: Sequence[int] = ()) -> tuple[Array, Array, Steps | None]:
            if waiting is None:
                return np.zeros(0), np.zeros(0), None
            t, taken, steps, kept = waiting
            self._row_slopes = self._along(kept, events, at)[0]
            return t, taken, replace(steps, signals=np.hstack([steps.signals[:, :own], self._row_slopes[None]]))

        try:
            for t, taken, steps, happened in super().land(t0, h, n, first, changed):
                if happened is None:
                    assert steps is not None
                    if waiting is not None:
                        yield *followed(), None
                    waiting = t, taken, steps, self.landed_step(before, float(t[0]), float(taken[0]))
                    at, before = self.events.now(), self.states_now()
                    continue
                met = self.events.happened(happened[0].t)
                part = followed(met.events)
                now = self.events.now()
                self._S = self.events.jumped(met, at, now.p, self._S, self._T, self._acts)
                self._row_slopes = self._at_event(now)
                yield *part, (happened[0], np.concatenate([happened[1][:own], self._row_slopes]))
                waiting, at, before = None, now, self.states_now()
        except (StepFailure, Interrupted):
            if waiting is not None:
                yield *followed(), None
            raise
        if waiting is not None:
            yield *followed(), None

    def _at_event(self, at: EventInstant) -> Array:
        """Derivatives of the row after an event (columns)."""
        assert self.events is not None
        solved, blocks = self.events.junctions(at, self._S, self._T, self._acts), list[dict[str, Array]]()
        self._xi = self._xi if solved is None else solved
        for j, (m, S, names) in enumerate(zip(self.maps.members, self._S, self.at, strict=True)):
            own, P = self.joined.reach(j)
            assert isinstance(m, MemberMaps)
            i = m.member.instance
            point = Instants(
                *(np.array(v, float)[None, None] for v in (i.time, i.x[: m.nx], i.held_input, i.signal("a_end")))
            )
            told, along = m.at_instant(point, i.parameters, self._acts[names], S, self._T, P @ self._xi[own])
            told[:, names] += along
            first = m.of_step["dissipated"].stop
            found = {n: told[None, s.start - first : s.stop - first] for n, s in m.of_instant.items()}
            means = {"a": found["a_end"], "y_step": found["y_end"]}
            if not self.events.anew(m.member) and self._blocks_now:
                means = {n: self._blocks_now[j][n][-1:] for n in means}
            found |= means | {"x": S[None]}
            sums = {name: sum_[None] for name, sum_ in self._energies[j].items()}
            blocks.append(m.with_sums(found, sums))
        self._blocks_now = blocks
        return self._rows_of(blocks, self._xi[None])[0]

    def _blocks(self, j: int, told: Array, S: Array) -> dict[str, Array]:
        """Blocks of member j: name -> (n x entries x names)."""
        m = self.maps.members[j]
        blocks = {n: told[:, place] for n, place in (m.of_step | m.of_instant).items()} | {"x": S}
        sums = {}
        for name, start in self._energies[j].items():
            sums[name] = start + np.cumsum(blocks.pop(name), axis=0)
            self._energies[j][name] = sums[name][-1]
        return m.with_sums(blocks, sums)

    def _rows_of(self, blocks: list[dict[str, Array]], junctions: Array) -> Array:
        """Rows of derivatives of the columns that are derived."""
        n = len(junctions)
        width = len(self.by.names)
        found = self._row_of(blocks, junctions)[:, self._places].reshape(n, -1)
        return np.hstack([np.vstack([np.zeros((n - 1, width)), self._T]), found]) if self._times else found
