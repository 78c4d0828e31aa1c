"""The interface equations of a network in the stacked inputs and outputs of its members."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from phfmu.network.junctions.junction import End
from phfmu.network.junctions.network import Network
from phfmu.network.junctions.unknowns import junction_unknowns

Array = NDArray[Any]


@dataclass(frozen=True)
class Interface:
    """xi names and units, P (inputs x unknowns), C (skew), and which rows sum flows or efforts (Kirchhoff rows)."""

    names: list[str]
    P: Array
    C: Array
    start: Array
    nominal: Array
    sums: dict[str, slice]

    def commons(self) -> list[int]:
        """Rows of the common variables."""
        return [i for s in self.sums.values() for i in range(s.start, s.stop)]

    def sum_names(self) -> list[str]:
        return [self.names[i] for i in self.commons()]

    def rows_of_sums(self) -> list[Array]:
        """Per common variable: its row, or the rows of the outputs that must equal it."""
        duals = [(i, np.flatnonzero(self.C[i])) for i in self.commons()]
        return [dual if dual.size else np.array([i]) for i, dual in duals]


class Joinable(Protocol):
    """Whose ports are joined; `places`: port name -> slice of its `nu` external inputs."""

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
    entries: list[tuple[Any, Any]] = []
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
            entries += list(zip(offset[end], columns, strict=True))
    n = len(names)
    P, C = np.zeros((width, n)), np.zeros((n, n))
    for row, col in entries:
        P[row, col] = 1.0
    for c, d in skew:
        C[c, d], C[d, c] = 1.0, -1.0
    return Interface(names, P, C, np.array(start), np.array(nominal), sums)
