"""The ledger summed over a run: plain values, ready to be printed or compared."""

import math
from dataclasses import dataclass, field


@dataclass
class ComponentSummary:
    """A component over the run; the worst step is the one with the largest relative residual.

    `magnitude` is the largest sum |H_s| + |supplied| + |dissipated| + |numerical| of a step.
    """

    component: str
    H_start: float
    H_end: float
    stored: float
    dissipated: float | None
    supplied: float | None
    jumps: float | None
    worst_residual: float
    worst_relative: float
    worst_step: int
    worst_t0: float
    magnitude: float
    quality: str
    numerical: float | None = None

    @property
    def gap(self) -> float:
        """H_end - H_start - stored - jumps: energy that changed between the steps and was not booked."""
        return self.H_end - self.H_start - self.stored - (self.jumps or 0.0)


@dataclass
class PortSummary:
    """Energy that a port (all its pairs) supplied to its component over the run."""

    component: str
    port: str
    junction: str | None
    quality: str
    supplied: float


@dataclass
class JunctionSummary:
    """Energy that a junction created (its members got more than they gave), and what passed through it."""

    junction: str
    residual: float
    exchanged: float | None
    worst_residual: float


@dataclass
class NetworkSummary:
    """The balance over the run; worst_unexplained is the largest magnitude of a single step."""

    stored: float
    dissipated: float | None
    external: float | None
    junction_residual: float | None
    unexplained: float
    worst_unexplained: float
    numerical: float | None = None


@dataclass
class LedgerSummary:
    """The whole ledger summed over the run; network is None for a run without steps."""

    steps: int = 0
    t_start: float = math.nan
    t_end: float = math.nan
    components: list[ComponentSummary] = field(default_factory=list)
    ports: list[PortSummary] = field(default_factory=list)
    junctions: list[JunctionSummary] = field(default_factory=list)
    network: NetworkSummary | None = None
    events: dict[str, int] = field(default_factory=dict)
