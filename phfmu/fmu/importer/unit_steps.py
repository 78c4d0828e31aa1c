"""Steps of an instance of a unit: what each is told of states that are held, and how it may end.

States that are kept inside a unit, each freed when nobody holds it any more.
"""

from __future__ import annotations

import weakref
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.fmu.importer.archive import Archive
from phfmu.fmu.importer.refusal import UnitCallError, UnitFailure
from phfmu.fmu.importer.slave import AnySlave
from phfmu.fmu.importer.unit_books import Books
from phfmu.outcome.status import EndRequested, StepFailure


@dataclass(eq=False)
class SavedState:
    """A state inside the unit and what the instance knows beside it, its time among that; freed when nobody holds it."""

    handle: Any
    memory: dict[str, Any]


class SavedStates:
    """Saved states of one unit; the unit is freed after them."""

    def __init__(self, slave: AnySlave):
        self._slave, self._handles = slave, dict[int, tuple[Any, float]]()

    def keep(self, handle: Any, memory: dict[str, Any]) -> SavedState:
        state = SavedState(handle, memory)
        self._handles[id(handle)] = handle, memory["time"]
        weakref.finalize(state, self._forget, id(handle))
        return state

    def reach_before(self, t: float) -> bool:
        """Whether one is held that belongs to a time before t, so that it may be restored."""
        return bool(self._handles) and any(time < t for _, time in self._handles.values())

    def _forget(self, key: int) -> None:
        kept = self._handles.pop(key, None)
        if kept is not None:
            self._slave.forget(kept[0])

    def free(self) -> None:
        """All of them, then the unit."""
        for key in list(self._handles):
            self._forget(key)
        self._slave.free()


def free(states: SavedStates, archive: Archive) -> None:
    """The unit with its states; `archive` is held so that its folder outlives the library."""
    del archive
    states.free()


Array = NDArray[np.float64]

ROUNDING = 1e-6  # of a step: the time at its start, summed or multiplied


class UnitSteps:
    """`time`: where the unit is (s);  `h`: length of the last step;  `ended`: it has asked to end the simulation;
    `no_set_prior`: what steps are told, None: what is so;  `in_parts`: each is taken in two parts, of a third and two thirds.
    """

    def __init__(
        self, name: str, slave: AnySlave, states: SavedStates, books: Books, no_set_prior: bool | None, in_parts: bool
    ):
        self._name, self._slave, self._states, self._books = name, slave, states, books
        self.no_set_prior, self.in_parts = no_set_prior, in_parts
        self.begin(0.0)

    def begin(self, start: float) -> None:
        self.time, self.h, self.ended, self._stopped = start, 0.0, False, start - 1.0

    def take(self, t: float, h: float) -> float:
        """One step, booked; the time reached."""
        try:
            self._books.ahead()
            kept = self.no_set_prior
            if kept is None:
                kept = not self._states.reach_before(t - ROUNDING * h)
            reached = self._over(t, h, kept)
            looked = self._books.look()
        except UnitCallError as error:
            if self._books.estimated or error.status is None:  # its words and no remedy of ours
                raise UnitFailure(self._name, t, h, error.function, error.answer, error.words) from error
            raise StepFailure(error.status, self._name, t, h, tried=f"in the unit: {error}") from error
        if not np.isfinite(looked).all():
            raise self.not_finite(self._books.looked, looked, reached)
        if reached == t + h:
            self.time, self.h = reached, h
            self._books.book(h, looked)
            return reached
        return self._part(t, h, reached, looked)

    def _over(self, t: float, h: float, kept: bool) -> float:
        """The step itself, in two parts where that is asked for; the time reached.

        Both parts are told the same: what no state of a time before it is restored to is the step.
        """
        if not self.in_parts:
            reached, self.ended = self._slave.do_step(t, h, kept)
            return reached
        third, end = t + h / 3, t + h
        reached, self.ended = self._slave.do_step(t, third - t, kept)
        if self.ended or abs(reached - third) > ROUNDING * h:
            return reached
        self._books.within(self._books.look())
        reached, self.ended = self._slave.do_step(third, end - third, kept)
        return end if abs(reached - end) <= ROUNDING * h else reached

    def _part(self, t: float, h: float, reached: float, looked: Array) -> float:
        """The part of a step that ended before its end."""
        if reached > t:
            self.time, self.h = reached, reached - t
            self._books.book(self.h, looked)
        if self.ended:
            raise EndRequested(self._name, t, h, reached, self._slave.last_words())
        if reached <= t and self._stopped == t:
            raise UnitFailure(self._name, t, h, "no progress in its step", "no progress", self._slave.last_words())
        self._stopped = reached
        return reached

    def not_finite(self, names: Sequence[str], values: Array, t: float) -> UnitFailure:
        """The failure that names the first of the variables whose value at time t is not finite."""
        i = int(np.argmin(np.isfinite(values)))
        words = list(self._slave.words)[-1:]
        return UnitFailure(self._name, t, 0.0, f"'{names[i]}' = {values[i]}", "not finite", words)
