"""A case: a question put to the solver, the criterion that the answer must meet, and the verdict."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum


class Verdict(Enum):
    """Verdicts on a case: its criterion is met or not, could not have failed, or cannot be posed."""

    PASS = "pass"
    FAIL = "FAIL"
    AT_REST = "at rest"
    NOT_SUPPORTED = "not supported"


@dataclass(frozen=True)
class StressOutcome:
    """The outcome of a case in numbers, and whether it meets the criterion; `holds` is None where the case cannot be posed.

    `tested`: False if nothing moved, so that the criterion could not have failed.
    """

    happened: str
    holds: bool | None
    tested: bool = True


@dataclass(frozen=True)
class StressCase:
    """`target`: the component or scene it is about; `long`: takes more than some seconds, run on request only."""

    target: str
    name: str
    criterion: str
    measure: Callable[[], StressOutcome]
    long: bool = False


@dataclass(frozen=True)
class StressResult:
    """A case and its answer."""

    case: StressCase
    happened: str
    verdict: Verdict


def answer(case: StressCase) -> StressResult:
    """Run a case; an exception that it does not expect is a failure with its words."""
    try:
        found = case.measure()
    except Exception as error:
        return StressResult(case, f"{type(error).__name__}: {error}", Verdict.FAIL)
    if found.holds is None:
        return StressResult(case, found.happened, Verdict.NOT_SUPPORTED)
    if found.holds and not found.tested:
        return StressResult(case, f"at rest: nothing was tested ({found.happened})", Verdict.AT_REST)
    return StressResult(case, found.happened, Verdict.PASS if found.holds else Verdict.FAIL)


def not_supported(reason: str) -> Callable[[], StressOutcome]:
    """A case that cannot be posed, with the reason."""
    return lambda: StressOutcome(reason, None)


def refused(call: Callable[[], object], kind: type[Exception], word: str, *words: str) -> StressOutcome:
    """Holds if `call` raises an error of `kind` whose text, which is what a user reads, contains the words."""
    try:
        call()
    except kind as error:
        text = str(error.args[0]) if isinstance(error, KeyError) and error.args else str(error)
        missing = [w for w in (word, *words) if w not in text]
        note = f" (does not say {', '.join(missing)})" if missing else ""
        return StressOutcome(f"{type(error).__name__}: {_first(text)}{note}", not missing)
    return StressOutcome("was accepted", False)


def _first(text: str) -> str:
    """The first sentence, not longer than a line."""
    head = text.split(". ")[0].split("; ")[0]
    return head if len(head) <= 160 else head[:157] + "..."
