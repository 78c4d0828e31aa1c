"""Outcomes of the runs of a sweep."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


class SweepStopped(Exception):
    """The sweep was stopped; nobody waits for its runs any more."""


@dataclass(frozen=True)
class RunOutcomes:
    """Outcomes of n runs.

    values: measures (n x measures; nan of a run that failed);  steps: of each run (n)
    ledger: by how much of what is allowed the ledger of a run misses in its worst step (n; above 1 it is violated)
    errors: why a run failed, "" if it did not
    inside: steps that were taken side by side with those of other runs; none of what is read from a file
    alone: why no steps of the model are, "" if they may be
    """

    values: NDArray[Any]
    steps: NDArray[Any]
    ledger: NDArray[Any]
    errors: tuple[str, ...]
    inside: int = 0
    alone: str = ""

    @classmethod
    def joined(cls, parts: Sequence[RunOutcomes]) -> RunOutcomes:
        """Runs after runs."""
        values, steps, ledger = (np.concatenate([getattr(p, n) for p in parts]) for n in ("values", "steps", "ledger"))
        errors, inside = tuple(e for p in parts for e in p.errors), sum(p.inside for p in parts)
        return cls(values, steps, ledger, errors, inside, max((p.alone for p in parts), default=""))
