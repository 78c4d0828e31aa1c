"""Exchange of coupled members in a step: k_J values per common variable of a junction J, impulse pairs at bare nodes.

k_J is the least of its members'. With c_m, b_m the nodes and weights of a member and l_i the Lagrange basis on the nodes of J,

    U = R P xi,     R_mi = l_i(c_m),         r_i = P^T (R* Y)_i + C xi_i,     R*_im = (b_m / b_i) R_mi.

R* is the adjoint of R in the weights: h sum_i b_i xi_i . r_i is what the junctions take, whatever the members do inside.

A signal between members that take and give it at nodes is exchanged alike, with k the lesser of the two,

    u = R xi + offset,     r_i = xi_i - factor (R* y)_i,

and has no power: its weights in all energies are zero.

Members that are ideal switches and nothing else have no steps of their own (`members/relation.py`): their unknowns a are columns
too, and their rows, 0 = J a + B P xi and P^T B^T a in those of their junctions, stand in C, anew in each mode.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TypeGuard

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import block_diag, csr_array, eye_array

from phfmu.gradients.quadrature import nodes
from phfmu.network.interface.bare_columns import Clusters, bare
from phfmu.network.interface.coupled_members import CoupledMembers
from phfmu.network.interface.relations import Relations, all_together
from phfmu.network.interface.shared_jumps import SharedJumps
from phfmu.network.members.engine_member import EngineMember
from phfmu.network.members.member import Member
from phfmu.network.members.node_values import HeldNodes, NodeValues, node_values
from phfmu.signals import of_member

Array = NDArray[np.float64]
Ints = NDArray[np.intp]


@dataclass(frozen=True)
class MemberUnknowns:
    """A member's part: what it reaches of the N unknowns at nodes (own) and of the bare columns (bare), and how.

    to: node inputs of its own unknowns (k nu x own);  back: the adjoint (own x k nu);  Q: impulses of its bare columns
    (kicked x bare);  ends: sums at ends of its outputs (nu x bare)
    """

    values: NodeValues
    place: slice
    own: Ints
    to: Array
    back: Array
    bare: Ints
    Q: Array
    ends: Array
    #: inputs that junctions feed, and the rows of `to` with them
    fed: list[int]
    fed_rows: list[int]

    @cached_property
    def kicked(self) -> bool:
        return bool(self.Q.any())


def has_events(member: Member) -> TypeGuard[EngineMember]:
    """Whether an engine steps a model with state events."""
    return isinstance(member, EngineMember) and member.model.events is not None


class InterfaceUnknowns:
    """Unknowns xi (N): of each column of the interface its k_J values; `bare`: columns with impulses.

    `offered`: columns of all junctions whose ports take impulses.
    """

    def __init__(self, joined: CoupledMembers):
        self.joined, face = joined, joined.face
        self.shared = SharedJumps(joined)
        #: whether events are those of the composed declaration, by which all members land together
        self.whole = all_together(joined, self.shared)
        parts = [node_values(m, self._lands(m)) for m in joined.members]
        if not self.whole:
            self._hold_at_bare_nodes(parts)
        k_of = {v.member.name: v.rule.k for v in parts}
        #: values per column of the interface
        self.k = columns_k(joined, k_of)
        #: numbers of the wires that are exchanged at nodes
        self.wires = self._at_nodes_both(parts)
        wires = [joined.network.wires[i] for i in self.wires]
        self._offset = np.array([w.offset for w in wires])
        self.relations = Relations(joined, len(self.k) + len(wires))
        #: values per column, signals being columns of their own behind those of the interface, then unknowns of relations
        self.counts = np.array(
            [*self.k, *(min(k_of[w.source], k_of[w.target]) for w in wires), *self.relations.counts], int
        )
        self.names = [*face.names, *(of_member(w.target, w.input) for w in wires), *self.relations.names]
        self.columns = np.repeat(np.arange(len(self.counts)), self.counts)
        self._first = np.cumsum(self.counts) - self.counts
        self.at_node = np.concatenate([np.zeros(0, int), *(np.arange(k) for k in self.counts)])
        self._b = np.concatenate([np.zeros(0), *(nodes(int(k)).b for k in self.counts)])
        signal = (self.columns >= len(self.k)) & (self.columns < self.relations.first)
        self.weights = np.where(signal, 0.0, self._b)
        self._plain = csr_array(block_diag([face.C, eye_array(len(wires))]))
        self.join()
        self.row_nominal = np.concatenate([face.row_nominal, np.ones(len(wires)), self.relations.row_nominal])[
            self.columns
        ]
        offers = [v.offer for v in parts]
        found = bare(joined.network, face, joined.places, offers)
        self.bare, self.offered = list(found.columns), list(found.offered)
        self._bare = np.full(len(self.k), -1)
        self._bare[self.bare] = np.arange(len(self.bare))
        #: (-1)^k_J per bare column
        self.signs = (-1.0) ** self.k[self.bare]
        self.shares = [self._share(v, *p) for v, p in zip(parts, enumerate(joined.places), strict=True)]
        self.clusters = Clusters([s.bare for s in self.shares if s.kicked], len(self.bare))

    def _lands(self, member: Member) -> bool:
        """Whether a member may land together with the others: of order 4 and 6, and where jumps act on other members."""
        if self.whole:
            return True
        if self.joined.network.wires or not has_events(member) or not member.guards_states:
            return False
        return member.model.step.k > 1 or member.name in self.shared.of

    def join(self) -> None:
        """C, with relations in their present modes."""
        self.C = self._at_nodes(self.relations.added(self._plain))

    def _hold_at_bare_nodes(self, parts: list[NodeValues]) -> None:
        """Members with state events take no impulses: where they meet at bare nodes, they land inside and take held values."""
        joined = self.joined
        found = bare(joined.network, joined.face, joined.places, [v.offer for v in parts])
        for i, values in enumerate(parts):
            if has_events(values.member) and not set(joined.reach(i)[0].tolist()).isdisjoint(found.columns):
                parts[i] = HeldNodes(values.member)

    def landing(self) -> list[EngineMember]:
        """Members with state events that land together with all others."""
        found = (s.values.member for s in self.shares if not isinstance(s.values, HeldNodes))
        return [m for m in found if has_events(m)]

    @property
    def held(self) -> bool:
        """One value each and no impulses: what the held inputs of a step are."""
        return not (self.bare or self.wires or self.landing()) and bool((self.k == 1).all())

    def of_columns(self, xi: Array) -> Array:
        """A value of each column; of signals as they are now."""
        signals = self.joined.sampled[self.wires] - self._offset
        return np.concatenate([xi, signals, self.relations.values()])

    def mean(self, values: Array) -> Array:
        """sum_i b_i xi_i of each column."""
        return np.bincount(self.columns, self.weights * values, len(self.counts))[: len(self.k)].astype(float)

    def at_end(self, values: Array) -> Array:
        """The polynomial of each column of the interface at the end of the step."""
        return np.bincount(self.columns, self.at_ends * values, len(self.counts))[: len(self.k)].astype(float)

    @cached_property
    def at_ends(self) -> Array:
        """The basis of each value at the end of a step."""
        return np.concatenate([np.zeros(0), *(nodes(int(k)).value(1.0) for k in self.counts)])

    def _at_nodes(self, C: csr_array) -> csr_array:
        """C between unknowns at one node; columns that it joins have as many values."""
        c, d = C.nonzero()
        k = self.counts[c]
        node = np.arange(k.sum()) - np.repeat(np.cumsum(k) - k, k)
        where = np.repeat(self._first[c], k) + node, np.repeat(self._first[d], k) + node
        return csr_array((np.repeat(C.data, k), where), shape=(len(self.columns),) * 2)

    def _share(self, values: NodeValues, i: int, place: slice) -> MemberUnknowns:
        (columns, P), rule = self.joined.reach(i), values.rule
        own_a = self.relations.of(i)
        if len(own_a):  # what its rows leave is in C
            all_, right = np.append(columns, own_a), block_diag([P, np.eye(len(own_a))]).toarray()
            left = np.zeros_like(right)
        else:
            signals, into, out = self._signals(values.member.name, place)
            all_, right, left = np.append(columns, signals), np.hstack([P, into]), np.hstack([P, out])
        width = len(right)
        to, back = np.zeros((2, rule.k, width, int(self.counts[all_].sum())))
        own, at = np.zeros(to.shape[2], int), 0
        for c, p, q in zip(all_, right.T, left.T, strict=True):
            k = int(self.counts[c])
            R = np.eye(k) if np.array_equal(nodes(k).c, rule.c) else np.array([nodes(k).value(t) for t in rule.c])
            to[:, :, at : at + k], back[:, :, at : at + k] = R[:, None, :] * p[:, None], R[:, None, :] * q[:, None]
            own[at : at + k] = self._first[c] + np.arange(k)
            at += k
        to, back = to.reshape(rule.k * width, at), back.reshape(rule.k * width, at)
        back = back.T * np.repeat(rule.b, width) / self._b[own][:, None]
        fed = [] if len(own_a) else np.flatnonzero(right.any(axis=1)).tolist()
        rows = [node * width + j for node in range(rule.k) for j in fed]
        kicked = values.offer.kicked if self.bare and values.offer else []
        mine = self._bare[columns] >= 0
        ends = P[:, mine]
        return MemberUnknowns(values, place, own, to, back, self._bare[columns[mine]], ends[kicked], ends, fed, rows)

    def _at_nodes_both(self, parts: list[NodeValues]) -> list[int]:
        """Numbers of the wires whose ends are ports of members that take and give values at nodes."""
        at_nodes = {v.member.name for v in parts if not isinstance(v, HeldNodes)}
        taken, sent = self.joined.taken, self.joined.sent
        return [
            i
            for i, w in enumerate(self.joined.network.wires)
            if {w.source, w.target} <= at_nodes and (w.target, w.input) in taken and (w.source, w.output) in sent
        ]

    def _signals(self, name: str, place: slice) -> tuple[Ints, Array, Array]:
        """Columns of the signals that a member takes or gives, its inputs (nu x columns) and -factor of its outputs alike."""
        joined, first = self.joined, len(self.k)
        ends = [(first + n, joined.network.wires[i]) for n, i in enumerate(self.wires)]
        own = [(c, w) for c, w in ends if name in (w.source, w.target)]
        into, out = np.zeros((2, place.stop - place.start, len(own)))
        for at, (_, w) in enumerate(own):
            if w.target == name:
                into[joined.taken[name, w.input] - place.start, at] = 1.0
            if w.source == name:
                out[joined.sent[name, w.output] - place.start, at] = -w.factor
        return np.array([c for c, _ in own], int), into, out


def columns_k(joined: CoupledMembers, k_of: dict[str, int]) -> NDArray[np.int64]:
    """k_J per column of the interface."""
    least = {j.name: min(k_of[e.member] for e in j.ends) for j in joined.network.junctions}
    return np.array([least[name] for name in joined.face.junction_of], int)
