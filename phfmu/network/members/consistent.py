"""States that meet their hidden constraints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from phfmu.declare.error import Problem, Refusal
from phfmu.declare.junction_words import junction_words
from phfmu.discretise.model import CONSISTENCY, Model

PROJECT = "let the run move the start onto it with --project (energy change booked)"
#: members know their own constraints only; stepped apart they are moved at nodes of states, by impulses
MONOLITHIC = f"compose the network (--coupling monolithic) and {PROJECT}"


class InconsistentState(Refusal):
    """Hidden constraints (position, velocity, Kirchhoff) do not hold: one problem for each, with its number."""


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
        remedy = (
            "a start off the constraints would chatter for ever: change the start values so that the constraint holds "
            f"(position, velocity or sum of currents), or {instead}"
        )
        raise inconsistent(model.name, bad, remedy)


def inconsistent(name: str, reasons: Sequence[str], remedy: str) -> InconsistentState:
    """The error for what does not hold at the start of `name`, with one remedy for all of it."""
    return InconsistentState.of([Problem("", name, f"inconsistent start: {reason}", remedy) for reason in reasons])
