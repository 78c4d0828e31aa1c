"""Members that step one after the other, as linear equations in the derivatives of a step.

Before group g of members steps, the unknowns xi_g of the junctions are those of the instant (`network/interface/instant.py`), at
which members that have stepped are at the end of the step and the others at its start:

    r_g = P^T y(x_g, P xi_g + U_free) + C xi_g = 0,      x_g = x1_m(x0_m, xi_g(m)) where g > g(m), else x0_m.

With z = (xi_0 | xi_1 | ..) the matrix dr/dz has nothing above its diagonal blocks P^T G P + C, G = dy/dU at the instant, so that
tangents go through the groups in their order, and bars back through them.  Members hold what they take over the step.
Source: implicit function theorem; `network/couplings/runtime/in_turn.c` for the steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.derivatives.apart.joint_maps import AnyMaps, JointSlopes, JointSteps, at_once
from phfmu.derivatives.apart.member_maps import MemberMaps
from phfmu.derivatives.by import IndependentVariables
from phfmu.network.couplings.compiled.master_pattern import ExchangeTables, ShareTables
from phfmu.network.interface.coupled_members import CoupledMembers
from phfmu.network.interface.instant import InstantSolver
from phfmu.network.members.member import Member

Array = NDArray[np.float64]


class InTurnMaps:
    """Members, each with its part in the interface and the names that it is derived by; `groups`: places of those that step at
    once, in the order in which they step; `made`: makes the maps of each."""

    in_turn = True

    def __init__(
        self,
        exchanged: ExchangeTables,
        members: Sequence[tuple[Member, ShareTables, IndependentVariables]],
        groups: list[list[int]],
        made: Callable[[Member, ShareTables, IndependentVariables], AnyMaps],
    ):
        self._groups, self._n, self._instant = groups, exchanged.nodes, InstantSolver()
        #: by member, the number of its group
        self._group = np.argsort(np.concatenate([np.array(g, int) for g in groups]), kind="stable")
        for number, own in enumerate(groups):
            self._group[own] = number
        n, size = self._n, self._n * len(groups)
        self.at_once = at_once(size)
        self.members = [
            made(m, replace(part, col=part.col + n * self._group[i]), by) for i, (m, part, by) in enumerate(members)
        ]
        self._C = np.zeros((n, n))
        np.add.at(self._C, (exchanged.skew_row, exchanged.skew_col), exchanged.skew)
        self._blocks = [slice(g * n, (g + 1) * n) for g in range(len(groups))]
        #: columns of junctions by the unknowns: what the last group that takes them has taken
        self._means = np.zeros((n, size))
        for g, own in enumerate(groups):
            taken = np.unique(np.concatenate([np.zeros(0, int), *(members[i][1].col for i in own)]))
            self._means[taken] = 0.0
            self._means[taken, g * n + taken] = 1.0

    def unknowns(
        self, z: Array, joined: CoupledMembers, before: list[Any], given: list[Array], t: float
    ) -> tuple[Array, tuple[Any, ...]]:
        """The unknowns of the step from t that was taken last, and where members were asked for their outputs, by looking at its
        instants again; before: states of the members at t; given: their inputs from outside; z: where to start from."""
        after, free, xi = joined.states(), joined.free.copy(), z.copy()
        points: list[list[Any]] = [[] for _ in self.members]
        found = list[Array]()
        try:
            for place, own in zip(joined.places, given, strict=True):
                joined.free[place] = own
            joined.restore(before)
            for own in self._groups:
                xi = self._instant.solve(joined, xi, t)
                found.append(xi)
                for m, to in zip(self.members, points, strict=True):
                    to.append(m.looked())
                for i in own:
                    joined.members[i].set_state(after[i])
        finally:
            joined.free[:] = free
            joined.restore(after)
            for m in self.members:
                if isinstance(m, MemberMaps):
                    m.member.took(m.member.instance.held_input)
        return np.concatenate(found), tuple(m.looks(own) for m, own in zip(self.members, points, strict=True))

    def means(self, h: Array) -> Array:
        """Means of the columns over steps of lengths h (n) by the unknowns (n x columns x unknowns)."""
        return np.tile(self._means, (len(h), 1, 1))

    def passed_on(self, slopes: JointSlopes, told: list[Array], z: Array) -> None:
        """Nothing: no signals are exchanged within these steps."""

    def passed_back(self, slopes: JointSlopes, told: list[Array], z: Array) -> None:
        """Nothing: no signals are exchanged within these steps."""

    def slopes(self, steps: JointSteps, acts: Sequence[Array]) -> JointSlopes:
        """Derivatives of steps; `acts`: 1 of the names of each member that still act."""
        n, N, count = len(steps.z), self._n, len(self._groups)
        found = [
            m.at(own, np.zeros((n, 2, 1, 0)), act) for m, own, act in zip(self.members, steps.parts, acts, strict=True)
        ]
        matrix, rows, at = np.zeros((n, N * count, N * count)), list[Array](), list[NDArray[np.intp]]()
        for b in self._blocks:
            matrix[:, b, b] = self._C
        for i, (m, own, act) in enumerate(zip(self.members, found, acts, strict=True)):
            nx, first, mine = m.nx, m.given, int(self._group[i])
            outputs = m.presented(steps.instants[i], steps.parts[i], act)
            asked = np.einsum("ro,ngoc->ngrc", m.left[:, : m.part.nu], outputs)
            by = asked[..., :first].copy()
            own_columns = m.part.col - N * mine
            for g in range(count):
                place = m.part.row + N * g
                matrix[:, place[:, None], own_columns + N * g] += asked[:, g, :, first:]
                if g > mine:
                    by[:, g, :, :nx] = 0.0
                    moved = asked[:, g, :, :nx] @ own.x
                    by[:, g] += moved[..., :first]
                    matrix[:, place[:, None], m.part.col] += moved[..., first:]
            rows.append(by.reshape(n, count * len(m.part.row), first))
            at.append((m.part.row + N * np.arange(count)[:, None]).ravel())
        return JointSlopes(found, rows, at, matrix, self._blocks)
