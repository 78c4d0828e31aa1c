"""A problem of a declaration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Severity = Literal["error", "warning"]


@dataclass(frozen=True)
class Problem:
    """One violated rule: the entry it was found in, what is wrong (with numbers), and what to do about it.

    severity: "error": the model is wrong and is not to be stepped;  "warning": it steps, but something in it is most
    likely not what was meant
    """

    rule: str
    entry: str
    reason: str
    remedy: str
    severity: Severity = "error"

    def __str__(self) -> str:
        mark = "warning: " if self.severity == "warning" else ""
        return f"{mark}{self.entry}: {self.reason}; {self.remedy} [{self.rule}]"
