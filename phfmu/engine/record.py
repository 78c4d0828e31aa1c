"""Records of the steps that `run` and `land` of an instance take."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.outcome.status import StepFailure
from phfmu.outcome.steps import EventRecord
from phfmu.words import meant

Array = NDArray[Any]

#: records that there are: the whole signal table, parts of it, and ledger rows and counters of each step
RECORD: tuple[str, ...] = (
    "signals",
    "x",
    "a",
    "y_step",
    "pairs",
    "stored",
    "dissipated",
    "supplied",
    "numerical",
    "moved",
    "unknowns",
    "energy",
    "counts",
)
ALL = f"there are: {', '.join(RECORD)}"
#: recorded name -> block of signals
BLOCKS = {"a": "a", "y_step": "y_step", "energy": "H"}
#: records that are solved for at the end of a step, which may fail
PRESENT = {"signals", "energy"}


@dataclass(frozen=True)
class Grid:
    """Steps k = first..first+n-1 from t0 + k h, each in `parts` equal internal steps.

    `pause`: landing ends after the first event, and those that follow it at the same time
    """

    t0: float
    h: float
    n: int
    first: int = 0
    parts: int = 1
    pause: bool = False

    def start(self, i: int) -> float:
        """Start of its i-th step."""
        return self.t0 + (self.first + i) * self.h


def recordable(model: str, names: Iterable[str]) -> tuple[str, ...]:
    """Names to record, once each; ValueError for those that `RECORD` has not."""
    asked = tuple(dict.fromkeys(names))
    for name in asked:
        if name not in RECORD:
            raise ValueError(f"{model}: there is no record '{name}'; {meant(name, RECORD, ALL)}")
    return asked


def recorded(instance: Any, before: Mapping[str, int], names: Iterable[str]) -> dict[str, Array]:
    """The record of the last step, `before` which the solver had done that; StepFailure where its end has no values."""
    spent = [float(instance.counts[name] - before[name]) for name in ("iterations", "solves")]
    now = instance.ledger() | {"counts": np.array(spent), "unknowns": instance.unknowns, "x": instance.x}
    now |= {name: instance.signal(block) for name, block in BLOCKS.items() if name in names}
    if "signals" in names:
        now["signals"] = instance.row()
    return {name: np.array(now[name]) for name in names}


def step_by_step(
    instance: Any, grid: Grid, names: tuple[str, ...], inputs: Array | None
) -> tuple[dict[str, Array], tuple[EventRecord, ...]]:
    """`run` of an instance by its `do_step`, and what happened; StepFailure has the rows before it.

    A step whose end values are recorded and do not exist is not taken.
    """
    rows: dict[str, list[Array]] = {name: [] for name in names}
    found: list[EventRecord] = []
    for i in range(grid.n):
        if inputs is not None:
            (instance.set_input if inputs.ndim == 2 else instance.set_node_inputs)(inputs[i])
        before, state = dict(instance.counts), instance.get_state() if PRESENT & rows.keys() else None
        try:
            instance.do_step(grid.start(i), grid.h, grid.parts)
            now = recorded(instance, before, names)
        except StepFailure as failure:
            if state is not None:
                instance.restore(state)
            failure.recorded = {name: np.array(kept) for name, kept in rows.items()}
            raise
        found += instance.happened
        for name, kept in rows.items():
            kept.append(now[name])
    return {name: np.array(kept) for name, kept in rows.items()}, tuple(found)
