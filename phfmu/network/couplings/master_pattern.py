"""What members exchange, as lists of numbers for the compiled master: unknowns z = (xi at nodes | impulses m | m')."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from phfmu.engine.derived import factor_room
from phfmu.gradients.quadrature import nodes
from phfmu.network.couplings.coupling import Coupling
from phfmu.network.couplings.exchange import Share
from phfmu.network.couplings.joined import Joined
from phfmu.network.couplings.node_newton import NodeNewton
from phfmu.network.members.engine_member import EngineMember
from phfmu.network.members.node_values import HeldNodes
from phfmu.plan.ordering import elimination_order

Array = NDArray[Any]
Ints = NDArray[np.int32]


@dataclass(frozen=True)
class Part:
    """Of a member: the lists of `ph_share`."""

    member: EngineMember
    held: bool
    k: int
    weights: Array
    inputs: Ints
    kicks: int
    bare: Ints
    col: Ints
    row: Ints
    right_direction: Ints
    right_col: Ints
    right: Array
    left_output: Ints
    left_row: Ints
    left: Array

    @property
    def instance(self) -> Any:
        return self.member.instance

    @property
    def directions(self) -> int:
        return len(self.inputs) + 2 * self.kicks

    @property
    def signals(self) -> int:
        """Length of the signal table."""
        return max(s.stop for s in self.instance.layout.values())


@dataclass(frozen=True)
class Exchanged:
    """Of all members: the lists of `ph_master`; bare columns stand cluster by cluster, `place`: of each in the exchange."""

    parts: list[Part]
    columns: int
    weights: Array
    column: Ints
    bare: Ints
    place: Ints
    skew_row: Ints
    skew_col: Ints
    skew: Array
    least: Array
    cluster: Ints
    square: Ints
    signs: Array
    ahead_to: Ints
    ahead_from: Ints
    ahead: Array

    @property
    def nodes(self) -> int:
        return len(self.weights)

    @property
    def size(self) -> int:
        return self.nodes + 2 * len(self.bare)

    @property
    def widths(self) -> list[int]:
        """Of the record of each member."""
        plans = [p.instance.model.step for p in self.parts]
        return [p.signals + 5 * plan.ncomp + plan.nq for p, plan in zip(self.parts, plans, strict=True)]

    def pack(self, z: Array) -> Array:
        """Unknowns as the exchange has them -> as they stand here."""
        m = z[self.nodes :].reshape(2, -1)
        return np.concatenate([z[: self.nodes], m[0][self.place], m[1][self.place]])

    def unpack(self, z: Array) -> Array:
        """And back."""
        return z[self.unpacked]

    @property
    def unpacked(self) -> Ints:
        """Where the unknowns of the exchange stand here."""
        at = np.argsort(self.place) + self.nodes
        return np.concatenate([np.arange(self.nodes), at, at + len(self.bare)]).astype(np.int32)


def exchanged(joined: Joined, coupling: Coupling) -> Exchanged:
    """What members exchange under one of the Newton couplings."""
    if isinstance(coupling, NodeNewton):
        e = coupling.exchange
        shares, columns, C, weights, k, bare = e.shares, e.columns, e.C, e.weights, e.k, e.bare
    else:
        n = len(joined.face.names)
        k, columns = np.ones(n, int), np.arange(n)
        C, weights, bare = joined.face.C, np.ones(n), []
        shares = [_held(m, p, joined.face.P[p]) for m, p in zip(joined.members, joined.places, strict=True)]
    place, cluster = _clusters([s.Q for s in shares], len(bare))
    skew = np.argwhere(C)
    nominal = np.maximum(np.abs(joined.face.C) @ joined.face.nominal, 1e-3)
    bare = np.asarray(bare, np.int32)[place]
    ahead = [
        (int(to), int(from_), float(v))
        for c in range(len(k))
        for own in [np.flatnonzero(columns == c)]
        for to, t in zip(own, nodes(int(k[c])).c, strict=True)
        for from_, v in zip(own, nodes(int(k[c])).value(1.0 + t), strict=True)
    ]
    return Exchanged(
        [_part(s, place, len(columns)) for s in shares],
        len(k), weights, columns.astype(np.int32), bare, place,
        skew[:, 0].astype(np.int32), skew[:, 1].astype(np.int32), C[skew[:, 0], skew[:, 1]],
        1e-12 * nominal[[*columns, *bare]], cluster, np.append(0, np.cumsum(np.diff(cluster) ** 2)).astype(np.int32),
        (-1.0) ** k[bare],
        np.array([a[0] for a in ahead], np.int32), np.array([a[1] for a in ahead], np.int32), np.array([a[2] for a in ahead]),
    )  # fmt: skip


def _held(member: Any, place: slice, P: Array) -> Share:
    fed = np.flatnonzero(P.any(axis=1)).tolist()
    none = np.zeros((0, 0))
    return Share(HeldNodes(member), place, P, P.T, none, none, fed, fed)


def _clusters(kicks: list[Array], n: int) -> tuple[Ints, Ints]:
    """Bare columns cluster by cluster, and where each begins: those are one that a member with impulses joins."""
    pairs = [np.flatnonzero(Q.any(axis=0)) for Q in kicks if Q.any()]
    rows = np.concatenate([np.full(len(p), p[0]) for p in pairs] or [np.zeros(0, int)])
    cols = np.concatenate(pairs or [np.zeros(0, int)])
    _, label = connected_components(csr_matrix((np.ones(len(rows)), (rows, cols)), shape=(n, n)), directed=False)
    place = np.argsort(label, kind="stable")
    return place.astype(np.int32), np.append(0, np.cumsum(np.bincount(label))).astype(np.int32)


def _part(s: Share, place: Ints, n: int) -> Part:
    """`place`: of the bare columns, `n`: unknowns at nodes."""
    member, rule = s.values.member, s.values.rule
    assert isinstance(member, EngineMember)
    kicks, Q, ends = (len(s.Q), s.Q[:, place], s.ends[:, place]) if s.kicked else (0, None, None)
    own, inputs = np.flatnonzero(s.to.any(axis=0)), np.array(s.fed_rows, np.int32)
    right = [(d, c, s.to[row, z]) for d, row in enumerate(inputs) for c, z in enumerate(own) if s.to[row, z]]
    left = [(i, r, s.back[z, i]) for r, z in enumerate(own) for i in np.flatnonzero(s.back[z])]
    bare, mine = np.full(kicks, -1, np.int32), np.zeros(0, int)
    if Q is not None and ends is not None:
        mine = np.flatnonzero(Q.any(axis=0))
        for i, j in np.argwhere(Q):
            bare[i], c = j, int(np.searchsorted(mine, j))
            right += [
                (len(inputs) + i, len(own) + c, Q[i, j]),
                (len(inputs) + kicks + i, len(own) + len(mine) + c, Q[i, j]),
            ]
        left += [
            (rule.k * member.nu + i, len(own) + int(np.searchsorted(mine, j)), ends[i, j]) for i, j in np.argwhere(ends)
        ]
    col = np.concatenate([own, n + mine, n + len(place) + mine])
    return Part(
        member, isinstance(s.values, HeldNodes), rule.k, rule.b, inputs, kicks, bare,
        col.astype(np.int32), col[: len(own) + len(mine)].astype(np.int32),
        *(np.array([r[i] for r in right], kind) for i, kind in enumerate((np.int32, np.int32, float))),
        *(np.array([v[i] for v in left], kind) for i, kind in enumerate((np.int32, np.int32, float))),
    )  # fmt: skip


class Pattern:
    """The interface matrix by columns, its elimination order, and where the entries of each part of it are.

    StructurallySingular
    """

    def __init__(self, e: Exchanged):
        n, nb = e.size, len(e.bare)
        blocks: list[tuple[Array, Array]] = [
            (np.repeat(p.row, len(p.col)), np.tile(p.col, len(p.row))) for p in e.parts
        ]
        blocks.append((e.skew_row, e.skew_col))
        law = [
            (e.nodes + nb + first + i, e.nodes + first + j)
            for first, end in zip(e.cluster[:-1], e.cluster[1:], strict=True)
            for i in range(end - first)
            for j in range(end - first)
        ]
        blocks.append((np.array([i for i, _ in law], int), np.array([j for _, j in law], int)))
        diagonal = e.nodes + nb + np.arange(nb)
        blocks.append((diagonal, diagonal))
        row, col = (np.concatenate([b[i] for b in blocks]).astype(np.int64) for i in (0, 1))
        keys, where = np.unique(col * n + row, return_inverse=True)
        self.rowind = (keys % n).astype(np.int32) if n else np.zeros(0, np.int32)
        columns = (keys // n).astype(np.int32) if n else np.zeros(0, np.int32)
        self.colptr = np.searchsorted(columns, np.arange(n + 1)).astype(np.int32)
        ends = np.cumsum([len(b[0]) for b in blocks])[:-1]
        *self.entries, self.skew, self.law, self.own = (a.astype(np.int32) for a in np.split(where, ends))
        self.order, self.prefer = elimination_order(n, self.rowind, columns, np.zeros(0, np.int32))
        self.capacity = max(1, factor_room(self.rowind, self.colptr, self.order, self.prefer))
