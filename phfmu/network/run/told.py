"""What a run tells: the columns of its rows, signals of the stepper and then its free inputs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.network.couplings.stepper import Stepper
from phfmu.network.run.stretches import CLOSE, Stretch
from phfmu.pick import pick

Array = NDArray[Any]


class Told:
    """Columns `names` with `units`, chosen by patterns out of all that there is (none: all of them).

    An input stands in a row with the value that it had in the step that ends there; at the start, with that of the start.
    Errors: ValueError for a pattern that means no column.
    """

    def __init__(self, stepper: Stepper, patterns: Sequence[str] = (), step: float = 1.0):
        self._stepper, self._step = stepper, step
        self._inputs = list(stepper.inputs())
        everything = [*stepper.names, *self._inputs]
        self.names = pick(patterns, everything, "the run") if patterns else everything
        units = stepper.units
        self.units = [units[n] for n in self.names]
        place = {n: i for i, n in enumerate(everything)}
        at = np.array([place[n] for n in self.names], int)
        own = at < len(stepper.names)
        #: columns of the stepper and of the inputs: where they are, and where they go
        self._signals, self._given = (
            (at[own], np.flatnonzero(own)),
            (at[~own] - len(stepper.names), np.flatnonzero(~own)),
        )
        self._all = not patterns
        self._changes = np.zeros(0)  # times after which the next row of `_held` counts
        self._held = np.zeros((1, 0))

    def begin(self, stretch: Stretch) -> None:
        """A stretch whose events happened."""
        if not self._inputs:
            return
        places = {n: [i] for i, n in enumerate(self._inputs)}
        for i, name in enumerate(self._inputs):
            if "[" in name:
                places.setdefault(name.partition("[")[0], []).append(i)
        self._changes = stretch.start + (np.array([k for k, _ in stretch.inputs], float) + CLOSE) * self._step
        self._held = np.empty((len(stretch.inputs) + 1, len(self._inputs)))
        self._held[0] = list(self._stepper.inputs().values())
        for row, (_, event) in enumerate(stretch.inputs):
            self._held[row + 1] = self._held[row]
            self._held[row + 1, places[event.name]] = event.value

    def rows(self, time: Array, values: Array) -> Array:
        """The columns (n x names) of rows at `time` (n) of the stretch, with what the stepper tells."""
        if self._all and not self._inputs:
            return values
        out = np.empty((len(time), len(self.names)))
        if self._all:
            out[:, : values.shape[1]] = values
        else:
            out[:, self._signals[1]] = values[:, self._signals[0]]
        if len(self._given[0]):
            out[:, self._given[1]] = self._held[np.searchsorted(self._changes, time)][:, self._given[0]]
        return out
