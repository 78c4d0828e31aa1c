"""Outcomes of a step: one enumeration whose values are the messages, and the exception that carries them."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import Any

from phfmu.engine.limits import LIMITS


class Status(Enum):
    """Outcome of a solve; order and messages are those of `ph_status` in `runtime/phfmu.h`, then those of units."""

    OK = "step accepted"
    NO_CONVERGENCE = "Newton's method did not converge, not even on the smallest substep"
    SINGULAR = "the Newton matrix is singular: an equation is missing or redundant"
    NOT_FINITE = "a value is not finite"
    LU_CAPACITY = "the factors of the Newton matrix outgrew the reserved memory"
    ABI = "model tables and compiled runtime do not belong together"
    ARGUMENT = "an argument is out of range"
    VALUE = "a given value is not finite; it was not taken over"
    NO_SENSITIVITY = "the sensitivity needs a last step of which no internal step was halved"
    #: not one of `ph_status`: what only a unit of another tool can answer
    UNIT = "a unit of another tool refused a call"


class StepFailure(RuntimeError):
    """A step that was refused; the instance is at its last accepted step.

    `component`: name of the model; `time`, `h`: start and length (s) of the refused step or substep, h = 0 if
    the values at one instant failed; `equation`: name of the row with the largest scaled residual `residual`, of
    which rounding alone leaves `floor`; `update`: last scaled change of the unknowns (1 = nominal); `iterations` of the
    last attempt, `spent` by all at this internal step; `tried`: what was attempted; `joined`: members were being joined,
    `history` the scaled residuals of that.  A run adds `asked`, the step it asked for, and `longest`, the longest it had
    solved.  The remedy follows from these (`phfmu.engine.remedy`).
    """

    def __init__(
        self,
        status: Status,
        component: str,
        time: float,
        h: float,
        *,
        equation: str = "",
        residual: float = float("nan"),
        floor: float = 0.0,
        update: float = float("nan"),
        iterations: int = 0,
        spent: int = 0,
        tried: str = "",
        joined: bool = False,
        history: Sequence[float] = (),
    ) -> None:
        self.status = status
        self.component = component
        self.time = time
        self.h = h
        self.equation = equation
        self.residual = residual
        self.floor = floor
        self.update = update
        self.iterations = iterations
        self.spent = spent
        self.tried = tried
        self.joined, self.history = joined, tuple(history)
        self.asked, self.longest = 0.0, 0.0
        #: what a run over many steps had recorded of the accepted ones
        self.recorded: dict[str, Any] = {}
        super().__init__()

    def __str__(self) -> str:
        return self._text()

    def _text(self) -> str:
        """What happened, with its numbers, and the remedy."""
        from phfmu.engine.remedy import remedy

        text = f"{self.component} at t = {self.time:.9g} s" + (f", h = {self.h:.3g} s" if self.h else "")
        text += f": {self.status.value}"
        if self.equation:
            text += f"; worst: {self.equation}"
        if self.residual == self.residual:
            text += f", scaled residual {self.residual:.3g}"
        if self.floor:
            text += f" (rounding floor {self.floor:.2g})"
        if self.update == self.update:
            text += f", last update {self.update:.3g}"
        if self.iterations:
            text += f", {self.iterations} iterations"
        if self.spent >= LIMITS["MOST_ITERATIONS"]:
            text += f", {self.spent} with all attempts: no step may take more"
        if self.tried:
            text += f"; tried {self.tried}"
        advice = remedy(self)
        return text + (f". Next: {advice}." if advice else "")
