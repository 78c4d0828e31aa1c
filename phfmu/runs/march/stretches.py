"""Stretches of a run between changes: input rows that fall on the grid of steps are taken inside one."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from sys import float_info

from phfmu.network.scene import Event

#: of a step: times that differ by less are one
CLOSE = 1e-9
#: of a time: what its digits and the products of the grid lose
ROUNDING = 4 * float_info.epsilon


Segment = tuple[float, float, list[Event]]


class Changes:
    """Free inputs that change between equal steps, in order: a run may have millions of them, so they are read as steps go on.

    `segments` begin with the one at step 0; those at the steps before `end` are read.
    """

    def __init__(self, segments: Iterator[Segment], step: float, end: int):
        self._segments, self._step, self._end = segments, step, end
        self._read = 0  # steps whose changes are in `_kept`, or were
        self._kept = deque[tuple[int, Event]]()

    def within(self, first: int, n: int) -> list[tuple[int, Event]]:
        """Changes at the steps first..first+n-1, numbered from `first`, which are kept until the next ones are asked for."""
        while self._kept and self._kept[0][0] < first:
            self._kept.popleft()
        while self._read < min(first + n, self._end):
            start, end, here = next(self._segments)
            if self._read:
                self._kept += [(self._read, e) for e in here]
            self._read += _whole(end - start, self._step)
        return [(k - first, e) for k, e in self._kept if k < first + n]

    def kept(self) -> list[tuple[int, Event]]:
        """Changes that were asked for last, with their steps."""
        return list(self._kept)

    def skip(self) -> None:
        """The rest of them is read past."""
        while self._read < self._end:
            start, end, _ = next(self._segments)
            self._read += _whole(end - start, self._step)


@dataclass(frozen=True)
class Stretch:
    """[start, end] in s; `events` count at the start.

    inputs: free inputs that change between steps; then all steps are equal
    """

    start: float
    end: float
    events: list[Event]
    inputs: Changes = field(default_factory=lambda: Changes(iter(()), 1.0, 0))


def stretches(segments: Callable[[], Iterator[Segment]], step: float, free: Callable[[str], bool]) -> Iterator[Stretch]:
    """(start, end, events at start) joined where the events set `free` inputs and fall on the grid of `step`.

    `segments` are gone through twice: ahead for the end of a stretch, and again for its inputs.
    """
    first: Segment | None = None
    steps, known, again = 0, dict[str, bool](), segments()

    def joined(begun: Segment) -> Iterator[Stretch]:
        inputs = Changes(again, step, steps)
        yield Stretch(*begun, inputs)
        inputs.skip()

    for start, end, here in segments():
        n = _whole(end - start, step)
        if (
            first is not None
            and _continues(first[0] + steps * step, start, step)
            and n
            and all(known[e.name] if e.name in known else known.setdefault(e.name, free(e.name)) for e in here)
        ):
            first, steps = (first[0], end, first[2]), steps + n
            continue
        if first is not None:
            yield from joined(first)
        if n:
            first, steps = (start, end, here), n
        else:
            first = None
            next(again)
            yield Stretch(start, end, here)
    if first is not None:
        yield from joined(first)


def _whole(length: float, step: float) -> int:
    """Number of steps in the length, 0 if it is no multiple."""
    n = round(length / step)
    return n if n and abs(length - n * step) <= CLOSE * step else 0


def _continues(grid: float, start: float, step: float) -> bool:
    return abs(grid - start) <= CLOSE * step + ROUNDING * abs(start)
