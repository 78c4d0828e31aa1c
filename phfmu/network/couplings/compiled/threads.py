"""Threads that step members beside the one that runs the compiled master; what they compute does not depend on their number.

How many threads step members: as many as were asked for, or as many as some steps show to pay.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from math import inf
from threading import Thread

import numpy as np
from numpy.typing import NDArray

from phfmu.processors import processors

TRIAL = 50e-6  # s: members that take less for a trial, all together, are stepped by one thread
HAND_OVER = 25e-6  # s: what a trial must save, about what it takes to wake a thread
START = 1e-3  # s: what a run must save to start threads


def worth(cost: NDArray[np.float64], trials: int, most: int) -> int:
    """Threads for so many trials, of at most `most`; cost: what a trial of each member takes (s)."""
    count = min(most, len(cost))
    total = float(cost.sum())
    saved = total - max(float(cost.max(initial=0.0)), total / max(count, 1))
    return count if total >= TRIAL and saved >= HAND_OVER and trials * saved >= START else 1


@contextmanager
def crew(lib: ctypes.CDLL, threads: int) -> Iterator[int | None]:
    """Address of a `ph_crew` in which all threads but the caller's help; None for one."""
    if threads < 2:
        yield None
        return
    memory = np.zeros(lib.ph_crew_size() // 8 + 1)
    address = memory.ctypes.data
    lib.ph_crew_init(address)
    helpers = [Thread(target=lib.ph_crew_help, args=(address,), daemon=True) for _ in range(threads - 1)]
    for helper in helpers:
        helper.start()
    try:
        yield address
    finally:
        lib.ph_crew_end(address)
        for helper in helpers:
            helper.join()


MEASURED = 4  # steps that tell how long a trial takes
TRIALS = 2  # of a step, at least
TRIED = 16  # steps by one thread and by many, of which the faster go on


class ThreadNumber:
    """Number of threads of each part of a run: that `asked` for or, if None, the one that measured times show to pay.

    cost: seconds that trials of each member took, of which compiled code adds up the first

    Parts of a run are the same whatever the threads: where one ends shows in the last bits.
    """

    def __init__(self, members: int, asked: int | None):
        self.cost, self.trials, self._asked = np.zeros(members), 0, asked
        #: parts that were begun;  seconds of a trial by so many threads
        self._parts, self._taken = 0, dict[int, float]()

    def part(self, n: int) -> tuple[int, int]:
        """Number of steps of the next part, of n that are left, and of the threads that take it."""
        self._parts += 1
        k = min(n, (MEASURED, TRIED, TRIED, n)[min(self._parts, 4) - 1])
        if self._asked is not None:
            return k, min(self._asked, len(self.cost))
        most = worth(self.cost / self.trials, TRIALS * n, processors()) if self.trials else 1
        if self._parts < 3 or most == 1:
            return k, 1
        return k, most if self._parts == 3 or self._taken.get(most, inf) < self._taken.get(1, 0.0) else 1

    @property
    def measures(self) -> bool:
        """Whether what trials cost is still to be told."""
        return not self.trials

    def took(self, threads: int, done: int, trials: NDArray[np.int32], spent: float) -> None:
        """A part: steps that were taken, their trials, seconds."""
        if self.measures:
            self.trials += int(trials.sum())
        elif done == TRIED:
            self._taken.setdefault(threads, spent / int(trials.sum()))
