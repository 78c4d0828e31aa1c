"""Members stepped apart with derivatives: beside each column `s` of a run stand columns `d(s)/d(name)`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.derivatives.apart.derived_members import DerivedMembers
from phfmu.derivatives.apart.joint_maps import JointSteps
from phfmu.derivatives.sensitive import slope_units
from phfmu.derivatives.tangents import of_quantities, with_sums
from phfmu.network.couplings.coupled import Coupled
from phfmu.outcome.steps import Steps
from phfmu.signals import SignalKind, derivative_name, of_member

Array = NDArray[np.float64]


class SensitiveMembers(DerivedMembers):
    """Members stepped apart, each row with its derivatives by parameters, held inputs or start values `by`.

    `signals`: which columns are derived (default: all that have derivatives: those of members, means at junctions, sums).
    Errors: those of `DerivedMembers`; ValueError for signals without derivatives.
    """

    def __init__(self, apart: Coupled, by: Sequence[str], signals: Sequence[str] | None = None):
        super().__init__(apart, by)
        self.choose(signals)
        self._S: list[Array] = []
        self._energies: list[dict[str, Array]] = []
        self._row = np.zeros(0)

    def like(self, apart: Coupled) -> SensitiveMembers:
        return SensitiveMembers(apart, self.by.names, self.derived_names)

    def go_on(self, other: Any) -> None:
        super().go_on(other)
        self._S, self._row = other._S, other._row
        self._energies = [dict(sums) for sums in other._energies]

    def choose(self, signals: Sequence[str] | None) -> None:
        """Derives these columns, None: all that have derivatives.  ValueError for those that have none."""
        for n in signals or ():
            self.require_derivable(n)
        self.derived_names = [n for n in self.derivable if signals is None or n in signals]
        self._places = [self.own_names.index(n) for n in self.derived_names]
        self.names = [*self.own_names, *(derivative_name(s, n) for s in self.derived_names for n in self.by.names)]

    @property
    def columns(self) -> list[str]:
        """The signals that are derived, each followed by its derivatives."""
        return [c for s in self.derived_names for c in (s, *(derivative_name(s, n) for n in self.by.names))]

    @property
    def units(self) -> dict[str, str]:
        own = super().units
        given = {
            of_member(m.name, n): v.unit
            for m in self.engines
            for v in (*m.model.declaration.parameters, *m.model.declaration.states)
            for n in v.names()
        }
        return own | slope_units(self.derived_names, self.by.names, own, own | given)

    @property
    def kinds(self) -> dict[str, SignalKind]:
        own = super().kinds
        more: dict[str, SignalKind] = {
            derivative_name(s, n): own[s] for s in self.derived_names if s in own for n in self.by.names
        }
        return own | more

    def read(self) -> Array:
        own = super().read()
        if not self._begun:
            self._S, slopes = self.at_start(own)
            width = len(self.by.names)
            sizes = [(m.member.model.step.nq, m.member.model.step.ncomp) for m in self.maps.members]
            self._energies = [{"energy": np.zeros((q, width)), "dissipated": np.zeros((c, width))} for q, c in sizes]
            self._row = slopes[self._places].ravel()
        return np.concatenate([own, self._row])

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
        self._row = found[-1]
        return replace(steps, signals=np.hstack([steps.signals, found]))

    def _along(self, steps: JointSteps) -> Array:
        """Derivatives of the rows at the ends of steps (n x columns), to which the tangents go on."""
        maps, n, width = self.maps.members, len(steps.z), len(self.by.names)
        acts = [self._acts[at] for at in self.at]
        slopes = self.maps.slopes(steps, acts)
        D = [np.zeros((n, m.nx + m.names + m.reached, width)) for m in maps]
        dz = np.zeros((n, steps.z.shape[1], width))
        for m, d, at in zip(maps, D, self.at, strict=True):
            d[:, m.nx + np.arange(m.names), at] = 1.0
        for i in range(n):
            right = np.zeros(dz.shape[1:])
            for m, d, S, rows, at in zip(maps, D, self._S, slopes.rows, slopes.at, strict=True):
                d[i, : m.nx] = S
                first = m.nx + m.names
                right[at] += rows[i, :, :first] @ d[i, :first]
            dz[i] = slopes.solved(i, right)
            for m, d in zip(maps, D, strict=True):
                d[i, m.nx + m.names :] = dz[i][m.part.col]
            self._S = [own.x[i] @ d[i] for own, d in zip(slopes.members, D, strict=True)]
        told = [own.told @ d for own, d in zip(slopes.members, D, strict=True)]
        self.maps.passed_on(slopes, told, dz)
        states = (own.x @ d for own, d in zip(slopes.members, D, strict=True))
        blocks = [self._blocks(j, own, S) for j, (own, S) in enumerate(zip(told, states, strict=True))]
        junctions = (self.maps.means(steps.parts[0].taken.h) @ dz)[:, : len(self.joined.face.names)]
        return self._rows_of(blocks, junctions)

    def _blocks(self, j: int, told: Array, S: Array) -> dict[str, Array]:
        """Blocks of member j: name -> (n x entries x names)."""
        m = self.maps.members[j]
        blocks = {n: told[:, place] for n, place in (m.of_step | m.of_instant).items()} | {"x": S}
        plan = m.member.model.step
        sums = {}
        for name, start in self._energies[j].items():
            sums[name] = start + np.cumsum(blocks.pop(name), axis=0)
            self._energies[j][name] = sums[name][-1]
        return with_sums(plan, blocks, sums)

    def _rows_of(self, blocks: list[dict[str, Array]], junctions: Array) -> Array:
        """Rows of derivatives of the columns that are derived."""
        n, width = len(junctions), len(self.by.names)
        own = [of_quantities(qs, b, self.by) for qs, b in zip(self._quantities, blocks, strict=True)]
        rest = np.zeros((n, len(self._sums.names), width))
        all_ = np.concatenate([*own, junctions, rest], axis=1)
        rows = np.moveaxis(self._columns.rows(np.moveaxis(all_, 1, 2)), 2, 1)
        return rows[:, self._places].reshape(n, -1)
