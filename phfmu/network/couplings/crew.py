"""Threads that step members beside the one that runs the compiled master; what they compute does not depend on their number."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Thread

import numpy as np
from numpy.typing import NDArray

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
