"""What coupled members exchange in a step: k_J values per common variable of a junction J, impulse pairs at bare nodes.

k_J is the least of its members'. With c_m, b_m the nodes and weights of a member and l_i the Lagrange basis on the nodes of J,

    U = R P xi,     R_mi = l_i(c_m),         r_i = P^T (R* Y)_i + C xi_i,     R*_im = (b_m / b_i) R_mi.

R* is the adjoint of R in the weights: h sum_i b_i xi_i . r_i is what the junctions take, whatever the members do inside.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phfmu.gradients.quadrature import nodes
from phfmu.network.couplings.bare_columns import bare
from phfmu.network.couplings.joined import Joined
from phfmu.network.members.node_values import NodeValues, node_values

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Share:
    """A member's part: node inputs to(xi) (k nu x N), its adjoint (N x k nu), impulses Q (kicked x bare), those at ends."""

    values: NodeValues
    place: slice
    to: Array
    back: Array
    Q: Array
    ends: Array
    #: inputs that junctions feed, and the rows of `to` with them
    fed: list[int]
    fed_rows: list[int]

    @property
    def kicked(self) -> bool:
        return bool(self.Q.any())


class Exchange:
    """Unknowns xi (N): of each column of the interface its k_J values; `bare`: columns with impulses.

    `offered`: columns of all junctions whose ports take impulses.
    """

    def __init__(self, joined: Joined):
        self.joined, face = joined, joined.face
        parts = [node_values(m) for m in joined.members]
        #: values per column
        self.k = columns_k(joined, {v.member.name: v.rule.k for v in parts})
        self.columns = np.repeat(np.arange(len(self.k)), self.k)
        self.at_node = np.concatenate([np.arange(k) for k in self.k]) if len(self.k) else np.zeros(0, int)
        self.weights = np.concatenate([nodes(k).b for k in self.k]) if len(self.k) else np.zeros(0)
        same = self.at_node[:, None] == self.at_node
        self.C = face.C[np.ix_(self.columns, self.columns)] * same
        offers = [v.offer for v in parts]
        found = bare(joined.network, face, joined.places, offers)
        self.bare, self.offered = list(found.columns), list(found.offered)
        #: (-1)^k_J per bare column
        self.signs = (-1.0) ** self.k[self.bare]
        self.shares = [self._share(v, place) for v, place in zip(parts, joined.places, strict=True)]

    @property
    def held(self) -> bool:
        """One value each and no impulses: what the held inputs of a step are."""
        return not self.bare and bool((self.k == 1).all())

    def spread(self, xi: Array) -> Array:
        """Values of the columns, the same at all nodes."""
        return xi[self.columns]

    def mean(self, values: Array) -> Array:
        """sum_i b_i xi_i of each column."""
        return np.bincount(self.columns, self.weights * values, len(self.k)).astype(float)

    def ahead(self, values: Array, ratio: float) -> Array:
        """The polynomials of a step at the nodes of the next, `ratio` times as long."""
        out = values.copy()
        for c, k in enumerate(self.k):
            own = self.columns == c
            rule = nodes(k)
            out[own] = [rule.value(1.0 + ratio * t) @ values[own] for t in rule.c]
        return out

    def _share(self, values: NodeValues, place: slice) -> Share:
        P, rule = self.joined.face.P[place], values.rule
        to = np.zeros((rule.k, len(P), len(self.columns)))
        used = np.atleast_1d(P.any(axis=0))
        for z, (c, i) in enumerate(zip(self.columns, self.at_node, strict=True)):
            if not used[c]:
                continue
            own = nodes(self.k[c])
            R = np.eye(rule.k)[:, i] if own.k == rule.k else np.array([own.value(t)[i] for t in rule.c])
            to[:, :, z] = R[:, None] * P[:, c]
        to = to.reshape(rule.k * len(P), len(self.columns))
        back = to.T * np.repeat(rule.b, len(P)) / self.weights[:, None]
        fed = np.flatnonzero(P.any(axis=1)).tolist()
        rows = [node * len(P) + j for node in range(rule.k) for j in fed]
        kicked = values.offer.kicked if self.bare and values.offer else []
        return Share(values, place, to, back, P[kicked][:, self.bare], P[:, self.bare], fed, rows)


def columns_k(joined: Joined, k_of: dict[str, int]) -> NDArray[np.int64]:
    """k_J per column of the interface."""
    face = joined.face
    out = np.ones(len(face.names), int)
    starts = [s.start for s in face.sums.values()] + [len(face.names)]
    for j, start, stop in zip(joined.network.junctions, starts[:-1], starts[1:], strict=True):
        out[start:stop] = min(k_of[e.member] for e in j.ends)
    return out
