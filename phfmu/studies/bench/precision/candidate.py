"""A candidate of the comparison: a method with one setting, and what a run of it gives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CandidateRun:
    """States at the times asked for (times x n1); steps, iterations and the worst ledger residual [J] where they are known.

    cpu: CPU time of the run [s] where a process of its own told it
    """

    x: Array
    steps: int | None = None
    iterations: int | None = None
    ledger: float | None = None
    cpu: float | None = None


class Solve(Protocol):
    """Solves from the start to the last of `times`; `watch`: also what costs time to look at (the ledger)."""

    def __call__(self, times: Sequence[float], watch: bool = False) -> CandidateRun: ...


@dataclass(frozen=True)
class Candidate:
    """`prepare` does everything that is done once (models, compilation, reservations) and is not timed.

    method: name of its line in the table;  setting: e.g. `h=0.01`, `rtol=1e-06`;  own: a scheme of this package
    """

    method: str
    setting: str
    value: float
    prepare: Callable[[], Solve]
    own: bool = False


class NotAvailable(Exception):
    """The peer is not installed or cannot take this problem; the message says why."""


def missing(peer: str, why: str) -> Candidate:
    """The candidate that stands for a peer that is not there: one line in the remarks, with the remedy in `why`."""

    def prepare() -> Solve:
        raise NotAvailable(why)

    return Candidate(peer, "", 0.0, prepare)
