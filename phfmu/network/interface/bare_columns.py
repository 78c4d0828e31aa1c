"""Common variables of coupled members that carry impulses: bare nodes, all of whose ports take pairs of them.

With S = sum_j P_j^T S_j P_j over the members (A/(V s)), variables that S couples are a cluster: they share branches. Of a cluster
all carry impulses or none does, by the rule of composed models (`terms/bare.py`); where that projects, members apart do without.

Bare columns that S couples: those that a member with impulses joins; S is a block for each such cluster.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

from phfmu.network.interface.interface import Interface
from phfmu.network.interface.matrices import summed
from phfmu.network.members.node_values import Offer
from phfmu.network.network import Network
from phfmu.terms.bare import Remedy, remedy
from phfmu.terms.port_impulses import Impulse

Array = NDArray[np.float64]
Ints = NDArray[np.intp]


@dataclass(frozen=True)
class BareColumns:
    """columns: those with impulses;  why: bare junction without -> the reason ("": its sum is linear and stays at its start).

    offered: columns of all junctions whose ports take impulses.
    """

    columns: tuple[int, ...]
    why: dict[str, str]
    offered: tuple[int, ...] = ()


def bare(network: Network, face: Interface, inputs: Sequence[slice], offers: Sequence[Offer | None]) -> BareColumns:
    """Bare columns of a network, with impulses or without; `inputs`: places of the inputs of each member among all."""
    by_name = {o.name: o for o in offers if o is not None}
    refused: dict[str, str] = {}
    columns: list[int] = []
    linear: dict[str, bool] = {}
    for j in network.junctions:
        own = face.sums[j.name]
        if face.C.indptr[own.stop] > face.C.indptr[own.start]:  # outputs that must be equal
            continue
        ends = [by_name[e.member].ports[e.port] if e.member in by_name else None for e in j.ends]
        if any(e is None or e.kind is Impulse.NONE for e in ends):
            continue
        columns += range(own.start, own.stop)
        linear[j.name] = all(e.linear for e in ends if e is not None)
        odd = [
            f"{end}: {e.reason}"
            for end, e in zip(j.ends, ends, strict=True)
            if e is not None and e.kind is not Impulse.PAIR
        ]
        refused[j.name] = "; ".join(odd)
    if all(linear.values()):  # the common case, which needs no matrix
        return BareColumns((), dict.fromkeys(linear, ""), tuple(columns))
    kicked = ImpulseIncidence(face, columns)
    reached = [(kicked.at(o, p), o) for o, p in zip(offers, inputs, strict=True) if o is not None]
    S = kicked.inductance((own, o.jump()) for own, o in reached if (own >= 0).any())
    at = {c: name for name in linear for c in range(face.sums[name].start, face.sums[name].stop)}
    taken, why = list[int](), {}
    for part in clusters(S):
        names = list(dict.fromkeys(at[columns[i]] for i in part))
        bent = "; ".join(filter(None, (refused[n] for n in names)))
        found = remedy(all(linear[n] for n in names), "", partial(_part, S, part), partial(str, bent))
        kind, reason = found or (Remedy.NONE, "")
        if kind is Remedy.PAIR:
            taken += [columns[i] for i in part]
        else:
            why |= dict.fromkeys(names, reason)
    return BareColumns(tuple(sorted(taken)), why, tuple(columns))


class ImpulseIncidence:
    """Some columns of an interface, as those of impulses."""

    def __init__(self, face: Interface, columns: Sequence[int]):
        self.n, self._column = len(columns), face.column
        self._position = np.full(len(face.names) + 1, -1)  # the last one is that of inputs that nothing feeds
        self._position[list(columns)] = np.arange(self.n)

    def at(self, offer: Offer, place: slice) -> Ints:
        """The column that each impulse of a member is fed by, -1: none; `place`: its inputs among all."""
        return self._position[self._column[place][offer.kicked]]

    def inductance(self, parts: Iterable[tuple[Ints, Array]]) -> csr_array:
        """S of the columns, of members' `at` and S."""
        own = ((at, np.flatnonzero(at >= 0), S) for at, S in parts)
        return summed(self.n, ((at[mine], at[mine], S[np.ix_(mine, mine)]) for at, mine, S in own))


def clusters(S: csr_array | coo_array) -> list[Ints]:
    """The columns that S couples, in order."""
    count, label = connected_components(S, directed=False)
    order = np.argsort(label, kind="stable")
    return np.split(order, np.searchsorted(label[order], np.arange(1, count)))


def _part(S: csr_array, part: Ints) -> Array:
    return S[part][:, part].toarray()


class Clusters:
    """Clusters of n bare columns; `reached`: those of each member with impulses; `of`: the columns of each cluster."""

    def __init__(self, reached: Sequence[Ints], n: int):
        pairs = [r for r in reached if len(r)]
        rows = np.concatenate([np.full(len(p), p[0]) for p in pairs] or [np.zeros(0, int)])
        columns = np.concatenate([*pairs, np.zeros(0, int)])
        graph = coo_array((np.ones(len(rows)), (rows, columns)), shape=(n, n))
        self.of = clusters(graph) if n else []
        self._label, self._place = np.zeros((2, n), int)
        for i, own in enumerate(self.of):
            self._label[own], self._place[own] = i, np.arange(len(own))

    def blank(self) -> list[Array]:
        """S = 0."""
        return [np.zeros((len(own),) * 2) for own in self.of]

    def add(self, S: list[Array], columns: Ints, part: Array) -> None:
        """S += part, of the bare columns of one member."""
        if len(columns):
            own = self._place[columns]
            S[self._label[columns[0]]][own[:, None], own] += part

    def form(self, S: list[Array], x: Array) -> float:
        """x S x."""
        return float(sum(x[own] @ s @ x[own] for own, s in zip(self.of, S, strict=True)))

    def times(self, T: list[Array], x: Array) -> Array:
        """T x."""
        out = np.zeros_like(x)
        for own, t in zip(self.of, T, strict=True):
            out[own] = t @ x[own]
        return out
