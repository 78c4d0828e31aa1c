"""Communication steps with the state events in them, each told as one step; the twin of runtime/events/event_step.c.

With parts of lengths h_j that end at events, means are sum_j h_j ybar_j / h, so that h u^T ybar is the energy that held inputs
supplied; rows of the ledger are sums.  What jumps add to the stored energy is told beside them, by the events.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phfmu.engine.landing import landed
from phfmu.engine.state import State
from phfmu.engine.status import StepFailure
from phfmu.events.happened import Happened
from phfmu.plan.plan import Plan

Array = NDArray[Any]

#: rows that are summed, and means
SUMS, MEANS = ("stored", "dissipated", "supplied", "numerical", "moved", "pairs"), ("y_step", "a")


@dataclass(frozen=True)
class Told:
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


def told(instance: Any, t: float, h: float, parts: int) -> Told:
    """Takes [t, t + h], h > 0, in `parts` equal internal steps that end on the zeros of guards too."""
    rows: dict[str, Array] = {}
    means: dict[str, Array] = {}
    found, n = [], 0
    for piece in landed(instance, t, h / parts, parts, (*SUMS, *MEANS), 0, True):
        for i, begun in enumerate(piece.t):
            row = {name: values[i] for name, values in piece.rows.items()}
            before = (begun - t) / (begun + piece.h[i] - t)
            rows = {k: row[k] + rows[k] if n else row[k] for k in SUMS}
            means = {k: before * means[k] + (1.0 - before) * row[k] if n else row[k] for k in MEANS}
            n += 1
        found += [piece.happened] if piece.happened is not None else []
    return Told(rows, means, tuple(found), n)


def run_told(
    instance: Any, t0: float, h: float, n: int, record: Iterable[str], inputs: ArrayLike | None, parts: int, first: int
) -> tuple[dict[str, Array], tuple[Happened, ...]]:
    """`run` of a compiled instance by its `do_step`, and what happened; StepFailure has the rows before it."""
    rows: dict[str, list[Array]] = {name: [] for name in record}
    held = None if inputs is None else np.asarray(inputs, float)
    found: list[Happened] = []
    if held is not None and held.shape != (n, instance.model.step.nu):
        raise ValueError(
            f"{instance.model.name}: expected values of shape {(n, instance.model.step.nu)}, got {held.shape}"
        )
    for k in range(n):
        if held is not None:
            instance.set_input(held[k])
        before, state = dict(instance.counts), instance.get_state()
        try:
            instance.do_step(t0 + (first + k) * h, h, parts)
            now = _read(instance, before, rows)
        except StepFailure as failure:
            instance.restore(state)
            failure.recorded = {name: np.array(kept) for name, kept in rows.items()}
            raise
        found += instance.happened
        for name, kept in rows.items():
            kept.append(now[name])
    return {name: np.array(kept) for name, kept in rows.items()}, tuple(found)


def require_no_events(model: Any) -> None:
    """ValueError for impulses at the ports of a model with state events."""
    if model.events is not None:
        names = ", ".join(model.events.names[:4])
        raise ValueError(f"{model.name}: has state events ({names}), which do not go with impulses at its ports")


def _read(instance: Any, before: dict[str, int], names: Iterable[str]) -> dict[str, Array]:
    """What is recorded of the last step."""
    spent = [float(instance.counts[name] - before[name]) for name in ("iterations", "solves")]
    now = instance.ledger() | {"counts": np.array(spent), "unknowns": instance.unknowns, "x": instance.x}
    blocks = {"a": "a", "y_step": "y_step", "energy": "H"}
    now |= {name: instance.signal(block) for name, block in blocks.items() if name in names}
    if "signals" in names:
        signals = instance.signals()
        now["signals"] = np.concatenate([signals[b] for b in instance.layout])
    return {name: np.array(now[name]) for name in names}
