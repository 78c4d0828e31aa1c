"""Tangents of consistent starts.

Where hidden constraints hold at the start (currents that sum to zero, lengths), a parameter that is in them moves the start as
`phfmu run --project` would: each direction is a difference quotient of that projection, extrapolated from two steps.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phfmu.discretise.model import Model
from phfmu.discretise.start import project_start

Array = NDArray[np.float64]

#: steps of the differences, of the size of what is moved: the error of the extrapolation and rounding are about 1e-11 there
STEPS = (2e-4, 1e-4)


def consistent(model: Model, x: Array, p: Array, t: float, dx: Array, dp: Array) -> Array:
    """The tangent of the projected start (nx) along dx of the states and dp of the parameters."""
    sizes = [np.abs(v) / np.abs(d) for v, d in ((x, dx), (p, dp)) if d.any() for v, d in [(v[d != 0], d[d != 0])]]
    size = float(max((s.max() for s in sizes), default=1.0)) or 1.0
    found = []
    for part in STEPS:
        e = part * size
        ends = [project_start(model, x + sign * e * dx, p=p + sign * e * dp, t=t).x for sign in (1.0, -1.0)]
        found.append((ends[0] - ends[1]) / (2 * e))
    return found[1] + (found[1] - found[0]) / 3.0
