"""What an engine tells of a stretch of steps between state events."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


@dataclass(frozen=True)
class Happened:
    """State events at one instant: numbers of the `events`, and of the `rests` among them that came to rest.

    energy, lost:  by component, what the jump added to its H and what it lost (J); the sums of both are 0 together
    signals:  the table row after it;  switched: switches that changed with it, in words
    """

    t: float
    events: tuple[int, ...]
    rests: tuple[int, ...]
    energy: Array
    lost: Array
    signals: Array
    switched: tuple[str, ...] = ()


@dataclass(frozen=True)
class Landed:
    """Accepted steps with their starts t (n), sizes h (n) and recorded rows; `happened` at the end of the last one.

    No steps where one event follows another at once.
    """

    t: Array
    h: Array
    rows: dict[str, Array]
    happened: Happened | None

    @classmethod
    def of(cls, steps: list[tuple[float, float, dict[str, Array]]], happened: Happened | None = None) -> Landed:
        names = steps[0][2] if steps else {}
        rows = {name: np.array([row[name] for _, _, row in steps]) for name in names}
        return cls(np.array([t for t, _, _ in steps]), np.array([h for _, h, _ in steps]), rows, happened)
