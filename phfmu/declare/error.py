"""What is refused, as data."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Self

from phfmu.declare.problem import Problem

#: of a scheme; of a model; those of `phfmu check` that are found without it
RULES = frozenset({
    "order", "stages", "gradient", "closure", "pair", "drift", "constraint", "mass", "velocity", "descriptor", "singular",
    "type", "port", "shape", "symbol", "source", "start", "energy", "costate", "switch",
})  # fmt: skip


class Refusal(ValueError):
    """What was given does not fit what is asked of it: what of it, why, and what to do.

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
