"""The outcome of a claim that was tried: it holds, it is false, or it could not be tested."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from phfmu.vet.subject import Subject

HOLDS, FALSE, UNTESTED = "holds", "false", "untested"


@dataclass(frozen=True)
class ClaimFinding:
    """`verdict`: HOLDS, FALSE or UNTESTED;  `seen`: what was observed, with numbers, or why nothing was."""

    verdict: str
    seen: str


@dataclass(frozen=True)
class Claim:
    """A claim of a description: its `name`, how it is tried (`done`, in words), and the function that tries it."""

    name: str
    done: str
    test: Callable[[Subject], ClaimFinding]


def holds(seen: str) -> ClaimFinding:
    """The claim was tried and is true of everything that was seen."""
    return ClaimFinding(HOLDS, seen)


def false(seen: str) -> ClaimFinding:
    """The claim was tried and something that was seen contradicts it."""
    return ClaimFinding(FALSE, seen)


def untested(why: str) -> ClaimFinding:
    """The unit does not make this claim, or it could not be tried."""
    return ClaimFinding(UNTESTED, why)
