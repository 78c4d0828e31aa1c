"""Free inputs of members stepped apart that follow data: what they are at the nodes of a step."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from phfmu.network.members.interpolant import Interpolant

Array = NDArray[np.float64]


class PrescribedInputs:
    """Inputs that follow `data`, functions of time; `free`: by name the place among the inputs of all members, and the factor."""

    def __init__(self, data: Interpolant, free: Mapping[str, tuple[int, float]]):
        self.data = data
        self.places = np.array([free[name][0] for name in data.names], int)
        self._signs = np.array([free[name][1] for name in data.names])

    def own(self, place: slice) -> NDArray[np.intp]:
        """The data that belong to the inputs at `place`."""
        return np.flatnonzero((self.places >= place.start) & (self.places < place.stop))

    def at_nodes(self, free: Array, place: slice, c: Array, grid: tuple[float, float, int], n: int) -> Array:
        """Inputs at `place` at the fractions c of n steps k = first.. from t0 + k h (n x k x nu), grid: t0, h, first.

        What does not follow data is as in `free` (nu).
        """
        own, (t0, h, first) = self.own(place), grid
        out = np.tile(free, (n, len(c), 1))
        given = self.data.at_nodes(c, t0, h, n, first) * self._signs
        out[:, :, self.places[own] - place.start] = given[:, :, own]
        return out
