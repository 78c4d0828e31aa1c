"""The ledger summed over a run: plain values, ready to be printed or compared."""

import math
from dataclasses import dataclass, field

from phfmu.audit.judge import DEFAULT_RTOL
from phfmu.audit.kinds import LedgerVerdict, Quality
from phfmu.audit.violation import COMPONENT, Violation


@dataclass
class ComponentSummary:
    """A component over the run.

    `worst_ratio` is the largest |residual| / allowed of a step, `run_ratio` that of the sum over the run; `gap` is
    H_end - H_start - stored - jumps between its steps: energy that changed and was not booked. `gross`: sum of |energy| of its
    port pairs over the steps, None without ports.
    verdict: closed | VIOLATED | estimated | none.
    """

    component: str
    H_start: float
    H_end: float
    stored: float
    dissipated: float
    supplied: float
    jumps: float | None
    worst_residual: float
    worst_ratio: float
    worst_relative: float
    worst_step: int
    worst_t0: float
    gap: float
    verdict: LedgerVerdict
    numerical: float | None = None
    run_ratio: float = 0.0
    gross: float | None = None


@dataclass
class PortSummary:
    """Energy that a port (all its pairs) supplied to its component over the run."""

    component: str
    port: str
    junction: str | None
    quality: Quality
    supplied: float


@dataclass
class JunctionSummary:
    """Energy that a junction created (its members got more than they gave), and what passed through it.

    `residual` is the net sum over the steps, in which signs cancel; `gross` the sum of the magnitudes of the steps.
    verdict: closed | VIOLATED | estimated | loose.
    """

    junction: str
    residual: float
    exchanged: float | None
    worst_residual: float
    verdict: LedgerVerdict
    gross: float = 0.0


@dataclass
class PartSummary:
    """A part of the energy that a junction created: of a node, a held value, an impulse, or of what estimates missed."""

    junction: str
    part: str
    residual: float
    worst_residual: float


@dataclass
class TermSummary:
    """Energy that a term of H stored, or a part of R dissipated, over the run."""

    component: str
    term: str
    stores: bool
    energy: float


@dataclass
class NetworkSummary:
    """The balance over the run; worst_unexplained is the largest magnitude of a single step."""

    stored: float
    dissipated: float
    external: float | None
    junction_residual: float | None
    unexplained: float
    worst_unexplained: float
    verdict: LedgerVerdict
    numerical: float | None = None


@dataclass
class LedgerSummary:
    """The whole ledger summed over the run and judged; network is None for a run without steps."""

    steps: int = 0
    t_start: float = math.nan
    t_end: float = math.nan
    components: list[ComponentSummary] = field(default_factory=list)
    ports: list[PortSummary] = field(default_factory=list)
    junctions: list[JunctionSummary] = field(default_factory=list)
    parts: list[PartSummary] = field(default_factory=list)
    terms: list[TermSummary] = field(default_factory=list)
    network: NetworkSummary | None = None
    events: dict[str, int] = field(default_factory=dict)
    rtol: float = DEFAULT_RTOL
    violations: list[Violation] = field(default_factory=list)

    @property
    def closed(self) -> bool:
        """Whether nothing contradicts that all energy is accounted for."""
        return not self.violations

    @property
    def share(self) -> float:
        """The largest residual of a component in a step or in the run, as a share of what is allowed; above 1: it is violated."""
        judged = [c for c in self.components if c.verdict in (LedgerVerdict.CLOSED, LedgerVerdict.VIOLATED)]
        missed = [max(c.worst_ratio, c.run_ratio) for c in judged]
        return max([*missed, *(v.ratio for v in self.violations if v.kind in COMPONENT)], default=0.0)

    @property
    def most(self) -> float:
        """The larger of `share` and the share that a junction has of what it is allowed; above 1 where the run is not closed."""
        return max([self.share, *(v.ratio for v in self.violations)])

    @property
    def worst(self) -> Violation | None:
        """The violation that is largest against what is allowed."""
        return max(self.violations, key=lambda v: v.ratio, default=None)
