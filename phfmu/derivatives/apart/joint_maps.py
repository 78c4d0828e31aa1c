"""The interface of members as linear equations in the derivatives of a step.

With z = (values at nodes | impulses m | m'), the rows of a step and their derivatives are

    r_i = P^T (R* Y)_i + C z_i,      r_e = P_b^T y1,      r_T = m' - (-1)^k T m,
    (dr/dz) dz = -(dr/dx dx + dr/dtheta dtheta),

T m = 1/n sum_l (cos^2 t_l S1 + sin^2 t_l S0)^-1 S0 m with its derivatives by S0 and S1, which follow the states of all members.
Source: implicit function theorem; `network/couplings/newton.py` for the rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.derivatives.apart.member_maps import MemberMaps, StepDerivatives
from phfmu.derivatives.apart.unit_maps import UnitMaps
from phfmu.network.couplings.compiled.master_pattern import ExchangeTables
from phfmu.network.interface.coupled_members import CoupledMembers
from phfmu.schemes.constraints.impulses import POINTS

Array = NDArray[np.float64]

#: members stepped by engines, and units
AnyMaps = MemberMaps | UnitMaps
#: cos^2 of the angles of the rule for T
COSINES = np.cos((2 * np.arange(1, POINTS + 1) - 1) * np.pi / (4 * POINTS)) ** 2
#: steps that are linearised at a time, and numbers of their matrices, at most
STEPS, ROOM = 256, 8_000_000


@dataclass(frozen=True)
class JointSteps:
    """Steps of all members: `parts` of each (`MemberSteps` or `UnitSteps`), unknowns z of the interface (n x unknowns), and where
    members step in turn the `instants` at which each is asked for its outputs."""

    parts: list[Any]
    z: Array
    instants: tuple[Any, ...] = ()

    @property
    def h(self) -> Array:
        """Lengths (n)."""
        return self.parts[0].h

    def some(self, which: slice) -> JointSteps:
        """Some of them."""
        return JointSteps(
            [p.some(which) for p in self.parts], self.z[which], tuple(i.some(which) for i in self.instants)
        )

    @staticmethod
    def joined(steps: Sequence[JointSteps]) -> JointSteps:
        parts = [own[0].joined(list(own)) for own in zip(*(s.parts for s in steps), strict=True)]
        instants = (own[0].joined(list(own)) for own in zip(*(s.instants for s in steps), strict=True))
        return JointSteps(parts, np.concatenate([s.z for s in steps]), tuple(instants))


@dataclass(frozen=True)
class JointSlopes:
    """Derivatives of steps: `members` by [x0 | names | unknowns that reach it] of each; `rows` of each (n x rows x the same),
    which stand in the rows `at` of the interface; `matrix` (n x unknowns x unknowns) is dr/dz, with nothing above its diagonal
    `blocks`."""

    members: list[StepDerivatives]
    rows: list[Array]
    at: list[NDArray[np.intp]]
    matrix: Array
    blocks: list[slice]

    def solved(self, i: int, right: Array, transposed: bool = False) -> Array:
        """-(dr/dz)^-1 right, or with the transposed matrix, of step i."""
        A = self.matrix[i].T if transposed else self.matrix[i]
        found, done = np.zeros_like(right), np.zeros(len(A), bool)
        for b in reversed(self.blocks) if transposed else self.blocks:
            found[b] = -_solved(A[b, b], right[b] + A[b, done] @ found[done], transposed)
            done[b] = True
        return found


def _solved(A: Array, right: Array, by_columns: bool) -> Array:
    """A^-1 right with one step of refinement, the rows (columns) of A scaled."""
    if not len(A):
        return np.zeros_like(right)
    scale = 1.0 / np.maximum(np.abs(A).max(axis=0 if by_columns else 1), 1e-300)
    scaled = A * scale if by_columns else A * scale[:, None]
    right = right if by_columns else right * scale[:, None]
    found = np.linalg.solve(scaled, right)
    found += np.linalg.solve(scaled, right - scaled @ found)
    return scale[:, None] * found if by_columns else found


def at_once(unknowns: int) -> int:
    """Number of steps with so many unknowns of the interface that are linearised at a time."""
    return min(STEPS, max(1, ROOM // max(unknowns, 1) ** 2))


class JointMaps:
    """Members with the equations of the interface."""

    #: whether members step one after the other, so that the states before a step are needed to look at it again
    in_turn = False

    def __init__(self, exchanged: ExchangeTables, members: Sequence[AnyMaps]):
        self.exchanged, self.members = exchanged, list(members)
        e, N = exchanged, exchanged.size
        self.at_once = at_once(N)
        self._C = np.zeros((N, N))
        np.add.at(self._C, (e.skew_row, e.skew_col), e.skew)
        self._start = slice(e.nodes, e.nodes + len(e.bare))
        self._end = slice(self._start.stop, N)
        #: impulses of each member by the bare columns (kicks x bare)
        self._to = [self._whole(m, m.kicks[0])[:, self._start] for m in members]
        #: means of the columns by the unknowns, of impulses for a step of length 1 (columns x unknowns each)
        self._means, self._thrown = np.zeros((2, e.columns, N))
        self._means[e.column, np.arange(e.nodes)] = e.weights
        for side in (self._start, self._end):
            self._thrown[e.bare, np.arange(side.start, side.stop)] = 1.0

    def unknowns(
        self, z: Array, joined: CoupledMembers, before: list[Any], given: list[Array], t: float
    ) -> tuple[Array, tuple[Any, ...]]:
        """The unknowns of the step from t that was taken last: what the master has left."""
        return z.copy(), ()

    # -- signals at the ends of steps --------------------------------------------------------------------------------------

    def passed_on(self, slopes: JointSlopes, told: list[Array], z: Array) -> None:
        """Adds to tangents of what is `told` (n x told x names) what follows from signals, which are passed on one after the
        other at the ends of steps (`couplings/runtime/present.c`); z: tangents of the unknowns (n x unknowns x names)."""
        now = {w: m.polynomial[i] @ z[:, m.part.col] for w, m, i in self._wired()}
        for w, (source, output, _, _) in enumerate(self.exchanged.wires.tolist()):
            m, own = self.members[source], slopes.members[source]
            row = m.of_instant["y_end"].start + output
            y = told[source][:, row].copy()
            for other, i in self._into(source):
                y += own.passed[:, row, i, None] * now[other]
            now[w] = self.exchanged.factors[w] * y
        for j, own in enumerate(slopes.members):
            for w, i in self._into(j):
                told[j] += own.passed[:, :, i, None] * now[w][:, None]

    def passed_back(self, slopes: JointSlopes, told: list[Array], z: Array) -> None:
        """The same of bars: those of what is told (n x told x measures) go on to members that gave signals, and to the
        unknowns."""
        now = {w: np.zeros_like(z[:, 0]) for w in range(len(self.exchanged.wires))}
        for j, own in enumerate(slopes.members):
            for w, i in self._into(j):
                now[w] += np.einsum("no,not->nt", own.passed[:, :, i], told[j])
        for w, (source, output, _, _) in reversed(list(enumerate(self.exchanged.wires.tolist()))):
            m, own = self.members[source], slopes.members[source]
            row, y = m.of_instant["y_end"].start + output, self.exchanged.factors[w] * now[w]
            now[w] = np.zeros_like(y)
            told[source][:, row] += y
            for other, i in self._into(source):
                now[other] = now[other] + own.passed[:, row, i, None] * y
        for w, m, i in self._wired():
            z[:, m.part.col] += m.polynomial[i][:, None] * now[w][:, None]

    def _into(self, member: int) -> list[tuple[int, int]]:
        """Signals that a member takes, and their places among those."""
        m, wires = self.members[member], self.exchanged.wires.tolist()
        return [(w, m.wired.index(i)) for w, (_, _, target, i) in enumerate(wires) if target == member]

    def _wired(self) -> list[tuple[int, AnyMaps, int]]:
        return [(w, m, i) for j, m in enumerate(self.members) for w, i in self._into(j)]

    def means(self, h: Array) -> Array:
        """Means of the columns over steps of lengths h (n) by the unknowns (n x columns x unknowns)."""
        return self._means + self._thrown / h[:, None, None]

    def _whole(self, m: AnyMaps, rows: Array) -> Array:
        found = np.zeros((len(rows), self.exchanged.size))
        found[:, m.part.col] = rows
        return found

    def slopes(self, steps: JointSteps, acts: Sequence[Array]) -> JointSlopes:
        """Derivatives of steps; `acts`: 1 of the names of each member that still act."""
        n, nb = len(steps.z), len(self.exchanged.bare)
        T, roots, v = self._pairs(steps)
        found = [
            m.at(own, np.einsum("kb,nsvb->nsvk", to, v), act)
            for m, own, to, act in zip(self.members, steps.parts, self._to, acts, strict=True)
        ]
        matrix, rows, at = np.tile(self._C, (n, 1, 1)), list[Array](), list[NDArray[np.intp]]()
        if nb:
            matrix[:, self._end, self._end] += np.eye(nb)
            matrix[:, self._end, self._start] -= T
        for m, own, to in zip(self.members, found, self._to, strict=True):
            mine, place = m.left @ own.outputs, np.asarray(m.part.row, np.intp)
            if nb and m.part.kicks:
                law = np.einsum("kb,nvkc->nvbc", to, own.before), np.einsum("kb,nvkc->nvbc", to, own.after)
                mine = np.concatenate([mine, -self._law(roots, *law)], axis=1)
                place = np.concatenate([place, np.arange(self._end.start, self._end.stop)])
            rows.append(mine)
            at.append(place)
            first = m.given
            for i in range(n):
                matrix[i][np.ix_(place, m.part.col)] += mine[i, :, first:]
        return JointSlopes(found, rows, at, matrix, [slice(0, matrix.shape[1])])

    def _pairs(self, steps: JointSteps) -> tuple[Array, Array, Array]:
        """sign T (n x bare x bare), sign (cos^2 S1 + sin^2 S0)^-1 / POINTS (n x POINTS x bare x bare), and the vectors that S0
        and S1 are derived along (n x 2 x 1 + POINTS x bare)."""
        n, nb = len(steps.z), len(self.exchanged.bare)
        S = np.zeros((2, n, nb, nb))
        for m, own, to in zip(self.members, steps.parts, self._to, strict=True):
            if m.part.kicks and nb:
                for side, own_jump in enumerate(m.jumps(own)):
                    S[side] += to.T @ own_jump @ to
        v = np.zeros((n, 2, 1 + POINTS, nb))
        if not nb:
            return np.zeros((n, 0, 0)), np.zeros((n, POINTS, 0, 0)), v
        c, impulse = COSINES[:, None, None], steps.z[:, self._start]
        roots = np.linalg.inv(c * S[1][:, None] + (1.0 - c) * S[0][:, None])
        v[:, 0, 0] = impulse
        moved = np.einsum("nlij,njk,nk->nli", roots, S[0], impulse)
        v[:, 0, 1:], v[:, 1, 1:] = -(1.0 - COSINES)[:, None] * moved, -COSINES[:, None] * moved
        roots = roots * self.exchanged.signs[:, None] / POINTS
        return roots.sum(axis=1) @ S[0], roots, v

    def _law(self, roots: Array, before: Array, after: Array) -> Array:
        """Derivatives of (-1)^k T m by what S0 and S1 follow: sum_l A_l^-1 (dS0 m - (cos^2 dS1 + sin^2 dS0) q_l)."""
        return np.einsum("nlij,nljc->nic", roots, before[:, :1] + before[:, 1:] + after[:, 1:])
