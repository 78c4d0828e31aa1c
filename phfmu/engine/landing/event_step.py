"""Communication steps with the state events in them, each told as one step; the twin of runtime/events/event_step.c.

With parts of lengths h_j that end at events, means are sum_j h_j ybar_j / h, so that h u^T ybar is the energy that held inputs
supplied; rows of the ledger are sums.  What jumps add to the stored energy is told beside them, by the events.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.reference.state import State
from phfmu.outcome.steps import Happened, Landed
from phfmu.plan.plan import Plan

Array = NDArray[Any]

#: rows that are summed, and means
SUMS, MEANS = ("stored", "dissipated", "supplied", "numerical", "moved", "pairs"), ("y_step", "a")
MERGED = (*SUMS, *MEANS)


@dataclass(frozen=True)
class MergedStep:
    """A step from its parts: `rows` of the ledger, `means` of outputs and algebraic variables, what `happened` in it."""

    rows: dict[str, Array]
    means: dict[str, Array]
    happened: tuple[Happened, ...]
    parts: int

    def put(self, s: State, plan: Plan, t: float) -> None:
        """Into the state at the end of its last part."""
        s.last, s.y_step = self.rows, self.means["y_step"]
        s.t = s.x[-1] = t
        if not plan.carries:
            s.a = self.means["a"]
        if self.parts > 1 or self.happened:  # a derivative of the last part would not be one of the step
            s.y_node, s.path = np.tile(s.y_step, (plan.k, 1)), []

    def skipped(self) -> MergedStep:
        """After a step too short to be one: means stay, nothing is booked."""
        return replace(self, rows={name: 0.0 * row for name, row in self.rows.items()}, happened=())


def merged(pieces: Iterable[Landed], t: float) -> MergedStep:
    """Takes the `pieces` of a step from t, of which MERGED is recorded."""
    rows: dict[str, Array] = {}
    means: dict[str, Array] = {}
    found, n = [], 0
    for piece in pieces:
        for i, begun in enumerate(piece.t):
            row = {name: values[i] for name, values in piece.rows.items()}
            before = (begun - t) / (begun + piece.h[i] - t)
            rows = {k: row[k] + rows[k] if n else row[k] for k in SUMS}
            means = {k: before * means[k] + (1.0 - before) * row[k] if n else row[k] for k in MEANS}
            n += 1
        found += [piece.happened] if piece.happened is not None else []
    return MergedStep(rows, means, tuple(found), n)


def require_no_events(model: Any) -> None:
    """ValueError for impulses at the ports of a model with state events."""
    if model.events is not None:
        names = ", ".join(model.events.names[:4])
        raise ValueError(f"{model.name}: has state events ({names}), which do not go with impulses at its ports")
