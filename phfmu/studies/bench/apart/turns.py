"""Times of steppers that go on from turn to turn, so that what else the machine does falls on all alike."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from time import thread_time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from phfmu.network.couplings.stepper import Stepper

WARM = 20  # steps before, in which iterations find their start


class StepperTurns:
    """Times of a step in turns of n steps of h [s] by one stepper [us]; `trials`: of each member per step of the last turn.

    end: bits of the signals at the end of the last turn
    """

    def __init__(self, stepper: Stepper, h: float, n: int, warm: int = WARM, clock: Callable[[], float] = thread_time):
        self._stepper, self._h, self._n, self._clock, self._first = stepper, h, n, clock, 0
        self.times: list[float] = []
        self.trials, self.end = 0.0, b""
        stepper.check_start()
        stepper.prepare(0.0, h)
        self._advance(warm)

    def take(self) -> None:
        self.times.append(1e6 * self._advance(self._n) / self._n)

    def _advance(self, n: int) -> float:
        """Time of n steps [s]."""
        before = self._clock()
        steps = self._stepper.advance(0.0, self._h, n, self._first)
        spent = self._clock() - before
        self._first += n
        self.trials, self.end = steps.spent / n, steps.signals[-1].tobytes()
        return spent


def in_turns(steppers: Sequence[StepperTurns], turns: int) -> None:
    """Let each stepper take its turn, so many times."""
    for _ in range(turns):
        for each in steppers:
            each.take()
