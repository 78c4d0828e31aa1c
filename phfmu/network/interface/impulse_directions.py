"""Directions of impulses between members: at nodes of states, and between outputs of states that a junction holds equal.

Impulses a may act where the ports that they move take some: at nodes of states, one per common variable, and at junctions whose
common variable is an output of several ports, one between every two of these.  With B the directions of a in the unknowns of the
interface, the rows that they can make zero are B^T P^T y.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from phfmu.network.interface.interface import Interface


def directions(face: Interface, kicked: Iterable[NDArray[np.intp]]) -> tuple[list[str], Any]:
    """Names of a, and B (unknowns of the interface x a).  kicked: places of the inputs that take impulses, by member."""
    taken = np.zeros(len(face.column), bool)
    for places in kicked:
        taken[places] = True
    refused = set(face.column[face.fed[~taken[face.fed]]].tolist())
    names = list[str]()
    entries: list[tuple[int, int, float]] = []
    for c, duals in zip(face.commons(), face.rows_of_sums(), strict=True):
        if not refused.isdisjoint(duals.tolist()):
            continue
        if c in duals:  # nothing but its sum: a node of states
            entries.append((c, len(names), 1.0))
            names.append(face.names[c])
        else:
            for first, second in zip(duals[:-1], duals[1:], strict=True):
                entries += [(int(first), len(names), 1.0), (int(second), len(names), -1.0)]
                names.append(face.names[c] if len(duals) == 2 else f"{face.names[c]} at {face.names[second]}")
    row, column, value = (np.array([e[i] for e in entries], kind) for i, kind in enumerate((int, int, float)))
    return names, csr_array((value, (row, column)), shape=(len(face.names), len(names)))
