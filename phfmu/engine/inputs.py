"""What the kernels of a step read besides its unknowns: the state at its start, and inputs at its nodes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.discretise.model import Model
from phfmu.engine.state import State

Array = NDArray[Any]


def carried(model: Model, s: State) -> Array:
    """[states | t], and the algebraic variables where a step carries them on."""
    return np.append(s.x, s.a) if model.step.carries else s.x


def inputs_at(model: Model, u: Array, at: Array) -> Array:
    """The polynomial through the node inputs u of a communication step, at the fractions `at` of it (stacked)."""
    k = model.step.k
    if k == 1 or not u.size:
        return np.tile(u, len(at)) if k == 1 else np.zeros(0)
    values, basis = u.reshape(k, -1), model.scheme.nodes
    if (values == values[0]).all():
        return np.tile(values[0], len(at))
    return np.concatenate([basis.value(float(c)) @ values for c in at])
