"""Refusals of a unit: the call that failed, and the step that fails of it."""

from __future__ import annotations

import re
from collections.abc import Iterable

from phfmu.fmu.export.variables import FMUError
from phfmu.outcome.status import Status, StepFailure

#: answer -> what the standard means by it, and the next move
ANSWERS = {
    "discard": ("it cannot do this step, but goes on from where it was", "try a smaller step, or look at its inputs"),
    "error": ("it met an error and cannot go on", "look at its inputs and start values, and begin the run anew"),
    "fatal": ("it met an error after which none of its instances can be used", "ask its maker; begin in a new process"),
    "pending": ("it steps on in the background, which is not supported", "export it without asynchronous steps"),
    "no progress": ("it ended a step where it began, twice at one time, so it will do so again",
                    "look at its inputs, or ask its maker"),
    "part of a step": ("it ended the step before its end, as it was allowed, but the run needs all of it",
                       "make its instance without early_return, or take smaller steps"),
    "other length": ("all of its steps have to be equal (canHandleVariableCommunicationStepSize)",
                     "move events, input rows and the stop onto the grid of steps, without --energy-rtol, --ecco "
                     "and --unconverged halve"),
    "early return": ("it ended the step before its end, which it was not allowed", "ask its maker"),
    "gone": ("it is not there any more", "ask its maker; rows and audit until here are kept"),
    "hang": ("its process was ended", "allow it more time (--isolate-timeout), or ask its maker"),
    "not finite": ("its value is not a number one can go on with", "look at its inputs and start values, or try a smaller step"),
}  # fmt: skip


#: answers that no call gave: what happened stands for the call
NOT_GIVEN = ("no progress", "not finite", "gone", "hang", "other length")

#: after these the unit is not there any more
FINAL = ("fatal", "gone", "hang")

#: what `fmu_log.c` says of a refused call: its name, what `ph_status_text` has, the numbers
_SAID = re.compile(rf"[^:]*: ({'|'.join(re.escape(s.value) for s in Status)})(\. Worst: .*)?", re.DOTALL)


class UnitCallError(FMUError):
    """A call that was not answered with ok: name of the `unit`, `function`, `answer` (a key of ANSWERS), last `words`."""

    def __init__(self, unit: str, function: str, answer: str, words: Iterable[str] = ()):
        self.unit, self.function, self.answer, self.words = unit, function, answer, tuple(words)
        super().__init__(f"{unit}: {function} answers '{answer}'{said(self.words)}")

    @property
    def status(self) -> Status | None:
        """The outcome of the solver that a unit of this package tells, which it can in a message only; None in others."""
        found = next(filter(None, map(_SAID.fullmatch, self.words)), None)
        return None if found is None else Status(found[1])


class UnitFailure(StepFailure):
    """A step that a unit of another tool refused, or left with values that are not finite (`answer`, see ANSWERS).

    `function` is the call or the variable; `words` are the last messages of the unit.
    """

    def __init__(self, unit: str, time: float, h: float, function: str, answer: str, words: Iterable[str] = ()):
        self.function, self.answer, self.words = function, answer, tuple(words)
        self.final = answer in FINAL
        status = Status.NOT_FINITE if answer == "not finite" else Status.UNIT
        super().__init__(status, unit, time, h)

    def _text(self) -> str:
        meaning, remedy = ANSWERS.get(self.answer, ("no answer of the standard", "ask its maker"))
        at = f"{self.component} at t = {self.time:.9g} s" + (f", h = {self.h:.3g} s" if self.h else "")
        what = self.function if self.answer in NOT_GIVEN else f"{self.function} answers '{self.answer}'"
        return f"{at}: {what}: {meaning}{said(self.words)}. Next: {remedy}."


def said(words: tuple[str, ...]) -> str:
    """Its messages, if there are any."""
    return f"; it says: {' | '.join(words)}" if words else ""
