"""Works of a coupling at its junctions in a step, part by part; the parts of a junction add up to the sum of its ports.

    W = h sum_i b_i xi_i.r_i + m.(r_0 + S0 m/2) + m'.(r_e - S1 m'/2) + h xi.P^T (Y - Y_p)

Parts: each node i, or the held value where there is one; the impulses at both ends; what the predictions Y_p of members that are
stepped last miss.  Each is found from rows and impulses alone, the ports' energies by the members' own books.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray

from phfmu.audit.booking import PartKey
from phfmu.network.interface.coupled_members import CoupledMembers
from phfmu.network.interface.unknowns import InterfaceUnknowns

Array = NDArray[np.float64]

HELD, START, END, ESTIMATED = "held value", "impulse at start", "impulse at end", "estimated ports"


class JunctionWorks:
    """The parts of junctions that have more than one: `keys`, empty where there is no such junction.

    `exchange`: of node values, None for one held value each;  `solved`: whether the coupling solves the rows.
    """

    def __init__(self, joined: CoupledMembers, exchange: InterfaceUnknowns | None, solved: bool):
        self._found = _of_unknowns(joined, exchange) if solved else []
        self._at = {junction: i for i, junction in enumerate(joined.face.sums)}
        self._choose(self._found)

    def share(self, other: JunctionWorks) -> None:
        """Both tell the same parts, those that they do not have as zero: they take steps of one run."""
        every = self._found + other._found
        self._choose(every)
        other._choose(every)

    def _choose(self, every: list[PartKey | None]) -> None:
        """Keys of junctions that have more than one among `every`."""
        parts = Counter(key.junction for key in set(every) if key)
        kept = dict.fromkeys(key for key in every if key and parts[key.junction] > 1)
        self.keys = tuple(sorted(kept, key=lambda key: self._at[key.junction]))
        place = {key: i for i, key in enumerate(self.keys)}
        chosen = sorted((place[key], i) for i, key in enumerate(self._found) if key in place)
        self._order = np.array([i for _, i in chosen], int)
        self._own, self._first = np.unique([p for p, _ in chosen], return_index=True)

    def grouped(self, works: Array) -> Array:
        """Energies of unknowns (.. x unknowns) -> of the parts (.. x keys)."""
        own = np.add.reduceat(works[..., self._order], self._first, axis=-1)
        if len(self._own) == len(self.keys):
            return own
        found = np.zeros((*works.shape[:-1], len(self.keys)))
        found[..., self._own.astype(int)] = own
        return found


def _of_unknowns(joined: CoupledMembers, exchange: InterfaceUnknowns | None) -> list[PartKey | None]:
    """The part that each unknown belongs to: xi, then impulses, then columns that estimates are exchanged through."""
    at = joined.face.junction_of
    if exchange is None:
        keys: list[PartKey | None] = [PartKey(junction, HELD) for junction in at]
    else:
        nodes = zip(exchange.columns, exchange.at_node, strict=True)
        # signals, behind the columns of junctions, have no power
        keys = [
            PartKey(at[c], HELD if exchange.k[c] == 1 else f"node {i + 1}") if c < len(at) else None for c, i in nodes
        ]
        keys += [PartKey(at[c], end) for end in (START, END) for c in exchange.bare]
    if not joined.put_off:
        return keys
    last = {m.name for m in joined.put_off}
    estimated = {j.name for j in joined.network.junctions if any(e.member in last for e in j.ends)}
    return [*keys, *(PartKey(j, ESTIMATED) if j in estimated else None for j in at)]
