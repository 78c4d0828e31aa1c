"""Hashes of states, as rows of the audit."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class StateRow:
    """The hash of the state at the end of a step [t0, t0 + h] in s: of a component, or of another `part` of the run."""

    step: int
    t0: float
    h: float
    component: str | None
    part: str | None
    hash: str
