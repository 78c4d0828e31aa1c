"""Junctions at the present time: their unknowns, what the states of members violate there, and starts that do.

With xi as it was when the outputs y were read, the rows r = P^T y + C xi are parted: what xi can change of them it answers,

    xi_end = xi - M^+ r,     M = P^T G P + C,     G = dy/dU at one instant,

and what it cannot, Q r, is left by the states: the sums of their flows at nodes of inductors, the spread of joined velocities.
There xi stays, on its polynomial over the step: what composed models solve for is a rate, which members apart do not tell.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array

from phfmu.declare.junction_words import spread_words
from phfmu.network.interface.coupled_members import CoupledMembers
from phfmu.network.interface.hidden import RankDecomposition, rank_decomposition
from phfmu.network.interface.matrices import DENSE
from phfmu.network.junction import Junction
from phfmu.network.members.consistent import MONOLITHIC, inconsistent
from phfmu.signals import check_name, end_name
from phfmu.terms.hidden import Level

Array = NDArray[np.float64]

CONSISTENT = 1e-7  # a sum below this part of the largest output it is made of, and of
UNIT = 1e-6  # this where all of them are zero


class JunctionValues:
    """Columns of the present time, as in composed models: `end_names` of the junction unknowns, `checks` of what is hidden.

    A check is a sum of joined flows (efforts) or, where outputs must be equal, the difference of one of them from the first.
    """

    def __init__(self, joined: CoupledMembers):
        self.joined = joined
        face = joined.face
        self._rows = face.rows_of_sums()
        self._starts = np.cumsum([0, *map(len, self._rows)])[:-1]
        self._single = np.array([len(own) == 1 for own in self._rows], bool)
        self._gathered = np.concatenate([*self._rows, np.zeros(0, int)]).astype(int)
        self._matrix: Any = None
        self._maps: tuple[Any, Any, Any] | None = None
        self._decomposition: RankDecomposition | None = None
        self.find(face.start)
        self.end_names = [end_name(n) for n in face.names]
        self._checked, self._against = self._hidden_rows()
        self.checks = [check_name(Level.VELOCITY, face.names[i]) for i in self._checked]
        self.names = [*self.end_names, *self.checks]

    @property
    def units(self) -> dict[str, str]:
        """Units of the names; checks have that of composed models."""
        own = self.joined.units
        return {end_name(n): own[n] for n in self.joined.face.names} | dict.fromkeys(self.checks, "1")

    def _hidden_rows(self) -> tuple[list[int], list[int]]:
        """Rows that no junction unknown changes, and the row that each is told against (itself: none).

        Of outputs that must be equal the first gives the common variable.
        """
        assert self._decomposition is not None
        hidden = self._decomposition.hidden.diagonal() > UNIT
        rows, against = list[int](), list[int]()
        for common, own in zip(self.joined.face.commons(), self._rows, strict=True):
            there = [int(i) for i in own if hidden[i]]
            rows += there if own[0] == common else there[1:]
            against += there if own[0] == common else [there[0]] * len(there[1:]) if there else []
        return rows, against

    def forget(self) -> None:
        """After parameters or inputs were set: outputs may follow other unknowns."""
        self._matrix = self._maps = self._decomposition = None

    def get_state(self) -> tuple[Array, Array, Array] | None:
        """Rows, columns and entries of M that the columns are made with, of the time when it was asked for; None: of none."""
        if self._matrix is None:
            return None
        entries: Any = coo_array(self._matrix)
        return entries.row, entries.col, entries.data

    def set_state(self, state: tuple[Array, Array, Array] | None) -> None:
        """Goes on with the M of `get_state`."""
        self.forget()
        if state is not None:
            row, column, values = state
            self._part(coo_array((values, (row, column)), shape=self.joined.face.C.shape))

    def values(self, xi: Array) -> Array:
        """The columns, with the junction unknowns xi as inputs."""
        self.find(xi)
        return self.of_rows(xi[None], self.joined.end_outputs()[None])[0]

    @property
    def hide(self) -> bool:
        """Whether there are sums that no junction unknown changes at an instant, once `values` was asked for."""
        return self._maps is not None and bool(len(self._rows)) and float(abs(self._maps[2]).max()) > UNIT

    @property
    def held_outputs(self) -> NDArray[np.bool_]:
        """The outputs (nu) in rows that no junction unknown changes at an instant, once `values` was asked for."""
        assert self._maps is not None
        P, _, Q = self._maps
        return np.asarray(abs(P @ Q).sum(axis=1)).ravel() > UNIT

    def of_rows(self, xi: Array, y: Array) -> Array:
        """The columns (steps x names) with junction unknowns xi and outputs y under them at ends, a row a step."""
        assert self._maps is not None and self._decomposition is not None
        P, C, Q = self._maps
        r = _by_row(y, P) + _by_row(xi, C)
        ends = xi + self._decomposition.answer(r)
        if not self._checked:
            return ends
        left, against = _by_row(r, Q), [i if i != j else -1 for i, j in zip(self._against, self._checked, strict=True)]
        base = np.where(np.array(against) < 0, 0.0, left[:, against])
        return np.hstack([ends, left[:, self._checked] - base])

    def left(self, rows: Array) -> Array:
        """Part of rows (n x any) that no junction unknown can change, once `values` was asked for."""
        assert self._maps is not None
        return np.asarray(rows.T @ self._maps[2]).T

    def _sums(self, xi: Array) -> Array:
        """Per common variable the sum or spread now."""
        assert self._maps is not None
        P, C, Q = self._maps
        r = (self.joined.end_outputs() @ P + xi @ C) @ Q
        if not len(self._rows):
            return np.zeros(0)
        r = r[self._gathered]
        spread = np.maximum.reduceat(r, self._starts) - np.minimum.reduceat(r, self._starts)
        return np.where(self._single, r[self._starts], spread)

    def require_zero(self, xi: Array) -> None:
        """InconsistentState if joined flows (efforts) of states do not sum to zero."""
        face, network = self.joined.face, self.joined.network
        self.find(xi)
        sums = self._sums(xi)
        size = face.summed(np.abs(self.joined.end_outputs()))
        bad = []
        at = [j for j in network.junctions for _ in range(network.port_of(j.ends[0]).n)]
        rows = zip(at, face.commons(), face.sum_names(), sums, self._rows, strict=True)
        for j, common, n, v, own in rows:
            if not abs(v) <= CONSISTENT * (size[own].max() + UNIT):
                pure = own[0] == common
                bad.append(f"{n}: sum {v:.6g}" if pure else f"{n}: {self._differ(j, v)}")
        if bad:
            instead = f", or {MONOLITHIC}" if network.composable else ""
            rule = "joined flows of states must sum to zero and joined outputs must be equal at the start"
            raise inconsistent(network.name, bad, f"{rule}: change the start values{instead}")

    def find(self, xi: Array) -> None:
        """P, C^T, Q^T and what is parted, where they are not known; sparse where there are many."""
        if self._maps is None:
            self._part(self.joined.instant_matrix(xi))

    def _part(self, M: Any) -> None:
        face, self._matrix = self.joined.face, M
        self._decomposition = rank_decomposition(M, face.nominal)
        maps = face.P, face.C.T, self._decomposition.hidden.T
        few = len(face.names) <= DENSE
        self._maps = tuple(m.toarray() for m in maps) if few else tuple(map(csr_array, maps))  # pyright: ignore

    def _differ(self, junction: Junction, value: float) -> str:
        ports = junction.ports(self.joined.network.members)
        givers = {str(e): p for e, p in ports.items() if p.given != junction.shared}
        return spread_words(next(iter(givers.values())), tuple(givers), value)


def _by_row(rows: Array, M: Any) -> Array:
    """rows @ M, each row by itself: BLAS rounds products of several rows in an order of its own, and rows come in blocks of any
    length."""
    return (rows[:, None] @ M)[:, 0] if isinstance(M, np.ndarray) else rows @ M
