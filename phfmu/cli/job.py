"""What a command line asks to run, and how its head line says it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import inf
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from phfmu.network.couplings.stepper import Stepper
    from phfmu.network.scene import Scene


@dataclass(frozen=True)
class Job:
    """What a command line asks to run; `label`: for the run's head line; `whole`: one composed model, not units or members;
    `notes`: what is not as asked for, one line each, also of what `build` finds;  `order`: of the whole, None where units do
    not tell it.

    `build` makes the stepper, which may compile: what can be refused before should be.
    """

    scene: Scene
    label: str
    whole: bool
    build: Callable[[], Stepper]
    notes: list[str] = field(default_factory=list)
    order: float | None = None


def label(schemes: Sequence[Any], engine: str, coupling: str, most: float = inf, held: str = "") -> str:
    """Schemes, the order of the whole (at most `most`, and why: `held`), engine and coupling."""
    if not schemes:
        return f"units, {coupling}"
    names = " and ".join(dict.fromkeys(s.name for s in schemes))
    gradient = "" if schemes[0].gradient in ("per-term", "nodal") else f", {schemes[0].gradient}"
    own = min(s.order for s in schemes)
    why = f" (members of order {own}, {held})" if own > most else ""
    return f"{names}, order {min(most, own)}{why}{gradient}, {engine}, {coupling}"
