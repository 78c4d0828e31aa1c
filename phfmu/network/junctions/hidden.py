"""What the states of coupled members must meet at their junctions, whatever the junction unknowns are.

With y(U) the outputs at one instant and G = dy/dU, the junction rows r(xi) = P^T y(P xi + U_free) + C xi change by
M dxi, M = P^T G P + C.  Combinations N of the rows with N^T M = 0 constrain the states alone: sums of currents of
inductors, the spread of the velocities of rigidly joined masses.  Outputs of resistors and dampers follow xi instead.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SINGULAR = 1e-9  # relative singular value of M that counts as zero


def hidden_part(M: Array, nominal: Array) -> Array:
    """Projector Q: Q r is the part of the junction rows r that no xi can change (n x n)."""
    n = len(M)
    if not n:
        return np.zeros((0, 0))
    scaled = M * nominal
    biggest = np.abs(scaled).max(axis=1)
    d = 1.0 / np.where(biggest > 0, biggest, 1.0)
    left, s, _ = np.linalg.svd(scaled * d[:, None])
    N = left[:, s <= SINGULAR * max(s[0], 1e-300)]
    return (N @ N.T) * d / d[:, None]
