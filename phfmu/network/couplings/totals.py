"""Columns of the ledger of a whole whose members are stepped apart, under the names of composed models: sums over the members."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from phfmu.signals import LEDGER, total

Array = NDArray[np.float64]


class Totals:
    """`names`: energy.stored, ... of what all members tell in the columns `signals`."""

    def __init__(self, members: Sequence[str], signals: Sequence[str]):
        place = {n: i for i, n in enumerate(signals)}
        rows = {total(what): [place.get(total(what, m)) for m in members] for what, _, _ in LEDGER}
        told = {n: [i for i in own if i is not None] for n, own in rows.items() if None not in own}
        self.names, self._places = list(told), np.array(list(told.values()), int).reshape(len(told), len(members))

    def before(self, signals: Array) -> Array:
        """Rows of signals (.. x columns) with the sums before them."""
        return np.concatenate([signals[..., self._places].sum(axis=-1), signals], axis=-1)
