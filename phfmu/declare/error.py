"""Refusals and problems of a declaration, as data: the entry, the reason, and the remedy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Self

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


#: of a scheme; of a model; those of `phfmu check` that are found without it
RULES = frozenset({
    "order", "stages", "gradient", "closure", "pair", "drift", "constraint", "mass", "velocity", "descriptor", "singular",
    "type", "port", "shape", "symbol", "source", "start", "energy", "costate", "switch", "dissipation",
})  # fmt: skip


class Refusal(ValueError):
    """An argument does not fit its use: the entry, the reason and the remedy.

    entry:     the model or network, and within it the variable, port, block or setting (`motor: port 'shaft'`)
    reason:    what does not fit, with its numbers;  remedy: what to do about it
    rule:      a word for programs, one of RULES, or "" where none asks for it
    problems:  all that were found; the data above are those of the first
    """

    def __init__(self, entry: str, reason: str, remedy: str, rule: str = "", also: Sequence[Problem] = ()) -> None:
        super().__init__(entry, reason, remedy, rule, tuple(also))
        self.entry, self.reason, self.remedy, self.rule = entry, reason, remedy, rule
        self.problems = (Problem(rule, entry, reason, remedy), *also)

    @classmethod
    def of(cls, problems: Sequence[Problem]) -> Self:
        """One error that carries them all."""
        first, *others = problems
        return cls(first.entry, first.reason, first.remedy, first.rule, others)

    def __str__(self) -> str:
        """A line for each problem."""
        return "\n".join(f"{p.entry}: {p.reason}; {p.remedy}" for p in self.problems)


class DeclarationError(Refusal):
    """The declaration does not fit what is asked of it."""
