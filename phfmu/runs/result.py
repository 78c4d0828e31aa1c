"""The result of a run."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from phfmu.results.table import Table

if TYPE_CHECKING:
    from phfmu.audit import Ledger
    from phfmu.audit.null_ledger import NullLedger
    from phfmu.discretise.start import Projection

Array = NDArray[Any]


@dataclass(repr=False)
class Result(Table):
    """Rows of a run, a table of its signals and free inputs; the ledger; step counts; how the start was projected."""

    ledger: Ledger | NullLedger
    steps: int
    iterations: float
    worst: dict[str, float] = field(default_factory=dict)
    projection: Projection | None = None
    #: steps taken with damping; adaptive runs: rejected trials, smallest and largest step (s)
    restarted: int = 0
    rejected: int = 0
    smallest: float = 0.0
    largest: float = 0.0
    #: whether a row lies within a step (rows), None for a run without such rows
    interpolated: Array | None = None
    #: what the run left out or did beside what was asked for, one line each
    notes: tuple[str, ...] = ()
    #: component -> time and signals by name at the end of the step in which it dissipated least, where that was negative
    least: dict[str, tuple[float, dict[str, float]]] = field(default_factory=dict)
