"""Whether signals between members grow without bound, where no energy tells it.

A loop of signals that the coupling makes unstable grows by a factor per step: each doubling takes as long as the one before,
while those of t^p take 2^(1/p) times as long.  Doublings to a `LIMIT` times the size, `FEWEST` at least since a signal may jump,
of which the second half took no longer than `STEADY` times the first one, are told.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from phfmu.network.wires import Wire

Array = NDArray[np.float64]

LIMIT = 1e6
FEWEST, MOST = 12, 20
STEADY = 1.5


class SignalGrowth:
    """Growth of held signals, step after step."""

    CARRIED = ("_level", "_when", "told")

    def __init__(self, wires: Sequence[Wire]):
        self._wires = wires
        self._level = np.zeros(len(wires))
        #: of each signal when it doubled last, and to what
        self._when = [deque[tuple[float, float]](maxlen=MOST + 1) for _ in wires]
        #: lines about signals that have grown
        self.told: dict[int, str] = {}

    def watch(self, t: float, values: Array) -> None:
        """The signals at time t."""
        size = np.abs(values)
        for i in np.flatnonzero(size > 2.0 * self._level):
            when, i = self._when[i], int(i)
            self._level[i] = size[i]
            when.append((t, float(size[i])))
            if i not in self.told and _steady(when):
                start, before = when[0]
                self.told[i] = (
                    f"signal {self._wires[i]} grows without bound: {size[i]:.3g} at t = {t:.6g} s, {before:.3g} at "
                    f"t = {start:.6g} s; a loop of signals that are held over steps may be unstable: take a smaller step, or "
                    "--coupling newton without --signals-held, which iterates them where units can take steps back"
                )


def _steady(when: Sequence[tuple[float, float]]) -> bool:
    if len(when) <= FEWEST or when[-1][1] < LIMIT * when[0][1]:
        return False
    start, middle, end = when[0][0], when[len(when) // 2][0], when[-1][0]
    return end - middle <= STEADY * (middle - start)
