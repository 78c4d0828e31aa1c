"""The exchange of members as lists of numbers for the compiled master: unknowns z = (xi at nodes | impulses m | m')."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array

from phfmu.engine.build.derived import factor_room
from phfmu.gradients.quadrature import nodes
from phfmu.network.couplings.coupling import Coupling
from phfmu.network.couplings.newton import Newton
from phfmu.network.interface.bare_columns import Clusters
from phfmu.network.interface.coupled_members import CoupledMembers
from phfmu.network.interface.unknowns import InterfaceUnknowns, MemberUnknowns
from phfmu.network.members.member import Member
from phfmu.network.members.node_values import HeldNodes, NodeValues
from phfmu.network.wires import Wire
from phfmu.outcome.steps import StepEvent
from phfmu.plan.ordering import elimination_order

Array = NDArray[Any]
Ints = NDArray[np.int32]


@dataclass(frozen=True)
class ShareTables:
    """The lists of `ph_share` for a member."""

    values: NodeValues
    #: of inputs, with the unknowns of a relation
    nu: int
    k: int
    weights: Array
    inputs: Ints
    kicks: int
    bare: Ints
    kicked: Ints
    kicked_output: Ints
    col: Ints
    row: Ints
    right_direction: Ints
    right_col: Ints
    right: Array
    left_output: Ints
    left_row: Ints
    left: Array
    #: held signals that it sends, and that it takes but by ports
    told: list[str]
    taken: list[str]

    @property
    def member(self) -> Member:
        return self.values.member

    @property
    def held(self) -> bool:
        """Whether it takes one held value of each input."""
        return isinstance(self.values, HeldNodes)

    @property
    def directions(self) -> int:
        return len(self.inputs) + 2 * len(self.kicked)


@dataclass(frozen=True)
class MemberRows:
    """Rows of a member, one a step: its columns, stored energies, outputs at the end, and its ledger.

    events: numbers of steps, and what happened in them;  missed: outputs less those that the step was found with
    """

    columns: Array
    H: Array
    ends: Array
    books: dict[str, Array]
    events: tuple[tuple[int, StepEvent], ...] = ()
    missed: Array | None = None


@dataclass(frozen=True)
class ExchangeTables:
    """The lists of `ph_master` for all members; bare columns stand cluster by cluster, `place`: of each in the exchange."""

    parts: list[ShareTables]
    columns: int
    weights: Array
    at_ends: Array
    at_starts: Array
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
    #: per signal (share, output, share, input), and its factor
    wires: Ints
    factors: Array

    @property
    def nodes(self) -> int:
        return len(self.weights)

    @property
    def size(self) -> int:
        return self.nodes + 2 * len(self.bare)

    @property
    def unpacked(self) -> Ints:
        """Places of the unknowns of the exchange here."""
        at = np.argsort(self.place) + self.nodes
        return np.concatenate([np.arange(self.nodes), at, at + len(self.bare)]).astype(np.int32)


def exchange_tables(joined: CoupledMembers, coupling: Coupling, held: Sequence[Wire] = ()) -> ExchangeTables:
    """The exchange of members under a coupling; `held`: signals that are held over a step."""
    if e := _exchange(coupling):
        shares, columns, C, weights, k, bare = e.shares, e.columns, e.C, e.weights, e.counts, e.bare
        clusters, nominal, at_ends = e.clusters, e.row_nominal, e.at_ends
        at_starts = np.concatenate([*(nodes(int(n)).value(0.0) for n in k), np.zeros(0)])
    else:
        n = len(joined.face.names)
        k, columns = np.ones(n, int), np.arange(n)
        C, weights, bare = joined.face.C, np.ones(n), []
        shares = [
            _held(m, p, *joined.reach(i)) for i, (m, p) in enumerate(zip(joined.members, joined.places, strict=True))
        ]
        clusters, nominal, at_ends, at_starts = Clusters([], 0), joined.face.row_nominal, weights, weights
    place = np.concatenate([*clusters.of, np.zeros(0, int)]).astype(np.int32)
    cluster = np.cumsum([0, *map(len, clusters.of)]).astype(np.int32)
    skew, where = coo_array(C), np.argsort(place)
    bare = np.asarray(bare, np.int32)[place]
    least = 1e-12 * np.concatenate([nominal, joined.face.row_nominal[bare]])
    to, from_, values = _ahead(k)
    return ExchangeTables(
        [_part(s, where, len(columns), *_held_signals(joined, s.values.member, held)) for s in shares],
        len(k), weights, at_ends, at_starts, columns.astype(np.int32), bare, place,
        skew.row.astype(np.int32), skew.col.astype(np.int32), skew.data,
        least, cluster, np.append(0, np.cumsum(np.diff(cluster) ** 2)).astype(np.int32),
        (-1.0) ** k[bare],
        to, from_, values, *_wires(joined, coupling),
    )  # fmt: skip


def _exchange(coupling: Coupling) -> InterfaceUnknowns | None:
    """Unknowns of a coupling that exchanges node values; None where each input is one held value."""
    return coupling.exchange if isinstance(coupling, Newton) else None


def _wires(joined: CoupledMembers, coupling: Coupling) -> tuple[Ints, Array]:
    exchange = _exchange(coupling)
    numbers = exchange.wires if exchange else []
    own, found = {m.name: i for i, m in enumerate(joined.members)}, [joined.network.wires[i] for i in numbers]
    first = [p.start for p in joined.places]
    rows = [
        (
            own[w.source], joined.sent[w.source, w.output] - first[own[w.source]],
            own[w.target], joined.taken[w.target, w.input] - first[own[w.target]],
        )
        for w in found
    ]  # fmt: skip
    return np.array(rows, np.int32).reshape(-1, 4), np.array([w.factor for w in found])


def _held(member: Any, place: slice, own: Any, P: Array) -> MemberUnknowns:
    fed = np.flatnonzero(P.any(axis=1)).tolist()
    none = np.zeros((0, 0))
    return MemberUnknowns(
        HeldNodes(member), place, own, P, P.T, np.zeros(0, int), none, np.zeros((len(P), 0)), fed, fed
    )


def _ahead(k: Array) -> tuple[Ints, Ints, Array]:
    """The continuation of the values of each column: to, from, factor."""
    first = np.cumsum(k) - k
    to, from_, values = [np.zeros(0, int)], [np.zeros(0, int)], [np.zeros(0)]
    for n in np.unique(k):
        rule, own = nodes(int(n)), first[k == n]
        node = np.arange(n)
        to.append((own[:, None] + np.repeat(node, n)).ravel())
        from_.append((own[:, None] + np.tile(node, n)).ravel())
        values.append(np.tile(np.array([rule.value(1.0 + t) for t in rule.c]).ravel(), len(own)))
    return np.concatenate(to).astype(np.int32), np.concatenate(from_).astype(np.int32), np.concatenate(values)


def _held_signals(joined: CoupledMembers, member: Member, held: Sequence[Wire]) -> tuple[list[str], list[str]]:
    told = dict.fromkeys(w.output for w in held if w.source == member.name)
    taken = (w.input for w in held if w.target == member.name and (w.target, w.input) not in joined.taken)
    return list(told), list(dict.fromkeys(taken))


def _part(s: MemberUnknowns, where: Array, n: int, told: list[str], taken: list[str]) -> ShareTables:
    """Lists of a member's share; `where`: place of each bare column, `n`: number of unknowns at nodes."""
    rule = s.values.rule
    kicks, own, inputs = len(s.Q) if s.kicked else 0, s.own, np.array(s.fed_rows, np.int32)
    if not s.back.any():  # of a relation, whose rows are in C
        inputs = np.flatnonzero(s.to.any(axis=1)).astype(np.int32)
    fed = s.to[inputs]
    right = [(d, c, fed[d, c]) for d, c in np.argwhere(fed)]
    left = [(i, r, s.back[r, i]) for r, i in np.argwhere(s.back)]
    bare, mine = np.full(kicks, -1, np.int32), np.zeros(0, int)
    kicked = np.flatnonzero(s.Q.any(axis=1)).astype(np.int32)
    outputs = np.array(s.values.offer.kicked, np.int32)[kicked] if kicks and s.values.offer else kicked
    if kicks:
        mine = where[s.bare]
        for i, c in np.argwhere(s.Q):
            bare[i], d = mine[c], int(np.searchsorted(kicked, i))
            right += [
                (len(inputs) + d, len(own) + c, s.Q[i, c]),
                (len(inputs) + len(kicked) + d, len(own) + len(mine) + c, s.Q[i, c]),
            ]
        left += [(len(s.to) + i, len(own) + c, s.ends[i, c]) for i, c in np.argwhere(s.ends)]
    col = np.concatenate([own, n + mine, n + len(where) + mine])
    return ShareTables(
        s.values, len(s.to) // rule.k, rule.k, rule.b, inputs, kicks, bare, kicked, outputs,
        col.astype(np.int32), col[: len(own) + len(mine)].astype(np.int32),
        *(np.array([r[i] for r in right], kind) for i, kind in enumerate((np.int32, np.int32, float))),
        *(np.array([v[i] for v in left], kind) for i, kind in enumerate((np.int32, np.int32, float))),
        told=told, taken=taken,
    )  # fmt: skip


class MasterPattern:
    """The interface matrix by columns, its elimination order, and where the entries of each part of it are.

    StructurallySingular
    """

    def __init__(self, e: ExchangeTables):
        n, nb = e.size, len(e.bare)
        blocks: list[tuple[Array, Array]] = [
            (np.repeat(p.row, len(p.col)), np.tile(p.col, len(p.row))) for p in e.parts
        ]
        blocks.append((e.skew_row, e.skew_col))
        clusters = [np.arange(a, b) for a, b in zip(e.cluster[:-1], e.cluster[1:], strict=True)]
        law = [(np.repeat(own, len(own)), np.tile(own, len(own))) for own in clusters]
        i, j = (np.concatenate([*(c[side] for c in law), np.zeros(0, int)]) for side in (0, 1))
        blocks.append((e.nodes + nb + i, e.nodes + j))
        diagonal = e.nodes + nb + np.arange(nb)
        blocks.append((diagonal, diagonal))
        row, col = (np.concatenate([b[i] for b in blocks]).astype(np.int64) for i in (0, 1))
        keys, where = np.unique(col * n + row, return_inverse=True)
        self.rowind = (keys % n).astype(np.int32) if n else np.zeros(0, np.int32)
        columns = (keys // n).astype(np.int32) if n else np.zeros(0, np.int32)
        self.colptr = np.searchsorted(columns, np.arange(n + 1)).astype(np.int32)
        ends = np.cumsum([len(b[0]) for b in blocks])[:-1]
        *self.entries, self.skew, self.law, self.own = (a.astype(np.int32) for a in np.split(where, ends))
        #: numbers of the matrix, which the master fills in
        self.a = np.zeros(len(self.rowind))
        self.order, self.prefer = elimination_order(n, self.rowind, columns, np.zeros(0, np.int32))
        self.capacity = max(1, factor_room(self.rowind, self.colptr, self.order, self.prefer))
