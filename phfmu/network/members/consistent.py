"""States that meet their hidden constraints."""

from __future__ import annotations

from typing import Any

from phfmu.declare.junction_words import junction_words
from phfmu.discretise.model import CONSISTENCY, Model

PROJECT = "let the run move the start onto it with --project (energy change booked)"
#: members know their own constraints only, so a coupled network cannot be projected
MONOLITHIC = f"compose the network (--coupling monolithic) and {PROJECT}"


class InconsistentState(ValueError):
    """A hidden constraint (position, velocity, Kirchhoff) does not hold; names it with its number and remedy."""


def require_consistent(model: Model, instance: Any, instead: str = PROJECT) -> None:
    """InconsistentState if a hidden constraint of the present state exceeds its tolerance; `instead` of better values."""
    if not model.checks:
        return
    values = instance.signal("observables")[-len(model.checks) :]
    bad = [
        f"{c.name}: {junction_words(model.declaration, c.name, v) or f'{c.level} residual {v:.6g}'} "
        f"(tolerance {CONSISTENCY * s:.3g})"
        for c, v, s in zip(model.checks, values, model.check_scale, strict=True)
        if not abs(v) <= CONSISTENCY * s
    ]
    if bad:
        raise InconsistentState(
            f"{model.name}: inconsistent start: {'; '.join(bad)}. A start off the constraints would chatter for ever; "
            f"change the start values so that the constraint holds (position, velocity or sum of currents), or {instead}"
        )
