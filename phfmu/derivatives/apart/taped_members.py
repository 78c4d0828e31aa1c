"""Members stepped apart whose run is kept to go back over: the transposed equations of the interface, step by step.

With bars xi of the states after a step and of what is told of it, the matrix dr/dz and J of each member's step,

    b = sum_m J_m^T (xi_m, bar told_m),      (dr/dz)^T mu = -b_z,      bar (x0, theta)_m = b_m + (dr/d(x0, theta))^T mu,

at a cost for each measure, whatever the number of names.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.derivatives.apart.derived_members import DerivedMembers
from phfmu.derivatives.apart.in_turn_maps import InTurnMaps
from phfmu.derivatives.apart.joint_maps import AnyMaps, JointMaps, JointSteps
from phfmu.derivatives.apart.member_maps import MemberMaps
from phfmu.derivatives.by import require_known
from phfmu.network.couplings.coupled import Coupled
from phfmu.outcome.steps import Steps
from phfmu.signals import Quantity

Array = NDArray[np.float64]


@dataclass(frozen=True)
class _Segment:
    """Steps under the same values, rows from `first` on; acts: 1 of the names that followed the start in them.

    maps: of the members under the scheme that took them
    """

    maps: JointMaps | InTurnMaps
    steps: JointSteps
    first: int
    acts: Array


@dataclass(frozen=True)
class _Bars:
    """Bars of what a member tells of steps, and of its states at their ends (rows x .. x measures)."""

    told: Array
    x: Array

    def add(self, m: AnyMaps, q: Quantity, c: Array) -> None:
        """Weights c (rows x measures) of a quantity of a member; sums since the start follow all rows before."""
        entries = np.arange(q.first, q.first + q.count)
        if q.block == "x":
            self.x[:, entries] += c[:, None]
        elif q.block == "supplied":
            assert isinstance(m, MemberMaps)
            pairs = np.flatnonzero(np.isin(m.member.model.step.pair_owner, entries))
            self.told[:, m.of_step["energy"].start + pairs] += _behind(c)[:, None]
        elif q.block in ("energy", "dissipated"):
            self.told[:, m.of_step[q.block].start + entries] += _behind(c)[:, None]
        elif q.block in m.of_step or q.block in m.of_instant:
            place = m.of_step.get(q.block) or m.of_instant[q.block]
            self.told[:, place.start + entries] += c[:, None]


def _behind(c: Array) -> Array:
    """Sums of weights (rows x measures) from each row on."""
    return np.cumsum(c[::-1], axis=0)[::-1]


class TapedMembers(DerivedMembers):
    """Members stepped apart that `slopes` goes back over, for measures of a run that was made with it.

    Kept are the states, unknowns and inputs of all steps.  Errors: those of `DerivedMembers`.
    """

    def __init__(self, apart: Coupled, by: Sequence[str], signals: Sequence[str] = ()):
        super().__init__(apart, by)
        for name in signals:
            self.require_derivable(name)

    def like(self, apart: Coupled) -> TapedMembers:
        return TapedMembers(apart, self.by.names)

    def go_on(self, other: Any) -> None:
        super().go_on(other)
        self._stretches, self._count = list(other._stretches), other._count

    def forget(self) -> None:
        super().forget()
        self._stretches, self._count = list[_Segment](), 1  #: and rows of the run

    def read(self) -> Array:
        row = super().read()
        if not self._begun:
            self._start = self.at_start(row)
        return row

    def advance(self, t0: float, h: float, n: int, first: int = 0) -> Steps:
        parts, kept, failure = self.kept_steps(t0, h, n, first)
        if failure is not None:
            failure.recorded = {"steps": Steps.joined(parts)} if parts else {}
            raise failure
        self._stretches.append(_Segment(self.maps, JointSteps.joined(kept), self._count, self._acts.copy()))
        self._count += n
        return Steps.joined(parts)

    # -- back ------------------------------------------------------------------------------------------------------------

    def slopes(self, weights: Sequence[dict[str, Array]]) -> Array:
        """Derivatives (measures x names) of measures of the run, from their `weights` by signal and row (rows)."""
        bars = self._bars(weights)
        total, width = len(weights), len(self.by.names)
        xi = [np.zeros((m.nx, total)) for m in self.maps.members]
        found = np.zeros((width, total))
        for s in reversed(self._stretches):
            n = len(s.steps.z)
            for start in reversed(range(0, n, s.maps.at_once)):
                some = slice(start, min(start + s.maps.at_once, n))
                part = replace(s, steps=s.steps.some(some), first=s.first + start)
                self._over(part, bars, xi, found)
        S, slopes = self._start
        for own, bar in zip(S, xi, strict=True):
            found += own.T @ bar
        for m, own in enumerate(weights):
            for name, c in own.items():
                if name in self.own_names and c[0]:
                    own_slopes = slopes[self.own_names.index(name)]
                    require_known(own_slopes, name)
                    found[:, m] += c[0] * own_slopes
        return found.T

    def _over(self, s: _Segment, bars: list[_Bars], xi: list[Array], found: Array) -> None:
        """Back over steps: the bars xi of the states, and of the names."""
        maps, first, n = s.maps.members, s.first, len(s.steps.z)
        slopes = s.maps.slopes(s.steps, [s.acts[at] for at in self.at])
        rows = slice(first, first + n)
        junctions, means = bars[-1].told[rows], s.maps.means(s.steps.h)
        z = np.einsum("ncz,nct->nzt", means[:, : junctions.shape[1]], junctions)
        given = [b.told[rows].copy() for b in bars[:-1]]
        s.maps.passed_back(slopes, given, z)
        told = [np.einsum("noc,not->nct", own.told, b) for own, b in zip(slopes.members, given, strict=True)]
        for i in reversed(range(n)):
            back = list[Array]()
            for m, own, D, b, bar in zip(maps, slopes.members, told, bars[:-1], xi, strict=True):
                back.append(D[i] + own.x[i].T @ (bar + b.x[first + i]))
                z[i][m.part.col] += back[-1][m.given :]
            mu = slopes.solved(i, z[i], transposed=True)
            for j, m in enumerate(maps):
                stop = m.given
                bar = back[j][:stop] + slopes.rows[j][i][:, :stop].T @ mu[slopes.at[j]]
                xi[j][:] = bar[: m.nx]
                found[self.at[j]] += bar[m.nx :]

    def _bars(self, weights: Sequence[dict[str, Array]]) -> list[_Bars]:
        """Bars of what members tell, and behind them of the junctions (rows x columns x measures)."""
        total, rows = len(weights), self._count
        tell = self._columns.rows(np.eye(self.width))
        by_column = dict[int, Array]()
        for t, own in enumerate(weights):
            for name, c in own.items():
                if name not in self.own_names:
                    continue
                of = tell[:, self.own_names.index(name)]
                for i in np.flatnonzero(of).tolist():
                    by_column.setdefault(i, np.zeros((rows, total)))[:, t] += of[i] * c
        found, at = list[_Bars](), 0
        for m, known in zip(self.maps.members, self._quantities, strict=True):
            bars = _Bars(np.zeros((rows, m.told, total)), np.zeros((rows, m.nx, total)))
            for i, q in enumerate(known):
                if at + i in by_column:
                    bars.add(m, q, by_column[at + i])
            found.append(bars)
            at += len(known)
        names = self.joined.face.names
        junctions = np.zeros((rows, len(names), total))
        for i in range(len(names)):
            junctions[:, i] = by_column.get(at + i, 0.0)
        return [*found, _Bars(junctions, np.zeros((rows, 0, total)))]
