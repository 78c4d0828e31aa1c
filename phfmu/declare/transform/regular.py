"""Is a matrix of numbers regular?"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

#: smallest over largest singular value of a singular matrix with balanced rows and columns
SINGULAR = 1e-13


def undetermined(matrix: NDArray[Any]) -> int:
    """The unknown a singular square matrix leaves undetermined most (or its zero row), -1 if it is regular.

    Rows and columns are balanced, so that units do not count.  A matrix that is not finite is not regular.
    """
    if not np.isfinite(matrix).all():
        return int(np.argmax(~np.isfinite(matrix).all(axis=0)))
    for axis in (1, 0):
        zero = np.flatnonzero(np.abs(matrix).max(axis=axis, initial=0.0) == 0)
        if zero.size:
            return int(zero[0])
    if np.count_nonzero(matrix - np.diag(np.diag(matrix))) == 0:
        return -1
    for _ in range(3):
        matrix = matrix / np.sqrt(np.abs(matrix).max(axis=1, keepdims=True))
        matrix = matrix / np.sqrt(np.abs(matrix).max(axis=0, keepdims=True))
    _, s, right = np.linalg.svd(matrix)
    return int(np.argmax(np.abs(right[-1]))) if s[-1] <= SINGULAR * s[0] else -1
