"""The interface equations of a network in the stacked inputs and outputs of its members."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from phfmu.network.junction import End, junction_unknowns
from phfmu.network.network import Network

Array = NDArray[Any]
Ints = NDArray[np.intp]


@dataclass(frozen=True)
class Interface:
    """xi names and units, which of them feeds each input, C (skew), and which rows sum flows or efforts (Kirchhoff rows).

    column:  of each of the nu inputs the unknown that feeds it, -1: none;  C:  n x n, sparse
    """

    names: list[str]
    column: Ints
    C: csr_array
    start: Array
    nominal: Array
    sums: dict[str, slice]

    @cached_property
    def fed(self) -> Ints:
        """Inputs that junctions feed."""
        return np.flatnonzero(self.column >= 0)

    @cached_property
    def P(self) -> csr_array:
        """U = P xi + U_free (nu x n)."""
        entries = np.ones(len(self.fed)), (self.fed, self._columns)
        return csr_array(entries, shape=(len(self.column), len(self.names)))

    def inputs(self, xi: Array) -> Array:
        """P xi (nu)."""
        u = np.zeros(len(self.column))
        u[self.fed] = xi[self._columns]
        return u

    def summed(self, y: Array) -> Array:
        """P^T y (n)."""
        return np.bincount(self._columns, y[self.fed], len(self.names)).astype(float)

    def reach(self, place: slice) -> tuple[Ints, Array]:
        """The unknowns that feed the inputs `place` of a member, and the block of P with these columns."""
        column = self.column[place]
        own = np.unique(column[column >= 0])
        return own, (column[:, None] == own).astype(float)

    @cached_property
    def row_nominal(self) -> Array:
        """The size that a row is measured by where all of its terms are zero (n)."""
        return np.maximum(abs(self.C) @ self.nominal, 1e-3)

    @cached_property
    def junction_of(self) -> list[str]:
        """Junction of each unknown (n)."""
        starts = [s.start for s in self.sums.values()] + [len(self.names)]
        return [n for n, a, b in zip(self.sums, starts[:-1], starts[1:], strict=True) for _ in range(a, b)]

    def commons(self) -> list[int]:
        """Rows of the common variables."""
        return [i for s in self.sums.values() for i in range(s.start, s.stop)]

    def sum_names(self) -> list[str]:
        return [self.names[i] for i in self.commons()]

    def rows_of_sums(self) -> list[Array]:
        """Per common variable: its row, or the rows of the outputs that must equal it."""
        C = self.C
        duals = [(i, np.sort(C.indices[C.indptr[i] : C.indptr[i + 1]])) for i in self.commons()]
        return [dual if dual.size else np.array([i]) for i, dual in duals]

    @cached_property
    def _columns(self) -> Ints:
        return self.column[self.fed]


class Joinable(Protocol):
    """A member whose ports are joined; `places`: port name -> slice of its `nu` external inputs."""

    @property
    def name(self) -> str: ...
    @property
    def nu(self) -> int: ...
    @property
    def places(self) -> dict[str, slice]: ...


def interface(network: Network, members: Sequence[Joinable]) -> Interface:
    """The interface equations of `network` in the members' stacked external inputs."""
    offset, width = {}, 0
    for m in members:
        for port, place in m.places.items():
            offset[End(m.name, port)] = np.arange(place.start, place.stop) + width
        width += m.nu
    names: list[str] = []
    start: list[float] = []
    nominal: list[float] = []
    column = np.full(width, -1)
    skew: list[tuple[Any, Any]] = []
    sums = {}
    for j in network.junctions:
        u = junction_unknowns(network.members, j)
        common = len(names) + np.arange(u.common.n)
        sums[j.name] = slice(len(names), len(names) + u.common.n)
        for variable in (u.common, *u.dual.values()):
            names += variable.names()
            start += variable.start
            nominal += variable.nominal
        place = {end: common for end in j.ends}
        first = len(sums) and common[-1] + 1
        for end, variable in u.dual.items():
            place[end] = first + np.arange(variable.n)
            first += variable.n
            skew += list(zip(common, place[end], strict=True))
        for end, columns in place.items():
            column[offset[end]] = columns
    c, d = np.array(skew, int).reshape(-1, 2).T
    one = np.ones(len(c))
    entries = np.concatenate([one, -one]), (np.concatenate([c, d]), np.concatenate([d, c]))
    C = csr_array(entries, shape=(len(names),) * 2)
    return Interface(names, column, C, np.array(start), np.array(nominal), sums)
