"""A problem of a declaration."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Problem:
    """One violated rule: the entry it was found in, what is wrong (with numbers), and what to do about it."""

    rule: str
    entry: str
    message: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.entry}: {self.message}; {self.remedy} [{self.rule}]"
