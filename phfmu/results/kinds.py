"""Kinds of signals by their names, for files that do not say them."""

from __future__ import annotations

from collections.abc import Sequence

from phfmu.signals import CONSTRAINT, END, ENERGY, LEDGER, MARKS, MEAN, SignalKind, total


def kinds_by_name(names: Sequence[str]) -> dict[str, SignalKind]:
    """Kinds of signals by their names alone, where nothing else tells; what none of the rules fits is no key."""
    bases = {n.partition("[")[0] for n in names}
    return {n: kind for n in names if (kind := _kind_by_name(n.partition("[")[0], bases))}


def _kind_by_name(base: str, bases: set[str]) -> SignalKind | None:
    if base == MARKS:
        return "mark"
    if base.startswith(CONSTRAINT):
        return "constraint"
    if base.endswith((MEAN, END)):
        return "mean" if base.endswith(MEAN) else "end"
    if base.endswith((ENERGY, *(total(name) for name, _, _ in LEDGER))):
        return "energy"
    if base + MEAN in bases:
        return "port"
    return "algebraic" if base + END in bases else None
