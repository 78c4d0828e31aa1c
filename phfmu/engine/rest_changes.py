"""Redundant constraints that are left out instead of others, told by name."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class RestChange:
    """The `number`-th since the start: from `time` on constraint `rests` is left out and `needed` is not (None: none)."""

    number: int
    time: float
    rests: str | None
    needed: str | None

    def __str__(self) -> str:
        if self.rests is None:
            return f"at t = {self.time:.6g} s {self.needed} is needed again"
        return f"at t = {self.time:.6g} s {self.rests} rests" + (f" instead of {self.needed}" if self.needed else "")


def named(changes: Iterable[tuple[int, float, int, int]], names: Sequence[str]) -> list[RestChange]:
    """(number, time, constraint that rests, constraint needed), -1: none."""
    return [RestChange(k, t, names[i] if i >= 0 else None, names[j] if j >= 0 else None) for k, t, i, j in changes]
