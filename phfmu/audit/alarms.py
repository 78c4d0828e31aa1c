"""Alarms: levels below those at which a ledger is violated, worth a look."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from phfmu.audit.kinds import LedgerVerdict
from phfmu.audit.summary import LedgerSummary


@dataclass(frozen=True)
class Alarms:
    """`residual`: of a step, as a part of what is allowed;  `junction`: energy it created, as a part of what passed it."""

    residual: float = 0.1
    junction: float = 1e-6

    def __post_init__(self) -> None:
        for name in ("residual", "junction"):
            if not getattr(self, name) >= 0.0:
                raise ValueError(f"alarm {name} = {getattr(self, name)}: expected a number from 0")


def alarms(summary: LedgerSummary, levels: Alarms) -> Iterator[str]:
    """A line for each place beyond a level that is not violated; estimates are said, and never more."""
    broken = {v.name for v in summary.violations}
    for c in summary.components:
        if c.verdict is LedgerVerdict.CLOSED and c.worst_ratio > levels.residual:
            yield (
                f"warning: {c.component}: step {c.worst_step} at t = {c.worst_t0:.9g} s misses {c.worst_residual:.3e} J, "
                f"{c.worst_ratio:.2g} of what is allowed"
            )
    for j in summary.junctions:
        passed = j.exchanged or 0.0
        if j.junction not in broken and abs(j.residual) > levels.junction * passed > 0.0:
            yield (
                f"warning: junction {j.junction} created {j.residual:.3e} J, {abs(j.residual) / passed:.2g} of the "
                f"{passed:.3e} J that passed through it ({j.verdict})"
            )
