"""Rows of the energy ledger, one kind a dataclass.

Power is positive INTO the component. Energies are in joule, times in seconds. None means absent, not zero.
"""

from dataclasses import dataclass

# how well a component's or a port's energy is known
EXACT = "exact"
ESTIMATED = "estimated"  # a quadrature, not the step's own
SILENT = "none"  # a unit that tells nothing


@dataclass(frozen=True, slots=True)
class ComponentRow:
    """One component over one step; None means that the component has no such thing.

    residual = dH + dissipated + numerical - supplied; `numerical` is what a damping scheme (Radau) lost. `moved` [J] is
    the sum over its energies of |change|, needed where they exchange energy within the component; without it
    max(|H0|, |H1|) is taken. `relative` is filled in by the ledger.
    """

    component: str
    H0: float
    H1: float
    dH: float
    dissipated: float | None = None
    supplied: float | None = None
    moved: float | None = None
    quality: str = EXACT
    newton: int | None = None
    newton_residual: float | None = None
    substeps: int | None = None
    rollbacks: int | None = None
    numerical: float | None = None
    relative: float | None = None

    @property
    def residual(self) -> float:
        return self.dH + (self.dissipated or 0.0) + (self.numerical or 0.0) - (self.supplied or 0.0)


@dataclass(frozen=True, slots=True)
class PortRow:
    """One effort/flow pair over one step: supplied = h u y, with u the input held and y its conjugate mean.

    `index` numbers the pairs of a vector port from 1. `kind` says how y was formed: step-conjugate, mean,
    displacement or endpoint. `quality` is "exact" or "estimated".
    """

    component: str
    port: str
    supplied: float
    u: float | None = None
    y: float | None = None
    index: int | None = None
    junction: str | None = None
    kind: str = "step-conjugate"
    quality: str = EXACT


@dataclass(frozen=True, slots=True)
class JunctionRow:
    """One junction over one step; residual and exchanged (sum of |supplied| / 2) come from its ports.

    `r_max` is the largest interface residual, `cond` the condition estimate of the interface matrix.
    """

    junction: str
    residual: float | None = None
    exchanged: float | None = None
    r_max: float | None = None
    cond: float | None = None
    iterations: int | None = None
    evals: int | None = None
    method: str | None = None
    accepted_by: str | None = None


@dataclass(frozen=True, slots=True)
class NetworkRow:
    """All components over one step, and the running sums; None where nothing of the kind exists."""

    H: float
    dH: float
    unexplained: float
    cum_unexplained: float
    dissipated: float | None = None
    external: float | None = None
    junction_residual: float | None = None
    cum_dissipated: float | None = None
    cum_external: float | None = None
    cum_junction_residual: float | None = None
    status: str | None = None
    numerical: float | None = None


@dataclass(frozen=True, slots=True)
class EventRow:
    """Something outside the steps: init, impulse, step-halved, rollback, nonconverged, reprojection, ..."""

    t: float
    kind: str
    component: str | None = None
    energy_jump: float | None = None
    message: str | None = None
