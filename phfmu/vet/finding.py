"""The outcome of a claim that was tried: it holds, it is false, or it could not be tested."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from phfmu.vet.subject import Subject

HOLDS, FALSE, UNTESTED = "holds", "false", "untested"


@dataclass(frozen=True)
class Finding:
    """`verdict`: HOLDS, FALSE or UNTESTED;  `seen`: what was observed, with numbers, or why nothing was."""

    verdict: str
    seen: str


@dataclass(frozen=True)
class Claim:
    """A claim of a description: its `name`, how it is tried (`done`, in words), and the function that tries it."""

    name: str
    done: str
    test: Callable[[Subject], Finding]


def holds(seen: str) -> Finding:
    """The claim was tried and is true of everything that was seen."""
    return Finding(HOLDS, seen)


def false(seen: str) -> Finding:
    """The claim was tried and something that was seen contradicts it."""
    return Finding(FALSE, seen)


def untested(why: str) -> Finding:
    """The unit does not make this claim, or it could not be tried."""
    return Finding(UNTESTED, why)
