"""Equal steps that end on the zeros of guards too, where state events happen."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from phfmu.engine.status import StepFailure
from phfmu.events.happened import Happened
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.network.members.happenings import Happenings
from phfmu.network.run.book import Book
from phfmu.network.run.march import Pace, pieces
from phfmu.network.run.options import Options
from phfmu.network.run.rows import Row
from phfmu.network.run.stretches import Stretch

Rows = Iterator[Row]


class EventSteps:
    """Grid steps of a model with state events; rows before and after each of them."""

    def __init__(self, stepper: Monolithic, book: Book, options: Options):
        for option, given in (
            ("--rtol", options.rtol is not None),
            ("--restart", options.restart > 0),
            ("--dense", options.dense is not None),
        ):
            if given:
                raise ValueError(f"{option} does not go with state events yet; take equal steps without it")
        self.stepper, self.book, self.step = stepper, book, options.step
        self._words = Happenings(stepper.model)
        self._pace = Pace()

    def takes_inputs(self, name: str) -> bool:
        """Stretches end where an input changes."""
        return False

    def over(self, stretch: Stretch, event: bool) -> Rows:
        """The rows in (start, end]; `event`: something changed at the start."""
        changed = True
        for t, h, n in pieces(stretch.start, stretch.end, self.step):
            first = 0
            while first < n:
                count = min(self._pace.steps, n - first)
                try:
                    for begun, size, steps, happened in self.stepper.land(t, h, count, first, changed):
                        if steps is not None:
                            self.book.add(begun, size, steps)
                            yield begun + size, steps.signals, np.zeros(len(size), bool)
                        if happened is not None:
                            yield self._happened(happened)
                except StepFailure as failure:
                    self.book.failed(failure)
                    raise
                first, changed = first + count, False
                self._pace.handed_over(count)

    def facts(self) -> dict[str, Any]:
        """What the result says about the steps."""
        return {}

    def notes(self) -> list[str]:
        """What was not as asked for, one line each."""
        return []

    def _happened(self, h: Happened) -> Row:
        """Books it; the row after it."""
        self.book.happened(self._words.told(h))
        self.stepper.check_start()
        return np.array([h.t]), h.signals[None], np.zeros(1, bool)
