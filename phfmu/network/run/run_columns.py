"""What a run tells: the columns of its rows, signals of the stepper and then its free inputs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.network.couplings.stepper import Follows, Stepper
from phfmu.network.members.inputs import held_rows, places
from phfmu.network.run.stretches import CLOSE, Stretch
from phfmu.pick import pick
from phfmu.results.kinds import kinds_by_name

Array = NDArray[Any]


class RunColumns:
    """Columns `names` with `units`, `kinds` and `labels`, chosen by patterns out of all that there is (none: all of them).

    An input stands in a row with the value that it had in the step that ends there; at the start, with that of the start.  One
    that is interpolated stands there with its value at that time, before a jump.
    Errors: ValueError for a pattern that means no column.
    """

    def __init__(self, stepper: Stepper, patterns: Sequence[str] = (), step: float = 1.0):
        self._stepper, self._step = stepper, step
        self._inputs = list(stepper.inputs())
        everything = [*stepper.names, *self._inputs]
        self.names = pick(patterns, everything, "the run") if patterns else everything
        units = stepper.units
        self.units = [units[n] for n in self.names]
        kinds = {**kinds_by_name(everything), **stepper.kinds, **dict.fromkeys(self._inputs, "input")}
        self.kinds = [kinds.get(n, "") for n in self.names]
        labels = stepper.labels
        self.labels = [labels.get(n, "") for n in self.names]
        place = {n: i for i, n in enumerate(everything)}
        at = np.array([place[n] for n in self.names], int)
        own = at < len(stepper.names)
        #: columns of the stepper and of the inputs: where they are, and where they go
        self._signals, self._given = (
            (at[own], np.flatnonzero(own)),
            (at[~own] - len(stepper.names), np.flatnonzero(~own)),
        )
        self._all = not patterns
        data = stepper.followed if isinstance(stepper, Follows) else None
        own_data = [] if data is None else [(n, i) for i, n in enumerate(data.names) if n in self.names]
        self._data, self._from_data = data if own_data else None, (
            [self.names.index(n) for n, _ in own_data], [i for _, i in own_data]
        )  # fmt: skip
        self._changes = np.zeros(0)  # times after which the next row of `_held` counts
        self._held = np.zeros((1, 0))

    def begin(self, stretch: Stretch) -> None:
        """A stretch whose events happened."""
        if not self._inputs:
            return
        at = {n: i for i, n in enumerate(self._inputs)}
        where = {name: places(at, name) for name in {e.name for _, e in stretch.inputs}}
        self._changes = stretch.start + (np.array([k for k, _ in stretch.inputs], float) + CLOSE) * self._step
        start = np.array(list(self._stepper.inputs().values()))
        changes = [(where[e.name], e.value) for _, e in stretch.inputs]
        self._held = held_rows(start, len(changes) + 1, changes, range(1, len(changes) + 1))

    def rows(self, time: Array, values: Array, after: bool = False) -> Array:
        """The columns (n x names) of rows at `time` (n) of the stretch, with what the stepper tells.

        `after`: what inputs are after a jump in their data at that time
        """
        if self._all and not self._inputs:
            return values
        out = np.empty((len(time), len(self.names)))
        if self._all:
            out[:, : values.shape[1]] = values
        else:
            out[:, self._signals[1]] = values[:, self._signals[0]]
        if len(self._given[0]):
            out[:, self._given[1]] = self._held[np.searchsorted(self._changes, time)][:, self._given[0]]
        if self._data is not None:
            out[:, self._from_data[0]] = self._data(time, after)[:, self._from_data[1]]
        return out
