"""The start of members of which some are units, so that no model of the whole has it: its derivatives, and those of its row.

At the instant junction unknowns xi are what makes P^T y(x, P xi + U_free) + C xi = 0, so that

    (P^T G P + C) dxi = -P^T (y_x dx + y_theta dtheta),     G = dy/du.

Where sums of outputs follow states alone (flows of inductors at a node), no unknown can answer them: they have to stay zero.
Source: `network/interface/junction_values.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from phfmu.derivatives.apart.joint_maps import AnyMaps
from phfmu.derivatives.apart.member_maps import MemberMaps
from phfmu.derivatives.by import IndependentVariables, start_tangents_by
from phfmu.network.interface.coupled_members import CoupledMembers
from phfmu.network.interface.junction_values import CONSISTENT, JunctionValues

Array = NDArray[np.float64]


class ApartStart:
    """Members with their names among those of the whole (`at`)."""

    def __init__(
        self,
        joined: CoupledMembers,
        sums: JunctionValues,
        members: Sequence[AnyMaps],
        at: Sequence[list[int]],
        by: IndependentVariables,
    ):
        self.joined, self.sums, self.members, self.at, self.by = joined, sums, members, at, by

    def slopes(
        self, given: Sequence[Array], xi: Array, rows: Callable[[list[dict[str, Array]], Array], Array]
    ) -> tuple[list[Array], Array]:
        """Tangents (nx x names) of the states of members, `given` before a projection, and of the row of the start (columns x
        names), which `rows` makes of blocks and junctions.

        Errors: ValueError for a name that moves the start off its constraints, or a unit whose start was projected.
        """
        width = len(self.by.names)
        S = [self._tangents(m, at, x) for m, at, x in zip(self.members, self.at, given, strict=True)]
        found = [m.now() for m in self.members]
        told = [
            self._by_names(m, D, own, at) for m, (D, _), own, at in zip(self.members, found, S, self.at, strict=True)
        ]
        y = [self._by_names(m, D, own, at) for m, (_, D), own, at in zip(self.members, found, S, self.at, strict=True)]
        self._require_constraints(told)
        self.sums.values(xi)
        dxi = self._junctions(np.concatenate([*y, np.zeros((0, width))]), xi)
        blocks = list[dict[str, Array]]()
        for j, (m, (D, _), own, x) in enumerate(zip(self.members, found, told, S, strict=True)):
            reached, P = self.joined.reach(j)
            along = own + _product(D[:, m.nx + m.names :] @ P, dxi[reached])
            first = m.of_step["dissipated"].stop
            block = {n: along[None, s.start - first : s.stop - first] for n, s in m.of_instant.items()} | {"x": x[None]}
            block |= m.as_means(block)
            blocks.append(m.with_sums(block, {n: s[None] for n, s in m.sums(width).items()}))
        return S, rows(blocks, dxi[None])[0]

    def _tangents(self, m: AnyMaps, at: list[int], given: Array) -> Array:
        """Tangents of the states of a member (nx x names)."""
        own, S = np.zeros((m.nx, m.names)), np.zeros((m.nx, len(self.by.names)))
        if isinstance(m, MemberMaps):
            i = m.member.instance
            own = start_tangents_by(m.member.model, m.by, given, m.state(), i.parameters, float(i.time))
        else:
            for state, column in m.by.starts:
                own[state, column] = 1.0
            if not np.array_equal(given, m.state()):
                raise ValueError(
                    f"the start of the unit '{m.member.name}' was projected, through which there are no derivatives; give start "
                    "values that are consistent"
                )
        S[:, at] = own
        return S

    def _by_names(self, m: AnyMaps, D: Array, S: Array, at: list[int]) -> Array:
        """Derivatives by states and names, by the names of the whole."""
        found = D[:, : m.nx] @ S
        found[:, at] += D[:, m.nx : m.nx + m.names]
        return found

    def _require_constraints(self, told: Sequence[Array]) -> None:
        """ValueError for a name that moves a unit off its hidden constraints."""
        for m, own in zip(self.members, told, strict=True):
            if isinstance(m, MemberMaps):
                continue
            for i in m.constraints:
                off = np.flatnonzero(np.abs(own[i]) > CONSISTENT * np.abs(own).max(axis=0))
                if off.size:
                    self._refuse(int(off[0]), f"'{m.told_now[i]}' of the unit '{m.member.name}'")

    def _refuse(self, name: int, what: str) -> None:
        raise ValueError(
            f"{self.joined.network.name}: with {self.by.names[name]} the start leaves {what}, and a start beside units is not "
            "projected; leave the name out, or take declarations as members"
        )

    def _junctions(self, y: Array, xi: Array) -> Array:
        """Derivatives of junction unknowns (n x names) from those of outputs under fixed ones; NaN where they are not those of
        the instant."""
        face = self.joined.face
        if not len(face.names):
            return np.zeros((0, y.shape[1]))
        r = face.P.T @ y
        if not self.sums.hide:
            M = self.joined.instant_matrix(xi)
            return -np.linalg.solve(M.toarray() if hasattr(M, "toarray") else M, r)
        left, size = self.sums.left(r), np.abs(face.P.T) @ np.abs(y)
        off = np.flatnonzero((np.abs(left) > CONSISTENT * np.maximum(size.max(axis=0), 1e-300)).any(axis=0))
        if off.size:
            self._refuse(int(off[0]), "sums of outputs at junctions that no unknown answers")
        return np.full((len(face.names), y.shape[1]), np.nan)


def _product(A: Array, b: Array) -> Array:
    """A b, where what is not known (NaN) does not count if its entry of A is zero."""
    found = np.zeros((len(A), b.shape[1]))
    for j in range(len(b)):
        on = A[:, j] != 0.0
        found[on] += np.outer(A[on, j], b[j])
    return found
